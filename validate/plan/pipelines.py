"""The pipelines of a campaign file: ours by name, its own as they are spelt out, each once a seed where it draws at random."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from formulations.method import Leg, Method, Pipeline
from models.errors import TouchstoneError
from validate.plan.mistakes import hint
from validate.plan.schema import CampaignFile, LegEntry, PipelineEntry

SOURCE = "a campaign file"
_LONGEST_NAME = 60


def chosen_pipelines(
    file: CampaignFile, ours: Sequence[Pipeline], load_method: Callable[[str], Method]
) -> tuple[tuple[Pipeline, ...], list[str]]:
    """The pipelines to run, none for all of ours; and mistakes."""
    known = {pipeline.name: pipeline for pipeline in ours}
    mistakes: list[str] = []
    own: dict[str, Pipeline] = {}
    for name, entry in file.pipeline.items():
        wrong = [*_name_mistakes(name, known), *_leg_mistakes(entry, load_method)]
        mistakes += [f"pipeline.{name[:_LONGEST_NAME]}{sentence}" for sentence in wrong]
        own[name] = _pipeline(name, entry)
    names = file.pipelines or list(own)
    for place, name in enumerate(names):
        if name not in known and name not in own:
            mistakes.append(f"pipelines[{place}]: there is no pipeline {name[:80]!r}; {hint(name, [*own, *known])}")
        elif name in names[:place]:
            mistakes.append(f"pipelines[{place}]: {name!r} stands there twice")
    if mistakes:
        return (), mistakes
    picked = [own.get(name) or known[name] for name in names]
    return (tuple(picked), []) if not file.seeds else _seeded(picked, file.seeds, load_method)


def _name_mistakes(name: str, known: Mapping[str, Pipeline]) -> Iterator[str]:
    if name in known:
        yield ": it is a pipeline of ours; choose another name"
    if not name.isprintable() or name != name.strip() or not 0 < len(name) <= _LONGEST_NAME:
        yield f": a name is 1 to {_LONGEST_NAME} letters, digits and signs, without blanks at its ends"


def _leg_mistakes(entry: PipelineEntry, load_method: Callable[[str], Method]) -> Iterator[str]:
    for place, leg in enumerate(entry.legs):
        where = f".legs[{place}]"
        try:
            method = load_method(leg.method)
        except (TouchstoneError, KeyError) as error:
            yield f"{where}.method: {error if isinstance(error, TouchstoneError) else f'there is no method {leg.method!r}'}"
            continue
        if method.needs_eps and not leg.eps:
            yield f"{where}.eps: method {leg.method} needs a schedule, such as eps = [1e-3, 1e-5]"
        for number, eps in enumerate(leg.eps):
            yield from _refused(f"{where}.eps[{number}]", method.check_eps, eps)
        stages = len(leg.eps) or 1
        if len(leg.stage_options) > stages:
            yield f"{where}.stage_options: they are for {len(leg.stage_options)} stages, but there {'is' if stages == 1 else 'are'} {stages}"
        yield from (f"{where}.{sentence}" for sentence in _option_mistakes(leg, method))


def _option_mistakes(leg: LegEntry, method: Method) -> Iterator[str]:
    sections = {"options": leg.options, **{f"stage_options[{number}]": own for number, own in enumerate(leg.stage_options)}}
    single = [
        sentence
        for section, options in sections.items()
        for name, value in options.items()
        for sentence in _refused(f"{section}.{name[:80]}", method.read_options, {name: value})
    ]
    yield from single
    if not single:  # options that are impossible only together
        for section, options in sections.items():
            yield from _refused(section, method.read_options, {**leg.options, **options})


def _refused(where: str, check: Callable[[Any], Any], value: Any) -> Iterator[str]:
    try:
        check(value)
    except (TouchstoneError, TypeError, ValueError, OverflowError) as error:
        yield f"{where}: {error}"


def _pipeline(name: str, entry: PipelineEntry) -> Pipeline:
    return Pipeline(name=name, title=entry.title or name, legs=tuple(_leg(leg) for leg in entry.legs), source=SOURCE)


def _leg(entry: LegEntry) -> Leg:
    return Leg(
        method=entry.method,
        schedule=tuple(entry.eps) or (None,),
        options=dict(entry.options),
        stage_options=tuple(dict(options) for options in entry.stage_options),
    )


def _seeded(
    pipelines: Sequence[Pipeline], seeds: Sequence[int], load_method: Callable[[str], Method]
) -> tuple[tuple[Pipeline, ...], list[str]]:
    if not pipelines:
        return (), ["seeds: name the pipelines that are to be run with them (pipelines = [...])"]
    if len(set(seeds)) < len(seeds):
        return (), ["seeds: one of them stands there twice"]
    found: list[Pipeline] = []
    mistakes: list[str] = []
    for pipeline in pipelines:
        draws = {leg.method for leg in pipeline.legs if hasattr(load_method(leg.method).options, "seed")}
        for name in sorted(draws):
            for place, seed in enumerate(seeds):
                mistakes += _refused(f"seeds[{place}]", load_method(name).read_options, {"seed": seed})
        found += [_with_seed(pipeline, draws, seed) for seed in seeds] if draws else [pipeline]
    if len(found) == len(pipelines) and not mistakes and found == list(pipelines):
        mistakes.append("seeds: none of these pipelines draws at random; leave them out")
    return tuple(found), mistakes


def _with_seed(pipeline: Pipeline, draws: set[str], seed: int) -> Pipeline:
    legs = tuple(replace(leg, options={**leg.options, "seed": seed}) if leg.method in draws else leg for leg in pipeline.legs)
    return replace(pipeline, name=f"{pipeline.name} seed {seed}", title=f"{pipeline.title}; seed {seed}", legs=legs)
