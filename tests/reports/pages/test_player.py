"""The film of a run: on which bodies a contact's arrows are drawn, and which way they point.

A film strip: where bodies stand at six times, against a motion made by hand.
"""

import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from wording import unsaid

from models.catalog import load_scene
from models.results.run import ContactRecord, ShapeRecord, TrackedRecord
from models.trajectory import Trajectory
from models.trajectory_netcdf import write_netcdf
from reports.pages.player import film, script_json, steps, strip
from reports.traces import Motion, Trace, read_motion
from tests.reports import record_factory
from validate.tasks.scene_record import scene_record

_UP = round(math.pi / 2, 6)
_DOWN = -round(math.pi / 2, 6)
_BACK = round(math.pi, 6)
# The body that is pushed along the arrow, the other, the point of the first (0 centre, 0.5 end of a
# line), the arrow against the other's direction [rad]; None: from centre to centre.
_ARROWS = {
    "three_cart": {"left": ("left", "middle", 0.0, _BACK),
                   "right": ("middle", "right", 0.0, _BACK)},
    "transport": {"front": ("cargo", "cart", 0.0, _BACK), "rear": ("cargo", "cart", 0.0, 0.0)},
    "cart_pole_walls": {"left": ("pole", "left wall", 0.5, _DOWN),
                        "right": ("pole", "right wall", 0.5, _UP)},
    "hopper": {"floor": ("foot", "floor", 0.0, _UP)},
    "two_discs_wall": {"pair": ("disc 1", "disc 2", 0.0, None),
                       "wall_1": ("disc 1", "wall", 0.0, _DOWN),
                       "wall_2": ("disc 2", "wall", 0.0, _DOWN)},
    "two_finger": {"left": ("left tip", "disc", 0.0, None),
                   "right": ("right tip", "disc", 0.0, None)},
    # The force of a joint's stop is no push between two drawn bodies.
    "acrobot_limits": {"left": None, "right": None},
}  # fmt: skip


def _drawn(factory, folder, name: str, **changes) -> dict:
    """The film of a plan that was written as a campaign writes it."""
    scene = load_scene(name)
    q = np.random.default_rng(0).normal(0.0, 0.3, (60, scene.nq)) + np.asarray(
        scene.task.start[: scene.nq]
    )
    still = np.zeros((60, scene.nq))
    plan = Trajectory(
        t=np.arange(60.0), q=q, v=still, u=np.zeros((59, scene.nu)), lam=np.zeros((59, scene.nl))
    )
    write_netcdf(folder / "trajectory.nc", plan, scene)
    run = factory.runs()[0]
    stage = replace(run.stages[-1], replay=None)
    run = replace(run, scene=replace(scene_record(scene), **changes), stages=(stage,))
    shown = film(run, [read_motion(folder, run, stage)])
    return json.loads(shown.markup)


@pytest.mark.parametrize("name", _ARROWS)
def test_arrows_stand_on_the_bodies_that_the_scene_names_and_part_them(factory, tmp_path, name):
    data = _drawn(factory, tmp_path, name)
    found = {}
    for contact, touch in zip(data["contacts"], data["touches"], strict=True):
        first, second = (
            (data["shapes"][place]["name"] for place in touch["shapes"]) if touch else ("", "")
        )
        found[contact] = touch and (first, second, touch["ends"][0], touch["turn"])
    assert found == _ARROWS[name]


def test_a_record_that_names_no_bodies_is_shown_without_arrows(factory, tmp_path):
    contacts = tuple(
        replace(contact, bodies=("", ""))
        for contact in scene_record(load_scene("three_cart")).contacts
    )
    assert _drawn(factory, tmp_path, "three_cart", contacts=contacts)["touches"] == [None, None]


def test_the_goal_is_drawn_where_the_record_has_it_and_only_a_disc_may_lack_its_angle(
    factory, tmp_path
):
    shapes = scene_record(load_scene("three_cart")).shapes
    changed = tuple(
        replace(shape, goal=(1.0, 2.0, None), kind=kind)
        for shape, kind in zip(shapes, ("box", "disc", "disc"), strict=True)
    )
    assert [shape["goal"] for shape in _drawn(factory, tmp_path, "three_cart")["shapes"]] == [
        list(shape.goal) for shape in shapes
    ]
    drawn = _drawn(factory, tmp_path, "three_cart", shapes=changed)
    assert [shape["goal"] for shape in drawn["shapes"]] == [
        None,
        [1.0, 2.0, None],
        [1.0, 2.0, None],
    ]


