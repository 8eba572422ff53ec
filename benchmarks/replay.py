"""CPU seconds of the replay against its true error: Co-Simulation by step and integrator, Model Exchange by tolerance, per scene.

Scenes: names, or files; without any, three_cart and the two closed-form scenes. `three_cart` is
    driven by the best exact plan this
repository finds (pipeline mpcc, cold). True error: largest position difference at the plan's nodes,
    to a Model Exchange run at rtol 1e-14 - for
the closed-form scenes also the relative errors of contact time, depth and restitution against their
    closed forms.
Against FMPy: the same FMU, plan and step (or rtol) by the loops in C and by FMPy's `simulate_fmu`,
    in turn; medians, on stdout.
The default replay (two tolerances, three steps) is timed as `python -m validate all` runs it, in
    this process, and in a child as `replay` does.
CPU time: the smallest of some repetitions, imports and compilation before it. docs/replay.md tells
    what was found.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from benchmarks.measure import least, timed
from benchmarks.options import out_option
from benchmarks.results import store
from models.catalog import load_scene
from models.fmu import build_fmu, variable_names
from models.fmu.variables import INTEGRATORS
from models.scene import Scene
from models.schemes import Scheme
from models.trajectory import Trajectory, uniform_grid
from validate.execution.isolated import Limits
from validate.fmi.description import Package, read_package, unpacked
from validate.judge.replay import Replay
from validate.judge.replay.everyday import simulate
from validate.judge.replay.reference import ExchangeModel, integrate
from validate.judge.replay.result import Run
from validate.judge.replay.run import replay
from validate.judge.replay.subject import find_variables
from validate.judge.replay.wiring import HeldInputs, Variables

_DEFAULT = ("three_cart", "bouncing_mass", "two_body_collision")
_TRUTH = 1e-14
_TOLERANCES = [10.0**-n for n in range(4, 14)]
_STEPS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
_REPETITIONS = 3
# Rounds of the comparison with FMPy; internal steps a step of the plan, and the tolerance of Model
# Exchange, in it.
_ROUNDS = 7
_FINENESS = 50
_RTOL = 1e-8
# The FMU's variable that chooses among them.
INTEGRATOR = "integrator"


def _plan(scene: Scene) -> Trajectory:
    """The best exact plan of three_cart; of other scenes, no inputs from the task's start."""
    if scene.name == "three_cart":
        from formulations.pipelines import load_method

        method = load_method("mpcc")
        with method.open(scene, {}) as session:
            solution = session.solve(eps=None, warm_start=None, time_limit=600.0)
        if solution.trajectory is None:
            raise click.ClickException(f"no plan: {solution.outcome}")
        click.echo(f"{scene.name}: plan of cost {solution.cost:.7g}", err=True)
        return solution.trajectory
    nodes = scene.task.steps + 1
    state = np.tile(np.array(scene.task.start), (nodes, 1))
    inputs, forces = np.zeros((nodes - 1, scene.nu)), np.zeros((nodes - 1, scene.nl))
    t, q, v = uniform_grid(scene.task.step, nodes - 1), state[:, : scene.nq], state[:, scene.nq :]
    return Trajectory(t=t, q=q, v=v, u=inputs, lam=forces, scheme=Scheme.SEMI_IMPLICIT_EULER)


def _positions(run: Run, nq: int) -> np.ndarray:
    return np.array(run.outputs)[run.knots, :nq]


def _reference(package: Package, variables: Variables, plan: Trajectory, rtol: float) -> Run:
    model = ExchangeModel(package, variables)
    try:
        return integrate(model, plan.start, HeldInputs(plan), rtol, 10_000)
    finally:
        model.close()


