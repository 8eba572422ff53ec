"""The rules that `ablate` switches off: where each one is, and what takes its place."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np


@dataclass(frozen=True, kw_only=True)
class Rule:
    """A rule of a planner.

    place: `module:attribute` or `module:Class.method`; off: the value or function that takes its
    place; pipelines: those that it may change.
    """

    name: str
    place: str
    off: Any
    pipelines: tuple[str, ...]


def _none(*_: object, **__: object) -> None:
    return None


def _false(*_: object, **__: object) -> bool:
    return False


def _nothing(*_: object, **__: object) -> Iterator[Any]:
    return iter(())


_MPCC = ("mpcc",)
_STRICT = ("strict", "softplus_dc+strict", "relaxed+strict")
_RELAXED = ("relaxed+strict",)
_SOFT = ("softplus_dc+strict",)
_FINDER = "formulations.contact_modes.finder:"
_SEARCH = "formulations.contact_modes.search:"
_QUADRATIC = "formulations.contact_modes.quadratic:"
_STRICT_LCP = "formulations.methods.strict_lcp:"
_SOLVING = "formulations.transcription.solving:"
_BEST = "formulations.methods.best_exact:"
_ENDLESS = 10**9

RULES = (
    Rule(
        name="mpcc: a coarser grid first",
        place=f"{_FINDER}Finder._coarse",
        off=_none,
        pipelines=_MPCC,
    ),
    Rule(
        name="mpcc: modes of relaxed complementarity",
        place=f"{_FINDER}Finder._relaxed",
        off=_none,
        pipelines=_MPCC,
    ),
    Rule(
        name="mpcc: random inputs corrected to the goal",
        place=f"{_FINDER}Finder._corrected",
        off=_nothing,
        pipelines=_MPCC,
    ),
    Rule(
        name="mpcc: modes that miss the goal continued to it",
        place=f"{_FINDER}Finder._continued",
        off=_none,
        pipelines=_MPCC,
    ),
    Rule(
        name="mpcc: search around loosened modes",
        place=f"{_FINDER}Finder._loosened",
        off=_none,
        pipelines=_MPCC,
    ),
    Rule(
        name="mpcc: search around walked modes",
        place=f"{_FINDER}Finder._walked",
        off=_none,
        pipelines=_MPCC,
    ),
    Rule(
        name="mpcc: modes of the corrected rollout",
        place=f"{_FINDER}correct_end",
        off=lambda scene, kernel, u, **_: (
            kernel.rollout(np.array(scene.task.start), u, scene.task.step),
            u,
        ),
        pipelines=_MPCC,
    ),
    Rule(
        name="mpcc: whether the goal is out of reach",
        place=f"{_FINDER}Finder._is_out_of_reach",
        off=_false,
        pipelines=_MPCC,
    ),
    Rule(
        name="mpcc: detours",
        place=f"{_SEARCH}_Search._detours",
        off=_false,
        pipelines=_MPCC,
    ),
    Rule(
        name="mpcc: detours by a repetition",
        place=f"{_SEARCH}_REPEATED",
        off=0,
        pipelines=_MPCC,
    ),
    Rule(
        name="mpcc: an interval repeated",
        place=f"{_SEARCH}_Search._repeat",
        off=_false,
        pipelines=_MPCC,
    ),
    Rule(
        name="mpcc: rearranged intervals",
        place=f"{_SEARCH}rearrangements",
        off=_nothing,
        pipelines=_MPCC,
    ),
    Rule(
        name="mpcc: fewer intervals first",
        place=f"{_SEARCH}fewer",
        off=_nothing,
        pipelines=_MPCC,
    ),
    Rule(
        name="mpcc: switched ends moved onwards",
        place=f"{_SEARCH}onwards",
        off=_none,
        pipelines=_MPCC,
    ),
    Rule(
        name="mpcc: pairs switched one by one",
        place=f"{_SEARCH}_ALONE",
        off=0,
        pipelines=_MPCC,
    ),
    Rule(
        name="mpcc: throws",
        place="formulations.contact_modes.session:MultiStart._thrown_instead",
        off=lambda self, before, budget: before,
        pipelines=_MPCC,
    ),
    Rule(
        name="mpcc: active conditions of a neighbour first",
        place=f"{_QUADRATIC}_MANY",
        off=_ENDLESS,
        pipelines=_MPCC,
    ),
    Rule(
        name="mpcc: active conditions by an interior-point method",
        place=f"{_QUADRATIC}interior_point_active_set",
        off=_none,
        pipelines=_MPCC,
    ),
    Rule(
        name="mpcc: a stiff contact begins softer",
        place="formulations.contact_modes.nonlinear:_TOUCH",
        off=1e300,
        pipelines=_MPCC,
    ),
    Rule(
        name="strict: looser bounds first",
        place=f"{_STRICT_LCP}_FIRST_BOUND",
        off=0.0,
        pipelines=_STRICT,
    ),
    Rule(
        name="strict: from well inside the bounds",
        place=f"{_STRICT_LCP}_FROM_PLAN",
        off=_ENDLESS,
        pipelines=_STRICT,
    ),
    Rule(
        name="strict: modes of the rollout",
        place=f"{_STRICT_LCP}StrictLCPSession._exact",
        off=lambda self, budget, plan: self._with_modes(budget, self._solver.residuals.modes(plan)),
        pipelines=_STRICT,
    ),
    Rule(
        name="strict: tighter bounds",
        place=f"{_STRICT_LCP}_LAST_BOUND",
        off=1.0,
        pipelines=_STRICT,
    ),
    Rule(
        name="strict: pairs switched to a cheaper mode",
        place=f"{_SOLVING}FixedModes._cheaper_modes",
        off=lambda self, budget, result, closed: np.zeros_like(closed, dtype=bool),
        pipelines=_STRICT,
    ),
    Rule(
        name="strict: barrier near the plan",
        place=f"{_SOLVING}_NEAR",
        off={},
        pipelines=_STRICT,
    ),
    Rule(
        name="Ipopt: stop in restoration",
        place=f"{_SOLVING}_MOST_RESTORATIONS",
        off=_ENDLESS,
        pipelines=_STRICT,
    ),
    Rule(
        name="Ipopt: begin again where multipliers run away",
        place=f"{_SOLVING}_RUNAWAY",
        off=float("inf"),
        pipelines=_STRICT,
    ),
    Rule(
        name="Ipopt: barrier of a cold start",
        place="formulations.transcription.method:BarrierOptions.cold_barrier",
        off=lambda self: {},
        pipelines=_STRICT,
    ),
    Rule(
        name="relaxed: a coarser grid first",
        place="formulations.methods.relaxed_lcp:_LONG",
        off=_ENDLESS,
        pipelines=_RELAXED,
    ),
    Rule(
        name="relaxed: softer from a cold start",
        place="formulations.methods.relaxed_lcp:RelaxedLCPSession._reached_cold",
        off=lambda self, stage, eps: self._first_to_end(stage, [eps])[0],
        pipelines=_RELAXED,
    ),
    Rule(
        name="homotopy: the goal released",
        place=f"{_SOLVING}plan_with_goal_released",
        off=_none,
        pipelines=(*_SOFT, *_RELAXED),
    ),
    Rule(
        name="best_exact: a stable step first",
        place=f"{_BEST}_stable",
        off=lambda scene, halvings: scene,
        pipelines=("best_exact",),
    ),
    Rule(
        name="best_exact: shots from random pushes",
        place=f"{_BEST}BestExactSession._shots",
        off=_nothing,
        pipelines=("best_exact",),
    ),
)


def _owner(place: str) -> tuple[Any, str]:
    """Return the module or class that holds an attribute, and its name."""
    module, _, path = place.partition(":")
    owner: Any = import_module(module)
    *outer, name = path.split(".")
    for item in outer:
        owner = getattr(owner, item)
    return owner, name


@contextmanager
def switched_off(rule: Rule) -> Iterator[None]:
    """Put what stands for a rule in its place; raise AttributeError if nothing is there."""
    owner, name = _owner(rule.place)
    kept = getattr(owner, name)
    setattr(owner, name, rule.off)
    try:
        yield
    finally:
        setattr(owner, name, kept)


@contextmanager
def observed(rules: tuple[Rule, ...]) -> Iterator[set[str]]:
    """Collect the names of the rules that may act: constants always, functions once called."""
    called: set[str] = set()
    kept: list[tuple[Any, str, Any]] = []

    def watched(rule: Rule, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return the function, which notes its rule."""

        def noted(*arguments: Any, **named: Any) -> Any:
            """Call the function."""
            called.add(rule.name)
            return function(*arguments, **named)

        return noted

    for rule in rules:
        owner, name = _owner(rule.place)
        value = getattr(owner, name)
        if callable(value):
            kept.append((owner, name, value))
            setattr(owner, name, watched(rule, value))
        else:
            called.add(rule.name)
    try:
        yield called
    finally:
        for owner, name, value in kept:
            setattr(owner, name, value)
