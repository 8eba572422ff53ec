"""A film strip: the bodies of a plan at a few times, as one small SVG."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from reports.records.record import SceneRecord, ShapeRecord
from reports.traces import Trace, at_all
from reports.wording import number

_FRAMES, _WIDTH, _HEIGHT, _GAP, _FOOT = 6, 150.0, 84.0, 8.0, 26.0


@dataclass(frozen=True)
class Strip:
    """The SVG, and what it shows in words."""

    svg: Markup
    words: str


def strip(scene: SceneRecord, plan: Trace | None) -> Strip | None:
    """Six moments of a plan, first and last among them; None where no shape has poses."""
    shapes = [shape for shape in scene.shapes if shape.size and plan is not None and shape.name in plan.poses]
    if plan is None or not shapes or plan.t[-1] <= plan.t[0]:
        return None
    moments = np.linspace(plan.t[0], plan.t[-1], _FRAMES)
    poses = {shape.name: np.array([at_all(plan.t, axis, moments) for axis in plan.poses[shape.name].T]) for shape in shapes}
    reach = {shape.name: max(shape.size) * (1.0 if shape.kind == "disc" else 0.5) for shape in shapes if shape.kind != "wall"}
    moving = list(reach) or [shape.name for shape in shapes]
    low = np.min([poses[name][:2].min(axis=1) - reach.get(name, 0.0) for name in moving], axis=0)
    high = np.max([poses[name][:2].max(axis=1) + reach.get(name, 0.0) for name in moving], axis=0)
    middle, extent = (low + high) / 2, np.maximum(high - low, 1e-9)
    scale = 0.9 * min(_WIDTH / extent[0], _HEIGHT / extent[1])
    frames = []
    for place, moment in enumerate(moments):
        left = place * (_WIDTH + _GAP)
        drawn = "".join(placed(shape, poses[shape.name][:, place], middle, scale, number_ % 6) for number_, shape in enumerate(shapes))
        frames.append(
            f'<svg x="{left:.0f}" y="0" width="{_WIDTH:.0f}" height="{_HEIGHT:.0f}" viewBox="{-_WIDTH / 2:.0f} {-_HEIGHT / 2:.0f} {_WIDTH:.0f} {_HEIGHT:.0f}">'
            f'<rect class="frame" x="{-_WIDTH / 2:.0f}" y="{-_HEIGHT / 2:.0f}" width="{_WIDTH:.0f}" height="{_HEIGHT:.0f}"/>{drawn}</svg>'
            f'<text class="tick" x="{left + _WIDTH / 2:.0f}" y="{_HEIGHT + 22:.0f}" text-anchor="middle">{number(float(moment), 3)} s</text>'
        )
    wide = _FRAMES * (_WIDTH + _GAP) - _GAP
    body = "".join(frames)
    svg = f'<svg class="plot strip" viewBox="0 0 {wide:.0f} {_HEIGHT + _FOOT:.0f}" aria-hidden="true" focusable="false">{body}</svg>'
    return Strip(Markup(svg), f"{_FRAMES} moments of the plan, from {number(float(moments[0]), 3)} s to {number(float(moments[-1]), 3)} s.")


def placed(shape: ShapeRecord, pose: np.ndarray, middle: np.ndarray, scale: float, colour: int) -> str:
    """One shape at a pose x, y [m], angle [rad]; up is up."""
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
        return f'<g class="body wall" {turn}><path d="M{-size[0] / 2:.1f},0H{size[0] / 2:.1f}"/></g>'
    wide, high = size[0], size[-1]
    return f'<g {style}><rect x="{-wide / 2:.1f}" y="{-high / 2:.1f}" width="{wide:.1f}" height="{high:.1f}"/></g>'
