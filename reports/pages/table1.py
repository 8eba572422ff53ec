"""Table of the stages on one scene, the paper's with its Table I, and computed conclusions."""

from __future__ import annotations

from typing import NamedTuple

from models.results.run import SceneRecord
from reports.judged import distance_of
from reports.pages.section import Report, Section
from reports.paper import TABLE_1
from reports.rows import Row, known_cost, lacking
from reports.wording import cost, count, error, listing, number, percent, seconds, times, unit

# Relative agreement of costs with the paper's print: two decimals of some hundreds.
_SAME_COST = 1e-4
# Ratio of costs of one problem beyond which the more expensive solver failed.
_FAILED_COST = 2.0
_NOT_TO_BLAME = " Plans at a fraction of the paper's cost hold after the replay, so its solver stopped far from the optimum there; the method is not to blame."
# Metric prefixes of terminal errors: of the plan, of exact contact on its grid, of the replay.
_WHERE = {"plan": "", "grid": "discrete_", "replay": "replay_"}


class TerminalError(NamedTuple):
    """A cell with terminal errors of the judged replay.

    - norm: of position and velocity, if only that is known.
    - alone: position by the inputs alone, if the stage holds with feedback.
    - reason: of a missing error.
    """

    position: float | None
    velocity: float | None
    norm: float | None
    alone: float | None
    reason: str


def build(report: Report) -> Section | None:
    """Return Table I, None without a stage of the paper."""
    scene = next(filter(report.is_papers, report.scenes), None)
    return scene and _section(report, scene, "table1", "Table I: ours beside the paper")


def of_scene(report: Report, scene: SceneRecord) -> Section | None:
    """Return all stages on one scene, None without stages, or beside Table I."""
    if report.single and report.is_papers(scene):
        return None
    return _section(
        report, scene, f"stages-{report.scenes.index(scene) + 1}", f"All methods on {scene.name}"
    )


def _section(report: Report, scene: SceneRecord, anchor: str, title: str) -> Section | None:
    rows = report.rows_of_scene(scene)
    if not rows:
        return None
    values = {
        "scene": scene,
        "rows": [
            (row, {where: _end(row, prefix) for where, prefix in _WHERE.items()}) for row in rows
        ],
        "lacks": lacking(rows),
        "beside": report.is_papers(scene),
        "units": _units(rows),
        "conclusions": conclude(rows),
    }
    return Section(anchor, title, "scene.html#stages", values)


def _end(row: Row, prefix: str) -> TerminalError:
    whole = row.stage.metric(f"{prefix}terminal_error")
    name = f"{prefix}terminal_position_error"
    alone = (
        row.stage.metric(name)
        if prefix == "replay_" and row.stage.verdict == "holds with feedback"
        else None
    )
    velocity, norm = (
        row.metric(f"{prefix}terminal_velocity_error"),
        row.metric(f"{prefix}terminal_error"),
    )
    reason = (whole.reason if whole is not None else "") or row.stage.why or "no plan"
    return TerminalError(
        row.metric(name), velocity, norm, alone.value if alone is not None else None, reason
    )


def _units(rows: list[Row]) -> tuple[str, str]:
    def one(part: str) -> str:
        found = {
            metric.unit
            for row in rows
            if (metric := row.stage.judged(f"replay_terminal_{part}_error")) is not None
        }
        return unit(found.pop()) if len(found) == 1 else ""

    return one("position"), one("velocity")


def conclude(rows: list[Row]) -> list[str]:
    """Return the sentences under the table."""
    both = [row for row in rows if row.stage.paper and row.stage.cost is not None]
    return [
        *_reproduced(both),
        *_failed(both),
        *_relaxed(rows),
        *_own_model(rows),
        *_physics(rows),
        *_bought(rows),
        *_clock(both),
    ]


def _reproduced(both: list[Row]) -> list[str]:
    if not both:
        return []
    same = [row for row in both if abs(row.cost_difference or 0.0) <= _SAME_COST]
    other = [row for row in both if row not in same]
    text = f"{len(same)} of {count(len(both), 'stage')} that both have agree in cost with the paper's printed digits (1 part in {number(1 / _SAME_COST)})"
    if not same or not other:
        return [text + "."]
    far = max(other, key=lambda row: abs(row.cost_difference or 0.0))
    most = f"The largest relative difference is {percent(far.cost_difference)}, of {far.label}."
    return [f"{text}: {'; '.join(row.label for row in same)}. {most}"]


def _failed(both: list[Row]) -> list[str]:
    """Return rows whose cost is a multiple of the other's, with our error."""
    expensive, worse = [], []
    for row in both:
        theirs, ours = row.stage.paper.get("cost"), row.stage.cost
        if theirs is None or ours is None or min(ours, theirs) <= 0:
            continue
        pair = f"ours {cost(ours)}{_replayed(row, ' (replayed, it misses the goal by {})')}, the paper's {cost(theirs)}"
        if theirs / ours >= _FAILED_COST:
            expensive.append((row, f"{row.label}: {pair}, {times(theirs / ours)} as much"))
        elif ours / theirs >= _FAILED_COST:
            worse.append(f"{row.label}: {pair}, so ours is the worse one.")
    sentences = []
    if expensive:
        held = all(row.holds for row, _ in expensive)
        sentences.append(
            f"{'; '.join(text for _, text in expensive)}.{_NOT_TO_BLAME if held else ''}"
        )
    return sentences + worse


