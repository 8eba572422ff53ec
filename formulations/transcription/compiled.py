"""A model compiled for Ipopt once and solved many times; its size counted by hand."""

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
    """Count the unknowns and equations of a model with T steps and g goal components.

        unknowns    2 nq (T+1) + nu T + nc T + nf T    states, inputs, contact and friction forces
        equations   2 nq + g + 2 nq T + nc T + nf T    start, end, time steps, laws

    Complementarity adds per step: a separation force and its definition per contact; two slip
        speeds,
    two reserves and four equations per friction; a spring force, its complement, definition and
    product per damped contact, and as many for a Kelvin-Voigt switch.
    """
    steps, ends_given = scene.task.steps, sum(value is not None for value in scene.task.goal)
    laws = [scene.contacts[index].damping_law for index in scene.damped]
    pairs = len(laws) + laws.count(DampingLaw.KELVIN_VOIGT)
    extra = (
        scene.nc + 4 * scene.nf + 2 * pairs if contact is ContactFormulation.COMPLEMENTARITY else 0
    )
    return ModelSize(
        unknowns=2 * scene.nq * (steps + 1) + (scene.nu + scene.nl + extra) * steps,
        equations=2 * scene.nq + ends_given + (2 * scene.nq + scene.nl + extra) * steps,
    )


Callback = Callable[[Iteration], "bool | None"]


class CompiledModel:
    """One Pyomo model and its compiled problem."""

    def __init__(self, model: Any) -> None:
        self.model = model
        self._problem: IpoptProblem | None = None

    def problem(self, budget: SolveBudget) -> IpoptProblem:
        """Return the compiled problem, refreshed."""
        begin = perf_counter()
        if self._problem is None:
            self._problem = compile_model(self.model)
        else:
            self._problem.refresh()
        budget.translate += perf_counter() - begin
        return self._problem

    def load(self, start: Trajectory | None) -> None:
        """Load this plan, or the paper's first guess. Raises TrajectoryError for another grid."""
        if start is None:
            load_first_guess(self.model)
        else:
            load_plan(self.model, start)

    def read(self) -> Trajectory:
        """Return the plan in the model. Raises TrajectoryError for a value that is not finite."""
        return read_plan(self.model)

    @property
    def size(self) -> ModelSize | None:
        """Return the compiled size, None before the first solve."""
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
        """Solve from the model's values, or after another solve, and load the end point.

        options: Ipopt's; max_iter is for the whole stage
        after: another solve, with the point and multipliers of the start
        callback: called after each iteration; False stops
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
        """Return values (n,) of variables after a solve, and the multipliers (n,) of their bounds.

        A multiplier is the derivative of the Lagrangian without bounds [objective per variable].
        Raises KeyError for a variable outside the model.
        """
        problem = self.problem(budget)
        place = {id(variable): column for column, variable in enumerate(problem.variables)}
        columns = np.array([place[id(variable)] for variable in variables])
        return result.x[columns], problem.lagrangian_gradient(result.x, result.lagrange)[columns]
