"""Data of the scene player: shapes, poses of plan and replay, forces, on common frames."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from models.results.run import ContactRecord, RunRecord, SceneRecord, ShapeRecord
from reports.traces import Motion, Trace, at_all
from reports.wording import number

# Frames of a film, smooth for a few seconds of motion.
_FRAMES = 151
# Grains of positions over the extent of the motion: a quarter of a pixel at full width.
_GRAINS = 3600
# Levels of a force: a third of a pixel of its bar.
_LEVELS = 1000
# Grain of an angle [rad]: a quarter of a pixel at the end of a bar of 500.
_ANGLE = 5e-4
# Rank of shapes by flatness: the flatter of two has the touched side.
_SIDES = {"line": 1, "box": 2, "wall": 3}
# Largest deviation of a gap from the distance to that side, over the gap's range.
_FLAT = 1e-3


class Film(NamedTuple):
    """A film: JSON for the script, or the SVG of a strip, and its content in words."""

    markup: Markup
    words: str


def film(run: RunRecord, motions: Sequence[Motion]) -> Film | None:
    """Return the film of the last stage with poses, or None; motions: by stage."""
    shapes = [shape for shape in run.scene.shapes if shape.size]
    pairs = zip(reversed(run.stages), reversed(motions), strict=True)
    stages = ((stage, motion.plan, motion.judged(stage)) for stage, motion in pairs)
    stage, plan, replay = next(
        (item for item in stages if any(trace and trace.poses for trace in item[1:])),
        (None, None, None),
    )
    if stage is None or not shapes:
        return None
    tracks = [trace for trace in (plan, replay) if trace is not None]
    begin, end = (
        float(min(trace.t[0] for trace in tracks)),
        float(max(trace.t[-1] for trace in tracks)),
    )
    if end <= begin:
        return None
    times = begin + (end - begin) * np.arange(_FRAMES) / (_FRAMES - 1)
    names, contacts = (
        [shape.name for shape in shapes],
        [contact.name for contact in run.scene.contacts],
    )
    planned, replayed = (trace and _track(trace, names, times) for trace in (plan, replay))
    pushes, pushed = (trace and _forces(trace, contacts, times) for trace in (plan, replay))
    grain = _extent([*(planned or []), *(replayed or [])]) / _GRAINS
    strongest = max(
        (
            float(values.max())
            for values in [*(pushes or []), *(pushed or [])]
            if values is not None
        ),
        default=0.0,
    )
    push = max(strongest, 1e-9) / _LEVELS
    data = {
        "t": [begin, end, _FRAMES],
        "grain": [grain, grain, _ANGLE],
        "push": push,
        "shapes": [
            {"name": shape.name, "kind": shape.kind, "size": list(shape.size), "goal": _goal(shape)}
            for shape in shapes
        ],
        "plan": _stepped(planned, (grain, grain, _ANGLE)),
        "replay": _stepped(replayed, (grain, grain, _ANGLE)),
        "contacts": contacts,
        "touches": [_touch(shapes, (replay, plan), contact) for contact in run.scene.contacts],
        "plan_force": _stepped_forces(pushes, push),
        "replay_force": _stepped_forces(pushed, push),
    }
    how = "replayed with feedback" if stage.is_tracked else "replayed"
    goal = ", the goal dotted" if any(shape["goal"] for shape in data["shapes"]) else ""
    words = f"The bodies of {run.scene.name} moving as planned (dashed outline) and as {how} (filled){goal}, with the contact forces{' as arrows, and' if any(data['touches']) else ''} as bars (above: planned, below: replayed)."
    return Film(script_json(data), words)


def script_json(data: object) -> Markup:
    """Return JSON that cannot end its script element; NaN is refused."""
    return Markup(
        json.dumps(data, allow_nan=False, separators=(",", ":"))
        .replace("<", "\\u003c")
        .replace("\u2028", "\\u2028")
    )


def _goal(shape: ShapeRecord) -> tuple[float, float, float | None] | None:
    """Return a shape's goal if it can be drawn: all but discs need an angle."""
    return (
        shape.goal
        if shape.goal is not None and (shape.goal[2] is not None or shape.kind == "disc")
        else None
    )


def _track(
    trace: Trace, names: list[str], times: NDArray[np.float64]
) -> list[NDArray[np.float64] | None]:
    """Return x, y and angle (3, frames) of each shape, None if not stored."""
    stored = [trace.poses.get(name) for name in names]
    return [
        None if poses is None else np.array([at_all(trace.t, axis, times) for axis in poses.T])
        for poses in stored
    ]


