"""`energy`: check that a time step follows the energies of a scene."""

from __future__ import annotations

import json
from dataclasses import asdict

import click

from models.catalog import load_scene
from validate.cli.options import scenes
from validate.cli.table import say
from validate.judge.time_step import energy_test

_EPILOG = """\b
Examples:
  python -m validate energy cart_pole_walls --step semi_implicit_euler
  python -m validate energy my_scene.py --step their_step.py:step

The function is called as step(q, v, u, h, parameters) and returns q and v at the
end of the step. Inputs, contacts and friction are left out.

Exit codes: 0 the energy error vanishes with the step; 1 it does not; 2 a
mistake in the scene or the step.
"""


@click.command(epilog=_EPILOG)
@click.argument("scene", shell_complete=scenes, metavar="SCENE")
@click.option(
    "--step",
    required=True,
    metavar="FILE.py:FUNCTION|SCHEME",
    help="Test this Python function, or semi_implicit_euler, implicit_midpoint or radau_iia_2.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the figures as JSON.")
def command(scene: str, step: str, as_json: bool) -> int:
    """Simulate free motion at the task's step h, h/5 and h/25, and compare the energies.

    The energy error of a right step vanishes with h. A step that solves other equations than those
    of the scene's energies leaves an error at every h.
    """
    found = energy_test(load_scene(scene), step)
    if as_json:
        order = found.order if found.order < float("inf") else None
        data = asdict(found) | {"order": order, "vanishes": found.vanishes}
        click.echo(json.dumps(data, indent=1))
    else:
        say(found.sentence)
    return 0 if found.vanishes else 1