def _sweep(scene: Scene, plan: Trajectory) -> list[dict[str, Any]]:
    rows = []
    with unpacked(read_package(build_fmu(scene))) as package:
        variables = find_variables(package, scene)
        truth = _positions(_reference(package, variables, plan, _TRUTH), scene.nq)

        def row(kind: str, setting: float, run: Run, seconds: float) -> None:
            q = _positions(run, scene.nq)
            error = float(np.abs(q - truth).max()) if q.shape == truth.shape else None
            rows.append(
                {
                    "kind": kind,
                    "setting": setting,
                    "cpu_s": seconds,
                    "error_m": error,
                    "outcome": run.outcome.name.lower(),
                }
            )

        for rtol in _TOLERANCES:
            run, seconds = least(
                lambda rtol=rtol: _reference(package, variables, plan, rtol), _REPETITIONS
            )
            row("Model Exchange, rtol", rtol, run, seconds)
        choice = next(
            variable
            for variable in package.description.modelVariables
            if variable.name == INTEGRATOR
        )
        for order in range(int(choice.min), int(choice.max) + 1):
            chosen = replace(variables, choices=((int(choice.valueReference), order),))
            for fineness in _STEPS:
                run, seconds = least(
                    lambda chosen=chosen, fineness=fineness: simulate(
                        package, chosen, plan.start, HeldInputs(plan), fineness
                    ),
                    _REPETITIONS,
                )
                row(f"Co-Simulation, {INTEGRATORS[order - 1][0]}", fineness, run, seconds)
    return rows


def _by_fmpy(
    folder: str, description: Any, scene: Scene, plan: Trajectory, interface: str
) -> np.ndarray:
    """(nq,) positions at the end by `fmpy.simulate_fmu`."""
    import fmpy

    names, step = variable_names(scene), scene.task.step
    # Two rows a node: FMPy draws lines between rows, and takes two at one time for a jump.
    inputs = np.zeros(2 * plan.steps, dtype=[("time", float), *((name, float) for name in names.u)])
    inputs["time"] = np.column_stack([plan.t[:-1], plan.t[1:]]).ravel()
    for column, name in enumerate(names.u):
        inputs[name] = np.repeat(plan.u[:, column], 2)
    start = dict(zip([*names.q, *names.v], plan.start.tolist(), strict=True))
    result = fmpy.simulate_fmu(
        folder,
        fmi_type=interface,
        start_values=start
        | ({names.internal_step: step / _FINENESS} if interface == "CoSimulation" else {}),
        input=inputs,
        output=list(names.q),
        output_interval=step,
        stop_time=float(plan.t[-1]),
        relative_tolerance=_RTOL,
        model_description=description,
    )
    return np.array([result[name][-1] for name in names.q])


def _against_fmpy(scene: Scene, plan: Trajectory) -> dict[str, dict[str, float]]:
    """Median CPU seconds by method, and the largest difference of the position at the end from the reference at rtol 1e-14."""
    held, rounds = HeldInputs(plan), range(_ROUNDS)
    with unpacked(read_package(build_fmu(scene))) as package:
        variables, folder, description = (
            find_variables(package, scene),
            str(package.folder),
            package.description,
        )
        truth = _positions(_reference(package, variables, plan, _TRUTH), scene.nq)[-1]

        methods: dict[str, Callable[[], np.ndarray]] = {
            "Co-Simulation, loop in C": lambda: _positions(
                simulate(package, variables, plan.start, held, _FINENESS), scene.nq
            )[-1],
            "Co-Simulation, simulate_fmu": lambda: _by_fmpy(
                folder, description, scene, plan, "CoSimulation"
            ),
            "Model Exchange, loop in C": lambda: _positions(
                _reference(package, variables, plan, _RTOL), scene.nq
            )[-1],
            "Model Exchange, simulate_fmu": lambda: _by_fmpy(
                folder, description, scene, plan, "ModelExchange"
            ),
        }
        seconds: dict[str, list[float]] = {name: [] for name in methods}
        errors = {}
        for number in (-1, *rounds):  # the first warms up
            for name, method in methods.items():
                end, spent = timed(method)
                errors[name] = float(np.abs(end - truth).max())
                if number >= 0:
                    seconds[name].append(spent)
    return {
        name: {"cpu_s": float(np.median(values)), "end_error_m": errors[name]}
        for name, values in seconds.items()
    }


