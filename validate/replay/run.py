"""replay(): the reference at two tolerances, the everyday replay at two steps, and what their differences say."""

from __future__ import annotations

import time as clock
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from models.scene import Scene
from models.trajectory import Trajectory
from validate.replay.error_estimate import difference, estimate
from validate.replay.everyday import everyday_refusal, require_some_method, simulate
from validate.replay.exchange import ExchangeModel
from validate.replay.inputs import HeldInputs
from validate.replay.outputs import Outputs
from validate.replay.package import Package, Variables, find_variables, open_package
from validate.replay.reference import Run, integrate
from validate.replay.result import Event, Replay, ReplayError, ReplayOutcome

# Relative tolerances of the reference. On three_cart the looser is 1.4e-9 m from the truth, the tighter 1e-11 m, at 1.1 times the time.
LOOSE, TIGHT = 1e-11, 1e-13
# Internal steps a plan step of the everyday replay, and halved.
COARSE, FINE = 100, 200
# Contact events before a replay is stopped as chattering; the plans of the scenes have 2 to 40.
EVENT_BUDGET = 10_000


def replay(
    scene: Scene,
    fmu: Path,
    trajectory: Trajectory,
    names: Mapping[str, str] | None = None,
    *,
    tolerances: tuple[float, float] = (LOOSE, TIGHT),
    fineness: tuple[int, int] = (COARSE, FINE),
    event_budget: int = EVENT_BUDGET,
) -> Replay:
    """Apply the plan's inputs from its start to the FMU of the scene, or to anybody's (`names`: scene name -> FMU name).

    Raises FmuError or TrajectoryError if FMU, map and plan do not fit the scene; how the simulation went is `Replay.outcome`.
    """
    trajectory.check_fits(scene)
    inputs = HeldInputs(trajectory)
    with open_package(fmu) as package:
        variables = find_variables(package, scene, names)
        refusal = everyday_refusal(package, variables, inputs)
        require_some_method(package, refusal)
        started = clock.process_time()
        reference = []
        if package.exchange is not None:
            reference = [_reference(package, variables, trajectory.start, inputs, rtol, event_budget) for rtol in tolerances]
        reference_seconds = clock.process_time() - started
        started = clock.process_time()
        everyday = []
        if refusal is None:
            everyday = [simulate(package, variables, trajectory.start, inputs, count) for count in fineness]
        everyday_seconds = clock.process_time() - started
    judged = (reference or everyday)[-1]
    nodes = [Outputs(scene, variables, run, run.knots) if run.outcome is ReplayOutcome.OK else None for run in (*reference, *everyday)]
    loose, tight = nodes[:2] if reference else (None, None)
    coarse, fine = nodes[-2:] if everyday else (None, None)
    error = estimate(
        tolerance=difference(loose, tight), step=difference(coarse, fine), everyday=difference(fine, tight), has_reference=bool(reference)
    )
    if refusal is None and reference:
        refusal = next((run.message for run in everyday if run.outcome is not ReplayOutcome.OK), None)
    return _assemble(
        scene, variables, judged, error=error, refusal=refusal, has_reference=bool(reference), event_budget=event_budget, fmu=package.digest,
        seconds=(reference_seconds, everyday_seconds),
    )  # fmt: skip


def _reference(package: Package, variables: Variables, start: np.ndarray, inputs: HeldInputs, rtol: float, event_budget: int) -> Run:
    model = ExchangeModel(package, variables)
    try:
        return integrate(model, start, inputs, rtol, event_budget)
    finally:
        model.close()


def _assemble(
    scene: Scene,
    variables: Variables,
    run: Run,
    *,
    error: ReplayError,
    refusal: str | None,
    has_reference: bool,
    event_budget: int,
    fmu: str,
    seconds: tuple[float, float],
) -> Replay:
    out = Outputs(scene, variables, run)
    names = [contact.name for contact in scene.contacts]
    notes = [run.message] if run.message else []
    if refusal is not None:
        notes.append(f"No everyday replay: {refusal.rstrip('.')}.")
    if not has_reference:
        notes.append("No reference replay: the FMU offers no Model Exchange.")
    indicators = {index for _, index, _ in run.events}
    named = all(index < len(names) for index in indicators)
    return Replay(
        scene=scene.name,
        outcome=run.outcome,
        message=" ".join(notes),
        method="reference" if has_reference else "everyday",
        t=np.array(run.t),
        q=out.q,
        v=out.v,
        lam=out.lam,
        gap=out.gap,
        knots=np.array(run.knots, dtype=np.int64),
        kinetic_energy=out.kinetic,
        potential_energy=out.potential,
        contact_energy=out.contact,
        input_work=out.work("input_power"),
        dissipated_work=out.work("dissipated_power"),
        contact_impulse=out.contact_impulse,
        events=tuple(
            Event(time=time, contact=names[index] if named else f"indicator_{index}", closes=closes) for time, index, closes in run.events
        ),
        event_budget=event_budget,
        error=error,
        seconds_reference=seconds[0],
        seconds_everyday=seconds[1],
        fmu=fmu,
    )
