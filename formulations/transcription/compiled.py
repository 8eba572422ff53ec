"""A model on the bench: translated once, solved many times.

The goal of a built model as a ball instead of a point.

Plans in and out of a model: a Trajectory as first guess, the model's values as a Trajectory.

How large a scene's model is: counted on paper, beside what Ipopt is given.

T steps, g of the 2 nq components of the end given:

    unknowns      2 nq (T+1) + nu T + nc T + nf T       states, inputs, contact and friction forces
    equations     2 nq + g + 2 nq T + nc T + nf T       start, end, time steps, one law a contact and friction

Complementarity adds to each contact and step its separation force and that force's definition; to each friction and step two slip speeds, two
reserves, and the four equations that tie them to the slip and to the force; to each damped contact and step the force of its spring and that
force's complement, its definition and their product, and with Kelvin-Voigt as much for the switch.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from time import perf_counter
from typing import Any

import numpy as np
import pyomo.environ as pyo

from formulations.ipopt import IpoptProblem, IpoptResult, Iteration, Start, compile_model, load, solve
from formulations.solution import ModelSize
from formulations.transcription.budget import SolveBudget
from formulations.transcription.collocation import forces_at_nodes, is_collocated, scheme_of, settle_stages
from formulations.transcription.contact import ContactFormulation, settle_separation
from models.errors import TrajectoryError
from models.scene import Scene
from models.scene.contacts import DampingLaw
from models.trajectory import Trajectory, uniform_grid


def open_goal(model: Any, ball: float) -> None:
    """Let the plan end within `ball` of the goal, in the norm of (q, v); 0 leaves the goal as it is, and a free end stays free."""
    if ball == 0.0:
        return
    given = release_goal(model)
    if given:
        # in units of the ball: its multiplier then has the size of the cost, however small the ball is
        model.parameter_goal_ball = radius = pyo.Param(initialize=ball, mutable=True)
        model.constraint_goal_ball = pyo.Constraint(expr=sum(((state - goal) / radius) ** 2 for state, goal, _ in given) <= 1.0)


def move_ball(model: Any, ball: float) -> None:
    """Another radius for the ball that `open_goal` has put around the goal; nothing where there is none."""
    if model.component("parameter_goal_ball") is not None:
        model.parameter_goal_ball.value = ball


def release_goal(model: Any) -> list[tuple[Any, Any, str]]:
    """Take the goal's constraints out; returns (last state, goal, coordinate) of every component that was given."""
    last = max(model.set_nodes)
    given = []
    for part, variable in (("position", model.variable_q), ("velocity", model.variable_v)):
        constraint, goal = model.component(f"constraint_goal_{part}"), model.component(f"parameter_goal_{part}")
        if constraint is not None:
            constraint.deactivate()
            given += [(variable[last, name], goal[name], name) for name in goal]
    return given


def load_plan(block: Any, plan: Trajectory) -> None:
    """Write a plan into the variables of a block, as first guess. Its ends need not be those of the task.

    Raises
    ------
    TrajectoryError
        unless the plan has the block's grid and numbers of columns
    """
    steps, h = len(block.set_steps), pyo.value(block.parameter_step)
    grid = uniform_grid(h, steps)
    if plan.steps != steps or not np.allclose(plan.t - plan.t[0], grid, rtol=1e-9, atol=1e-9 * h):
        raise TrajectoryError(
            f"warm start: it has {plan.steps} steps over {plan.t[-1] - plan.t[0]:g} s, but model {block.name} has {steps} steps of {h:g} s; "
            "resample it to that grid."
        )
    friction = block.component("variable_friction")
    nf = 0 if friction is None else len(friction) // steps
    nc = plan.lam.shape[1] - nf
    arrays = {"q": plan.q, "v": plan.v, "u": plan.u, "lam": plan.lam[:, : max(nc, 0)], "friction": plan.lam[:, max(nc, 0) :]}
    for name, values in arrays.items():
        variable = block.component(f"variable_{name}")
        columns = 0 if variable is None else len(variable) // len(values)
        if name == "lam" and is_collocated(block):
            columns //= len(block.set_stages)
        if values.shape[1] != columns:
            raise TrajectoryError(f"warm start: {name} has {values.shape[1]} columns, but model {block.name} has {columns}.")
        if variable is not None and not (name == "lam" and is_collocated(block)):
            write_values(variable, values)
    if is_collocated(block):
        settle_stages(block)
    settle_separation(block)


