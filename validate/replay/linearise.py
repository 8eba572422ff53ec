"""An FMU linearised along a plan by its own directional derivatives: what a tracking feedback needs of an FMU without a scene.

    feedback, growth = design_foreign(model, package, variables, plan, units, start, limits)

At each node the FMU's states are set to the plan's and its events are settled, so that a contact that the plan closes is closed. One step is
exp(h (F_t + F_{t+1})/2) with F the Jacobian of the rates by states and held inputs: of second order in h, and half a contact where it closes in between.
"""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from models.trajectory import Trajectory
from validate.isolation import Limits, run_isolated
from validate.replay.exchange import ExchangeModel
from validate.replay.feedback import Feedback
from validate.replay.growth import largest_growth, nominals
from validate.replay.package import Package, read_package, unpacked
from validate.replay.result import Growth
from validate.replay.subject import ForeignModel
from validate.replay.tracking import TrackingError, feedback_from
from validate.replay.wiring import Variables


def tracking_refusal(package: Package, variables: Variables) -> str | None:
    """None, or why no feedback can be designed for this FMU."""
    exchange = package.exchange
    if exchange is None:
        return "it offers no Model Exchange, whose states feedback needs"
    if not _provides_derivatives(package):
        return "it provides no directional derivatives"
    if not variables.u:
        return "it has no inputs"
    states = {int(item.valueReference): item.name for item in _states(package)}
    mapped = (*variables.q, *variables.v)
    unmapped = [name for reference, name in states.items() if reference not in mapped]
    if unmapped:
        return f"its state {unmapped[0]} is none of the positions and velocities of the map"
    if len(states) != len(mapped) or len(set(mapped)) != len(mapped):
        return "positions and velocities of the map are not its states, one for one"
    return None


def design_foreign(
    model: ForeignModel,
    package: Package,
    variables: Variables,
    plan: Trajectory,
    units: tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]],
    start: np.ndarray,
    limits: Limits | None,
) -> tuple[Feedback, Growth | None]:
    """The feedback around the plan, in its units, and the growth along it. units: scale and offset of the state (plan's = scale * FMU's + offset), and
    of the inputs (FMU's = scale * plan's + offset). Raises TrackingError."""
    if "q" in plan.missing:
        raise TrackingError("plan: it does not say its positions, so there is nothing to track.")
    (a, b), (c, d) = units
    A, B = linearised(package, variables, plan.with_inputs_in(c, d), start, (np.hstack([plan.q, plan.v]) - b) / a, limits)
    A, B = A * (a[:, None] / a[None, :]), B * (a[:, None] * c[None, :])
    return feedback_from(model, plan, A, B), largest_growth(A, plan.t, nominals(model))


def linearised(
    package: Package, variables: Variables, plan: Trajectory, start: np.ndarray, states: np.ndarray, limits: Limits | None
) -> tuple[np.ndarray, np.ndarray]:
    """A (steps, nx, nx), B (steps, nx, nu) in the FMU's units, in the order of variables.q + variables.v; plan: its inputs; start: of Variables.start;
    states (nodes, nx): the plan's. Raises TrackingError."""
    refusal = tracking_refusal(package, variables)
    if refusal is not None:
        raise TrackingError(f"FMU {package.path}: the plan cannot be tracked, because {refusal}.")
    request = {"path": str(package.path.resolve()), "variables": variables.to_json()}
    given = {"t": plan.t, "u": plan.u, "start": start, "states": states}
    if limits is None:
        _, found = jacobians(request, given)
    else:
        done = run_isolated("validate.replay.linearise:jacobians", request, given, limits=limits, what=f"FMU {package.path}")
        if not done.ok:
            raise TrackingError(done.sentence)
        found = done.arrays
    nx, h = states.shape[1], np.diff(plan.t)
    pair = (found["first"] + found["last"]) / 2.0  # (steps, nx, nx + nu): at both ends of each step, with the input of the step
    if not np.isfinite(pair).all():
        raise TrackingError(f"FMU {package.path}: the plan cannot be tracked, because a directional derivative is not a finite number.")
    square = np.zeros((len(h), pair.shape[2], pair.shape[2]))
    square[:, :nx] = h[:, None, None] * pair
    from scipy.linalg import expm

    whole = expm(square)
    return whole[:, :nx, :nx], whole[:, :nx, nx:]


def jacobians(request: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> tuple[None, dict[str, np.ndarray]]:
    """first, last (steps, nx, nx + nu): derivatives of the rates at both ends of each step. Runs in this process or in a child."""
    variables = Variables.from_json(request["variables"])
    t, u, states = arrays["t"], arrays["u"], arrays["states"]
    found = {name: np.empty((len(u), states.shape[1], states.shape[1] + u.shape[1])) for name in ("first", "last")}
    with unpacked(read_package(Path(request["path"]))) as package:
        order = [int(item.valueReference) for item in _states(package)]
        places = [order.index(reference) for reference in (*variables.q, *variables.v)]
        rates = [int(item.variable.valueReference) for item in package.description.derivatives]
        model = ExchangeModel(package, variables)
        try:
            model.start(float(t[0]), arrays["start"], u[0])
            knowns = [*(order[place] for place in places), *variables.u]
            unknowns = [rates[place] for place in places]
            for step in range(len(u)):
                for name, node in (("first", step), ("last", step + 1)):
                    x = np.empty(len(order))
                    x[places] = states[node]
                    model.event(float(t[node]), x, u[step])
                    found[name][step] = model.jacobian(float(t[node]), x, unknowns, knowns)
        finally:
            model.close()
    return None, found


def _provides_derivatives(package: Package) -> bool:
    """FMPy reads this of FMI 2.0 alone; the text was examined when the FMU was let in."""
    if not package.is_three:
        return bool(package.exchange is not None and package.exchange.providesDirectionalDerivative)
    with zipfile.ZipFile(package.path) as archive:
        interface = ElementTree.fromstring(archive.read("modelDescription.xml")).find("ModelExchange")
    return interface is not None and interface.get("providesDirectionalDerivatives") in ("true", "1")


def _states(package: Package) -> list[Any]:
    return [item.variable.derivative for item in package.description.derivatives]
