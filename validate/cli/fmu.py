"""`fmu`: export a scene as an FMU; validate/cli/exports adds other exports."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from models.catalog import load_scene
from models.fmu import build_fmu
from validate.campaign.warnings import warnings_of
from validate.cli.exports import ExportRequest, copy, exports
from validate.cli.options import apart, options, scenes
from validate.cli.table import warn

_EXPORTS = exports()
_EXAMPLES = "\n".join(f"  python -m validate fmu {export.example}" for export in _EXPORTS)


@click.command(
    epilog=f"""\b
Examples:
  python -m validate fmu three_cart -o three_cart.fmu
  python -m validate fmu my_scene.py -o my.fmu --fmi 3 --platform win64
{_EXAMPLES}

Exit codes: 0 written; 2 usage, or a scene or robot that no FMU can carry; 3 no
compiler or no MuJoCo, or it cannot be written.
"""
)
@click.argument("scene", metavar="NAME|FILE.py", required=False, shell_complete=scenes)
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
@options(*(option for export in _EXPORTS for option in export.options))
def command(
    scene: str | None,
    output: Path,
    version: str,
    platforms: tuple[str, ...],
    **given: Any,
) -> int:
    """Export a scene as an FMU: Co-Simulation and Model Exchange in one file."""
    request = ExportRequest(
        scene=scene, output=output, version=version, platforms=platforms, options=given
    )
    for export in reversed(_EXPORTS):
        export.check(request)
    for export in _EXPORTS:
        if given[export.option]:
            return export.write(request)
    if scene is None:
        raise click.UsageError("give a scene, by its name or the path of its file.")
    loaded = load_scene(scene)
    warn(warnings_of([loaded]))
    copy(build_fmu(loaded, version=f"{version}.0", platforms=platforms), output)
    return 0
