"""CPU time of the replay against its true error, per scene: Model Exchange by tolerance, Co-Simulation by step and integrator."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace

from benchmarks.pages.chart import chart
from benchmarks.records import AnyRecord, ReplaySpeedRecord, SpeedRow, SpeedScene
from reports.pages.section import Section
from reports.wording import error, listing, number, small, spaced

# Errors that a reader may want [m]: what judges a plan, and what judges the replay itself.
_GOALS = (1e-3, 1e-6, 1e-9)
# Below this an error is rounding; drawn at the edge.
_SMALLEST = 1e-16


def build(records: Sequence[AnyRecord]) -> Section | None:
    """The section, or None where no replay has a measured error."""
    scenes = [
        scene
        for record in records
        if isinstance(record, ReplaySpeedRecord)
        for scene in record.scenes
    ]
    views = [
        _view(scene) for scene in scenes if any(row.error_m is not None for row in scene.sweep)
    ]
    if not views:
        return None
    return Section(
        "replay-speed",
        "The replay: speed against error",
        "replay_speed.html",
        {"views": views, "setting": _setting},
    )


def _setting(row: SpeedRow) -> str:
    """As in rtol 1e-8, or h/100."""
    return f"rtol {small(row.setting)}" if "rtol" in row.kind else f"h/{number(row.setting)}"


def _name(kind: str) -> str:
    return spaced(kind.removesuffix(", rtol"))


def _view(scene: SpeedScene) -> SimpleNamespace:
    known = [(row, row.error_m) for row in scene.sweep if row.error_m is not None]
    series = {
        _name(kind): [
            (
                max(missed, _SMALLEST),
                row.cpu_s,
                f"{_name(kind)}, {_setting(row)}: error {error(row.error_m)} m, {error(row.cpu_s)} CPU s",
            )
            for row, missed in sorted(known, key=lambda item: item[0].setting)
            if row.kind == kind
        ]
        for kind in dict.fromkeys(row.kind for row, _ in known)
    }
    title = f"{scene.name}: CPU time against true error"
    plot = chart(
        title, ("largest position error", "m"), ("CPU time of a replay", "s"), series, lines=True
    )
    assert plot is not None, "build leaves out a scene without a point"
    plot.words = "Further left is more exact, further down is faster; each point is one replay."
    lost = [row for row in scene.sweep if row.error_m is None]
    return SimpleNamespace(scene=scene, plot=plot, sentence=_sentence(scene, known), lost=lost)


def _sentence(scene: SpeedScene, known: list[tuple[SpeedRow, float]]) -> str:
    cheapest: dict[
        int, list[str]
    ] = {}  # place of a row -> the goals that it reaches for the least time
    never = []
    for goal in _GOALS:
        good = [(row.cpu_s, place) for place, (row, missed) in enumerate(known) if missed <= goal]
        if good:
            cheapest.setdefault(min(good)[1], []).append(small(goal))
        else:
            never.append(small(goal))
    parts = []
    for place, goals in cheapest.items():
        row = known[place][0]
        parts.append(
            f"an error of at most {listing(goals)} m by {_name(row.kind)} at {_setting(row)} ({error(row.cpu_s)} CPU s)"
        )
    words = f"Cheapest for {listing(parts)}." if parts else ""
    if never:
        words += f" Nothing in this sweep reaches {listing(never)} m."
    own = (
        "does not say how exact it is"
        if scene.self_error_m is None
        else f"says of itself that it is exact to {error(scene.self_error_m)} m"
    )
    words += f" The default replay - two tolerances, three steps - takes {error(scene.default_cpu_s)} CPU s and {own}."
    closed = scene.closed_form_relative_errors
    if closed:
        told = listing([f"{name} to {error(value)}" for name, value in closed.items()])
        words += f" Against the closed form, relative: {told}."
    return words.strip()
