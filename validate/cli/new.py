"""`new`: write a scene file that runs, a plan that fits a scene, or the map of an FMU."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

import click

from models.catalog import load_scene
from models.errors import TouchstoneError
from models.scene import Scene
from models.trajectory import column_names
from validate.cli.options import A_FILE
from validate.cli.table import say
from validate.processes.disk import write_durably

TEMPLATE = Path(__file__).with_name("new_scene.txt")


class NewFileError(TouchstoneError):
    """A file that cannot be written under this name."""


@click.command(
    epilog="""\b
Examples:
  python -m validate new block            (block.py and block_plan.csv)
  python -m validate new --plan three_cart
  python -m validate new --map robot.fmu  (robot.toml and robot_plan.csv)

Exit codes: 0 written; 2 usage, or the file exists.
"""
)
@click.argument("name", required=False)
@click.option(
    "--plan",
    "scene_name",
    metavar="SCENE",
    help="Write only a plan of this scene (a name, or a scene file).",
)
@click.option(
    "--map",
    "fmu",
    type=A_FILE,
    metavar="FILE.fmu",
    help="Write a map of this FMU from its description, and a plan that fits.",
)
def command(name: str | None, scene_name: str | None, fmu: Path | None) -> int:
    """Write a scene file that runs, with a plan, and print the next commands.

    The scene is a block that is pushed to a mark; a comment explains each field. The plan has the
    times of the scene and inputs of zero. With --map: the map and a plan of an external FMU.
    """
    if sum(given is not None for given in (name, scene_name, fmu)) != 1:
        raise click.UsageError(
            "expected NAME, --plan SCENE or --map FILE.fmu; for example: new block"
        )
    if fmu is not None:
        return _new_map(fmu)
    if name is None:
        scene = load_scene(str(scene_name))
        plan = _new_path(f"{scene.name}_plan.csv")
        _write_plan(plan, scene)
        _print_next(("replay", str(plan), "--scene", str(scene_name)))
        return 0
    _check_name(name)
    file, plan = _new_path(f"{name}.py"), _new_path(f"{name}_plan.csv")
    write_durably(file, TEMPLATE.read_text(encoding="utf-8").replace("NAME", name))
    say(f"wrote {file}: a scene; a comment explains each field")
    _write_plan(plan, load_scene(str(file)))
    _print_next(
        ("replay", str(plan), "--scene", str(file)),
        ("all", "--scene", str(file), "--dry-run"),
        ("all", "--scene", str(file), "-k", "=strict", "--out", f"runs/{name}"),
    )
    return 0


def _new_map(fmu: Path) -> int:
    """Write the map of an FMU and a plan. Raises FmuError, MachineError, NewFileError."""
    from validate.fmi.description import read_package
    from validate.judge.replay.map_draft import draft_map

    draft = draft_map(read_package(fmu))
    file, plan = _new_path(f"{fmu.stem}.toml"), _new_path(f"{fmu.stem}_plan.csv")
    write_durably(file, draft.text)
    say(f"wrote {file}: what {fmu.name} declares; lines with # are your choices")
    write_durably(plan, draft.plan)
    inputs = f"its inputs {', '.join(draft.inputs)} have their start values, fill in yours"
    say(f"wrote {plan}: a plan; {inputs if draft.inputs else 'this FMU has no inputs'}")
    _print_next(
        ("replay", str(plan), "--fmu", str(fmu), "--map", str(file)),
        ("check", str(fmu)),
    )
    return 0


def _check_name(name: str) -> None:
    """Raise NewFileError if a scene file cannot have this name."""
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name):
        raise NewFileError(
            f"{name!r} is no name of a scene: expected lower-case letters, digits and _, "
            "with a letter first, for example: new pushed_block"
        )
    if importlib.util.find_spec(name) is not None and not Path(f"{name}.py").exists():
        raise NewFileError(
            f"{name}.py would hide the Python module {name!r} from every program that runs in this "
            "folder; choose another name."
        )


def _new_path(name: str) -> Path:
    """Return a path in this folder. Raises NewFileError if a file exists there."""
    path = Path(name)
    if path.exists():
        raise NewFileError(f"{path} exists; choose another name, or move the file away.")
    return path


def _write_plan(path: Path, scene: Scene) -> None:
    """Write the times of a scene and inputs of zero; print the columns that may be added.

    Raises NewFileError if the scene has no inputs.
    """
    names = column_names(scene)
    if not names["u"]:
        raise NewFileError(f"scene {scene.name} has no inputs: its motion needs no plan.")
    rows = [",".join(("t", *names["u"]))]
    for k in range(scene.task.steps):
        rows.append(",".join((repr(round(k * scene.task.step, 12)), *("0" for _ in names["u"]))))
    # The inputs of a row are held until the next row, so that the last row needs none.
    rows.append(
        ",".join((repr(round(scene.task.steps * scene.task.step, 12)), *("" for _ in names["u"])))
    )
    write_durably(path, "\n".join(rows) + "\n")
    say(f"wrote {path}: a plan; its inputs {', '.join(names['u'])} are zero, fill in yours")
    others = [*names["q"], *names["v"], *names["lam"]]
    say(f"a plan may also state positions, velocities and forces: {', '.join(others)}", indent="  ")


def _print_next(*commands: tuple[str, ...]) -> None:
    from validate.store.provenance import command_line

    program = str(click.get_current_context().find_root().info_name)
    click.echo("next:")
    for words in commands:
        click.echo(f"  {command_line(words, program)}")
