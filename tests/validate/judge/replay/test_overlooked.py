"""Contact between two steps of an integrator: found where there is one, and never passed over in silence."""

from dataclasses import replace

import numpy as np
import pytest
import sympy as sp

from models.catalog import load_scene
from models.collocation import lowest_between
from models.fmu import build_fmu
from models.scene import Contact, Coordinate, Input, Parameter, Scene, Task, goal_limits
from models.trajectory import Trajectory
from validate.judge.judgement import judge
from validate.judge.replay.run import replay

SPEED = 10.0
PLACE = 1.091

# A ball flies through the place of a pane that is far thinner than its way in a time step. In the
# middle it takes k/2 (w/4)^2 to be there.
q, v, u = sp.symbols("q v u", real=True)
m, w, k, c = sp.symbols("m w k c", positive=True)

PANE = Scene(
    name="thin_pane",
    title="A ball and a thin pane",
    source="a parabola of penetration across the pane",
    coordinates=(Coordinate(symbol=q, velocity=v, unit="m", description="place of the ball"),),
    inputs=(Input(symbol=u, unit="N", lower=-5.0, upper=5.0, description="push"),),
    parameters=(
        Parameter(symbol=m, value=1.0, unit="kg", lower=1e-6, description="mass"),
        Parameter(symbol=w, value=4e-4, unit="m", lower=1e-15, description="thickness of the pane"),
        Parameter(
            symbol=k, value=1e11, unit="N/m", lower=1e-6, description="stiffness of the pane"
        ),
        Parameter(
            symbol=c,
            value=1.091,
            unit="m",
            lower=0.0,
            description="where the middle of the pane is",
        ),
    ),
    kinetic_energy=m * v**2 / 2,
    potential_energy=sp.Integer(0),
    forces=(u,),
    contacts=(
        Contact(
            name="pane",
            bodies=("ball", "pane"),
            penetration=(w**2 / 4 - (q - c) ** 2) / w,
            stiffness=k,
            depth=1e-4,
            depth_reason="a quarter of the thickness, in the middle of the pane",
            nominal=1e-3,
            description="ball against the pane",
        ),
    ),
    task=Task(start=(0.0, 10.0), goal=(2.0, 10.0), running_cost=u**2, step=0.02, steps=10),
    limits=goal_limits(position=0.005, velocity=0.005, reason="a thousandth of the way"),
)


def through(scene: Scene, **declared: object) -> Trajectory:
    """The ball flies on as if there were no pane."""
    t = scene.task.step * np.arange(scene.task.steps + 1)
    arrays = {
        "q": SPEED * t[:, None],
        "v": np.full((len(t), 1), SPEED),
        "u": np.zeros((len(t) - 1, 1)),
        "lam": np.zeros((len(t) - 1, 1)),
    }
    return Trajectory(t=t, **arrays, **declared)  # type: ignore[arg-type]


@pytest.mark.slow
@pytest.mark.parametrize("missing", [frozenset(), frozenset({"q", "v", "lam"})])
def test_a_pane_thinner_than_a_step_sends_the_ball_back(missing: frozenset[str]):
    scene = PANE
    found = judge(scene, through(scene, missing=missing))
    assert found.verdict.value == "violates"
    assert [event.closes for event in found.replay.events] == [True, False]
    # Elastic: the same speed back, from where the pane begins; within it, it is for microseconds.
    assert found.replay.end == pytest.approx(
        [2.0 * (PLACE - 2e-4) - SPEED * scene.task.horizon, -SPEED], abs=2e-4
    )
    assert found.replay.error.estimate.state < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("thickness", [4e-3, 2e-5])
def test_a_plate_that_pushes_out_of_its_nearer_face_sends_the_ball_back(thickness: float):
    """Its gap is |q - c| - w/2, which turns round at once: no smooth curve through the rows touches."""
    plate = replace(PANE.contacts[0], penetration=w / 2 - sp.sqrt((q - c) ** 2 + w**2 / 10**8))
    omega = 20.0 * np.sqrt(2.0) / (thickness / 2.0)  # it comes to rest in a third of the plate
    scene = replace(PANE, name="plate", contacts=(plate,)).with_parameters(w=thickness, k=omega**2)
    found = judge(scene, through(scene))
    assert found.verdict.value == "violates"
    face = PLACE - thickness / 2.0
    back = scene.task.horizon - face / SPEED - np.pi / omega
    assert found.replay.end == pytest.approx([face - SPEED * back, -SPEED], abs=1e-3 * thickness)


@pytest.mark.slow
def test_a_pane_that_breaks_lets_it_through():
    """k/2 (w/4)^2 = 50 J is what the ball has: 40 J let it pass, and slow it down inside alone."""
    scene = PANE.with_parameters(k=0.8e10)
    found = judge(scene, through(scene))
    assert found.replay.end == pytest.approx([2.0, SPEED], abs=1e-3)
    assert [event.closes for event in found.replay.events] == [True, False]
    assert found.score.value("max_penetration") == pytest.approx(1e-4, rel=1e-5)


@pytest.mark.slow
def test_a_pane_that_no_step_can_see_leaves_the_plan_undecided():
    scene = PANE.with_parameters(w=1e-6, k=1e14)
    found = replay(scene, build_fmu(scene), through(scene))
    assert "steps over a contact" in found.message
    assert found.error.estimate is None
    assert judge(scene, through(scene)).verdict.value == "undecided"


def test_the_least_value_of_a_cubic_between_two_rows():
    """Of two cubics or parabolas at once, drawn at random and such as rest at a row, against ten thousand points of each."""
    random, s, h = np.random.default_rng(4), np.linspace(0.0, 1.0, 10_001), 0.25
    drawn = [
        [np.polynomial.Polynomial(random.normal(size=degree + 1)) for _ in range(2)]
        for degree in (3, 2, 1, 0) * 10
    ]
    rests = [np.polynomial.Polynomial([1.0, 0.0, sign * -3.0, sign * 2.5]) for sign in (1.0, -1.0)]
    for pair in (*drawn, rests, [of(np.polynomial.Polynomial([1.0, -1.0])) for of in rests]):
        gap, rate = (
            np.column_stack([of(s[[0, -1]]) for of in part])
            for part in (pair, [of.deriv() for of in pair])
        )
        lowest, place = lowest_between(np.array([1.0, 1.0 + h]), gap, rate / h)
        for column, polynomial in enumerate(pair):
            assert lowest[0, column] == pytest.approx(polynomial(s).min(), abs=1e-7)
            assert polynomial(place[0, column]) == pytest.approx(lowest[0, column], abs=1e-12)


@pytest.mark.parametrize("rows", [1, 3, 7, 20, 400])
def test_what_a_plan_costs_and_how_deep_it_goes_does_not_depend_on_its_rows(rows: int):
    """Constant pushes in so many rows: one motion, and one set of figures."""
    scene = load_scene("three_cart")
    t = np.linspace(0.0, scene.task.horizon, rows + 1)
    u = np.tile([10.0, -10.0], (rows, 1))
    found = judge(scene, {"t": t, "u1": u[:, 0], "u3": u[:, 1]})
    assert found.score.value("max_penetration") == pytest.approx(0.68624476, abs=1e-7)
    assert found.score.value("replay_cost") == pytest.approx(500 * 200.0, rel=1e-12)
