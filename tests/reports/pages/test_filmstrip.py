"""A film strip: where bodies stand at six times, against a motion made by hand."""

import math
import re

import numpy as np
import pytest

from reports.pages.player import strip
from reports.records.record import ShapeRecord
from reports.traces import Trace

# The scale of a strip: 0.9 of a frame of 150 by 84.
_WIDE, _HIGH = 150.0, 84.0


def drawn(factory, shapes: dict[str, tuple[str, tuple[float, ...]]], poses: dict[str, list[tuple[float, float, float]]], t=(0.0, 10.0)):
    scene = factory.scene().model_copy(
        update={"shapes": tuple(ShapeRecord(name=name, kind=kind, size=size) for name, (kind, size) in shapes.items())}
    )
    found = {name: np.array(values, float) for name, values in poses.items()}
    return strip(scene, Trace(np.array(t, float), {}, found))


def placed(svg: str) -> list[tuple[float, float, float]]:
    """Of each body in each frame: x, y [pixel], turn [degree]."""
    return [tuple(map(float, one)) for one in re.findall(r"translate\(([-\d.]+) ([-\d.]+)\) rotate\(([-\d.]+)\)", svg)]


def test_a_body_moves_evenly_through_six_frames(factory):
    found = drawn(factory, {"cart": ("box", (1.0, 1.0))}, {"cart": [(0.0, 0.0, 0.0), (9.0, 0.0, math.pi / 2)]})
    assert found is not None
    # From -0.5 to 9.5: ten metres in 135 pixels, about the middle 4.5.
    scale = 0.9 * _WIDE / 10.0
    moved = placed(found.svg)
    assert [x for x, _, _ in moved] == [pytest.approx(scale * (1.8 * place - 4.5), abs=0.051) for place in range(6)]
    assert [turn for _, _, turn in moved] == [pytest.approx(-18.0 * place, abs=0.051) for place in range(6)], (
        "up is up: turned against the page"
    )
    assert re.findall(r">([\d.]+ s)<", found.svg) == ["0 s", "2 s", "4 s", "6 s", "8 s", "10 s"]
    assert found.words == "6 moments of the plan, from 0 s to 10 s."


def test_up_is_up_and_a_tall_motion_is_fitted_by_its_height(factory):
    found = drawn(factory, {"ball": ("disc", (1.0,))}, {"ball": [(0.0, 0.0, 0.0), (0.0, 8.0, 0.0)]})
    scale = 0.9 * _HIGH / 10.0
    assert [y for _, y, _ in placed(found.svg)] == [pytest.approx(-scale * (1.6 * place - 4.0), abs=0.051) for place in range(6)]
    assert found.svg.count(f'r="{scale:.1f}"') == 6


@pytest.mark.parametrize(
    ("kind", "size", "mark"),
    [("box", (2.0, 1.0), "<rect x="), ("disc", (1.0,), "<circle"), ("line", (2.0,), "<path"), ("wall", (2.0,), 'class="body wall"')],
)
def test_each_kind_is_drawn_by_its_own_shape(factory, kind, size, mark):
    found = drawn(factory, {"it": (kind, size)}, {"it": [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)]})
    assert found.svg.count(mark) == 6


def test_walls_do_not_set_the_scale(factory):
    poses = {"cart": [(0.0, 0.0, 0.0), (9.0, 0.0, 0.0)], "wall": [(500.0, 0.0, 0.0)] * 2}
    both = drawn(factory, {"cart": ("box", (1.0, 1.0)), "wall": ("wall", (1000.0,))}, poses)
    alone = drawn(factory, {"cart": ("box", (1.0, 1.0))}, {"cart": poses["cart"]})
    assert placed(both.svg)[::2] == placed(alone.svg)


def test_without_bodies_or_time_there_is_none(factory):
    still = {"cart": [(0.0, 0.0, 0.0)] * 2}
    assert strip(factory.scene(), None) is None
    assert drawn(factory, {"cart": ("box", (1.0, 1.0))}, {}) is None
    assert drawn(factory, {"cart": ("box", ())}, still) is None
    assert drawn(factory, {"cart": ("box", (1.0, 1.0))}, still, t=(1.0, 1.0)) is None
    assert drawn(factory, {"cart": ("box", (1.0, 1.0))}, still) is not None, "a body that stands still is drawn"


def test_names_of_shapes_are_no_markup(factory):
    found = drawn(factory, {factory.HOSTILE: (factory.HOSTILE, (1.0,))}, {factory.HOSTILE: [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)]})
    assert "onerror" not in found.svg
