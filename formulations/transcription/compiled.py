"""A compiled model: translated for Ipopt once, solved many times.

And how large it is, counted on paper beside what Ipopt is given.

T steps, g of the 2 nq components of the end given:

    unknowns      2 nq (T+1) + nu T + nc T + nf T       states, inputs, contact and friction forces
    equations   2 nq + g + 2 nq T + nc T + nf T
        start, end, time steps, one law a contact and friction

Complementarity adds to each contact and step its separation force and that force's definition; to
each friction and step two slip speeds, two reserves, and the four equations that tie them to the
slip and to the force; to each damped contact and step the force of its spring and that force's
complement, its definition and their product, and with Kelvin-Voigt as much for the switch.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from time import perf_counter
from typing import Any

import numpy as np

from formulations.ipopt import (
    IpoptProblem,
    IpoptResult,
    Iteration,
    Start,
    compile_model,
    load,
    solve,
)
from formulations.solution import ModelSize
from formulations.transcription.build import load_first_guess, load_plan, read_plan
from formulations.transcription.contact import ContactFormulation
from formulations.transcription.method import SolveBudget
from models.scene import Scene
from models.scene.contacts import DampingLaw
from models.trajectory import Trajectory


def size_on_paper(scene: Scene, contact: ContactFormulation) -> ModelSize:
    """Unknowns and equations of the scene's model by hand; see the module docstring."""
    steps, given = scene.task.steps, sum(value is not None for value in scene.task.goal)
    laws = [scene.contacts[index].damping_law for index in scene.damped]
    pairs = len(laws) + laws.count(DampingLaw.KELVIN_VOIGT)
    extra = (
        scene.nc + 4 * scene.nf + 2 * pairs if contact is ContactFormulation.COMPLEMENTARITY else 0
    )
    return ModelSize(
        unknowns=2 * scene.nq * (steps + 1) + (scene.nu + scene.nl + extra) * steps,
        equations=2 * scene.nq + given + (2 * scene.nq + scene.nl + extra) * steps,
    )


Callback = Callable[[Iteration], "bool | None"]


class CompiledModel:
    """One Pyomo model and its translation."""

    def __init__(self, model: Any) -> None:
        self.model = model
        self._problem: IpoptProblem | None = None

    def problem(self, budget: SolveBudget) -> IpoptProblem:
        """The translation, current with the model's Params and bounds."""
        begin = perf_counter()
        if self._problem is None:
            self._problem = compile_model(self.model)
        else:
            self._problem.refresh()
        budget.translate += perf_counter() - begin
        return self._problem

    def load(self, start: Trajectory | None) -> None:
        """The model holds this plan, or the paper's first guess.

        Raises TrajectoryError for a plan of another grid.
        """
        if start is None:
            load_first_guess(self.model)
        else:
            load_plan(self.model, start)

    def read(self) -> Trajectory:
        """The plan that the model holds. Raises TrajectoryError where a value is not finite."""
        return read_plan(self.model)

    @property
    def size(self) -> ModelSize | None:
        """Of what was translated; None before the first solve."""
        return (
            None
            if self._problem is None
            else ModelSize(unknowns=self._problem.n, equations=self._problem.m)
        )

    def run(
        self,
        budget: SolveBudget,
        options: Mapping[str, Any],
        after: IpoptResult | None = None,
        *,
        callback: Callback | None = None,
    ) -> IpoptResult:
        """Solve from the values of the model's variables, or with all that another solve knew, and write the point where it ended into the model.

        Parameters
        ----------
        budget : of the stage
        options : Ipopt's; max_iter counts for the whole stage
        after : the other solve, whose point and multipliers this one starts from
        callback : called after each iteration; False stops
        """
        problem = self.problem(budget)
        left = {
            **options,
            "max_iter": int(
                max(
                    0, min(options["max_iter"] - budget.iterations, budget.iterations_left(problem))
                )
            ),
        }
        start = (
            None
            if after is None
            else Start(x=after.x, lagrange=after.lagrange, zl=after.zl, zu=after.zu)
        )
        result = solve(
            problem,
            options=left,
            warm_start=start,
            callback=callback,
            time_limit=budget.remaining,
        )
        budget.add(result, problem)
        if np.all(np.isfinite(result.x)):
            load(problem, result)
        return result

    def ends(
        self, budget: SolveBudget, result: IpoptResult, variables: Iterable[Any]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Values (n,) of variables at the end of a solve, and by each the derivative (n,) of the Lagrangian without its bounds: the multipliers of these."""
        problem = self.problem(budget)
        place = {id(variable): column for column, variable in enumerate(problem.variables)}
        columns = np.array([place[id(variable)] for variable in variables])
        return result.x[columns], problem.lagrangian_gradient(result.x, result.lagrange)[columns]