def load_first_guess(block: Any) -> None:
    """The paper's first guess: the start held, no inputs (or the nearest allowed), no contact forces."""
    for name, end in (("variable_q", "position"), ("variable_v", "velocity")):
        start = [pyo.value(value) for value in block.component(f"parameter_start_{end}").values()]
        write_values(block.component(name), np.tile(start, (len(block.set_nodes), 1)))
    if block.component("variable_u") is not None:
        for data in block.variable_u.values():
            data.set_value(
                min(max(0.0, -np.inf if data.lb is None else data.lb), np.inf if data.ub is None else data.ub), skip_validation=True
            )
    for name in ("variable_lam", "variable_friction"):
        if block.component(name) is not None:
            write_values(block.component(name), np.zeros((len(block.component(name)), 1)))
    if is_collocated(block):
        settle_stages(block)
    settle_separation(block)


def read_plan(block: Any) -> Trajectory:
    """The plan that the block's variables hold now. Raises TrajectoryError where one has no finite value."""
    steps = len(block.set_steps)
    arrays = {}
    for name, rows in (("q", steps + 1), ("v", steps + 1), ("u", steps), ("lam", steps), ("friction", steps)):
        variable = block.component(f"variable_{name}")
        if name == "lam" and is_collocated(block):
            arrays[name] = forces_at_nodes(block)
            continue
        arrays[name] = np.zeros((rows, 0)) if variable is None else read_values(variable).reshape(rows, -1)
    arrays["lam"] = np.hstack([arrays["lam"], arrays.pop("friction")])
    return Trajectory(t=uniform_grid(pyo.value(block.parameter_step), steps), scheme=scheme_of(block), **arrays)


def read_values(variable: Any) -> np.ndarray:
    """Values (n,) of an indexed variable in its own order, NaN where there is none [units of the variable]."""
    return np.array([np.nan if data.value is None else data.value for data in variable.values()], dtype=float)


def write_values(variable: Any, values: np.ndarray) -> None:
    """Set an indexed variable from values (n,) in its own order [units of the variable]; one outside the bounds is a guess like any other."""
    for data, value in zip(variable.values(), np.asarray(values, dtype=float).ravel().tolist(), strict=True):
        data.set_value(value, skip_validation=True)


def size_on_paper(scene: Scene, contact: ContactFormulation) -> ModelSize:
    """Unknowns and equations of the scene's model by hand; see the module docstring."""
    steps, given = scene.task.steps, sum(value is not None for value in scene.task.goal)
    laws = [scene.contacts[index].damping_law for index in scene.damped]
    pairs = len(laws) + laws.count(DampingLaw.KELVIN_VOIGT)
    extra = scene.nc + 4 * scene.nf + 2 * pairs if contact is ContactFormulation.COMPLEMENTARITY else 0
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

    def read(self) -> Trajectory:
        """The plan that the model holds. Raises TrajectoryError where a value is not finite."""
        return read_plan(self.model)

    @property
    def size(self) -> ModelSize | None:
        """Of what was translated; None before the first solve."""
        return None if self._problem is None else ModelSize(unknowns=self._problem.n, equations=self._problem.m)

    def run(
        self,
        budget: SolveBudget,
        options: Mapping[str, Any],
        start: Start | None = None,
        *,
        share: float = 1.0,
        callback: Callback | None = None,
    ) -> IpoptResult:
        """Solve from `start` (default: the values of the model's variables), and write the point where it ended into the model.

        Parameters
        ----------
        budget : of the stage
        options : Ipopt's; max_iter counts for the whole stage
        start : with multipliers, perhaps
        share : part of the remaining time this run may take
        callback : called after each iteration; False stops
        """
        problem = self.problem(budget)
        left = {**options, "max_iter": int(max(0, min(options["max_iter"] - budget.iterations, budget.iterations_left(problem))))}
        result = solve(problem, options=left, warm_start=start, callback=callback, time_limit=share * budget.remaining)
        budget.add(result, problem)
        if np.all(np.isfinite(result.x)):
            load(problem, result)
        return result


def primal_dual(result: IpoptResult) -> Start:
    """A start with all that the last solve knew."""
    return Start(x=result.x, lagrange=result.lagrange, zl=result.zl, zu=result.zu)