def _closed_forms(scene: Scene, result: Replay) -> dict[str, float]:
    """Relative errors against the scene's own answers; empty for a scene without."""
    answers = {answer.quantity: answer.value for answer in scene.answers}
    if "contact time [s]" not in answers:
        return {}
    closing, opening = result.events[:2]
    at = [int(np.flatnonzero(result.t == event.time)[0]) for event in (closing, opening)]
    found = {"contact time": abs((opening.time - closing.time) / answers["contact time [s]"] - 1)}
    relative = result.v[:, 0] if scene.nq == 1 else result.v[:, 0] - result.v[:, 1]
    found["restitution"] = abs(-relative[at[1]] / relative[at[0]] - 1)
    depth = next(value for name, value in answers.items() if name.startswith("largest"))
    found["depth"] = abs(_deepest(result) / depth - 1)
    return {name: float(value) for name, value in found.items()}


def _deepest(result: Replay) -> float:
    """Largest penetration, between the recorded points: the quintic through positions, velocities and forces cannot be off by 1e-9 there."""
    gap = result.gap[:, 0]
    i = int(gap.argmin())
    near = slice(i - 4, i + 5)
    t = result.t[near] - result.t[i]
    polynomial = np.polynomial.Polynomial.fit(t, -gap[near], 8)
    turns = polynomial.deriv().roots()
    inside = [turn.real for turn in turns if abs(turn.imag) < 1e-9 and t[0] < turn.real < t[-1]]
    return max(float(polynomial(turn)) for turn in inside)


@click.command()
@click.argument("scenes", nargs=-1)
@click.option(
    "--no-sweep",
    is_flag=True,
    help="Only the default replay, and the comparison with FMPy; nothing is written.",
)
@out_option
def command(scenes: tuple[str, ...], no_sweep: bool, out: Path) -> int:
    """CPU seconds of the replay against its true error, of SCENES (or three_cart and two with a closed form), and beside FMPy's own simulation."""
    told = []
    for scene in list(map(load_scene, scenes or _DEFAULT)):
        plan = _plan(scene)
        fmu = build_fmu(scene)
        result, here = least(
            lambda scene=scene, fmu=fmu, plan=plan: replay(scene, fmu, plan), _REPETITIONS
        )
        estimate = result.error.estimate
        figures: dict[str, Any] = {
            "name": scene.name,
            "default_cpu_s": here,
            "reference_cpu_s": result.seconds_reference,
            "everyday_cpu_s": result.seconds_everyday,
            "parent_cpu_s_of_a_child": timed(
                lambda scene=scene, fmu=fmu, plan=plan: replay(scene, fmu, plan, limits=Limits())
            )[1],
            "self_error_m": None if estimate is None else estimate.position,
            "closed_form_relative_errors": _closed_forms(scene, result),
            "sweep": [] if no_sweep else _sweep(scene, plan),
        }
        told.append(figures)
        click.echo(
            f"{scene.name}: default replay {here:.3f} CPU s (reference {result.seconds_reference:.3f}, everyday {result.seconds_everyday:.3f}), "
            f"self-error {figures['self_error_m']:.2g} m, closed forms {figures['closed_form_relative_errors']}"
        )
        for method, item in _against_fmpy(scene, plan).items():
            click.echo(f"  {method:38}{'':>10} {item['cpu_s']:9.4f} {item['end_error_m']:10.2e}")
        click.echo(f"  {'':38}{'setting':>10} {'CPU s':>9} {'error m':>10}")
        for item in figures["sweep"]:
            error = "-" if item["error_m"] is None else f"{item['error_m']:.2e}"
            click.echo(
                f"  {item['kind']:38}{item['setting']:>10.3g} {item['cpu_s']:9.4f} {error:>10}"
            )
    if not no_sweep:
        store(out, "replay", {"kind": "replay_speed", "scenes": told})
    return 0