def filmed(plan: Trace | None, moved: Trace | None, shapes=("box", "disc"), **changes):
    """A cart and a ball, and what is shown of them; forces by contact."""
    run = record_factory.run("strict", None, "strict_lcp")
    drawn = tuple(ShapeRecord(name=kind, kind=kind, size=(1.0, 0.5), goal=None) for kind in shapes)
    contact = ContactRecord(name="left", unit="N", bodies=("box", "disc"))
    scene = replace(run.scene, shapes=drawn, contacts=(contact,))
    stage = replace(run.stages[0], **changes)
    return film(
        replace(run, scene=scene, stages=(stage,)),
        [Motion(plan=plan, replay=moved, tracked=moved)],
    )


def moved(t, box, disc=None, force=()) -> Trace:
    poses = {
        name: np.array(values, float)
        for name, values in (("box", box), ("disc", disc))
        if values is not None
    }
    return Trace(
        np.array(t, float), {"lam_left": np.array(force, float)} if len(force) else {}, poses
    )


def test_frames_are_the_motion_in_grains_of_its_extent():
    """From 1 to 3 s; x covers 0 to 3.6 m of both traces, so that a grain is a millimetre.

    The largest force, 5 N, has a thousand levels.
    """
    plan = moved(
        [1.0, 2.0, 3.0],
        [(0.0, 0.5, 0.0), (1.0, 0.5, 1.0), (2.0, 0.5, -1.0)],
        [(0.5, 0.1, 0.2)] * 3,
        (0.0, 5.0, 1.0),
    )
    replay = moved([1.0, 3.0], [(0.2, 1.5, 0.0), (3.6, 0.5, 0.0)], None, (4.0, 0.0))
    shown = filmed(plan, replay)
    data = json.loads(shown.markup)
    assert (data["t"], data["push"], data["contacts"]) == (
        [1.0, 3.0, 151],
        pytest.approx(5e-3),
        ["left"],
    )
    assert data["grain"] == pytest.approx([1e-3, 1e-3, 5e-4])
    times = 1.0 + 2.0 * np.arange(151) / 150
    box, disc = data["plan"]
    for values, knots, grain in zip(
        box, ([0.0, 1.0, 2.0], [0.5] * 3, [0.0, 1.0, -1.0]), data["grain"], strict=True
    ):
        told = np.cumsum([*values, *[0] * (151 - len(values))]) * grain
        assert told == pytest.approx(np.interp(times, [1.0, 2.0, 3.0], knots), abs=0.51 * grain)
    assert disc == [[500], [100], [400]]
    assert data["replay"][1] is None
    assert np.cumsum(data["replay"][0][0])[[0, 75, 150]].tolist() == [200, 1900, 3600]
    assert np.cumsum(data["replay"][0][1])[[0, 150]].tolist() == [1500, 500]
    assert np.cumsum(data["plan_force"][0])[[0, 75, 150]].tolist() == pytest.approx(
        [0, 1000, 200], abs=7
    )
    assert np.cumsum(data["replay_force"][0])[[0, 75, 150]].tolist() == pytest.approx(
        [800, 400, 0], abs=7
    )
    assert data["shapes"] == [
        {"name": kind, "kind": kind, "size": [1.0, 0.5], "goal": None} for kind in ("box", "disc")
    ]
    assert data["touches"] == [None], "no gap is stored"


def test_a_film_says_what_it_shows():
    plan = moved([0.0, 1.0], [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)], force=(1.0, 2.0))
    shown = filmed(plan, None)
    assert not unsaid(
        shown.words,
        "three_cart … planned (dashed … replayed (filled) … (above: planned, below: replayed)",
    )
    data = json.loads(shown.markup)
    assert (data["replay"], data["replay_force"]) == (None, None)
    stage = record_factory.run("strict", None, "strict_lcp").stages[0]
    tracked = TrackedRecord(error_estimate=1e-9, rms=(0.1,), peak=(0.3,))
    replay = replace(stage.replay, judged="feedback", tracked=tracked)
    assert "as replayed with feedback (filled)," in filmed(plan, plan, replay=replay).words


@pytest.mark.parametrize(
    ("plan", "shapes"),
    [
        (None, ("box",)), (moved([0.0, 1.0], None), ("box",)),
        (moved([2.0, 2.0], [(0.0, 0.0, 0.0)] * 2), ("box",)),
        (moved([0.0, 1.0], [(0.0, 0.0, 0.0)] * 2), ()),
    ],
)  # fmt: skip
def test_without_poses_shapes_or_time_there_is_no_film(plan: Trace | None, shapes: tuple[str, ...]):
    assert filmed(plan, None, shapes) is None


