"""`plans`: its random tasks are the same everywhere, and rows are compared with the cheapest plan that was solved."""

import json

import numpy as np
import pytest

from benchmarks.suite.plans import compared, task


def test_tasks_are_seeded_and_cannot_be_done_without_contact():
    for seed in range(8):
        scene = task(seed)
        n = scene.nq
        assert n == 3 + seed % 4
        assert task(seed).task == scene.task
        moved = np.array(scene.task.goal[:n], dtype=float) - np.array(scene.task.start[:n])
        assert np.abs(moved[1:-1]).min() > 0.0, "nobody but its neighbours moves a cart in between"


def test_only_what_was_solved_is_compared():
    costs = {
        "a": (("SOLVED", 2.0), ("STALLED", 1.0), ("SOLVED", 2.5)),
        "b": (("SOLVED", 4.0),),
        "c": (("STALLED", 3.0),),
    }
    found = [
        {"row": row, "outcome": outcome, "cost": cost}
        for row, runs in costs.items()
        for outcome, cost in runs
    ]
    compared(found)
    assert [run.get("above") for run in found] == [0.0, None, 0.25, 0.0, None]


@pytest.mark.slow
def test_a_row_is_solved_and_told(cli, tmp_path):
    page = tmp_path / "costs.md"
    asked = ("--tasks", "1", "--pipeline", "softplus_dc+strict", "--out", str(tmp_path))
    done = cli("plans", *asked, "--markdown", str(page))
    assert done.returncode == 0, done.stderr
    (run,) = json.loads((tmp_path / "plans.json").read_text())["runs"]
    assert (run["row"], run["outcome"], run["above"]) == ("3 carts, 0", "SOLVED", 0.0)
    assert "softplus_dc+strict: 1 of 1 solved" in done.stdout
    assert page.read_text().splitlines()[::2] == [
        "| row | softplus_dc+strict |",
        f"| 3 carts, 0 | {run['cost']:.8g} |",
    ]