def _touch(
    shapes: list[ShapeRecord], traces: Sequence[Trace | None], contact: ContactRecord
) -> dict[str, object] | None:
    """Return where a contact's arrows are drawn: two shapes, and the direction of the gap."""
    drawn = [shape.name for shape in shapes]
    if not set(contact.bodies) <= set(drawn):
        return None
    # The second has the side.
    first, second = sorted(
        (drawn.index(body) for body in contact.bodies),
        key=lambda place: _SIDES.get(shapes[place].kind, 0),
    )
    if shapes[second].kind not in _SIDES:
        return {"shapes": [first, second], "ends": [0.0, 0.0], "turn": None}
    faced = next(
        (
            found
            for trace in traces
            if (found := _faced(trace, shapes[first], shapes[second], contact.name))
        ),
        None,
    )
    return faced and {"shapes": [first, second], "ends": [faced[0], 0.0], "turn": faced[1]}


def _faced(
    trace: Trace | None, body: ShapeRecord, other: ShapeRecord, contact: str
) -> tuple[float, float] | None:
    """Return the touching point of a body, and the turn of the other's normal [rad], or None.

    The point: 0 centre, -0.5 and 0.5 ends of a line. The gap must be the distance along the normal,
    up to a constant.
    """
    gaps = trace and trace.gap(contact)
    if (
        trace is None
        or gaps is None
        or body.name not in trace.poses
        or other.name not in trace.poses
    ):
        return None
    (x, y, angle), (far_x, far_y, turned) = (
        trace.poses[shape.name][: len(gaps)].T for shape in (body, other)
    )
    best, least = None, _FLAT * float(np.ptp(gaps))
    for end in (0.0, -0.5, 0.5) if body.kind == "line" else (0.0,):
        across, up = (
            x + end * body.size[0] * np.cos(angle) - far_x,
            y + end * body.size[0] * np.sin(angle) - far_y,
        )
        for quarter in (1, -1, 0, 2):
            turn = quarter * math.pi / 2
            missed = float(
                np.ptp(across * np.cos(turned + turn) + up * np.sin(turned + turn) - gaps)
            )
            if missed < least:
                best, least = (end, round(turn, 6)), missed
    return best


def _extent(tracks: list[NDArray[np.float64] | None]) -> float:
    drawn = [track[:2] for track in tracks if track is not None]
    return float(np.ptp(np.concatenate(drawn, axis=1), axis=1).max()) if drawn else 1.0


def steps(values: Sequence[float] | NDArray[np.float64], grain: float) -> list[int]:
    """Return the first value (n,) [any unit] and its changes in grains, one number if constant.

    Changes of rounded sums, so that errors do not accumulate. Raises IndexError without values.
    """
    rounded = np.rint(np.divide(values, grain)).astype(int)
    changes = np.diff(rounded)
    return [int(rounded[0]), *(changes.tolist() if changes.any() else ())]


def _stepped_forces(
    forces: list[NDArray[np.float64] | None] | None, grain: float
) -> list[list[int] | None] | None:
    return (
        None
        if forces is None
        else [None if values is None else steps(values, grain) for values in forces]
    )


def _stepped(
    track: list[NDArray[np.float64] | None] | None, sizes: Sequence[float]
) -> list[list[list[int]] | None] | None:
    if track is None:
        return None
    return [
        None
        if axes is None
        else [steps(values, size) for values, size in zip(axes, sizes, strict=True)]
        for axes in track
    ]


def _forces(
    trace: Trace, contacts: list[str], times: NDArray[np.float64]
) -> list[NDArray[np.float64] | None]:
    """Return each contact's largest force within half a frame, so that short blows are visible."""
    columns = [trace.force(name) for name in contacts]
    half = (times[1] - times[0]) / 2
    return [None if values is None else _peaks(trace.t, values, times, half) for values in columns]


def _peaks(
    times: NDArray[np.float64],
    values: NDArray[np.float64],
    wanted: NDArray[np.float64],
    half: float,
) -> NDArray[np.float64]:
    length = min(len(times), len(values))
    known, there = times[:length], np.append(values[:length], -np.inf)
    begin, end = (
        np.searchsorted(known, wanted - half, "left"),
        np.searchsorted(known, wanted + half, "right"),
    )
    # reduceat returns the value at an empty interval's start; every second result is an interval.
    inside = np.maximum.reduceat(there, np.column_stack([begin, end]).ravel())[::2]
    return np.maximum(at_all(times, values, wanted), np.where(begin < end, inside, -np.inf))