def test_a_blow_shorter_than_a_frame_is_seen():
    """Frames are 1/75 s apart.

    The blow is one of 2001 samples, 4 ms after the frame at 1 s, which is nearest.
    """
    t, force = np.linspace(0.0, 2.0, 2001), np.zeros(2001)
    force[1004] = 7.0
    data = json.loads(filmed(moved(t, np.column_stack([t, t, t]), force=force), None).markup)
    told = np.cumsum(data["plan_force"][0])
    assert (int(told.argmax()), int(told.max()), int(np.count_nonzero(told))) == (75, 1000, 1)
    between = np.zeros(2001)
    between[1009] = 7.0
    told = np.cumsum(
        json.loads(filmed(moved(t, np.column_stack([t, t, t]), force=between), None).markup)[
            "plan_force"
        ][0]
    )
    assert int(told.argmax()) == 76


def test_few_samples_of_a_force_are_joined_by_lines():
    data = json.loads(
        filmed(
            moved(
                [0.0, 1.0, 2.0],
                [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (2.0, 0.0, 0.0)],
                force=(0.0, 4.0),
            ),
            None,
        ).markup
    )
    told = np.cumsum(data["plan_force"][0])
    assert told[[0, 30, 75, 150]].tolist() == [0, 400, 1000, 1000]


@pytest.mark.parametrize(
    ("values", "grain", "told"),
    [
        ([3.0, 3.0, 3.0], 0.5, [6]),
        ([0.1, 0.26, 0.2], 0.1, [1, 2, -1]),
        ([-1.0, 1.0], 0.5, [-2, 4]),
        ([0.14] * 2, 0.1, [1]),
    ],
)
def test_values_are_told_by_their_changes(values: list[float], grain: float, told: list[int]):
    assert steps(values, grain) == told


def test_nothing_in_the_data_ends_its_script():
    assert (
        script_json({"name": "</script>\u2028", "x": [1.5, None]})
        == '{"name":"\\u003c/script>\\u2028","x":[1.5,null]}'
    )
    with pytest.raises(ValueError, match="JSON"):
        script_json(math.nan)


@pytest.mark.parametrize("turned", [0.0, 0.5])
@pytest.mark.parametrize(("kind", "end"), [("box", 0.0), ("line", 0.5), ("line", -0.5)])
@pytest.mark.parametrize(
    ("quarter", "turn"), [(1, math.pi / 2), (-1, -math.pi / 2), (0, 0.0), (2, math.pi)]
)
def test_an_arrow_points_along_the_way_in_which_the_gap_opens(
    kind: str, end: float, turned: float, quarter: int, turn: float
):
    """The gap is 0.3 m less than the way of the body's point along the normal of a wall that is turned."""
    random, n = np.random.default_rng(quarter + 5), 40
    body = np.column_stack([random.normal(size=(n, 2)), random.normal(size=n)])
    wall = np.tile([0.4, -0.2, turned], (n, 1))
    point = (
        body[:, :2]
        + end * 2.0 * np.column_stack([np.cos(body[:, 2]), np.sin(body[:, 2])])
        - wall[:, :2]
    )
    gap = point @ [math.cos(turned + turn), math.sin(turned + turn)] - 0.3
    run = record_factory.run("strict", None, "strict_lcp")
    shapes = (
        ShapeRecord(name="wall", kind="wall", size=(9.0,)),
        ShapeRecord(name="body", kind=kind if kind == "line" else "disc", size=(2.0,)),
    )
    scene = replace(
        run.scene,
        shapes=shapes,
        contacts=(ContactRecord(name="left", unit="N", bodies=("wall", "body")),),
    )
    trace = Trace(np.arange(float(n)), {"gap_left": gap}, {"wall": wall, "body": body})
    shown = film(replace(run, scene=scene), [Motion(plan=trace)])
    (touch,) = json.loads(shown.markup)["touches"]
    assert touch == {"shapes": [1, 0], "ends": [end, 0.0], "turn": round(turn, 6)}
    assert not unsaid(shown.words, "as arrows, and as bars")
    off = Trace(
        trace.t, {"gap_left": gap + 0.004 * float(np.ptp(gap)) * np.sin(np.arange(n))}, trace.poses
    )
    assert json.loads(film(replace(run, scene=scene), [Motion(plan=off)]).markup)["touches"] == [
        None
    ]


