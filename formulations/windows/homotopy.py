"""Softplus contact that grows sharper, b L = 7, 14, .., 448: where the contacts will be, from a cold start.

L is the length that the scene counts eps in, 1 m unless it says otherwise: a scene in other units, or a tenth as large, has the same schedule.

Softplus acts at a distance with k ln 2 / b at the touch. Where that exceeds what the inputs can hold against, the contact begins softer:
k is a hundredth, a fiftieth, .. of its value, and reaches it with the last stage.

Each stage starts from the one before; multipliers are handed on once the plan no longer moves much. A plan is the last stage's, of a law that is
nearly but not quite the true one: only its contact modes are used.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
import sympy as sp

from formulations.solution import Outcome
from formulations.transcription.build import build_model
from formulations.transcription.contact_laws import ContactLaw, tighten
from formulations.transcription.goal import move_ball, open_goal
from formulations.transcription.plans import load_first_guess, load_plan, read_plan
from formulations.transcription.workbench import Account, Workbench, primal_dual
from models.scene import Scene
from models.schemes import Scheme
from models.trajectory import Trajectory

# From this sharpness b L on a stage takes the multipliers of the one before: earlier the plan still moves too far
# for them (three carts: 64 iterations in all; 140 from the second stage on, 75 without any).
_DUALS_FROM = 100.0
# Largest softplus force of touching bodies, in parts of the strongest input: 3 N of 10 N for the three carts, k = 30 and b = 7.
_TOUCH = 0.3
# Most iterations of a stage once there is a plan: those that ended well mostly took up to 83 (chains of 2 to 5 carts); one that needs more has
# lost its way in restoration, and the plans before it are worth more than the time it takes.
PATIENCE = 200


class SoftplusHomotopy:
    """The softplus model of one scene, built once. schedule: b L of its stages; ball: radius of the goal, as in `quadratic`; scheme, integrate_cost: as in `build_model`."""

    def __init__(
        self,
        scene: Scene,
        ball: float,
        schedule: tuple[float, ...],
        *,
        scheme: Scheme = Scheme.SEMI_IMPLICIT_EULER,
        integrate_cost: bool = False,
    ) -> None:
        model = build_model(scene, ContactLaw.SOFTPLUS, eps=_eps(schedule[0]), scheme=scheme, integrate_cost=integrate_cost)
        self._stiffness = _own_stiffness(scene)
        self._stages = tuple(_stages(scene, schedule, bool(self._stiffness))) if scene.nc else ((schedule[0], 1.0),)
        open_goal(model, ball)
        self._bench = Workbench(model)

    @property
    def bench(self) -> Workbench:
        """The model, which holds the last stage's plan."""
        return self._bench

    def move_ball(self, ball: float) -> None:
        """Another radius of the goal: positive if it was built with one, else 0."""
        move_ball(self._bench.model, ball)

    def run(
        self,
        account: Account,
        options: Mapping[str, Any],
        start: Trajectory | None,
        keep: Callable[[Trajectory], None],
        patience: int = 10**9,
    ) -> tuple[Outcome, str]:
        """How the last stage ended, and in words. keep: called with the plan of every stage that was solved; patience: most iterations of a
        stage once there is a plan."""
        model = self._bench.model
        if start is None:
            load_first_guess(model)
        else:
            load_plan(model, start)
        plan, before = None, None
        outcome, message = Outcome.FAILED, ""
        options = {**options, "max_iter": account.iterations + options["max_iter"]}  # those of other runs do not count
        for sharpness, share in self._stages:
            if len(self._stages) > 1:
                tighten(model, _eps(sharpness))
            for name, value in self._stiffness.items():
                model.parameter_scene[name] = share * value
            warm = primal_dual(before) if before is not None and sharpness >= _DUALS_FROM else None
            allowed = options if plan is None else {**options, "max_iter": min(options["max_iter"], account.iterations + patience)}
            result = self._bench.run(account, allowed, warm)
            if not result.solved and warm is not None and plan is not None and not account.is_over:
                load_plan(model, plan)
                result = self._bench.run(account, allowed)
            outcome, message = result.outcome, result.message
            if not result.solved:
                break
            before, plan = result, read_plan(model)
            keep(plan)
        return outcome, message


def schedule(first: float, last: float, growth: float) -> tuple[float, ...]:
    """b L by b L, from the first to the last by a constant factor."""
    count = int(np.floor(np.log(max(last / first, 1.0)) / np.log(growth) + 1e-9)) + 1
    return tuple(first * growth**index for index in range(count))


def _own_stiffness(scene: Scene) -> dict[str, float]:
    """Parameters that are the stiffness of contacts and nothing else; empty unless all contacts have such."""
    symbols = {contact.stiffness for contact in scene.contacts}
    parameters = {parameter.symbol: parameter for parameter in scene.parameters}
    physics = [scene.kinetic_energy, scene.potential_energy, *scene.forces, scene.task.running_cost, scene.task.final_cost]
    elsewhere = set().union(*(sp.sympify(e).free_symbols for e in (*physics, *(contact.penetration for contact in scene.contacts))))
    if not all(symbol in parameters and symbol not in elsewhere for symbol in symbols):
        return {}
    return {parameters[symbol].name: parameters[symbol].value for symbol in parameters if symbol in symbols}


def _stages(scene: Scene, schedule: tuple[float, ...], may_soften: bool) -> Iterator[tuple[float, float]]:
    """(sharpness b L, part of the stiffness) stage by stage."""
    stiffest = max(float(sp.sympify(contact.stiffness).subs(scene.parameter_values)) for contact in scene.contacts)
    strongest = max(max(abs(item.lower), abs(item.upper)) for item in scene.inputs)
    share = 1.0
    for sharpness in schedule:
        touch = stiffest * scene.length * np.log(2.0) / sharpness
        share = min(1.0, _TOUCH * strongest / touch) if may_soften else 1.0
        yield sharpness, share
    while share < 1.0:
        share = min(1.0, 2.0 * share)
        yield schedule[-1], share


def _eps(sharpness: float) -> float:
    """The eps whose |ln eps| is this sharpness."""
    return float(np.exp(-sharpness))
