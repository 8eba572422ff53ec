"""Options that several benchmarks take.

What cannot be used is refused before anything is measured.
"""

from __future__ import annotations

import os
from pathlib import Path

import click

from validate.cli.options import FiniteRange

FOLDER = Path("runs/benchmarks")
COUNT = click.IntRange(min=1)
POSITIVE = FiniteRange(min=0.0, min_open=True)


def _place(context: click.Context, parameter: click.Parameter, path: Path | None) -> Path | None:
    """A path that can be made: of the folders it lies in, the last one that is there can be written to."""
    if path is not None:
        there = next(folder for folder in path.absolute().parents if folder.exists())
        if not there.is_dir() or not os.access(there, os.W_OK):
            raise click.BadParameter(
                f"nothing can be written to {there}; name another place.", context, parameter
            )
    return path


def _campaign(context: click.Context, parameter: click.Parameter, folder: Path) -> Path:
    from validate.campaign.stored import campaign_of

    campaign_of(folder)  # which says why there is none
    return folder


out_option = click.option(
    "-o", "--out", type=click.Path(path_type=Path, file_okay=False), default=FOLDER,
    show_default=True, callback=_place, metavar="DIR",
    help="Folder of the figures, NAME.json.",
)  # fmt: skip
json_option = click.option(
    "--json", "file", type=click.Path(path_type=Path, dir_okay=False), callback=_place,
    metavar="FILE", help="Write what was found to this file too."
)  # fmt: skip
seed_option = click.option(
    "--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Of what is random."
)
campaign_argument = click.argument(
    "folder", type=click.Path(path_type=Path), callback=_campaign, metavar="DIR"
)
