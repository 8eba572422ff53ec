"""`fmu --mjcf`: a robot of MuJoCo as an FMU, and its map for `replay`."""

from __future__ import annotations

from pathlib import Path

import click

from models.fmu.mjcf import build_robot, read_robot
from validate.cli.exports import Export, ExportRequest, copy
from validate.cli.table import warn
from validate.processes.disk import write_durably


def _check(request: ExportRequest) -> None:
    options, output = request.options, request.output
    robot = options["mjcf"]
    for wrong, sentence in (
        ((request.scene is None) == (robot is None), "give either a scene or --mjcf ROBOT.xml."),
        (
            robot and (request.platforms or options.get("coupled")),
            "--mjcf writes one FMU for this machine; leave out --coupled and --platform.",
        ),
        (
            robot and output.suffix.lower() != ".fmu",
            f"{output}: with --mjcf it is an FMU, beside which its map is written; call it {output.stem}.fmu.",
        ),
        (
            not robot and (options["contacts"] or options["keyframe"]),
            "--contact and --keyframe belong to --mjcf; a scene has its own contacts and its own start.",
        ),
    ):
        if wrong:
            raise click.UsageError(sentence)


def _write(request: ExportRequest) -> int:
    """Write the FMU of a robot and its map; keep an existing map, the user may have edited it."""
    options, output = request.options, request.output
    robot = read_robot(options["mjcf"], options["contacts"], options["keyframe"])
    built = build_robot(robot, f"{request.version}.0")
    warn(robot.notes)
    copy(built, output)
    map_file = output.with_suffix(".toml")
    if not map_file.exists():
        write_durably(map_file, robot.map_text)
        click.echo(str(map_file))
    elif (
        not map_file.is_file()
        or map_file.read_text(encoding="utf-8", errors="replace") != robot.map_text
    ):
        warn(
            [
                f"{map_file} is there already and was kept; where it does not fit this FMU, remove it and export again."
            ]
        )
    return 0


EXPORT = Export(
    option="mjcf",
    options=(
        click.option(
            "--mjcf",
            type=click.Path(path_type=Path),
            metavar="ROBOT.xml",
            help="A robot instead of a scene: MuJoCo's XML, a URDF that MuJoCo reads, or a compiled .mjb. Beside ROBOT.fmu the map ROBOT.toml is written, for replay.",
        ),
        click.option(
            "--contact",
            "contacts",
            multiple=True,
            metavar="A:B",
            help="With --mjcf: force and gap between two geoms or bodies as outputs; may be repeated.",
        ),
        click.option(
            "--keyframe",
            metavar="NAME",
            help="With --mjcf: start there instead of at the model's default.",
        ),
    ),
    example="--mjcf robot.xml --contact foot:floor -o robot.fmu",
    check=_check,
    write=_write,
)
