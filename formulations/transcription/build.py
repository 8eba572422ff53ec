"""Build the Pyomo model of a plan, write plans into it and read them from it.

model = build_model("three_cart", contact=ContactFormulation.SOFTPLUS, eps=1e-3)
model.parameter_scene["k"] = 300.0  # no rebuilding
model.own = pyo.Constraint(expr=model.variable_q[250, "q2"] >= 3.2)
load_plan(model, plan)  # a Trajectory as first guess
plan = read_plan(model)  # the model's values as a Trajectory
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import numpy as np
import pyomo.environ as pyo
from pyomo.common.gc_manager import PauseGC

from formulations.grids import check_grid
from formulations.transcription import equations
from formulations.transcription.collocation import (
    add_collocation,
    forces_at_nodes,
    is_collocated,
    settle_stages,
)
from formulations.transcription.contact import (
    ContactFormulation,
    ModelError,
    SceneExpressions,
    add_contact_law,
    add_friction,
    add_springs,
    damped_softplus,
    relax,
    rows_by_time,
    settle_separation,
)
from models.catalog import as_scene
from models.contact_law import sharpness
from models.dynamics import derive
from models.errors import SceneError, TrajectoryError, named_arguments
from models.scene import Scene
from models.schemes import Scheme
from models.trajectory import Trajectory, uniform_grid


@named_arguments(SceneError)
def build_model(
    scene: Scene | str | Path,
    contact: ContactFormulation = ContactFormulation.COMPLEMENTARITY,
    *,
    eps: float | None = None,
    steps: int | None = None,
    step: float | None = None,
    scheme: Scheme = Scheme.SEMI_IMPLICIT_EULER,
    integrate_cost: bool = False,
) -> pyo.ConcreteModel:
    """Return a plain Pyomo model of the scene's task, at the paper's first guess.

    The first guess: all nodes at the start, u = lam = 0. `build_block` lists the components.

    Parameters
    ----------
    scene : a Scene, its name, or the path of its file
    contact : formulation of contact
    eps : SOFTPLUS: 0 < eps < 1; COMPLEMENTARITY: a number applies Pyomo's `mpec.simple_nonlinear`
        with that bound [N^2], None leaves pyomo.mpec's `Complementarity` untransformed
    steps, step : another grid [s]; the plan lasts steps * step
    scheme : the time step, semi-implicit Euler or a collocation (see `collocation`)
    integrate_cost : with a collocation, integrate the running cost by its quadrature instead of
        summing over the nodes

    Raises
    ------
    ModelError
        for an unknown contact, and a scene without collocation
    SceneError
        for an object that is no scene, and a function that Pyomo does not have
    UnknownNameError
        for an unknown scene name

    Examples
    --------
    >>> import pyomo.environ as pyo
    >>> from formulations import ContactFormulation, build_model, set_relaxation
    >>> model = build_model("three_cart", contact=ContactFormulation.COMPLEMENTARITY, eps=1e-2, steps=50, step=0.1)
    >>> model.parameter_scene["k"] = 300.0  # stiffer contact, no rebuilding
    >>> # a constraint of the caller
    >>> model.own = pyo.Constraint(expr=model.variable_q[25, "q2"] <= 3.2)
    >>> set_relaxation(model, 1e-4)  # another bound, the same model
    >>> pyo.value(model.mpec_bound)
    0.0001
    """
    chosen = as_scene(scene)
    model = pyo.ConcreteModel(name=chosen.name)
    build_block(
        model,
        chosen,
        contact,
        eps=eps,
        steps=steps,
        step=step,
        scheme=scheme,
        integrate_cost=integrate_cost,
    )
    model.objective_cost = pyo.Objective(expr=model.expression_cost, sense=pyo.minimize)
    return model


def build_block(
    block: Any,
    scene: Scene | str | Path,
    contact: ContactFormulation = ContactFormulation.COMPLEMENTARITY,
    *,
    eps: float | None = None,
    steps: int | None = None,
    step: float | None = None,
    scheme: Scheme = Scheme.SEMI_IMPLICIT_EULER,
    integrate_cost: bool = False,
) -> None:
    """Fill a Block as `build_model` does, without an objective (see `block.expression_cost`).

    Components exist only if the scene needs them; t in 0..T (`set_nodes`) or 0..T-1 (`set_steps`):

    | name | index | meaning |
    |---|---|---|
    | variable_q, variable_v | node, coordinate | positions [m, rad], velocities |
    | variable_u | step, input | inputs within their bounds |
    | variable_lam | step, contact | contact forces [N] at the start of the step |
    | variable_spring, variable_touch | step, damped contact | see `contact.add_springs` |
    | variable_friction | step, friction | friction forces [N], by the slip at the end of the step |
    | variable_slip | step, friction, way | slip speeds [m/s] of complementarity |
    | parameter_scene | parameter | the scene's parameters, mutable |
    | parameter_start_position, parameter_start_velocity | coordinate | mutable |
    | parameter_goal_position, parameter_goal_velocity | coordinate | mutable; not for a free end |
    | parameter_step | | h [s], mutable |
    | parameter_sharpness | | softplus: b = abs(ln eps)/L [1/m], mutable |
    | parameter_length | | softplus: the scene's length L [m] |
    | mpec_bound | | eps of relaxed complementarity, mutable |
    | constraint_start_position, constraint_start_velocity | coordinate | |
    | constraint_goal_position, constraint_goal_velocity | coordinate | not for a free end |
    | constraint_position_step, constraint_velocity_step | step, coordinate | semi-implicit Euler |
    | constraint_contact_softplus or complementarity_contact | step, contact | contact law |
    | complementarity_spring, complementarity_touch | step, damped contact | spring and switch |
    | constraint_friction_regularised | step, friction | friction law of softplus |
    | constraint_slip, complementarity_friction | step, friction (, way) | of complementarity |
    | expression_cost | | running and final cost |
    | objective_cost | | only in `build_model` |

    >>> import pyomo.environ as pyo
    >>> from formulations import ContactFormulation, build_block
    >>> model = pyo.ConcreteModel()
    >>> model.soft, model.stiff = pyo.Block(), pyo.Block()
    >>> build_block(model.soft, "three_cart", ContactFormulation.SOFTPLUS, eps=1e-3, steps=20)
    >>> build_block(model.stiff, "three_cart", ContactFormulation.SOFTPLUS, eps=1e-5, steps=20)
    >>> model.same_force = pyo.Constraint(model.soft.set_steps, rule=lambda m, t: m.soft.variable_u[t, "u1"] == m.stiff.variable_u[t, "u1"])
    >>> model.cost = pyo.Objective(expr=model.soft.expression_cost + model.stiff.expression_cost)
    """
    chosen = as_scene(scene)
    if hasattr(block, "set_nodes"):
        raise ModelError(
            f"{block.name} holds a plan already; build each plan into a Block of its own."
        )
    if not isinstance(contact, ContactFormulation):
        raise ModelError(
            f"contact is {contact!r}, but must be one of {', '.join(str(law) for law in ContactFormulation)}."
        )
    if not isinstance(scheme, Scheme):
        raise ModelError(
            f"scheme is {scheme!r}, but must be one of {', '.join(str(item) for item in Scheme)}."
        )
    if steps is not None or step is not None:
        task = chosen.task
        chosen = chosen.with_task(
            steps=task.steps if steps is None else steps, step=task.step if step is None else step
        )
    # Checks eps before the model is built.
    b = (
        sharpness(cast(float, eps), chosen.length)
        if contact is ContactFormulation.SOFTPLUS
        else None
    )
    with PauseGC():
        _add_sets(block, chosen)
        _add_parameters(block, chosen)
        if b is not None:
            block.parameter_length = pyo.Param(initialize=chosen.length)
        _add_variables(block, chosen)
        _add_ends(block, chosen)
        if scheme is Scheme.SEMI_IMPLICIT_EULER:
            _add_steps(block, chosen, contact, b)
        else:
            add_collocation(block, chosen, contact, b, scheme, integrate_cost=integrate_cost)
        if contact is ContactFormulation.COMPLEMENTARITY and eps is not None and chosen.nl:
            relax(block, eps)


def _add_sets(block: Any, scene: Scene) -> None:
    block.set_nodes = pyo.RangeSet(0, scene.task.steps)
    block.set_steps = pyo.RangeSet(0, scene.task.steps - 1)
    block.set_coordinates = pyo.Set(
        initialize=[coordinate.name for coordinate in scene.coordinates]
    )
    if scene.nu:
        block.set_inputs = pyo.Set(initialize=[item.name for item in scene.inputs])
    if scene.nc:
        block.set_contacts = pyo.Set(initialize=[contact.name for contact in scene.contacts])


def _add_parameters(block: Any, scene: Scene) -> None:
    nq, names = scene.nq, list(block.set_coordinates)
    if scene.parameters:
        values = {parameter.name: parameter.value for parameter in scene.parameters}
        block.parameter_scene = pyo.Param(list(values), initialize=values, mutable=True)
    for end, state in (("start", scene.task.start), ("goal", scene.task.goal)):
        for part, values in (("position", state[:nq]), ("velocity", state[nq:])):
            table = {
                name: value for name, value in zip(names, values, strict=True) if value is not None
            }
            index = block.set_coordinates if len(table) == nq else list(table)
            if table:
                block.add_component(
                    f"parameter_{end}_{part}", pyo.Param(index, initialize=table, mutable=True)
                )
    block.parameter_step = pyo.Param(initialize=scene.task.step, mutable=True)


def _add_variables(block: Any, scene: Scene) -> None:
    nodes, steps = block.set_nodes, block.set_steps
    start = dict(
        zip(
            block.set_coordinates,
            zip(scene.task.start[: scene.nq], scene.task.start[scene.nq :], strict=True),
            strict=True,
        )
    )
    block.variable_q = pyo.Var(
        nodes, block.set_coordinates, initialize=lambda b, t, name: start[name][0]
    )
    block.variable_v = pyo.Var(
        nodes, block.set_coordinates, initialize=lambda b, t, name: start[name][1]
    )
    for coordinate in scene.coordinates:
        for t in range(scene.task.steps) if coordinate.has_velocity_bounds else ():
            block.variable_v[t, coordinate.name].setlb(coordinate.velocity_lower)
            block.variable_v[t, coordinate.name].setub(coordinate.velocity_upper)
    if scene.nu:
        bounds = {item.name: (item.lower, item.upper) for item in scene.inputs}
        first = {name: min(max(0.0, lower), upper) for name, (lower, upper) in bounds.items()}
        block.variable_u = pyo.Var(
            steps,
            block.set_inputs,
            bounds=lambda b, t, name: bounds[name],
            initialize=lambda b, t, name: first[name],
        )


def _add_ends(block: Any, scene: Scene) -> None:
    for end, node in (("start", 0), ("goal", scene.task.steps)):
        for part, variable in (("position", block.variable_q), ("velocity", block.variable_v)):
            value = block.component(f"parameter_{end}_{part}")
            if value is None:  # a free end
                continue
            rows = pyo.Constraint(
                value.index_set(),
                rule=lambda b, name, node=node, variable=variable, value=value: (
                    variable[node, name] == value[name]
                ),
            )
            block.add_component(f"constraint_{end}_{part}", rows)


def _add_steps(block: Any, scene: Scene, contact: ContactFormulation, b: float | None) -> None:
    law = SceneExpressions(derive(scene))
    nq, h = scene.nq, block.parameter_step
    p = list(block.parameter_scene.values()) if scene.parameters else []
    q, v = (
        rows_by_time(block.variable_q, scene.task.steps + 1),
        rows_by_time(block.variable_v, scene.task.steps + 1),
    )
    u = rows_by_time(block.variable_u, scene.task.steps) if scene.nu else [[]] * scene.task.steps
    place = {name: index for index, name in enumerate(block.set_coordinates)}
    lam: list[list[Any]] = [[]] * scene.task.steps
    if scene.nc:
        lam = _add_contact(block, scene, contact, b, law, (q, v), p)
    if scene.nf:
        friction = add_friction(block, scene, law, b, (q, v, lam), p)
        lam = [[*contacts, *frictions] for contacts, frictions in zip(lam, friction, strict=True)]
    mass = [law.mass(q_now, p) for q_now in q[:-1]]
    force = [law.force(*arguments, p) for arguments in zip(q[:-1], v[:-1], u, lam, strict=True)]

    def position(_: Any, t: int, name: str) -> Any:
        i = place[name]
        return equations.constraint_position_step(q[t + 1][i], q[t][i], v[t + 1][i], h)

    def velocity(_: Any, t: int, name: str) -> Any:
        i = place[name]
        return equations.constraint_velocity_step(
            mass[t][i * nq : (i + 1) * nq], v[t + 1], v[t], force[t][i], h
        )

    block.constraint_position_step = pyo.Constraint(
        block.set_steps, block.set_coordinates, rule=position
    )
    block.constraint_velocity_step = pyo.Constraint(
        block.set_steps, block.set_coordinates, rule=velocity
    )
    costs = [
        law.running_cost(*arguments, p)[0] for arguments in zip(q[:-1], v[:-1], u, strict=True)
    ]
    block.expression_cost = pyo.Expression(
        expr=equations.expression_cost([*costs, *law.final_cost(q[-1], v[-1], p)])
    )


def _add_contact(
    block: Any,
    scene: Scene,
    contact: ContactFormulation,
    b: float | None,
    law: SceneExpressions,
    states: tuple[list, list],
    p: list[Any],
) -> list[list[Any]]:
    """Add the contact forces and their law; return lam[t][contact].

    states: q, v as rows of variables
    """
    q, v = states
    place = {name: index for index, name in enumerate(block.set_contacts)}
    block.variable_lam = pyo.Var(block.set_steps, block.set_contacts, initialize=0.0)
    lam = rows_by_time(block.variable_lam, scene.task.steps)
    k = law.stiffness(p)
    phi = [law.penetration(q_now, p) for q_now in q[:-1]]
    pushes: list[dict[int, Any]] = [{}] * scene.task.steps
    if contact is ContactFormulation.COMPLEMENTARITY:
        block.variable_lam.setlb(0.0)
        pushes = add_springs(block, scene, law, phi, q, v, p) if scene.damped else pushes

    def softplus(t: int, name: str) -> Any:
        i = place[name]
        if i in scene.damped:
            rate = law.penetration_rate(q[t], v[t], p)[i]
            return lam[t][i] == damped_softplus(
                scene, i, phi[t][i], rate, k[i], law.damping(p)[i], block.parameter_sharpness
            )
        return equations.constraint_contact_softplus(
            lam[t][i], phi[t][i], k[i], block.parameter_sharpness
        )

    def push(t: int, name: str) -> Any:
        i = place[name]
        return pushes[t][i] if i in pushes[t] else k[i] * phi[t][i]

    add_contact_law(block, (block.set_steps, block.set_contacts), contact, b, softplus, push)
    return lam


def keep_within_depth(block: Any, scene: Scene, share: float) -> None:
    """Add constraint_depth (node, contact): no contact is deeper than this share of its depth.

    Raises ModelError for a share that is not in (0, 1].
    """
    if not 0.0 < share <= 1.0:
        raise ModelError(f"share of the depth is {share!r}, but must be above 0 and at most 1.")
    if not scene.nc:
        return
    law = SceneExpressions(derive(scene))
    p = list(block.parameter_scene.values()) if scene.parameters else []
    q = rows_by_time(block.variable_q, scene.task.steps + 1)
    phi = [law.penetration(q_now, p) for q_now in q]
    most = {
        name: share * depth for name, depth in zip(block.set_contacts, scene.depths, strict=True)
    }
    place = {name: index for index, name in enumerate(block.set_contacts)}
    # The first node is the given start.
    nodes = pyo.RangeSet(1, scene.task.steps)
    block.constraint_depth = pyo.Constraint(
        nodes, block.set_contacts, rule=lambda b, t, name: phi[t][place[name]] <= most[name]
    )


def release_goal(model: Any) -> list[tuple[Any, Any, str]]:
    """Remove the goal's constraints.

    Return (last state, goal, coordinate) of each given component.
    """
    last = max(model.set_nodes)
    components = []
    for part, variable in (("position", model.variable_q), ("velocity", model.variable_v)):
        constraint, goal = (
            model.component(f"constraint_goal_{part}"),
            model.component(f"parameter_goal_{part}"),
        )
        if constraint is not None:
            constraint.deactivate()
            components += [(variable[last, name], goal[name], name) for name in goal]
    return components


def load_plan(block: Any, plan: Trajectory) -> None:
    """Write a plan into the variables of a block as first guess.

    Its ends may differ from the task's.

    Raises
    ------
    TrajectoryError
        unless the plan has the block's grid and numbers of columns
    ModelError
        if the block does not come from `build_block`
    """
    steps, h = _steps_of(block), pyo.value(block.parameter_step)
    if not isinstance(plan, Trajectory):
        raise TrajectoryError(
            f"warm start: a {type(plan).__name__} is no plan; give a Trajectory, as `solution.trajectory` or `read_plan` gives one."
        )
    check_grid(plan, steps, h, f"model {block.name}")
    friction = block.component("variable_friction")
    nf = 0 if friction is None else len(friction) // steps
    nc = plan.lam.shape[1] - nf
    arrays = {
        "q": plan.q,
        "v": plan.v,
        "u": plan.u,
        "lam": plan.lam[:, : max(nc, 0)],
        "friction": plan.lam[:, max(nc, 0) :],
    }
    for name, values in arrays.items():
        variable = block.component(f"variable_{name}")
        columns = 0 if variable is None else len(variable) // len(values)
        if name == "lam" and is_collocated(block):
            columns //= len(block.set_stages)
        if values.shape[1] != columns:
            raise TrajectoryError(
                f"warm start: {name} has {values.shape[1]} columns, but model {block.name} has {columns}."
            )
        if variable is not None and not (name == "lam" and is_collocated(block)):
            write_values(variable, values)
    if is_collocated(block):
        settle_stages(block)
    settle_separation(block)


def _steps_of(block: Any) -> int:
    steps = getattr(block, "set_steps", None)
    if steps is None:
        raise ModelError(
            f"model {getattr(block, 'name', repr(block))} holds no plan: it must come from build_model or build_block."
        )
    return len(steps)


def load_first_guess(block: Any) -> None:
    """Write the paper's first guess, with inputs clipped to their bounds."""
    for name, end in (("variable_q", "position"), ("variable_v", "velocity")):
        start = [pyo.value(value) for value in block.component(f"parameter_start_{end}").values()]
        write_values(block.component(name), np.tile(start, (len(block.set_nodes), 1)))
    if block.component("variable_u") is not None:
        for data in block.variable_u.values():
            data.set_value(
                min(
                    max(0.0, -np.inf if data.lb is None else data.lb),
                    np.inf if data.ub is None else data.ub,
                ),
                skip_validation=True,
            )
    for name in ("variable_lam", "variable_friction"):
        if block.component(name) is not None:
            write_values(block.component(name), np.zeros((len(block.component(name)), 1)))
    if is_collocated(block):
        settle_stages(block)
    settle_separation(block)


