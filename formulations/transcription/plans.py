"""Plans in and out of a model: a Trajectory as first guess, the model's values as a Trajectory."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyomo.environ as pyo

from formulations.transcription.collocation import forces_at_nodes, is_collocated, scheme_of, settle_stages
from formulations.transcription.contact_laws import settle_separation
from models.errors import TrajectoryError
from models.trajectory import Trajectory, uniform_grid


def load_plan(block: Any, plan: Trajectory) -> None:
    """Write a plan into the variables of a block, as first guess. Its ends need not be those of the task.

    Raises TrajectoryError unless the plan has the block's grid and numbers of columns.
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
    """(n,) values of an indexed variable in its own order, NaN where there is none."""
    return np.array([np.nan if data.value is None else data.value for data in variable.values()], dtype=float)


def write_values(variable: Any, values: np.ndarray) -> None:
    """Set an indexed variable from an array in its own order; a value outside the bounds is a guess like any other."""
    for data, value in zip(variable.values(), np.asarray(values, dtype=float).ravel().tolist(), strict=True):
        data.set_value(value, skip_validation=True)
