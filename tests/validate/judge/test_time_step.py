"""Time steps: three wrong ones are found, three right ones are cleared, nonsense is one sentence; the defect of a plan in a foreign step."""

import numpy as np
import pytest
from scipy.optimize import root

from models.catalog import load_scene
from models.schemes import Scheme
from models.trajectory import Trajectory
from validate.judge.time_step import (
    StepError,
    energy_test,
    load_step,
    numbers_of,
    scheme_step,
    step_defect,
    take_step,
)

# A cart-pole: its mass matrix depends on an angle.
SCENE = load_scene("cart_pole_walls")


def mass(q, p):
    coupling = p["m_p"] * p["l"] * np.cos(q[1])
    return np.array([[p["m_c"] + p["m_p"], coupling], [coupling, p["m_p"] * p["l"] ** 2]])


def gravity(q, p):
    return np.array([0.0, p["m_p"] * p["g"] * p["l"] * np.sin(q[1])])  # -dV/dq


def coriolis(q, v, p):
    return np.array([-p["m_p"] * p["l"] * np.sin(q[1]) * v[1] ** 2, 0.0])


def kinetic_slope(q, v, p):
    return np.array([0.0, -p["m_p"] * p["l"] * np.sin(q[1]) * v[0] * v[1]])  # dT/dq


def momentum_step(force):
    """A trapezoidal step of the momentum: M v of the next node, minus M v, minus h times the mean of the force."""

    def step(q, v, u, h, p):
        def residual(w):
            z = q + h / 2 * (v + w)
            driven = h / 2 * (force(z, w, p) + force(q, v, p))
            return mass(z, p) @ w - mass(q, p) @ v - driven

        w = root(residual, v, tol=1e-13).x
        return q + h / 2 * (v + w), w

    return step


def explicit_in_velocity(acceleration):
    def step(q, v, u, h, p):
        w = v + h * acceleration(q, v, p)
        return q + h * w, w

    return step


WRONG = {
    "Coriolis terms twice": momentum_step(lambda q, v, p: gravity(q, p) - coriolis(q, v, p)),
    "sign of the Coriolis terms": explicit_in_velocity(
        lambda q, v, p: np.linalg.solve(mass(q, p), gravity(q, p) + coriolis(q, v, p))
    ),
    "frozen mass matrix": explicit_in_velocity(
        lambda q, v, p: np.linalg.solve(mass(np.zeros(2), p), gravity(q, p) - coriolis(q, v, p))
    ),
}
RIGHT = {
    "semi-implicit Euler": (
        explicit_in_velocity(
            lambda q, v, p: np.linalg.solve(mass(q, p), gravity(q, p) - coriolis(q, v, p))
        ),
        1,
    ),
    "implicit midpoint": (scheme_step(SCENE, Scheme.IMPLICIT_MIDPOINT), 2),
    "variational": (momentum_step(lambda q, v, p: gravity(q, p) + kinetic_slope(q, v, p)), 2),
}


@pytest.mark.parametrize("name", WRONG)
def test_energy_test_wrong_step_found(name: str):
    found = energy_test(SCENE, WRONG[name])
    assert not found.vanishes, found.sentence
    assert "other equations" in found.sentence


@pytest.mark.parametrize("name", RIGHT)
def test_energy_test_right_step_cleared_with_order(name: str):
    step, order = RIGHT[name]
    found = energy_test(SCENE, step)
    assert found.vanishes, found.sentence
    assert found.order == pytest.approx(order, abs=0.2)


def test_energy_test_sign_of_gravity_found():
    wrong = explicit_in_velocity(
        lambda q, v, p: np.linalg.solve(mass(q, p), -gravity(q, p) - coriolis(q, v, p))
    )
    assert not energy_test(SCENE, wrong).vanishes


def test_energy_test_damped_scene_work_is_counted():
    """Damping takes energy out; a right step of a damped scene is cleared, an undamped one found."""
    scene = load_scene("three_cart")
    assert energy_test(scene, Scheme.SEMI_IMPLICIT_EULER).vanishes
    assert not energy_test(scene, lambda q, v, u, h, p: (q + h * v, v)).vanishes


@pytest.mark.parametrize(
    ("step", "told"),
    [
        (lambda q, v, u, h, p: (q, v[:1]), r"shape \(2,\) and \(1,\), expected"),
        (lambda q, v, u, h, p: (q, v * np.nan), "not finite"),
        (lambda q, v, u, h, p: q, "shape"),
        (lambda q, v, u, h, p: p["mass"], "KeyError"),
        (lambda q: q, "TypeError"),
        (lambda q, v, u, h, p: ("a", "b"), "ValueError"),
    ],
)
def test_take_step_nonsense_one_sentence(step, told: str):
    with pytest.raises(StepError, match=told) as error:
        energy_test(SCENE, step)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("reference", "told"),
    [
        ("midpoint", "expected FILE.py:FUNCTION"),
        ("none.py:step", "there is no file"),
        ("own.py:stop", "no function 'stop'"),
        ("broken.py:step", "SyntaxError"),
    ],
)
def test_load_step_missing_one_sentence(reference: str, told: str, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.py").write_text("def step(q, v, u, h, p):\n    return q, v\n")
    (tmp_path / "broken.py").write_text("def step(\n")
    assert callable(load_step("own.py:step"))
    with pytest.raises(StepError, match=told):
        load_step(reference)


def test_step_defect_own_plan_below_one_other_above():
    step, scene = RIGHT["semi-implicit Euler"][0], SCENE
    numbers, h = numbers_of(scene), 0.02
    q, v = [np.array([0.3, 0.4])], [np.zeros(2)]
    for _ in range(20):
        following = take_step(scene, step, q[-1], v[-1], np.zeros(1), h, numbers)
        q.append(following[0])
        v.append(following[1])
    plan = Trajectory(
        t=h * np.arange(21),
        q=np.array(q),
        v=np.array(v),
        u=np.zeros((20, 1)),
        lam=np.zeros((20, 2)),
    )
    assert step_defect(scene, step, plan) < 1e-3
    assert step_defect(scene, WRONG["frozen mass matrix"], plan) > 1.0
