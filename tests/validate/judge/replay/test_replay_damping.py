"""Contacts with damping against their exact restitution, through Model Exchange with located events; energy that is lost is accounted for."""

import cmath
import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import lambertw
from wording import unsaid

from models.catalog import load_scene
from models.codegen.kernel import load_kernel
from models.fmu import build_fmu
from models.scene import Scene
from models.schemes import Scheme
from models.trajectory import Trajectory, uniform_grid
from validate.judge.replay import Replay
from validate.judge.replay.run import replay
from validate.judge.score import Metric, Verdict, score
from validate.tasks.scene_record import scene_record

SCENE = load_scene("damped_collision")
M1 = 1.0
M2 = 3.0
MU = 0.75
K = 2000.0
V1, V2 = SCENE.task.start[2:]
DIGITS = 1e-8


def free_motion(scene: Scene) -> Trajectory:
    task = scene.task
    motion = load_kernel(scene).rollout(np.array(task.start), np.zeros((task.steps, 0)), task.step)
    return Trajectory(
        t=uniform_grid(task.step, task.steps), q=motion.q, v=motion.v, u=np.zeros((task.steps, 0)),
        lam=motion.lam,
        scheme=Scheme.SEMI_IMPLICIT_EULER,
    )  # fmt: skip


def replayed(scene: Scene) -> Replay:
    """By the scene's one FMU, whose parameters the replay sets."""
    result = replay(scene, build_fmu(SCENE), free_motion(scene))
    assert result.ok
    return result


def values(metrics: Iterable[Metric]) -> dict[str, float]:
    return {metric.name: metric.value for metric in metrics if metric.value is not None}


def kelvin_voigt(z: float) -> float:
    """Restitution exp(-2 a / tan a), cos a = z.

    The same formula with an imaginary a where the swing is overdamped.
    """
    a = cmath.acos(z)
    return cmath.exp(-2.0 * a / cmath.tan(a)).real


def hunt_crossley(y: float) -> float:
    """Restitution at y = d v_in: 1 - e y = -W0(-(1 + y) exp(-(1 + y)))."""
    return (1.0 + float(lambertw(-(1.0 + y) * math.exp(-1.0 - y)).real)) / y


@pytest.mark.parametrize("z", [0.02, 0.2, 0.95, 1.6])
def test_kelvin_voigt_without_adhesion_has_its_exact_restitution(z: float):
    scene = SCENE.with_parameters(c=2.0 * z * math.sqrt(K * MU)).with_task(steps=600)
    motion = replayed(scene)
    mean, e = (M1 * V1 + M2 * V2) / (M1 + M2), kelvin_voigt(z)
    assert motion.v[-1] == pytest.approx(
        [mean - MU * e * (V1 - V2) / M1, mean + MU * e * (V1 - V2) / M2], abs=DIGITS
    )
    assert (
        abs(e - math.exp(-math.pi * z / math.sqrt(abs(1.0 - z * z)))) > 1e-4
    )  # not that of a contact that pulls
    released = [event for event in motion.events if event.contact == "pressing_pair"]
    opened = [event for event in motion.events if event.contact == "pair" and not event.closes]
    assert len(released) == len(opened) == 1
    assert opened[0].time - released[0].time == pytest.approx(
        2.0 * z / math.sqrt(K / MU), abs=DIGITS
    )  # released before it opens
    assert motion.lam[:, 0].min() >= -1e-9


@pytest.mark.parametrize("d", [0.02, 0.5, 5.0])
def test_hunt_crossley_has_its_exact_restitution(d: float):
    scene = SCENE.with_parameters(d=d).with_task(steps=1600)
    motion = replayed(scene)
    hits = [event for event in motion.events if event.contact == "bumper"]
    assert [event.closes for event in hits] == [True, False]
    before, after = (motion.v[np.searchsorted(motion.t, hit.time), 0] for hit in hits)
    assert after == pytest.approx(-before * hunt_crossley(-d * before), abs=DIGITS)


def test_what_the_dampers_take_is_accounted_for():
    motion = replayed(SCENE)
    lost = motion.energy[0] - motion.energy[-1]
    assert lost > 1.0
    assert motion.dissipated_work[-1] == pytest.approx(lost, abs=1e-9)
    assert np.diff(motion.dissipated_work).min() > -1e-12


def test_the_scene_meets_its_closed_forms():
    result = score(SCENE, free_motion(SCENE), replayed(SCENE))
    assert result.verdict is Verdict.CONSISTENT, result.why
    found = values(result.metrics)
    assert found["physics"] == 0.0
    assert found["energy_residual_relative"] < 1e-9
    assert found["answer_error"] < 1.0


def test_forces_without_their_damping_are_found():
    plan = free_motion(SCENE)
    kernel = load_kernel(SCENE)
    springs = kernel.stiffness() * np.maximum(kernel.penetration(plan.q[:-1]), 0.0)
    wrong = Trajectory(
        t=plan.t, q=plan.q, v=plan.v, u=plan.u, lam=springs, scheme=Scheme.SEMI_IMPLICIT_EULER
    )
    found = values(score(SCENE, wrong, None).metrics)
    assert found["physics"] > 1e3
    assert found["defect"] > 1e-2
    undeclared = score(SCENE, replace(wrong, scheme=None), None)
    metric = undeclared.metric("contact_law_error")
    assert metric.ok is False


def test_the_report_shows_the_two_laws():
    shown = {equation.caption: equation.mathml for equation in scene_record(SCENE).equations}
    assert not unsaid(shown, "contact pair, Kelvin-Voigt without adhesion, … elsewhere 0")
    law = shown["force of contact bumper, Hunt-Crossley"]
    assert law.count("max") == 2
    assert "<mi>b</mi>" in law
    assert "<mi>d</mi>" in law
    assert sum(caption.startswith("rate of penetration") for caption in shown) == 2
