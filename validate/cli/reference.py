"""`reference`: an FMU's reference solution with error bars, into its LS-REF folder or beside it as the FMI cross-check has it."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable
from pathlib import Path

import click
import numpy as np

from models.errors import TouchstoneError
from validate.cli.options import FiniteRange
from validate.cli.table import say
from validate.fmi import references as files
from validate.fmi.description import Package, read_package, unpacked
from validate.fmu_check.reference import POINTS, reference_solution
from validate.store.disk import make_folder, write_durably

_EPILOG = """\b
Examples:
  python -m validate reference model.fmu
  python -m validate reference model.fmu --input drive.csv --stop-time 10 -o model.fmu
  python -m validate reference model.fmu --cross-check

Exit codes: 0 written; 2 usage, no FMU, or nothing tells how large its error is;
3 it cannot be run or written on this machine.
"""
# The folder that is not read where an FMU is only run.
_TYPES = {"ME": "ModelExchange", "CS": "CoSimulation"}


@click.command(epilog=_EPILOG)
@click.argument("file", type=click.Path(path_type=Path), metavar="FILE.fmu")
@click.option(
    "--type",
    "kind",
    type=click.Choice(list(_TYPES)),
    help="The interface that is simulated.  [default: ME where the FMU offers it]",
)
@click.option(
    "--input",
    "input_file",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE.csv",
    help="Inputs over time: a column `time` and one for each input. [default: FILE_in.csv where there is one, else they stay at their starts]",
)
@click.option(
    "--stop-time",
    type=FiniteRange(),
    metavar="SECONDS",
    help="End of the experiment.  [default: the FMU's, or that of FILE_ref.opt]",
)
@click.option(
    "--step",
    type=FiniteRange(min=0.0, min_open=True),
    metavar="SECONDS",
    help="Between two lines of the result.  [default: a 500th of the experiment]",
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="OUT.fmu",
    help="Write into the LS-REF folder of a copy of the FMU, or of the FMU itself; else beside it.",
)
@click.option(
    "--cross-check",
    is_flag=True,
    help="Write FILE_cc.csv: what touchstone gives for somebody's FILE_ref.opt and FILE_in.csv, which lie beside the FMU.",
)
@click.option("--overwrite", is_flag=True, help="Also where a file or a result is there already.")
@click.option(
    "--time-limit",
    type=FiniteRange(min=0.1),
    default=300.0,
    show_default=True,
    metavar="SECONDS",
    help="For all runs together.",
)
def command(
    file: Path,
    kind: str | None,
    input_file: Path | None,
    stop_time: float | None,
    step: float | None,
    output: Path | None,
    cross_check: bool,
    overwrite: bool,
    time_limit: float,
) -> int:
    """Simulate an FMU at several tolerances, or steps, and write its outputs and states with an error bar for each number.

    Beside the FMU are written FILE_ref.csv, FILE_ref_error.csv and FILE_ref.opt; `check` tries such
    results again, whoever stored them.
    """
    if cross_check and (output is not None or stop_time is not None or step is not None):
        wrong = "--cross-check takes the experiment from FILE_ref.opt, and writes FILE_cc.csv; leave out -o, --stop-time and --step."
        raise click.UsageError(wrong)
    package = read_package(file)
    there = files.beside(file)
    if kind is not None and _TYPES[kind] not in package.kinds:
        raise click.UsageError(
            f"--type {kind}: {file} offers {' and '.join(package.kinds)} on this machine."
        )
    kind = kind or ("ME" if package.exchange is not None else "CS")
    if cross_check and there.settings is None:
        raise TouchstoneError(
            f"{file}: there is no {file.stem}{files.SETTINGS} beside it, which --cross-check reads."
        )
    settings = _settings(
        package,
        there if there.settings and (cross_check or stop_time is None) else None,
        stop_time,
        step,
        POINTS,
    )
    input_file = input_file or there.inputs
    inputs = files.read_table(str(input_file), files.read_text(input_file)) if input_file else None
    endings = (files.CHECKED,) if cross_check else (files.RESULT, files.ERROR, files.SETTINGS)
    endings += (
        (files.INPUT,)
        if inputs is not None and not cross_check and input_file != there.inputs
        else ()
    )
    targets = {ending: file.with_name(file.stem + ending) for ending in endings}  # beside the FMU
    if not overwrite and (taken := _taken(file, output, targets.values())):
        raise TouchstoneError(f"{taken[0]} is there already; give --overwrite to replace it.")
    count = max(1, round((settings["StopTime"] - settings["StartTime"]) / settings["StepSize"]))
    times = settings["StartTime"] + settings["StepSize"] * np.arange(count + 1)
    arrays, names = {"times": times}, list(inputs.columns) if inputs else []
    request = {
        "path": str(file.resolve()),
        "name": str(file),
        "type": kind,
        "input_file": str(input_file),
        "inputs": names,
    }
    if inputs is not None:
        arrays |= {
            "input_times": inputs.times,
            **{f"input {place}": column for place, column in enumerate(inputs.columns.values())},
        }
    with unpacked(package) as ready:
        found, numbers = reference_solution(
            {**request, "folder": str(ready.folder)}, arrays, time_limit
        )
    values, bars = (
        files.Table(times, files.columns_of(found["names"], found["sizes"], numbers[name]))
        for name in ("values", "bars")
    )
    texts = {files.CHECKED if cross_check else files.RESULT: files.table_text(values)}
    if not cross_check:
        texts |= {
            files.ERROR: files.table_text(bars),
            files.SETTINGS: files.settings_text(settings),
        }
        if inputs is not None:
            texts[files.INPUT] = files.table_text(inputs)
    if output is None:
        for ending, target in targets.items():
            write_durably(target, texts[ending])
    else:
        texts[files.EXPERIMENT] = files.experiment_text(file.stem, settings, inputs is not None)
        make_folder(output.parent)
        write_durably(output, files.with_references(file, file.stem, texts))
    size = np.maximum(np.abs(numbers["values"]).max(axis=0), 1e-300)
    what = f"{len(found['names'])} variables at {len(times)} times by {found['how']}; {found['events']} events"
    largest = f"largest error bar {np.max(numbers['bars'] / size):.1g} of a variable's size"
    say(f"{output or targets[next(iter(texts))]}: {what}; {largest}.")
    return 0


def _taken(file: Path, output: Path | None, targets: Iterable[Path]) -> list[str]:
    """What would be replaced: files, or results that the FMU itself holds."""
    if output is not None and output.exists() and output.samefile(file):
        return [f"{file}: {name}" for name in files.held(file, file.stem)]
    return [str(path) for path in (targets if output is None else (output,)) if path.exists()]


def _settings(
    package: Package,
    there: files.StoredResult | None,
    stop: float | None,
    step: float | None,
    points: int,
) -> dict[str, float]:
    """The experiment, as the .opt file holds it.

    Raises FmuError, TouchstoneError where it is not known.
    """
    if there is not None and there.settings is not None:
        found = files.read_settings(str(there.settings), files.read_text(there.settings))
    else:
        default = package.description.defaultExperiment

        def number(name: str, fallback: float) -> float:
            text = getattr(default, name, None)
            with contextlib.suppress(ValueError):
                return fallback if text is None else float(text)
            raise TouchstoneError(
                f"FMU {package.path}: its DefaultExperiment has {name}={text!r}, which is no number; correct it."
            )

        begin = number("startTime", 0.0)
        end = number("stopTime", np.nan) if stop is None else stop
        if np.isnan(end):
            raise TouchstoneError(
                f"FMU {package.path}: it does not say when its experiment ends; give --stop-time."
            )
        if not (end > begin and np.isfinite(end - begin)):
            why = f"the experiment begins at {begin:g} s, and cannot end at {end:g} s; give a --stop-time after its beginning."
            raise TouchstoneError(f"FMU {package.path}: {why}")
        found = {
            "StartTime": begin,
            "StopTime": end,
            "StepSize": 0.0,
            "RelTol": number("tolerance", 1e-4),
        }
    length = found["StopTime"] - found["StartTime"]
    found["StepSize"] = step or found["StepSize"] or length / points
    if not length / found["StepSize"] <= files.MOST_ROWS:
        lines = f"a line every {found['StepSize']:g} s makes {length / found['StepSize']:.3g} lines of {length:g} s"
        raise TouchstoneError(
            f"FMU {package.path}: {lines}; a result has {files.MOST_ROWS} at most: give a longer --step."
        )
    count = max(1, round(length / found["StepSize"]))
    if abs(count * found["StepSize"] - length) > 1e-6 * length:
        found["StepSize"] = length / count
    return found
