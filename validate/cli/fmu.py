"""`fmu`: export a scene, or a robot of MuJoCo."""

from __future__ import annotations

import shutil
from pathlib import Path

import click

from models.catalog import load_scene
from models.fmu import build_fmu
from models.fmu.coupled import build_ssp
from models.fmu.mjcf import build_robot, read_robot
from validate.campaign.warnings import warnings_of
from validate.cli.options import apart, scenes
from validate.cli.table import warn
from validate.processes.disk import disk_error, make_folder, write_durably


@click.command(
    epilog="""\b
Examples:
  python -m validate fmu three_cart -o three_cart.fmu
  python -m validate fmu my_scene.py -o my.fmu --fmi 3 --platform win64
  python -m validate fmu three_cart --coupled -o three_cart.ssp
  python -m validate fmu --mjcf robot.xml --contact foot:floor -o robot.fmu

Exit codes: 0 written; 2 usage, or a scene or robot that no FMU can carry; 3 no
compiler or no MuJoCo, or it cannot be written.
"""
)
@click.argument("scene", metavar="NAME|FILE.py", required=False, shell_complete=scenes)
@click.option(
    "--mjcf",
    type=click.Path(path_type=Path),
    metavar="ROBOT.xml",
    help="A robot instead of a scene: MuJoCo's XML, a URDF that MuJoCo reads, or a compiled .mjb. Beside ROBOT.fmu the map ROBOT.toml is written, for replay.",
)
@click.option(
    "--contact",
    "contacts",
    multiple=True,
    metavar="A:B",
    help="With --mjcf: force and gap between two geoms or bodies as outputs; may be repeated.",
)
@click.option(
    "--keyframe", metavar="NAME", help="With --mjcf: start there instead of at the model's default."
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path, dir_okay=False),
    required=True,
    metavar="FILE",
    help="Where to write the FMU.",
)
@apart("-o", "output")
@click.option(
    "--fmi",
    "version",
    type=click.Choice(["2", "3"]),
    default="2",
    show_default=True,
    help="Version of FMI.",
)
@click.option(
    "--platform",
    "platforms",
    multiple=True,
    metavar="NAME",
    help="Carry binaries for this platform, by its name in FMI 2.0 or 3.0 (linux64 or x86_64-linux); may be repeated. Default: this machine's.",
)
@click.option(
    "--coupled",
    is_flag=True,
    help="Write an .ssp instead: an FMU for each body and each contact, and how they are connected (FMI 2.0, this machine's platform).",
)
def command(
    scene: str | None,
    mjcf: Path | None,
    contacts: tuple[str, ...],
    keyframe: str | None,
    output: Path,
    version: str,
    platforms: tuple[str, ...],
    coupled: bool,
) -> int:
    """Export a scene, or a robot of MuJoCo, as an FMU: Co-Simulation and Model Exchange in one file."""
    ending, other = (".ssp", ".fmu") if coupled else (".fmu", ".ssp")
    named = f"call it {output.stem}{ending}."
    own = (
        "--coupled writes an .ssp"
        if coupled
        else "this is an FMU, and only --coupled writes an .ssp"
    )
    for wrong, sentence in (
        ((scene is None) == (mjcf is None), "give either a scene or --mjcf ROBOT.xml."),
        (
            mjcf and (coupled or platforms),
            "--mjcf writes one FMU for this machine; leave out --coupled and --platform.",
        ),
        (
            mjcf and output.suffix.lower() != ".fmu",
            f"{output}: with --mjcf it is an FMU, beside which its map is written; {named}",
        ),
        (
            not mjcf and (contacts or keyframe),
            "--contact and --keyframe belong to --mjcf; a scene has its own contacts and its own start.",
        ),
        (
            coupled and (version != "2" or platforms),
            "--coupled writes FMI 2.0 for this machine; leave out --fmi and --platform.",
        ),
        (output.suffix.lower() == other, f"{output}: {own}; {named}"),
    ):
        if wrong:
            raise click.UsageError(sentence)
    if mjcf is not None:
        return _robot(mjcf, contacts, keyframe, output, f"{version}.0")
    loaded = load_scene(str(scene))
    warn(warnings_of([loaded]))
    built = (
        build_ssp(loaded)
        if coupled
        else build_fmu(loaded, version=f"{version}.0", platforms=platforms)
    )
    _copy(built, output)
    return 0


def _robot(
    mjcf: Path, contacts: tuple[str, ...], keyframe: str | None, output: Path, version: str
) -> int:
    """Write the FMU of a robot and its map; keep an existing map, the user may have edited it."""
    robot = read_robot(mjcf, contacts, keyframe)
    built = build_robot(robot, version)
    warn(robot.notes)
    _copy(built, output)
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


def _copy(built: Path, output: Path) -> None:
    make_folder(output.parent)
    if output.is_file() or not output.exists():
        write_durably(output, built.read_bytes())
    else:  # a pipe or a device
        try:
            shutil.copyfile(built, output)
        except OSError as error:
            raise disk_error(output, error) from error
    click.echo(str(output))
