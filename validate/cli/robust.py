"""`robust`: measure how much perturbation a plan tolerates."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from models.catalog import load_scene
from models.results.robustness import RobustnessRecord
from models.results.run import RunRecord, stage_files
from models.results.stored import to_json
from models.scene import Scene
from models.trajectory import Trajectory
from models.trajectory_netcdf import read_netcdf
from reports.pages.robustness import page_of_plan
from validate.campaign.stored import CampaignError
from validate.cli.group import INTERRUPTED
from validate.cli.options import folder_of, scenes, write, written_to
from validate.cli.replay import FMU_OPTIONS, read_fmu_options
from validate.cli.show import find_run
from validate.cli.table import print_table, say, short, wide_option
from validate.judge.judgement import as_trajectory, wire_fmu
from validate.judge.robustness import PerturbationKind, Robustness, robustness
from validate.store.store import Store
from validate.tasks.task import RunTask, task_from_json, varied


@click.command(
    epilog="""\b
Examples:
  python -m validate robust plan.csv --scene three_cart
  python -m validate robust plan.csv --scene three_cart --samples 10000 --html page.html
  python -m validate robust "three_cart x mpcc" --in runs/all
  python -m validate robust plan.csv --scene three_cart --perturb parameters
  python -m validate robust plan.csv --fmu robot.fmu --map robot.toml --perturb mass_trunk

