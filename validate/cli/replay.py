"""`replay`: score any plan, on a scene or on an external FMU."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Sequence
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from models.catalog import load_scene
from reports.judged import cause_of_stage
from validate.cli.additions import additions
from validate.cli.options import A_FILE, FiniteRange, options, scenes, write, written_to
from validate.cli.table import say, warn, wide_option
from validate.cli.verdict import print_score, print_verdict
from validate.processes.disk import make_folder, write_durably
from validate.processes.isolated import Limits

if TYPE_CHECKING:
    from validate.judge.judgement import Judgement
    from validate.judge.replay.result import Replay
    from validate.judge.score import Verdict


# Multiple of the task's duration. A longer plan may be in another unit of time, and its replay
# takes minutes.
_LONG = 10.0


# Options that name an external FMU and its execution.
FMU_OPTIONS = options(
    click.option(
        "--fmu",
        type=A_FILE,
        metavar="FILE.fmu",
        help="Use this external FMU (2.0 or 3.0) instead of a scene.",
    ),
    click.option(
        "--map",
        "map_path",
        type=A_FILE,
        metavar="MAP.toml",
        help="Map columns of the plan to variables of the FMU.  [default: equal names]",
    ),
    click.option(
        "--hold",
        type=click.Choice(["zero", "linear"]),
        help="Hold inputs constant between two rows, or interpolate linearly. `# hold: linear` in the CSV does the same.  [default: zero]",
    ),
    click.option(
        "--time-limit",
        type=FiniteRange(min=0.1),
        default=300.0,
        show_default=True,
        metavar="SECONDS",
        help="Limit the wall time of the FMU.",
    ),
    click.option(
        "--memory-limit",
        type=FiniteRange(min=0.5),
        default=4.0,
        show_default=True,
        metavar="GIB",
        help="Limit the address space of the FMU's process.",
    ),
    click.option(
        "--own-step",
        is_flag=True,
        help="With --fmu: judge Co-Simulation with one doStep a step of the plan; its error is the change with shorter steps.",
    ),
    click.option(
        "--ignore",
        multiple=True,
        metavar="COLUMN",
        help="Ignore this column of the CSV; may be repeated.",
    ),
)


def read_fmu_options(
    scene: str | None,
    fmu: Path | None,
    *,
    map_path: Path | None,
    hold: str | None,
    time_limit: float,
    memory_limit: float,
    own_step: bool,
    ignore: Sequence[str],
) -> dict[str, Any]:
    """Return the arguments of `wire_fmu` except FMU and plan, from these options.

    Raises click.UsageError for an option that needs a scene with an FMU, or an FMU with a scene.
    """
    if (scene is None) == (fmu is None):
        raise click.UsageError("give either --scene or --fmu.")
    if map_path is not None and fmu is None:
        raise click.UsageError("--map belongs to --fmu; a scene knows its own names.")
    if own_step and fmu is None:
        raise click.UsageError(
            "--own-step belongs to --fmu; a scene's plan is judged by the true motion."
        )
    limits = Limits(seconds=time_limit, memory=int(memory_limit * 1024**3))
    return {
        "map_path": map_path, "hold": hold, "limits": limits, "own_step": own_step,
        "ignore": ignore,
    }  # fmt: skip


_ADDITIONS = additions()
_EXAMPLES = "\n".join(f"  python -m validate replay {item.example}" for item in _ADDITIONS)


@click.command(
    epilog=f"""\b
Examples:
  python -m validate replay plan.csv --scene three_cart
  python -m validate replay plan.csv --scene cart_pole_walls --track
  python -m validate replay plan.csv --scene three_cart --html plan.html
  python -m validate replay plan.csv --fmu robot.fmu --map robot.toml --json
{_EXAMPLES}