# Moments of a film strip.
_MOMENTS = 6
_WIDTH = 150.0  # of a frame [px]
_HEIGHT = 84.0  # of a frame [px]
_GAP = 8.0  # between frames [px]
_FOOT = 26.0  # for times [px]


def strip(scene: SceneRecord, plan: Trace | None) -> Film | None:
    """Return even moments of a plan, None without poses."""
    shapes = [
        shape
        for shape in scene.shapes
        if shape.size and plan is not None and shape.name in plan.poses
    ]
    if plan is None or not shapes or plan.t[-1] <= plan.t[0]:
        return None
    moments = np.linspace(plan.t[0], plan.t[-1], _MOMENTS)
    poses = {
        shape.name: np.array([at_all(plan.t, axis, moments) for axis in plan.poses[shape.name].T])
        for shape in shapes
    }
    reach = {
        shape.name: max(shape.size) * (1.0 if shape.kind == "disc" else 0.5)
        for shape in shapes
        if shape.kind != "wall"
    }
    moving = list(reach) or [shape.name for shape in shapes]
    low = np.min([poses[name][:2].min(axis=1) - reach.get(name, 0.0) for name in moving], axis=0)
    high = np.max([poses[name][:2].max(axis=1) + reach.get(name, 0.0) for name in moving], axis=0)
    middle, extent = (low + high) / 2, np.maximum(high - low, 1e-9)
    scale = 0.9 * min(_WIDTH / extent[0], _HEIGHT / extent[1])
    frames = []
    for place, moment in enumerate(moments):
        left = place * (_WIDTH + _GAP)
        drawn = "".join(
            placed(shape, poses[shape.name][:, place], middle, scale, number_ % 6)
            for number_, shape in enumerate(shapes)
        )
        frames.append(
            f'<svg x="{left:.0f}" y="0" width="{_WIDTH:.0f}" height="{_HEIGHT:.0f}" viewBox="{-_WIDTH / 2:.0f} {-_HEIGHT / 2:.0f} {_WIDTH:.0f} {_HEIGHT:.0f}">'
            f'<rect class="frame" x="{-_WIDTH / 2:.0f}" y="{-_HEIGHT / 2:.0f}" width="{_WIDTH:.0f}" height="{_HEIGHT:.0f}"/>{drawn}</svg>'
            f'<text class="tick" x="{left + _WIDTH / 2:.0f}" y="{_HEIGHT + 22:.0f}" text-anchor="middle">{number(float(moment), 3)} s</text>'
        )
    wide = _MOMENTS * (_WIDTH + _GAP) - _GAP
    body = "".join(frames)
    svg = f'<svg class="plot strip" viewBox="0 0 {wide:.0f} {_HEIGHT + _FOOT:.0f}" aria-hidden="true" focusable="false">{body}</svg>'
    first, last = (number(float(moment), 3) for moment in moments[[0, -1]])
    return Film(Markup(svg), f"{_MOMENTS} moments of the plan, from {first} s to {last} s.")


def placed(
    shape: ShapeRecord, pose: np.ndarray, middle: np.ndarray, scale: float, colour: int
) -> str:
    """Return one shape at a pose (3,): x, y [m], angle [rad]; middle: (2,) [m]. Raises nothing."""
    x, y, angle = (float(value) for value in pose)
    across, up = scale * (x - middle[0]), -scale * (y - middle[1])
    turn = f'transform="translate({across:.1f} {up:.1f}) rotate({-math.degrees(angle):.1f})"'
    size = [scale * float(value) for value in shape.size]
    style = f'class="body c{colour}" {turn}'
    if shape.kind == "disc":
        return f'<g {style}><circle r="{size[0]:.1f}"/><path d="M0,0H{size[0]:.1f}"/></g>'
    if shape.kind == "line":
        return f'<g {style}><path d="M{-size[0] / 2:.1f},0H{size[0] / 2:.1f}"/></g>'
    if shape.kind == "wall":
        return (
            f'<g class="body wall" {turn}><path d="M{-size[0] / 2:.1f},0H{size[0] / 2:.1f}"/></g>'
        )
    wide, high = size[0], size[-1]
    return f'<g {style}><rect x="{-wide / 2:.1f}" y="{-high / 2:.1f}" width="{wide:.1f}" height="{high:.1f}"/></g>'
