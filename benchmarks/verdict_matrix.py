"""What other simulators say of the plan of each scene, as a page: the verdict matrix (validate.judge.elsewhere).

A plan is read from the folder where there is one, SCENE.nc, and else found by the pipeline that is
named here, and kept there: that which is quick, and holds.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click

import touchstone as ts
from models.trajectory_netcdf import write_netcdf
from validate.cli.options import write, written_to
from validate.execution.isolated import Limits
from validate.execution.process import usable_cores
from validate.judge.elsewhere import EngineVerdict, elsewhere
from validate.judge.judgement import judge
from validate.judge.simulator import LIMITS, describe_engine, named_engines

PIPELINES = {
    "three_cart": "mpcc", "cart_chain": "mpcc", "two_discs": "mpcc", "two_discs_wall": "mpcc",
    "hopper": "mpcc", "wall_pendulum": "mpcc",
    "acrobot_limits": "softplus_dc+strict", "cart_pole_walls": "collocation",
    "transport": "relaxed+strict", "two_finger": "relaxed+strict",
    "two_finger_lift": "relaxed+strict", "hopper_planar": "softplus_dc+strict",
}  # fmt: skip


plans_option = click.option(
    "--plans", type=click.Path(path_type=Path, file_okay=False), default="runs/verdict_matrix",
    show_default=True, help="Where plans are kept.",
)  # fmt: skip


def kept_plan(name: str, plans: Path) -> Path | None:
    """The file of a scene's plan in that folder, found now where there is none.

    None: its pipeline finds none. Raises TouchstoneError.
    """
    file = plans / f"{name}.nc"
    if not file.is_file():
        found = ts.solve(name, PIPELINES[name]).trajectory
        if found is None:
            click.echo(f"{name}: {PIPELINES[name]} found no plan")
            return None
        plans.mkdir(parents=True, exist_ok=True)
        write_netcdf(file, found, ts.scene(name))
    return file


def as_markdown(
    engines: Sequence[str], rows: dict[str, tuple[str, str, list[EngineVerdict]]]
) -> str:
    """The page: a table of scenes by engines, then each disagreement with its class and what was measured; without times, so that it is equal whenever it is made."""
    lines = [
        "# The verdict matrix\n",
        f"Made by `python -m benchmarks verdict-matrix --engine {','.join(engines)}`; [engines.md](engines.md) says what is asked and how a class is measured.",
        "",
        "A cell is the engine's own verdict at its finest step; **bold** where it is another than ours at that step or at one of two longer ones.",
        "",
        f"| scene | plan by | ours | {' | '.join(engines)} |",
        f"|{'---|' * (len(engines) + 3)}",
    ]
    for scene, (pipeline, verdict, found) in rows.items():
        cells = [
            row.verdict if row.agrees is not False else f"**{row.verdict}**: {row.kind.value}"
            for row in found
        ]
        lines.append(f"| {scene} | {pipeline} | {verdict} | {' | '.join(cells)} |")
    lines += [
        "",
        "What was measured where they do not agree, or could not be asked; distances are in the nominal sizes of the coordinates:",
        "",
    ]
    lines += ["| scene | engine | class | measured |", "|---|---|---|---|"]
    for scene, (_, _, found) in rows.items():
        lines += [
            f"| {scene} | {row.engine} | {row.kind.value} | {row.sentence.replace('|', '/')} |"
            for row in found
            if not row.agrees
        ]
    lines += [
        "",
        *(
            f"- **{name}**: {describe_engine(name).title}; {describe_engine(name).law}."
            for name in engines
        ),
    ]
    return "\n".join(lines) + "\n"


@click.command()
@click.option(
    "--scene",
    "scenes",
    multiple=True,
    type=click.Choice(list(PIPELINES)),
    help="Only this scene; may be repeated.",
)
@click.option(
    "--engine",
    "engines",
    default="all",
    show_default=True,
    metavar="NAME,..|all",
    help="As of `validate replay`.",
)
@plans_option
@click.option(
    "--seconds",
    type=click.FloatRange(min=1.0),
    default=LIMITS.seconds,
    show_default=True,
    help="For each time that an engine is asked.",
)
@written_to("--markdown", "markdown", "FILE.md", "the page, as docs/verdict_matrix.md is")
def command(
    scenes: tuple[str, ...], engines: str, plans: Path, seconds: float, markdown: Path | None
) -> int:
    """What other simulators say of the plan of each scene, and why where they say otherwise."""
    asked, rows = tuple(name for name in named_engines(engines) if name != "fmu"), {}
    for name in scenes or PIPELINES:
        file = kept_plan(name, plans)
        if file is None:
            continue
        judgement = judge(name, file, limits=Limits())
        click.echo(f"{name}: {judgement.verdict.value}")
        found = elsewhere(
            judgement,
            asked,
            limits=Limits(seconds=seconds),
            jobs=usable_cores(),
            tell=lambda text: click.echo(f"  {text}"),
        )
        rows[name] = (PIPELINES[name], judgement.verdict.value, found)
        write(markdown, lambda: as_markdown(asked, rows))
    click.echo(as_markdown(asked, rows))
    return 0