Exit codes: 0 the plan holds, by its inputs alone or with feedback (--require holds:
by its inputs alone); 1 it violates, or that is undecided; 2 a mistake in plan, map
or FMU; 3 a system requirement is missing.
"""
)
@click.argument("plan", type=click.Path(path_type=Path), metavar="PLAN.csv|PLAN.nc")
@click.option(
    "--scene", metavar="NAME|FILE.py", shell_complete=scenes, help="Judge the plan on this scene."
)
@FMU_OPTIONS
@click.option(
    "--track",
    is_flag=True,
    help="Always replay with feedback too.  [default: only if the inputs alone do not give the plan's motion]",
)
@click.option(
    "--require",
    type=click.Choice(["holds", "feedback"]),
    default="feedback",
    show_default=True,
    help="Require for exit code 0 that the plan holds by its inputs alone, or at least with feedback.",
)
@options(*(item.option for item in _ADDITIONS))
@click.option("--json", "as_json", is_flag=True, help="The score as JSON on stdout.")
@wide_option
@written_to("--html", "html_file", "FILE.html", "a page with verdict, player, plots and metrics")
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="DIR",
    help="Write score.json and replay.nc to this folder.",
)
@click.pass_obj
def command(
    arguments: tuple[str, ...],
    plan: Path,
    scene: str | None,
    fmu: Path | None,
    track: bool,
    require: str,
    as_json: bool,
    html_file: Path | None,
    out: Path | None,
    **given: Any,
) -> int:
    """Replay a plan through an FMU, in a process of its own, and print its score.

    PLAN.csv has one row a node: t, the inputs by name, and optionally positions, velocities and
    contact forces. A scene also takes plans of a campaign: DIR/runs/KEY/trajectory.nc.
    docs/replay.md describes plan and map, docs/verdict.md the questions.
    """
    wanted = {item: value for item in _ADDITIONS if (value := given.pop(item.name)) is not None}
    wired = read_fmu_options(scene, fmu, **given)
    requests = {item: item.prepare(value, fmu is not None) for item, value in wanted.items()}
    # NumPy's OpenBLAS starts a thread for each core on import. A process with threads is not forked
    # (validate.processes.process).
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if fmu is not None:
        from validate.judge.judgement import wire_fmu

        judgement, warnings = wire_fmu(fmu, plan, **wired).judge(track), []
    else:
        judgement, warnings = _of_scene(str(scene), plan, wired, track)
    told = _told(judgement, warnings)
    added = {
        item: item.results(judgement, request, wired["limits"])
        for item, request in requests.items()
    }
    told |= {item.name: rows for item, rows in added.items()}
    if out is not None:
        _write(out, told, judgement)
    write(html_file, lambda: _page(judgement, plan, arguments, told))
    if as_json:
        click.echo(json.dumps(told, indent=1))
    else:
        warn(told["warnings"])
        _print(judgement)
        for item, rows in added.items():
            item.show(rows)
    return exit_code(judgement.verdict, require)


def exit_code(verdict: Verdict, require: str) -> int:
    """Return 0 for a plan that holds or has no questions, 1 for violates and undecided.

    `require` "holds": the plan must hold by its inputs alone.
    """
    accepted = {"holds", "consistent", "not applicable"} | (
        {"holds with feedback"} if require != "holds" else set()
    )
    return 0 if verdict.value in accepted else 1


def _of_scene(
    scene: str, plan: Path, given: dict[str, Any], track: bool
) -> tuple[Judgement, list[str]]:
    from models.fmu import build_fmu
    from validate.campaign.warnings import warnings_of
    from validate.judge.judgement import ANOTHER_UNIT, as_trajectory, judge_trajectory

    loaded = load_scene(scene)
    trajectory = as_trajectory(plan, loaded, hold=given["hold"], ignore=given["ignore"])
    assert trajectory is not None, "a file is a plan"
    takes, horizon = trajectory.duration, loaded.task.horizon
    if _LONG * horizon < takes <= ANOTHER_UNIT * horizon:
        doubt = f"it takes {takes:.4g} s, the task of {loaded.name} {horizon:.4g} s; is its t in s? Its replay takes as much longer"
        say(f"{plan}: {doubt}", err=True)
    longest = float(max(after - before for before, after in pairwise(trajectory.t)))
    same = math.isclose(longest, loaded.task.step, rel_tol=1e-9)
    warnings = warnings_of(
        [loaded if same else loaded.with_task(step=longest)], steps=trajectory.scheme is not None
    )
    return judge_trajectory(
        loaded, build_fmu(loaded), trajectory, feedback=track, limits=given["limits"]
    ), warnings


def _told(judgement: Judgement, warnings: list[str]) -> dict[str, Any]:
    """Return the score that is printed as JSON and written to score.json."""
    replay, result = judgement.replay, judgement.score
    return {
        "subject": judgement.scene.name,
        "verdict": result.verdict.value,
        "why": result.why,
        "cause": {"code": result.cause, "fields": dict(result.cause_fields)},
        "judged": result.judged,
        "questions": [
            {"number": question.number, "question": question.value, "answer": answer}
            for question, answer in result.questions
        ],
        "metrics": [
            {
                **asdict(metric),
                "question": metric.question.number,
                "error": metric.error if math.isfinite(metric.error) else None,
            }
            for metric in result.metrics
        ],
        "waived": list(result.waived),
        "not_asked": list(result.not_asked),
        "warnings": warnings,
        "growth": None
        if replay is None or replay.growth is None
        else {**asdict(replay.growth), "rate": replay.growth.rate},
        "replay": None if replay is None else _facts(replay),
        "tracked": None if replay is None or replay.tracked is None else _facts(replay.tracked),
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


def _write(out: Path, told: dict[str, Any], judgement: Judgement) -> None:
    from models.scene import Scene
    from models.trajectory_netcdf import write_netcdf
    from validate.judge.replay.netcdf import write_replay

    replay, subject, plan = judgement.replay, judgement.scene, judgement.plan
    make_folder(out)
    write_durably(out / "score.json", json.dumps(told, indent=1))
    if replay is None or plan is None:
        return
    if len(replay.t):
        write_replay(out / "replay.nc", replay, subject, plan)
    if replay.tracked is not None and len(replay.tracked.t):
        write_replay(out / "tracked.nc", replay.tracked, subject, plan)
        if isinstance(subject, Scene) and replay.tracked.feedback is not None:
            write_netcdf(out / "plan.nc", plan, subject, replay.tracked.feedback.gains)


def _page(
    judgement: Judgement, plan: Path, arguments: tuple[str, ...], told: dict[str, Any]
) -> str:
    from validate.campaign.shown import JudgedPlan
    from validate.store.provenance import command_line

    return JudgedPlan.of(judgement, plan).page(command_line(arguments), told["warnings"], told)


def _print(judgement: Judgement) -> None:
    from validate.tasks.records import given_stage

    result, replay = judgement.score, judgement.replay
    stage = given_stage("", replay, result, 0.0)
    print_verdict(stage.verdict, result.why, stage, cause_of_stage(stage))
    print_score(stage)
    for text in result.waived:
        say(f"waived by the scene: {text}")
    if replay is not None:
        say(_own_error("the replay", replay))
        if replay.tracked is not None:
            say(_own_error("the replay with feedback", replay.tracked))


def _own_error(what: str, replay: Replay) -> str:
    estimate = replay.error.estimate
    own = (
        "has no estimate"
        if estimate is None
        else f"is {_size(estimate.position)} in any position, {_size(estimate.state)} in the state"
    )
    events = "1 event" if len(replay.events) == 1 else f"{len(replay.events)} events"
    return f"{what}'s own error {own} ({replay.method}; {events}). {replay.message}".rstrip()


def _size(value: float) -> str:
    return "unknown" if math.isinf(value) else f"{value:.2g}"
