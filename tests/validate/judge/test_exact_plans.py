"""Exact plans of a mass between a push and a wall, stiff or light or strongly damped, on coarse grids: each holds, however it is written."""

from typing import Any

import numpy as np
import pytest
import sympy as sp
from scipy.linalg import expm
from scipy.optimize import brentq
from wording import unsaid

from models.scene import Contact, Coordinate, Friction, Input, Parameter, Scene, Task, goal_limits
from models.scene.contacts import DampingLaw
from validate.judge.judgement import judge

q, v, u = sp.symbols("q v u", real=True)
m, c, k, d = sp.symbols("m c k d", positive=True)
WALL = 1.0
START = (0.0, 0.0)


def scene_of(
    *,
    h: float,
    steps: int,
    end: np.ndarray,
    push: float,
    mass: float,
    drag: float,
    k_wall: float,
    damping: float,
    inputs: bool,
) -> Scene:
    parameters = [
        Parameter(symbol=m, value=mass, unit="kg", lower=1e-9, description="mass"),
        Parameter(symbol=c, value=drag, unit="N s/m", lower=0.0, description="drag"),
        Parameter(
            symbol=k, value=k_wall, unit="N/m", lower=1e-9, description="stiffness of the wall"
        ),
    ]
    damped: dict[str, Any] = {}
    if damping:
        parameters.append(
            Parameter(
                symbol=d, value=damping, unit="N s/m", lower=0.0, description="damping of the wall"
            )
        )
        damped = {"damping": d, "damping_law": DampingLaw.KELVIN_VOIGT}
    start = START if inputs else (0.0, 0.5)
    return Scene(
        name="slider", title="A mass and a wall", source="Newton",
        coordinates=(Coordinate(symbol=q, velocity=v, unit="m", description="place"),),
        inputs=(Input(symbol=u, unit="N", lower=-push, upper=push, description="push"),
                ) if inputs else (),
        parameters=tuple(parameters),
        kinetic_energy=m * v**2 / 2, potential_energy=sp.Integer(0),
        forces=((u if inputs else 0) - c * v,),
        contacts=(
            Contact(name="wall", bodies=("mass", "wall"), penetration=q - WALL, stiffness=k,
                    nominal=0.01, depth=0.5, depth_reason="half the wall",
                    description="mass against wall", **damped),
        ),
        task=Task(start=start, goal=tuple(np.round(end, 4)),
                  running_cost=u**2 if inputs else sp.Integer(0), step=h, steps=steps),
        limits=goal_limits(position=0.002, velocity=0.002,
                           reason="ten times what rounding to 4 decimals takes"),
    )  # fmt: skip


def truth(
    t: np.ndarray,
    pushes: np.ndarray,
    start: tuple[float, float],
    mass: float,
    drag: float,
    k_wall: float,
    damping: float,
) -> dict[str, np.ndarray]:
    """q, v at t, and the contact force at the start, at the end and in the mean of each step: linear equations, pressed or free, by matrix exponentials."""

    def force(x: np.ndarray) -> float:
        return max(k_wall * (x[0] - WALL) + damping * x[1], 0.0) if x[0] > WALL else 0.0

    def pressed(x: np.ndarray) -> float:
        """Above 0 where the wall pushes."""
        return min(x[0] - WALL, k_wall * (x[0] - WALL) + damping * x[1])

    def flow(push: float, closed: bool) -> np.ndarray:
        """Of (q, v, impulse, 1)."""
        k, d = (k_wall, damping) if closed else (0.0, 0.0)
        return np.array(
            [
                [0, 1, 0, 0],
                [-k / mass, -(drag + d) / mass, 0, (push + k * WALL) / mass],
                [k, d, 0, -k * WALL],
                [0, 0, 0, 0],
            ],
            dtype=float,
        )

    x, closed = np.array([*start, 0.0, 1.0]), False
    states, impulses = [x[:2]], []
    for h, push in zip(np.diff(t), pushes, strict=True):
        left, x = float(h), np.array([x[0], x[1], 0.0, 1.0])
        while left > 0.0:
            A, looks = flow(push, closed), np.linspace(0.0, left, 400)[1:]
            turned, ahead, on = [], x, expm(A * looks[0])
            for _ in looks if x[0] + abs(x[1]) * left > WALL - 0.1 else ():
                ahead = on @ ahead
                turned.append(pressed(ahead) > 0.0)
            first = next((place for place, now in enumerate(turned) if now != closed), None)
            if first is None:
                x, left = expm(A * left) @ x, 0.0
                continue
            low = looks[first - 1] if first else 1e-12
            when = (
                brentq(
                    lambda time, A=A, x=x: pressed(expm(A * time) @ x),
                    low,
                    looks[first],
                    xtol=1e-15,
                )
                if pressed(expm(A * low) @ x) * (1 if closed else -1) > 0
                else low
            )
            x, left, closed = expm(A * when) @ x, left - when, not closed
        states.append(x[:2])
        impulses.append(x[2])
    nodes = np.array(states)
    forces = np.array([force(state) for state in nodes])
    return {
        "q": nodes[:, 0],
        "v": nodes[:, 1],
        "start": forces[:-1],
        "end": forces[1:],
        "mean": np.array(impulses) / np.diff(t),
    }


