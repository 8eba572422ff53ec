"""Replays held against closed forms: they meet them to the stated digits, and a wrong form is found."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import sympy as sp

from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.fmu import build_fmu
from models.scene import Contact, Coordinate, Input, Parameter, Scene, Task
from models.scene.impulses import excess_impulse, force_window
from models.trajectory import Hold, Trajectory, uniform_grid
from validate.judge.replay.run import replay
from validate.judge.score import Score, Verdict, score
from validate.judge.score.evidence import Evidence
from validate.judge.score.measures import MEASURES, ghost_impulse, missed_impulse


def judged(scene: Scene, *others: Scene) -> list[Score]:
    """The motion by the scene's own time step, judged on it, and on others that differ from it in their answers alone."""
    task = scene.task
    motion = load_kernel(scene).rollout(np.array(task.start), np.zeros((task.steps, 0)), task.step)
    plan = Trajectory(
        t=uniform_grid(task.step, task.steps),
        q=motion.q,
        v=motion.v,
        u=np.zeros((task.steps, 0)),
        lam=motion.lam,
    )
    replayed = replay(scene, build_fmu(scene), plan)
    return [score(one, plan, replayed) for one in (scene, *others)]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bouncing_mass", "two_body_collision"])
def test_the_replay_meets_every_closed_form(name: str):
    scene = load_scene(name)
    measured = [index for index, answer in enumerate(scene.answers) if answer.measure]
    moved = [
        replace(answer, value=answer.value + 10.0 * answer.tolerance) for answer in scene.answers
    ]
    result, *wrong = judged(
        scene,
        *(
            replace(scene, answers=(*scene.answers[:i], moved[i], *scene.answers[i + 1 :]))
            for i in measured
        ),
    )
    assert result.verdict is Verdict.CONSISTENT, (
        result.why
    )  # nothing is asked of a motion that nobody plans
    assert {answer.measure for answer in scene.answers} - {""} <= set(MEASURES)
    metric = result.metric("answer_error")
    assert metric.value < 0.1
    assert len(wrong) == len(measured) > 0, (
        "each answer alone is watched: moved by ten tolerances, it is found"
    )
    for result in wrong:
        assert result.verdict is Verdict.UNDECIDED, "it accuses the judge, never the plan"
        assert "the judge is not well" in result.why
        assert "tolerances off a closed form" in result.why


def test_contact_forces_change_by_penetration_and_by_its_rate():
    """Kelvin-Voigt: k and c.

    Hunt-Crossley, F = b phi (1 + d phi'): at most b times the largest share F / (b phi), and b d
    times the largest depth.
    """
    scene = load_scene("damped_collision")
    values = {symbol.name: value for symbol, value in scene.parameter_values.items()}
    k, c, b, d = (values[name] for name in "kcbd")
    gap = np.array([[-0.1, -0.2], [0.3, -0.4], [-0.5, 0.0]])
    lam = np.array([[9.0, 1.5 * b * 0.2], [0.0, 0.5 * b * 0.4], [9.0, 7.0]])
    case = SimpleNamespace(
        equations=scene, k=np.array([k, b]), replay_gap=gap, replay=SimpleNamespace(lam=lam)
    )
    by_depth, by_rate = Evidence.slopes.func(case)
    assert by_depth == pytest.approx([k, 1.5 * b])
    assert by_rate == pytest.approx([c, d * b * 0.4])
    lam[0, 1] = 0.0  # no share is above 1 then
    assert Evidence.slopes.func(case)[0] == pytest.approx([k, b])
    case = SimpleNamespace(equations=load_scene("three_cart"), k=np.array([30.0, 31.0]))
    assert [part.tolist() for part in Evidence.slopes.func(case)] == [[30.0, 31.0], [0.0, 0.0]]


# A finger and a box in honey, on a line: the gap between them is one equation of the first order.
DRAG = 10.0
STIFFNESS = 300.0
APART = 0.2
STEP = 0.02
STEPS = 60


def pusher() -> Scene:
    f, b, v, w, u, d, k, tau = sp.symbols("f b v w u d k tau", real=True)
    return Scene(
        name="pusher", title="A finger pushes a box in honey", source="drag", relaxation_time=tau,
        coordinates=(Coordinate(symbol=f, velocity=v, unit="m"),
                     Coordinate(symbol=b, velocity=w, unit="m")),
        inputs=(Input(symbol=u, unit="N", lower=-20.0, upper=20.0),),
        parameters=(Parameter(symbol=d, value=DRAG, unit="N s/m"),
                    Parameter(symbol=k, value=STIFFNESS, unit="N/m")),
        kinetic_energy=tau * d * (v**2 + w**2) / 2, potential_energy=sp.Integer(0),
        forces=(u - d * v, -d * w),
        contacts=(Contact(name="tip", bodies=("finger", "box"), penetration=f - b, stiffness=k,
                          depth=0.1, depth_reason="the box"),),
        task=Task(start=(0.0, APART, 0.0, 0.0), goal=(None,) * 4, running_cost=u**2, step=STEP,
                  steps=STEPS),
    )  # fmt: skip


