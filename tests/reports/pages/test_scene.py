"""The page of a scene: the motion that stands for it, its contact forces, all methods as one scatter and one table, its equations."""

import html
import json
import re
from dataclasses import replace
from pathlib import Path

import pytest
from wording import unsaid

from reports.load import load
from reports.pages import scene as module
from reports.pages.section import Report, run_pages
from reports.render import PAGES, write_report


def page_of(folder: Path) -> str:
    write_report(folder, jobs=1)
    return html.unescape((folder / PAGES / "scene-three_cart.html").read_text(encoding="utf-8"))


def shown(folder: Path):
    report = Report(load(folder), folder)
    return module.build(report, report.scenes[0]).values["shown"]


@pytest.mark.slow
def test_it_plays_the_cheapest_plan_that_holds_beside_replay_goal_and_forces(factory, tmp_path):
    scene = factory.scene()
    scene = replace(
        scene, shapes=tuple(replace(shape, goal=(2.5, 0.0, 0.0)) for shape in scene.shapes)
    )
    runs = [replace(run, scene=scene) for run in factory.runs()[:5]]
    cheap = min(
        (run for run in runs if run.verdict == "holds"), key=lambda run: run.stages[-1].cost
    )
    dear = max((run for run in runs if run.verdict == "holds"), key=lambda run: run.stages[-1].cost)
    assert cheap.stages[-1].cost < dear.stages[-1].cost
    text = page_of(
        factory.store(tmp_path / "all", [dear, *(run for run in runs if run is not dear)])
    )
    assert (
        f"The cheapest plan that holds: {cheap.pipeline}, cost {cheap.stages[-1].cost:.2f}" in text
    )
    (data,) = (
        json.loads(found)
        for found in re.findall(r'<script type="application/json">(.*?)</script>', text)
    )
    assert data["plan"]
    assert data["replay"]
    assert all(shape["goal"] == [2.5, 0.0, 0.0] for shape in data["shapes"])
    assert f'href="{run_pages([cheap])[cheap.key]}">Its run</a>' in text
    motion = text[text.index('id="scene-1"') : text.index('id="pareto-1"')]
    assert "Contact force, " in motion
    assert "Positions: plan dotted, replay solid" in motion


@pytest.mark.slow
def test_its_methods_follow_as_a_scatter_and_a_table_and_then_its_equations(factory, tmp_path):
    text = page_of(factory.store(tmp_path / "all", factory.runs()))
    order = [
        text.index(f'<section id="{anchor}"')
        for anchor in ("scene-1", "pareto-1", "stages-1", "front-1", "tightening-1", "model-1")
    ]
    assert order == sorted(order)
    table = text[order[2] : order[3]]
    assert all(
        f">{run.stages[-1].method}<" in table or run.stages[-1].method in table
        for run in factory.runs()
    )
    assert "<math" in text[order[-1] :]


def test_where_nothing_holds_it_shows_the_plan_that_its_replay_stays_nearest_to(factory, tmp_path):
    runs = []
    for run, error in zip(factory.runs()[:2], (0.4, 0.3), strict=True):
        last = run.stages[-1]
        metrics = tuple(
            replace(metric, value=error, ok=False) if metric.name == "replay_error" else metric
            for metric in last.metrics
        )
        stages = (
            *run.stages[:-1],
            replace(last, verdict="violates", metrics=metrics),
        )
        runs.append(replace(run, verdict="violates", stages=stages))
    found = shown(factory.store(tmp_path / "all", runs))
    assert (found.run.pipeline, found.said) == (
        runs[1].pipeline,
        f"No plan holds; nearest to its replay stays {runs[1].pipeline}",
    )


@pytest.mark.parametrize("lost", ["plan", "files"])
def test_without_a_motion_it_says_so(factory, tmp_path, lost):
    run = factory.runs()[0]
    if lost == "plan":
        run = replace(run, stages=(replace(run.stages[-1], has_plan=False),))
    folder = factory.store(tmp_path / "all", [run])
    for path in (folder / "runs" / run.key).glob("*.nc"):
        path.unlink()
    assert shown(folder) is None
    assert not unsaid(page_of(folder), "No motion")