Exit codes: 0 measured; 2 a mistake, or a plan that does not hold in the unperturbed
world; 3 a system requirement is missing; 130 interrupted, partial results are printed.
"""
)
@click.argument("plan", metavar="PLAN.csv|RUN")
@click.option(
    "--scene",
    metavar="NAME|FILE.py",
    shell_complete=scenes,
    help="Judge the plan on this scene.  [default: the scene of the run]",
)
@folder_of("--in", "Read the run from this campaign.")
@click.option(
    "--samples",
    type=int,
    default=1000,
    show_default=True,
    help="Try this number of worlds, and a quarter of them with feedback.",
)
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    help="Draw the worlds from this seed.",
)
@FMU_OPTIONS
@click.option(
    "--perturb",
    "kinds",
    multiple=True,
    metavar="KIND|NAME",
    help="Perturb only parameters, start, gain, noise, delay, or one of them by its name; may be repeated.  [default: all]",
)
@click.option(
    "--anyway",
    is_flag=True,
    help="Measure a plan that does not hold in the unperturbed world, too.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the results as JSON.")
@wide_option
@written_to("--html", "html_file", "FILE.html", "a page with the results")
@written_to(
    "--csv",
    "csv_file",
    "FILE.csv",
    "every world, with its perturbations and the plan's largest share of a limit",
)
def command(
    plan: str,
    scene: str | None,
    folder: Path,
    samples: int,
    seed: int,
    fmu: Path | None,
    kinds: tuple[str, ...],
    anyway: bool,
    as_json: bool,
    html_file: Path | None,
    csv_file: Path | None,
    **given: Any,
) -> int:
    """Try a plan in perturbed worlds: the share in which it arrives, and the weakest perturbation.

    Parameters, start, gain of the inputs, noise and delay are perturbed by up to the sizes of
    docs/robustness.md: first all together, then each alone until the plan fails. Inputs alone and
    inputs with feedback are reported separately.
    """
    if fmu is not None:
        subject, trajectory, name = (
            wire_fmu(fmu, plan, **read_fmu_options(scene, fmu, **given)),
            None,
            Path(plan).name,
        )
    elif given["map_path"] is not None or given["own_step"] or given["hold"] is not None:
        raise click.UsageError("--map, --own-step and --hold belong to --fmu.")
    else:
        subject, trajectory, name = _plan_of(plan, scene, folder, given["ignore"])
    found = robustness(
        subject, trajectory, samples=samples, seed=seed, kinds=kinds or tuple(PerturbationKind),
        anyway=anyway,
        tell=lambda text: click.echo(f"{text} ..", err=True),
    )  # fmt: skip
    write(csv_file, lambda: _worlds(found))
    write(html_file, lambda: page_of_plan(found, name))
    if as_json:
        click.echo(to_json(found, 1, RobustnessRecord))
    else:
        _print(found)
    return 0 if found.complete else INTERRUPTED


def _plan_of(
    plan: str, scene: str | None, folder: Path, ignore: Sequence[str]
) -> tuple[Any, Any, str]:
    """Return the scene, the plan as a Trajectory, and its name, from a file or from a run."""
    if Path(plan).is_file() or Path(plan).suffix in (".csv", ".nc"):
        if scene is None:
            raise click.UsageError("a plan from a file needs --scene NAME, or --fmu FILE.fmu.")
        subject = load_scene(scene)
        return subject, as_trajectory(plan, subject, ignore=ignore), Path(plan).name
    found, record = find_run(plan, folder)
    if not isinstance(record, RunRecord):
        raise CampaignError(f"{plan}: this is a check and no run, so it left no plan to try.")
    return *stored_plan(found, record, scene), record.title


def stored_plan(
    folder: Path, record: RunRecord, scene: str | None = None
) -> tuple[Scene, Trajectory]:
    """Return the last plan of a stored run, and its scene or the named one.

    The run's scene has the changes of its campaign. Raise CampaignError, SceneError or
    TrajectoryError.
    """
    last = record.last
    if last is None or not last.has_plan:
        raise CampaignError(f"{record.title}: this run left no plan, so there is nothing to try.")
    try:
        task = task_from_json(Store(folder).request(record.key))
    except ValueError:  # damaged: the record has only the name of the scene
        task = None
    asked = task if scene is None and isinstance(task, RunTask) else None
    subject = load_scene(scene or (record.scene.name if asked is None else asked.scene))
    if asked is not None and asked.variant is not None:
        subject = varied(subject, asked.variant)
    return subject, read_netcdf(
        folder / "runs" / record.key / stage_files(last.index, len(record.stages))["trajectory"],
        subject,
    )


def _worlds(found: Robustness) -> str:
    """Return CSV with one row a world.

    Columns: number, perturbations in sizes, largest share of a limit by inputs alone and with
    feedback.
    """
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(
        [
            "world",
            *(cause.name for cause in found.causes),
            *(f"share of limit, {way.name}" for way in found.ways),
        ]
    )
    for number in range(len(found.ways[0].tried)):
        shares = (
            repr(float(way.tried[number])) if number < len(way.tried) else "" for way in found.ways
        )
        rows.writerow([number, *(repr(float(size)) for size in found.points[number]), *shares])
    return text.getvalue()


def _print(record: RobustnessRecord) -> None:
    rows = []
    for item in sorted(record.failures, key=lambda item: (item.sizes is None, item.sizes)):
        unit = "" if item.cause.unit == "1" else f" {item.cause.unit}"
        at = (
            f"not up to {short(item.tried, '.3g')} sizes"
            if item.amount is None
            else f"{short(item.amount, '.3g')}{unit}"
        )
        rows.append(
            [
                item.cause.name,
                "+" if item.direction > 0 else "-",
                short(item.sizes, ".3g"),
                at,
                item.by,
            ]
        )
    say(f"{record.verdict}: {record.summary}")
    for way in record.ways:
        checked = way.checked
        if way.fails:
            say(f"{way.name}: it fails by {way.fails}.")
        if checked is not None:
            differ, largest = len(checked.differ), f"{checked.largest_difference:.1e}"
            say(
                f"{way.name}: {checked.count} worlds tried {checked.by} too, {differ} end otherwise; largest difference {largest} of a limit."
            )
    if record.weakest is not None:
        say(f"{record.weakest.cause.name}: it fails by {record.weakest.by}.")
    if rows:
        click.echo()
        titles = ["perturbation", "", "sizes", "first fails at", "by"]
        print_table(titles, rows, ("sizes",), drop=["by"])
    if not record.complete:
        say("interrupted: this is what was tried until then.", err=True)
