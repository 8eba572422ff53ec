"""`fmu --coupled`: a scene as coupled FMUs in an .ssp."""

from __future__ import annotations

import click

from models.catalog import load_scene
from models.fmu.coupled import build_ssp
from validate.campaign.warnings import warnings_of
from validate.cli.exports import Export, ExportRequest, copy
from validate.cli.table import warn


def _check(request: ExportRequest) -> None:
    selected, output = request.options["coupled"], request.output
    if selected and (request.version != "2" or request.platforms):
        raise click.UsageError(
            "--coupled writes FMI 2.0 for this machine; leave out --fmi and --platform."
        )
    if selected and request.scene is None:
        raise click.UsageError("--coupled splits a scene; give its name or file.")
    if selected and output.suffix.lower() == ".fmu":
        raise click.UsageError(f"{output}: --coupled writes an .ssp; call it {output.stem}.ssp.")
    if not selected and output.suffix.lower() == ".ssp":
        raise click.UsageError(
            f"{output}: this is an FMU, and only --coupled writes an .ssp; call it {output.stem}.fmu."
        )


def _write(request: ExportRequest) -> int:
    scene = load_scene(str(request.scene))
    warn(warnings_of([scene]))
    copy(build_ssp(scene), request.output)
    return 0


EXPORT = Export(
    option="coupled",
    options=(
        click.option(
            "--coupled",
            is_flag=True,
            help="Write an .ssp instead: an FMU for each body and each contact, and how they are connected (FMI 2.0, this machine's platform).",
        ),
    ),
    example="three_cart --coupled -o three_cart.ssp",
    check=_check,
    write=_write,
)
