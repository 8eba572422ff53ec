"""`fmu`: export a scene."""

from __future__ import annotations

import shutil
from pathlib import Path

import click


@click.command(epilog="Example: python -m validate fmu three_cart -o three_cart.fmu")
@click.argument("scene", metavar="NAME|FILE.py")
@click.option(
    "-o", "--output", type=click.Path(path_type=Path, dir_okay=False), required=True, metavar="FILE", help="Where to write the FMU."
)
def command(scene: str, output: Path) -> int:
    """Export a scene as an FMU (FMI 2.0, Co-Simulation and Model Exchange)."""
    from models.catalog import load_scene
    from models.fmu import build_fmu
    from validate.store import disk_error

    built = build_fmu(load_scene(scene))
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(built, output)
    except OSError as error:
        raise disk_error(output, error) from error
    click.echo(str(output))
    return 0
