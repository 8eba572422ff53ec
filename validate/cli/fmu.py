"""`fmu`: export a scene."""

from __future__ import annotations

import shutil
from pathlib import Path

import click

from models.catalog import load_scene
from validate.cli.options import scenes
from validate.cli.table import warn
from validate.store.disk import disk_error, make_folder, write_durably


@click.command(
    epilog="""\b
Examples:
  python -m validate fmu three_cart -o three_cart.fmu
  python -m validate fmu my_scene.py -o my.fmu --fmi 3 --platform win64
  python -m validate fmu three_cart --coupled -o three_cart.ssp

Exit codes: 0 written; 2 usage, or a scene that no FMU can carry; 3 no compiler,
or it cannot be written.
"""
)
@click.argument("scene", metavar="NAME|FILE.py", shell_complete=scenes)
@click.option(
    "-o", "--output", type=click.Path(path_type=Path, dir_okay=False), required=True, metavar="FILE", help="Where to write the FMU."
)
@click.option("--fmi", "version", type=click.Choice(["2", "3"]), default="2", show_default=True, help="Version of FMI.")
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
def command(scene: str, output: Path, version: str, platforms: tuple[str, ...], coupled: bool) -> int:
    """Export a scene as an FMU: Co-Simulation and Model Exchange in one file."""
    from models.fmu import build_fmu
    from models.fmu.coupled import build_ssp
    from validate.plan.warnings import warnings_of

    if coupled and (version != "2" or platforms):
        raise click.UsageError("--coupled writes FMI 2.0 for this machine; leave out --fmi and --platform.")
    if output.suffix.lower() == (".fmu" if coupled else ".ssp"):
        raise click.UsageError(
            f"{output}: {'--coupled writes an .ssp' if coupled else 'this is an FMU, and only --coupled writes an .ssp'}; call it {output.with_suffix('.ssp' if coupled else '.fmu').name}."
        )
    loaded = load_scene(scene)
    warn(warnings_of([loaded]))
    built = build_ssp(loaded) if coupled else build_fmu(loaded, version=f"{version}.0", platforms=platforms)
    make_folder(output.parent)
    if output.is_file() or not output.exists():
        write_durably(output, built.read_bytes())
    else:  # a pipe or a device
        try:
            shutil.copyfile(built, output)
        except OSError as error:
            raise disk_error(output, error) from error
    click.echo(str(output))
    return 0