def pressed(depth: float, u: float, time: float) -> tuple[float, float]:
    """Depth [m] after a time [s] under an input [N], by depth' = (u - 2 k max(depth, 0)) / d, and the contact impulse until then [N s]."""
    if depth < 0.0 or (depth == 0.0 and u <= 0.0):
        wait = -depth * DRAG / u if u > 0.0 else np.inf
        return pressed(0.0, u, time - wait) if wait < time else (depth + u * time / DRAG, 0.0)
    rest, rate = u / (2 * STIFFNESS), 2 * STIFFNESS / DRAG
    closed = min(time, np.log1p(-depth / rest) / rate) if u < 0.0 else time
    moved = (depth - rest) * -np.expm1(-rate * closed)
    impulse = STIFFNESS * (rest * closed + moved / rate)
    return pressed(0.0, u, time - closed)[0] if closed < time else depth - moved, impulse


@pytest.mark.slow
def test_contact_impulses_without_inertia_are_as_wrong_as_their_error_says_and_it_says_little_more():
    """Against the first-order model: forces by k times the largest error of any gap, for as long as anything touches, would be 50 times as wrong and more."""
    scene, random = pusher(), np.random.default_rng(4)
    fmu, t, found = build_fmu(scene), uniform_grid(STEP, STEPS), []
    for _ in range(4):
        u = np.repeat(random.uniform(-6.0, 12.0, STEPS // 5), 5)
        states = [(-APART, 0.0)]
        for one in u:
            states.append(pressed(states[-1][0], one, STEP))
        force = STIFFNESS * np.maximum([depth for depth, _ in states[:-1]], 0.0)[:, None]
        still = Trajectory(
            t=t,
            q=np.tile([0.0, APART], (STEPS + 1, 1)),
            v=np.zeros((STEPS + 1, 2)),
            u=u[:, None],
            lam=force,
        )
        replayed = replay(scene, fmu, still)
        steps = np.clip(np.searchsorted(t, replayed.t, side="right") - 1, 0, STEPS - 1)
        depths = [
            pressed(states[step][0], u[step], time - t[step])[0]
            for step, time in zip(steps, replayed.t, strict=True)
        ]
        rows = STIFFNESS * np.maximum(depths, 0.0)[:, None]
        mean = np.array([impulse for _, impulse in states[1:]])[:, None] / STEP
        for planned in (
            force,
            1.05 * force,
            0.95 * force,
            0.0 * force,
            force + 0.3 * (force == 0.0),
            np.roll(force, 3),
        ):
            case = Evidence(scene, replace(still, lam=planned), replayed)
            least, most = force_window(rows, case.step_of, STEPS, mean)
            for measure, true in (
                (ghost_impulse, excess_impulse(planned, most, case.h)),
                (missed_impulse, excess_impulse(least, planned, case.h)),
            ):
                measured = measure(case)
                found.append((abs(measured.values - true), measured.error))
                if planned is force:  # what ten times the error has to fit in
                    assert 10.0 * measured.error <= 0.5 * 0.01 * measured.scales
    off, error = np.array(found).T
    assert (off <= error + 1e-12).all()
    assert error.sum() <= 5.0 * off.sum()  # of a single plan those of two steps may cancel
    assert off.max() > 1e-5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hold", "spare", "touches"), [(Hold.ZERO_ORDER, 1e-4, []), (Hold.LINEAR, -1e-6, [True, False])]
)
def test_a_finger_without_inertia_turns_back_before_the_box_or_touches_it_between_two_rows(
    hold: Hold, spare: float, touches: list[bool]
):
    """Where its input jumps its velocity does, which is no dip of the gap.

    Under a line from 5 to -5 N it makes a parabola, a quarter of 5 N h/d high.
    """
    u, v = np.full((STEPS, 1), -5.0), np.zeros((STEPS + 1, 2))
    u[0] = (APART - spare) * DRAG / STEP if hold is Hold.ZERO_ORDER else 5.0
    start = 0.0 if hold is Hold.ZERO_ORDER else APART - spare - 5.0 * STEP / 4 / DRAG
    still = Trajectory(
        t=uniform_grid(STEP, STEPS),
        q=np.tile([start, APART], (STEPS + 1, 1)),
        v=v,
        u=u,
        lam=v[1:, :1],
        hold=hold,
        u_end=u[-1],
    )
    scene = pusher().with_task(start=(start, APART, 0.0, 0.0))
    found = replay(scene, build_fmu(scene), still)
    assert [event.closes for event in found.events] == touches
    assert found.error.estimate.gap < 1e-3