def read_plan(block: Any) -> Trajectory:
    """Return the plan in the block's variables.

    Raises TrajectoryError for a value that is not finite, ModelError for a block without a plan.
    """
    steps = _steps_of(block)
    arrays, scheme = {}, Scheme.SEMI_IMPLICIT_EULER
    for name, rows in (
        ("q", steps + 1),
        ("v", steps + 1),
        ("u", steps),
        ("lam", steps),
        ("friction", steps),
    ):
        variable = block.component(f"variable_{name}")
        arrays[name] = (
            np.zeros((rows, 0)) if variable is None else read_values(variable).reshape(rows, -1)
        )
    if is_collocated(block):
        arrays["lam"], scheme = forces_at_nodes(block), block.scheme
    arrays["lam"] = np.hstack([arrays["lam"], arrays.pop("friction")])
    return Trajectory(
        t=uniform_grid(pyo.value(block.parameter_step), steps), scheme=scheme, **arrays
    )


def read_values(variable: Any) -> np.ndarray:
    """Return the values (n,) of an indexed variable, NaN if missing [variable unit]."""
    return np.array(
        [np.nan if data.value is None else data.value for data in variable.values()], dtype=float
    )


def write_values(variable: Any, values: np.ndarray) -> None:
    """Set an indexed variable from values (n,) in its own order [variable unit].

    Values outside the bounds are allowed. Raises ValueError for another number of values.
    """
    for data, value in zip(
        variable.values(), np.asarray(values, dtype=float).ravel().tolist(), strict=True
    ):
        data.set_value(value, skip_validation=True)