def _relaxed(rows: list[Row]) -> list[str]:
    sentences = []
    for method in dict.fromkeys(row.stage.method for row in rows if row.stage.kind == "direct"):
        mine = [row for row in rows if row.stage.method == method and row.stage.cost is not None]
        cold = next((row for row in mine if len(row.methods) == 1), None)
        warm = [row for row in mine if len(row.methods) > 1]
        if cold is None or not warm or cold.stage.cost is None:
            continue
        parts = [
            f"{row.methods[0]}{f' ({row.run.pipeline})' if row.twin else ''} {_against(row.stage.cost or 0.0, cold.stage.cost)}, {_replayed(row, '{} off the goal, ')}"
            f"{seconds(row.stage.seconds.total)} s in total"
            for row in warm
        ]
        start = f"{method} cold: cost {cost(cold.stage.cost)}, {_replayed(cold, 'replayed {} off the goal, ')}{seconds(cold.stage.seconds.total)} s"
        sentences.append(f"{start}. Warm started after {'; after '.join(parts)}.")
    return sentences


def _replayed(row: Row, words: str) -> str:
    """Return the distance of the replay's final positions from the goal in `words`, or ""."""
    return words.format(_first_of(row.ends)) if row.ends not in ("", "free end") else ""


def _first_of(distance: str) -> str:
    """Return the first part of `position 0.11 m, velocity 0.10 m/s`; the table has both."""
    return distance.partition(", velocity ")[0].removeprefix("position ").removeprefix("error ")


def _against(warm: float, cold: float) -> str:
    """Return a cost relative to the cold start's, absolute if that is 0."""
    return f"{percent(warm / cold - 1)} cost" if cold > 0 else f"cost {cost(warm)}"


def _own_model(rows: list[Row]) -> list[str]:
    ends = [
        (row, row.metric("terminal_error"), row.metric("discrete_terminal_error")) for row in rows
    ]
    cheating = [
        row
        for row, planned, truly in ends
        if planned is not None and truly is not None and planned <= 1e-3 and truly >= 0.05
    ]
    if not cheating:
        return []
    parts = [
        f"{row.label} misses by {_first_of(distance_of(row.stage, 'discrete_'))}"
        for row in cheating
    ]
    return [
        f"Plans that reach the goal in their own model only: with the true contact law in the same time step, {listing(parts)}."
    ]


def _physics(rows: list[Row]) -> list[str]:
    descended = [
        row for row in rows if row.stage.method == "relu_gd" and row.metric("physics") is not None
    ]
    if not descended:
        return []
    nonzero = [row for row in descended if row.metric("physics") != 0]
    if not nonzero:
        return [
            "The physics of every plan of ReLU gradient descent is exactly 0, as it must be when force and penetration have the same time index."
        ]
    parts = [f"{row.label}: {error(row.metric('physics'))}" for row in nonzero]
    return [
        f"The physics of a plan of ReLU gradient descent must be exactly 0, but is not in {listing(parts)}."
    ]


def _bought(rows: list[Row]) -> list[str]:
    """Return costs below the best known exact plan, with their terminal errors."""
    sentences = []
    for scene in {row.run.scene.name: row.run.scene for row in rows}.values():
        _, known = known_cost(scene) or ("", 0.0)
        cheap = [
            row
            for row in rows
            if row.stage.kind == "direct"
            and row.stage.cost is not None
            and row.stage.cost < known * (1 - 1e-6)
        ]
        below = [(row, off) for row in cheap if (off := distance_of(row.stage, "discrete_"))]
        if not known or not below:
            continue
        parts = [f"{row.label} ({cost(row.stage.cost)} at {_first_of(off)})" for row, off in below]
        sentences.append(
            f"The best known cost of an exact plan is {cost(known)}. Plans of direct methods below it buy their cost with terminal error "
            f"on their own grid: {listing(parts)}. A cost means nothing without the error beside it."
        )
    return sentences


def _clock(both: list[Row]) -> list[str]:
    timed = [row for row in both if "time" in row.stage.paper]
    ours, theirs = (
        sum(row.stage.seconds.wall for row in timed),
        sum(row.stage.paper["time"] for row in timed),
    )
    if ours <= 0:
        return []
    lacks = "" if len(timed) == len(TABLE_1) else f" ({len(timed)} of its {len(TABLE_1)} rows)"
    return [
        f"All stages, without those they start from, take {seconds(ours)} s here and {seconds(theirs)} s in the paper{lacks}, on other machines: {times(theirs / ours)} as long."
    ]