# What the mass and wall are, the plan's grid, and what the plan says.
PLANS: dict[str, dict[str, Any]] = {
    "a hard bounce within a step, mean forces": {"k": 1e4, "forces": "mean"},
    "a harder one, forces at the start, all of them 0": {"k": 1e6, "forces": "start"},
    "a harder one, mean forces": {"k": 1e6, "forces": "mean"},
    "a strongly damped wall, mean forces": {"damping": 150.0, "k": 200.0, "forces": "mean",
                                            "h": 0.005, "steps": 400},
    "a damped wall, forces and no velocities": {"damping": 30.0, "k": 200.0, "forces": "mean",
                                                "says": "q"},
    "a light mass in a strong drag": {"mass": 1e-4, "drag": 2.0, "k": 100.0, "says": "qv"},
    "a strong drag, positions alone": {"mass": 1.0, "drag": 800.0, "k": 500.0, "push": 900.0,
                                       "says": "q", "h": 0.005, "steps": 400},
    "hard bounces, positions alone": {"k": 1e6, "says": "q", "h": 0.005, "steps": 400},
    "a clock that began in 1970": {"k": 200.0, "forces": "end", "since": 1.7e9},
    "nothing driven and nothing touched": {"k": 200.0, "inputs": False, "says": "qv", "steps": 50},
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", PLANS)
def test_an_exact_plan_holds(name: str):
    plan = {
        "mass": 1.0, "drag": 2.0, "damping": 0.0, "push": 4.0, "h": 0.02, "steps": 100,
        "says": "qv", "since": 0.0,
        "inputs": True, **PLANS[name],
    }  # fmt: skip
    t = plan["h"] * np.arange(plan["steps"] + 1)
    body = {
        "mass": plan["mass"],
        "drag": plan["drag"],
        "k_wall": plan["k"],
        "damping": plan["damping"],
    }
    pushes = (
        np.where(t[:-1] < 1.2, plan["push"], -0.25 * plan["push"])
        if plan["inputs"]
        else np.zeros(len(t) - 1)
    )
    true = truth(t, pushes, START if plan["inputs"] else (0.0, 0.5), **body)
    assert (true["q"].max() > WALL or true["mean"].max() > 0.0) == plan["inputs"], "it touches"
    end = np.array([true["q"][-1], true["v"][-1]])
    scene = scene_of(
        h=plan["h"], steps=plan["steps"], end=end, push=plan["push"], inputs=plan["inputs"], **body
    )
    columns = {"t": plan["since"] + t, **{key: true[key] for key in plan["says"]}}
    columns |= {"u": pushes} if plan["inputs"] else {}
    columns |= {"lam_wall": true[plan["forces"]]} if "forces" in plan else {}
    found = judge(scene, columns)
    assert found.verdict.value == "holds", str(found)


@pytest.mark.slow
@pytest.mark.parametrize("forces", ["start", "end", "mean"])
def test_friction_whose_load_changes_on_the_way_is_that_of_any_part_of_a_step(forces: str):
    """A slide under a load of 5 + 3 q: mu N v' = -mu (5 + 3 q) is an oscillation until it stops, and then it sticks."""
    mu, mass, h, steps = 0.3, 1.0, 0.02, 150
    scene = Scene(
        name="rail", title="A slide under a growing load", source="Newton and Coulomb",
        coordinates=(Coordinate(symbol=q, velocity=v, unit="m", description="place"),),
        parameters=(Parameter(symbol=m, value=mass, unit="kg", lower=1e-9, description="mass"),
                    Parameter(symbol=c, value=mu, unit="1", lower=0.0, description="friction"),
                    Parameter(symbol=k, value=5.0, unit="N", lower=0.0, description="load at 0"),
                    Parameter(symbol=d, value=3.0, unit="N/m", lower=0.0,
                              description="load a metre")),
        kinetic_energy=m * v**2 / 2, potential_energy=sp.Integer(0), forces=(sp.Integer(0),),
        inputs=(), contacts=(),
        frictions=(Friction(name="rail", slip=v, coefficient=c, normal_force=k + d * q, nominal=0.1,
                            description="on the rail"),),
        task=Task(start=(0.0, 2.0), goal=(None, 0.0), running_cost=sp.Integer(0), step=h,
                  steps=steps),
        limits=goal_limits(velocity=0.01, reason="it stands"),
    )  # fmt: skip
    w, rest = np.sqrt(mu * 3.0 / mass), 5.0 / 3.0
    t = h * np.arange(steps + 1)
    stop = np.arctan2(2.0 / w, rest) / w  # of (q + 5/3) = 5/3 cos wt + 2/w sin wt
    on = np.minimum(t, stop)
    place, speed = (
        rest * np.cos(w * on) + 2.0 / w * np.sin(w * on) - rest,
        np.where(t < stop, 2.0 * np.cos(w * on) - rest * w * np.sin(w * on), 0.0),
    )
    pull = np.where(t < stop, -mu * (5.0 + 3.0 * place), 0.0)
    said = {"start": pull[:-1], "end": pull[1:], "mean": mass * np.diff(speed) / h}[forces]
    found = judge(scene, {"t": t, "q": place, "v": speed, "friction_rail": said})
    assert found.verdict.value == "holds", str(found)
    wrong = judge(
        scene,
        {
            "t": t,
            "q": place,
            "v": speed,
            "friction_rail": np.where(np.arange(steps) > steps - 20, 1.0, said),
        },
    )
    assert wrong.verdict.value == "violates"
    assert not unsaid(wrong.score.why, "friction that the replay does not have")
