"""The film of a run: on which bodies a contact's arrows are drawn, and which way they point."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from models.catalog import load_scene
from models.trajectory import Trajectory
from models.trajectory_netcdf import write_netcdf
from reports.pages.player import film
from reports.traces import read_motion
from validate.tasks.scene_record import scene_record

_UP, _DOWN = round(math.pi / 2, 6), -round(math.pi / 2, 6)
_BACK = round(math.pi, 6)
# The body that is pushed along the arrow, the other, the point of the first (0 centre, 0.5 end of a line), the arrow against the other's direction [rad];
# None: from centre to centre.
_ARROWS = {
    "three_cart": {"left": ("left", "middle", 0.0, _BACK), "right": ("middle", "right", 0.0, _BACK)},
    "transport": {"front": ("cargo", "cart", 0.0, _BACK), "rear": ("cargo", "cart", 0.0, 0.0)},
    "cart_pole_walls": {"left": ("pole", "left wall", 0.5, _DOWN), "right": ("pole", "right wall", 0.5, _UP)},
    "hopper": {"floor": ("foot", "floor", 0.0, _UP)},
    "two_discs_wall": {"pair": ("disc 1", "disc 2", 0.0, None), "wall_1": ("disc 1", "wall", 0.0, _DOWN), "wall_2": ("disc 2", "wall", 0.0, _DOWN)},
    "two_finger": {"left": ("left tip", "disc", 0.0, None), "right": ("right tip", "disc", 0.0, None)},
    # The force of a joint's stop is no push between two drawn bodies.
    "acrobot_limits": {"left": None, "right": None},
}  # fmt: skip


def _drawn(factory, folder, name: str, **changes) -> dict:
    """The film of a plan that was written as a campaign writes it."""
    scene = load_scene(name)
    q = np.random.default_rng(0).normal(0.0, 0.3, (60, scene.nq)) + np.asarray(scene.task.start[: scene.nq])
    still = np.zeros((60, scene.nq))
    plan = Trajectory(t=np.arange(60.0), q=q, v=still, u=np.zeros((59, scene.nu)), lam=np.zeros((59, scene.nl)))
    write_netcdf(folder / "trajectory.nc", plan, scene)
    run = factory.runs()[0]
    stage = run.stages[-1].model_copy(update={"replay": None})
    run = run.model_copy(update={"scene": scene_record(scene).model_copy(update=changes), "stages": (stage,)})
    shown = film(run, [read_motion(folder, run, stage)])
    assert shown is not None
    return json.loads(shown.data)


@pytest.mark.parametrize("name", _ARROWS)
def test_arrows_stand_on_the_bodies_that_the_scene_names_and_part_them(factory, tmp_path, name):
    data = _drawn(factory, tmp_path, name)
    found = {}
    for contact, touch in zip(data["contacts"], data["touches"], strict=True):
        first, second = (data["shapes"][place]["name"] for place in touch["shapes"]) if touch else ("", "")
        found[contact] = touch and (first, second, touch["ends"][0], touch["turn"])
    assert found == _ARROWS[name]


def test_a_record_that_names_no_bodies_is_shown_without_arrows(factory, tmp_path):
    contacts = tuple(contact.model_copy(update={"bodies": ("", "")}) for contact in scene_record(load_scene("three_cart")).contacts)
    assert _drawn(factory, tmp_path, "three_cart", contacts=contacts)["touches"] == [None, None]


def test_the_goal_is_drawn_where_the_record_has_it_and_only_a_disc_may_lack_its_angle(factory, tmp_path):
    shapes = scene_record(load_scene("three_cart")).shapes
    changed = tuple(
        shape.model_copy(update={"goal": (1.0, 2.0, None), "kind": kind})
        for shape, kind in zip(shapes, ("box", "disc", "disc"), strict=True)
    )
    assert [shape["goal"] for shape in _drawn(factory, tmp_path, "three_cart")["shapes"]] == [list(shape.goal) for shape in shapes]
    drawn = _drawn(factory, tmp_path, "three_cart", shapes=changed)
    assert [shape["goal"] for shape in drawn["shapes"]] == [None, [1.0, 2.0, None], [1.0, 2.0, None]]
