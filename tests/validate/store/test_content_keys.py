"""The key of a cell: another one for every option, eps, order and scene, the same for the same."""

import math
import os
import platform
from dataclasses import Field, fields, replace
from pathlib import Path
from typing import Any

import pytest

from formulations.method import Leg, Pipeline
from formulations.pipelines import load_method, method_names
from validate.execution.campaign import CampaignSettings, select
from validate.store import provenance
from validate.tasks.task import CheckTask


def key(*legs: Leg, scene: str = "wall_pendulum", name: str = "same", title: str = "one title") -> str:
    entries, _ = select(
        CampaignSettings(out=Path("nowhere"), scenes=(scene,), expression="same", pipelines=(Pipeline(name=name, title=title, legs=legs),))
    )
    (entry,) = entries
    return entry.task.key


def others(item: Field[Any]) -> list[object]:
    """Values of an option that are not its default: all others of a choice, the nearest numbers (two away where they may have to be even)."""
    default, bounds = item.default, (item.metadata["lower"], item.metadata["upper"])
    if item.metadata["choices"]:
        return [choice for choice in item.metadata["choices"] if choice != default]
    if default is None:
        return [bound for bound in bounds if math.isfinite(bound)]
    if isinstance(default, tuple):
        return [default[:-1], (*default[:-1], math.nextafter(default[-1], math.inf))]
    near = (
        [default - 2, default + 2] if isinstance(default, int) else [math.nextafter(default, -math.inf), math.nextafter(default, math.inf)]
    )
    return [value for value in near if bounds[0] <= value <= bounds[1]]


@pytest.mark.slow
@pytest.mark.parametrize("name", method_names())
def test_every_option_of_every_method_has_a_key_of_its_own(name: str):
    method = load_method(name)
    asked = Leg(method=name, schedule=(1e-2 if method.needs_eps else None,))
    options = fields(method.options)
    changed = [{item.name: value} for item in options for value in others(item)]
    assert {name for variant in changed for name in variant} == {item.name for item in options}, "each option in turn"
    keys = [key(replace(asked, options=variant)) for variant in changed]
    assert len({key(asked), *keys}) == 1 + len(changed)
    by_stage = [key(replace(asked, stage_options=(variant,))) for variant in changed]
    assert by_stage == keys, "it is what a stage is given that counts, not how"
    assert key(replace(asked, options={item.name: item.default for item in options})) == key(asked)


SOFT = Leg(method="softplus_dc", schedule=(1e-3, 1e-5))
STRICT = Leg(method="strict_lcp")


@pytest.mark.slow
def test_whatever_is_asked_otherwise_has_another_key():
    variants = {
        "as it is": key(SOFT, STRICT), "another eps": key(replace(SOFT, schedule=(1e-3, math.nextafter(1e-5, 1.0))), STRICT),
        "the same eps in another order": key(replace(SOFT, schedule=(1e-5, 1e-3)), STRICT),
        "a stage less": key(replace(SOFT, schedule=(1e-3,)), STRICT), "a method less": key(SOFT),
        "the methods the other way round": key(STRICT, SOFT),
        "an option of one stage": key(replace(SOFT, stage_options=({"max_iterations": 7},)), STRICT),
        "an option of the other stage": key(replace(SOFT, stage_options=({}, {"max_iterations": 7})), STRICT),
        "another scene": key(SOFT, STRICT, scene="three_cart"), "another name": key(SOFT, STRICT, name="same_otherwise"),
    }  # fmt: skip
    assert len(set(variants.values())) == len(variants)
    assert key(SOFT, STRICT) == variants["as it is"]


@pytest.mark.slow
def test_another_linear_solver_or_library_has_another_key(monkeypatch: pytest.MonkeyPatch):
    ours = key(STRICT)
    monkeypatch.setenv("TOUCHSTONE_LINEAR_SOLVER", "mumps")
    theirs = key(STRICT)
    monkeypatch.setenv("TOUCHSTONE_LINEAR_SOLVER", "another")
    assert len({ours, theirs, key(STRICT)}) == 3
    monkeypatch.delenv("TOUCHSTONE_LINEAR_SOLVER")
    assert key(STRICT) == ours
    versions = provenance.library_versions()
    for name in versions:
        monkeypatch.setattr(provenance, "library_versions", lambda name=name: {**versions, name: "another"})
        assert key(STRICT) != ours, name


def _sources_with(changed: str) -> dict[str, str]:
    return {**SOURCES, changed: "another digest"}


SOURCES = provenance._source_digests()
# A file of ours, and whether it decides: a run of strict_lcp, a check of nothing but models/fmu, one that names no sources, which has all.
DECIDES = {
    "models/fmu/package.py": (True, True, True), "models/dynamics.py": (True, False, True), "formulations/methods/strict_lcp.py": (True, False, False),
    "formulations/methods/mpcc.py": (False, False, False), "models/scenes/three_cart.py": (False, False, False), "validate/tasks/check.py": (False, True, True),
    "validate/judge/score/measures.py": (True, False, True), "reports/records/record.py": (True, True, True),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("changed", DECIDES)
def test_a_key_is_of_the_sources_that_decide_and_of_no_others(changed: str, monkeypatch: pytest.MonkeyPatch):
    assert changed in SOURCES, "or nothing would be changed"
    one = CheckTask(kind="k", name="n", expected="e", function="f", sources=("models/fmu",))
    whole = replace(one, sources=())

    def keys() -> tuple[str, ...]:
        return key(STRICT), provenance.check_key(one), provenance.check_key(whole)

    before = keys()
    monkeypatch.setattr(provenance, "_source_digests", lambda: _sources_with(changed))
    assert tuple(now != then for now, then in zip(keys(), before, strict=True)) == DECIDES[changed]


def test_a_record_says_where_it_came_from():
    told = provenance.gather("python -m validate all")
    assert told.platform == platform.platform()
    assert told.python.split() == [platform.python_implementation(), platform.python_version()]
    assert told.cores == len(os.sched_getaffinity(0))
    assert told.threads == 1
    assert told.command == "python -m validate all"
    assert told.packages == {name: version for name, version in provenance.library_versions().items() if name != "python"}
    information = Path("/proc/cpuinfo")
    if information.exists():
        models = {
            line.partition(":")[2].strip() for line in information.read_text(encoding="utf-8").splitlines() if line.startswith("model name")
        }
        assert not models or any(model in told.cpu for model in models)