# The scale of a strip: 0.9 of a frame of 150 by 84.
_WIDE = 150.0
_HIGH = 84.0


def drawn(
    factory,
    shapes: dict[str, tuple[str, tuple[float, ...]]],
    poses: dict[str, list[tuple[float, float, float]]],
    t=(0.0, 10.0),
):
    scene = replace(
        factory.scene(),
        shapes=tuple(
            ShapeRecord(name=name, kind=kind, size=size) for name, (kind, size) in shapes.items()
        ),
    )
    found = {name: np.array(values, float) for name, values in poses.items()}
    return strip(scene, Trace(np.array(t, float), {}, found))


def placed(svg: str) -> list[tuple[float, float, float]]:
    """Of each body in each frame: x, y [pixel], turn [degree]."""
    return [
        tuple(map(float, one))
        for one in re.findall(r"translate\(([-\d.]+) ([-\d.]+)\) rotate\(([-\d.]+)\)", svg)
    ]


def test_a_body_moves_evenly_through_six_frames(factory):
    found = drawn(
        factory, {"cart": ("box", (1.0, 1.0))}, {"cart": [(0.0, 0.0, 0.0), (9.0, 0.0, math.pi / 2)]}
    )
    assert found is not None
    # From -0.5 to 9.5: ten metres in 135 pixels, about the middle 4.5.
    scale = 0.9 * _WIDE / 10.0
    moved = placed(found.markup)
    assert [x for x, _, _ in moved] == [
        pytest.approx(scale * (1.8 * place - 4.5), abs=0.051) for place in range(6)
    ]
    assert [turn for _, _, turn in moved] == [
        pytest.approx(-18.0 * place, abs=0.051) for place in range(6)
    ], "up is up: turned against the page"
    assert re.findall(r">([\d.]+ s)<", found.markup) == ["0 s", "2 s", "4 s", "6 s", "8 s", "10 s"]
    assert found.words == "6 moments of the plan, from 0 s to 10 s."


def test_up_is_up_and_a_tall_motion_is_fitted_by_its_height(factory):
    found = drawn(factory, {"ball": ("disc", (1.0,))}, {"ball": [(0.0, 0.0, 0.0), (0.0, 8.0, 0.0)]})
    scale = 0.9 * _HIGH / 10.0
    assert [y for _, y, _ in placed(found.markup)] == [
        pytest.approx(-scale * (1.6 * place - 4.0), abs=0.051) for place in range(6)
    ]
    assert found.markup.count(f'r="{scale:.1f}"') == 6


@pytest.mark.parametrize(
    ("kind", "size", "mark"),
    [
        ("box", (2.0, 1.0), "<rect x="),
        ("disc", (1.0,), "<circle"),
        ("line", (2.0,), "<path"),
        ("wall", (2.0,), 'class="body wall"'),
    ],
)
def test_each_kind_is_drawn_by_its_own_shape(factory, kind, size, mark):
    found = drawn(factory, {"it": (kind, size)}, {"it": [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)]})
    assert found.markup.count(mark) == 6


def test_walls_do_not_set_the_scale(factory):
    poses = {"cart": [(0.0, 0.0, 0.0), (9.0, 0.0, 0.0)], "wall": [(500.0, 0.0, 0.0)] * 2}
    both = drawn(factory, {"cart": ("box", (1.0, 1.0)), "wall": ("wall", (1000.0,))}, poses)
    alone = drawn(factory, {"cart": ("box", (1.0, 1.0))}, {"cart": poses["cart"]})
    assert placed(both.markup)[::2] == placed(alone.markup)


def test_without_bodies_or_time_there_is_none(factory):
    still = {"cart": [(0.0, 0.0, 0.0)] * 2}
    assert strip(factory.scene(), None) is None
    assert drawn(factory, {"cart": ("box", (1.0, 1.0))}, {}) is None
    assert drawn(factory, {"cart": ("box", ())}, still) is None
    assert drawn(factory, {"cart": ("box", (1.0, 1.0))}, still, t=(1.0, 1.0)) is None
    assert drawn(factory, {"cart": ("box", (1.0, 1.0))}, still) is not None, (
        "a body that stands still is drawn"
    )


def test_names_of_shapes_are_no_markup(factory):
    found = drawn(
        factory,
        {factory.HOSTILE: (factory.HOSTILE, (1.0,))},
        {factory.HOSTILE: [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)]},
    )
    assert "onerror" not in found.markup
