"""`replay`: score anybody's plan, on a scene or on anybody's FMU."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from validate.cli.completion import scenes
from validate.cli.doubts import tell_doubts
from validate.cli.numbers import FiniteRange
from validate.cli.table import one_line, short, table, use_colour

if TYPE_CHECKING:
    from models.trajectory import Trajectory
    from validate.replay.result import Replay
    from validate.replay.subject import Subject
    from validate.score import Score


@click.command(
    epilog="""\b
Examples:
  python -m validate replay plan.csv --scene three_cart
  python -m validate replay plan.csv --scene cart_pole_walls --track
  python -m validate replay plan.csv --fmu robot.fmu --map robot.toml --json

\b
Exit codes: 0 the plan holds; 1 it does not, or that is not resolved; 2 a mistake
in plan, map or FMU; 3 this machine cannot.
"""
)
@click.argument("plan", type=click.Path(path_type=Path), metavar="PLAN.csv")
@click.option("--scene", metavar="NAME|FILE.py", shell_complete=scenes, help="The scene the plan is for.")
@click.option("--fmu", type=click.Path(path_type=Path), metavar="FILE.fmu", help="Somebody's FMU (2.0 or 3.0) instead of a scene's own.")
@click.option(
    "--map",
    "map_path",
    type=click.Path(path_type=Path),
    metavar="MAP.toml",
    help="What of the plan is what of the FMU; equal names without it.",
)
@click.option("--hold", type=click.Choice(["zero", "linear"]), help="Inputs within a step: constant (default), or a line to the next row.")
@click.option("--time-limit", type=FiniteRange(min=0.1), default=300.0, show_default=True, help="Seconds after which the FMU is ended.")
@click.option(
    "--memory-limit", type=FiniteRange(min=0.5), default=4.0, show_default=True, help="GiB of address space of the FMU's process."
)
@click.option(
    "--track",
    is_flag=True,
    help="Replay with tracking feedback too, and show both; without it that is done where an error grows too much for the open loop to judge.",
)
@click.option("--json", "as_json", is_flag=True, help="The score as JSON on stdout.")
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), metavar="DIR", help="Write score.json and replay.nc there.")
def command(
    plan: Path,
    scene: str | None,
    fmu: Path | None,
    map_path: Path | None,
    hold: str | None,
    time_limit: float,
    memory_limit: float,
    track: bool,
    as_json: bool,
    out: Path | None,
) -> int:
    """Replay a plan through an FMU, in a process of its own, and print its score.

    PLAN.csv has one row a node: t, positions and inputs by name, and velocities and contact forces if they are
    known (figures that need them are missing otherwise); the last row has no inputs. docs/replay.md describes plan and map.
    Exit code 0 if the plan holds, 1 if it does not or if that is not resolved.
    """
    from validate.isolation import Limits

    if (scene is None) == (fmu is None):
        raise click.UsageError("give either --scene or --fmu.")
    if map_path is not None and fmu is None:
        raise click.UsageError("--map belongs to --fmu; a scene knows its own names.")
    limits = Limits(seconds=time_limit, memory=int(memory_limit * 1024**3))
    lacks: dict[str, str] = {}
    if fmu is not None:
        subject, trajectory, replay, lacks = _of_fmu(fmu, plan, map_path, hold, limits, track)
    else:
        subject, trajectory, replay = _of_scene(str(scene), plan, hold, limits, track)
    from validate.score import score

    result = score(subject, trajectory, replay)
    told = _told(subject, replay, result, lacks)
    if out is not None:
        _write(out, told, replay, subject, trajectory)
    if as_json:
        click.echo(json.dumps(told, indent=1))
    else:
        _print(result, replay, lacks)
    return 0 if result.verdict.value == "holds" else 1


def _of_scene(scene: str, plan: Path, hold: str | None, limits: Any, track: bool) -> tuple[Subject, Trajectory, Replay]:
    from models.catalog import load_scene
    from models.fmu import build_fmu
    from models.trajectory import Hold, read_csv
    from validate.replay import replay

    loaded = load_scene(scene)
    trajectory = read_csv(plan, loaded, Hold.LINEAR if hold == "linear" else Hold.ZERO_ORDER)
    longest = float(max(after - before for before, after in pairwise(trajectory.t)))
    same = math.isclose(longest, loaded.task.step, rel_tol=1e-9)
    tell_doubts([loaded if same else loaded.with_task(step=longest)], steps=True)
    replayed = replay(loaded, build_fmu(loaded), trajectory, limits=limits, track=track or None)
    other = trajectory.other_duration(loaded)
    if other:
        click.echo(one_line(f"warning: plan {plan}: {other}"), err=True)
    return loaded, trajectory, replayed


def _of_fmu(
    fmu: Path, plan: Path, map_path: Path | None, hold: str | None, limits: Any, track: bool
) -> tuple[Subject, Trajectory, Replay, dict[str, str]]:
    from models.plan_table import PlanTable
    from validate.replay.equal_names import hint
    from validate.replay.map_schema import MapError, read_map
    from validate.replay.mapping import wire
    from validate.replay.package import read_package
    from validate.replay.run import replay_foreign
    from validate.score import figure_names

    given = read_map(map_path) if map_path is not None else None
    for name in given.limits if given is not None else ():
        if name not in figure_names():
            raise MapError(f"map {map_path}: limits.{name}: there is no figure of that name{hint(name, figure_names())}.")
    package = read_package(fmu)
    where = f"map {map_path}" if map_path is not None else f"FMU {fmu}"
    foreign, trajectory = wire(package, PlanTable(plan), given, hold, where)
    return foreign.model, trajectory, replay_foreign(foreign, package, trajectory, limits=limits, track=track), dict(foreign.model.lacks)


def _told(subject: Subject, replay: Replay, result: Score, lacks: dict[str, str]) -> dict[str, Any]:
    """What is printed as JSON and written to score.json."""
    return {
        "subject": subject.name,
        "verdict": result.verdict.value,
        "why": result.why,
        "judged": result.judged,
        "figures": [asdict(figure) for figure in result.figures],
        "growth": None if replay.growth is None else {**asdict(replay.growth), "rate": replay.growth.rate},
        "replay": _facts(replay),
        "tracked": None if replay.tracked is None else _facts(replay.tracked),
        "not_shown": lacks,
    }


def _facts(replay: Replay) -> dict[str, Any]:
    return {
        "outcome": replay.outcome.name.lower(),
        "message": replay.message,
        "method": replay.method,
        "events": len(replay.events),
        "error": replay.error.as_json(),
        "fmu_sha256": replay.fmu,
        "seconds": {"reference": replay.seconds_reference, "everyday": replay.seconds_everyday},
        **({"effort": asdict(replay.effort)} if replay.effort is not None else {}),
    }


def _write(out: Path, told: dict[str, Any], replay: Replay, subject: Subject, plan: Trajectory) -> None:
    from models.scene import Scene
    from models.trajectory_netcdf import write_netcdf
    from validate.disk import make_folder, write_durably
    from validate.replay.netcdf import write_replay

    make_folder(out)
    write_durably(out / "score.json", json.dumps(told, indent=1))
    if len(replay.t):
        write_replay(out / "replay.nc", replay, subject)
    if replay.tracked is not None and len(replay.tracked.t):
        write_replay(out / "tracked.nc", replay.tracked, subject)
        if isinstance(subject, Scene) and replay.tracked.feedback is not None:
            write_netcdf(out / "plan.nc", plan, subject, replay.tracked.feedback.gains)


def _print(result: Score, replay: Replay, lacks: dict[str, str]) -> None:
    from validate.score.verdict import TWINS

    names, beside = ["value"], {}
    if replay.tracked is not None:
        names, beside = ["open loop", "tracked"], {name: result.figure(twin) for name, twin in TWINS.items()}
    rows = []
    for figure in result.figures:
        if figure.name in TWINS.values():
            continue  # beside its twin
        twin = beside.get(figure.name)
        judged = twin if twin is not None and twin.is_judged else figure
        values = [short(figure.value, ".4e"), short(twin.value, ".4e") if twin else ""][: len(names)]
        if figure.name.startswith("feedback"):
            values.reverse()  # there is none in the open loop
        meaning = one_line(judged.meaning if judged.value is not None else f"not measured: {judged.reason}")
        rows.append([figure.name, *values, figure.unit, short(judged.limit, ".3g"), _judgement(judged), meaning])
    click.echo(table(["figure", *names, "unit", "limit", "", "meaning"], rows, (*names, "limit")), color=use_colour())
    click.echo()
    click.echo(one_line(_own_error("The replay", replay)))
    if replay.tracked is not None:
        click.echo(one_line(_own_error("The tracked replay", replay.tracked)))
    for text in lacks.values():
        click.echo(one_line(f"Not shown: {text}."))
    click.echo(one_line(f"{result.verdict.value}: {result.why}"), color=use_colour())


def _own_error(what: str, replay: Replay) -> str:
    estimate = replay.error.estimate
    ratio = replay.error.step_ratio
    shrinks = "" if ratio is None else f"; half the step shrinks the everyday replay's error {ratio:.3g} times"
    own = "has no estimate" if estimate is None else f"is {_size(estimate.position)} in any position, {_size(estimate.state)} in the state"
    source = replay.error.step_source
    told = "" if source == "none" else f"; error of the step by {source}"
    return f"{what}'s own error {own} ({replay.method}; {len(replay.events)} events{shrinks}{told}). {replay.message}".rstrip()


def _size(value: float) -> str:
    return "unknown" if math.isinf(value) else f"{value:.2g}"


def _judgement(figure: Any) -> str:
    if figure.value is None:
        return "missing"
    if figure.limit is None:
        return ""
    return "not resolved" if figure.ok is None else "ok" if figure.ok else "too large"
