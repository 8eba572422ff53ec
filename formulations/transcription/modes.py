"""A complementarity model with its contact modes fixed: every pair is decided, and what is left is solved exactly.

Closed means lam = k phi, open lam = 0. Pairs at lam = 0 = lam - k phi whose multiplier says that the other mode is cheaper are switched, and the problem
is solved again.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from formulations.ipopt import IpoptProblem, IpoptResult
from formulations.solution import Outcome
from formulations.transcription.budget import SolveBudget
from formulations.transcription.build import load_plan, read_plan
from formulations.transcription.compiled import CompiledModel
from formulations.transcription.contact import hold_modes, pressed_columns, sides

# Modes that have a plan are solved in 6 to 20 iterations; more are spent only on proving that there is none.
_MODE_ITERATIONS = 100
# They start from a plan that is nearly theirs: Ipopt's own barrier (0.1) first pushes it away from every bound, so far that two fingers that lift
# a disc end in restoration; with this one they need 23 iterations.
_NEAR = {"mu_init": 1e-4, "bound_push": 1e-6, "bound_frac": 1e-6}
# A pair counts as undecided where both forces are below this [N], and as wanting the other mode where that would lower the cost by
# more than this a newton: both well above Ipopt's 1e-8 and far below any force that moves a cart.
_UNDECIDED, _WANTING = 1e-5, 1e-5


class FixedModes:
    """The problem without complementarity of a built model, translated at its first use. options: Ipopt's; most_switches: rounds of switching."""

    def __init__(self, model: Any, options: Mapping[str, Any], most_switches: int) -> None:
        self._model, self._options, self._most_switches = model, {**options, **_NEAR}, most_switches
        self._compiled = CompiledModel(model)

    def solve(self, budget: SolveBudget, closed: np.ndarray) -> IpoptResult:
        """The last solved problem, its plan left in the model.

        Parameters
        ----------
        budget : what the stage may spend
        closed : (steps, nc + 2 nf + springs + switches) as in `hold_modes` [-]
        """
        hold_modes(self._model, closed)
        best = self._run(budget)
        for _ in range(self._most_switches):
            if best.outcome is not Outcome.SOLVED or budget.is_over:
                return best
            switch = _cheaper_modes(self._compiled.problem(budget), best, self._model, closed)
            if not switch.any():
                return best
            plan, closed = read_plan(self._model), closed ^ switch
            hold_modes(self._model, closed)
            again = self._run(budget)
            if again.outcome is not Outcome.SOLVED or again.objective >= best.objective:
                load_plan(self._model, plan)  # no gain beyond rounding: keep what was there
                return best
            best = again
        return best

    def _run(self, budget: SolveBudget) -> IpoptResult:
        most = min(self._options["max_iter"], budget.iterations + _MODE_ITERATIONS)
        return self._compiled.run(budget, {**self._options, "max_iter": most})


def _cheaper_modes(problem: IpoptProblem, result: IpoptResult, model: Any, closed: np.ndarray) -> np.ndarray:
    """Pairs (steps, nc + 2 nf) at lam = 0 = v that would lower the cost in the other mode: the force held at zero there has a negative multiplier."""
    place = {id(variable): column for column, variable in enumerate(problem.variables)}
    couples = sides(model)
    lam, separation = (np.array([place[id(couple[side])] for couple in couples]) for side in (0, 1))
    slope = problem.lagrangian_gradient(result.x, result.lagrange)
    undecided = np.maximum(result.x[lam], result.x[separation]) < _UNDECIDED
    held = np.where(closed.ravel(), separation, lam)
    switch = (undecided & (slope[held] < -_WANTING)).reshape(closed.shape)
    for contact, forward in pressed_columns(model):  # a friction that nothing presses has no mode to switch
        switch[:, forward : forward + 2] &= closed[:, contact : contact + 1]
    return switch
