"""`replay`: score anybody's plan."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import click

from validate.cli.table import one_line, short, table, use_colour


@click.command(epilog="Example: python -m validate replay plan.csv --scene three_cart")
@click.argument("plan", type=click.Path(path_type=Path), metavar="PLAN.csv")
@click.option("--scene", required=True, metavar="NAME|FILE.py", help="The scene the plan is for.")
@click.option("--json", "as_json", is_flag=True, help="The score as JSON on stdout.")
def command(plan: Path, scene: str, as_json: bool) -> int:
    """Replay a plan through the scene's FMU and print its score.

    PLAN.csv has one row a node: t, the scene's positions and inputs by name, and velocities and contact forces if they are
    known (figures that need them are missing otherwise); the last row has no inputs. Exit code 0 if the plan holds, 1 if it does not or if that is not resolved.
    """
    from models.catalog import load_scene
    from models.trajectory import read_csv
    from validate.tools import DEFAULT

    loaded = load_scene(scene)
    trajectory = read_csv(plan, loaded)
    replay = DEFAULT.replay(loaded, DEFAULT.build_fmu(loaded), trajectory)
    score = DEFAULT.score(loaded, trajectory, replay)
    verdict = getattr(score.verdict, "value", score.verdict)
    if as_json:
        figures = [asdict(figure) for figure in score.figures]
        click.echo(json.dumps({"scene": loaded.name, "verdict": verdict, "why": score.why, "figures": figures}, indent=1, default=str))
    else:
        rows = [
            [
                figure.name,
                short(figure.value, ".4e"),
                figure.unit,
                short(figure.limit, ".3g"),
                _judgement(figure),
                one_line(figure.meaning if figure.value is not None else f"not measured: {figure.reason}"),
            ]
            for figure in score.figures
        ]
        click.echo(table(["figure", "value", "unit", "limit", "", "meaning"], rows, ("value", "limit")), color=use_colour())
        click.echo()
        click.echo(one_line(f"{verdict}: {score.why}"), color=use_colour())
    return 0 if verdict == "holds" else 1


def _judgement(figure) -> str:
    if figure.value is None:
        return "missing"
    if figure.limit is None:
        return ""
    return "not resolved" if figure.ok is None else "ok" if figure.ok else "too large"
