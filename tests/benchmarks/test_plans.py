"""`plans`: its random tasks are the same everywhere, and rows are compared with the cheapest plan that was solved."""

import json

import numpy as np
import pytest

from benchmarks.suite.plans import compared, rows, task


def test_tasks_are_seeded_and_cannot_be_done_without_contact():
    for seed in range(8):
        scene = task(seed)
        n = scene.nq
        assert n == 3 + seed % 4
        assert task(seed).task == scene.task
        moved = np.array(scene.task.goal[:n], dtype=float) - np.array(scene.task.start[:n])
        assert np.abs(moved[1:-1]).min() > 0.0, "nobody but its neighbours moves a cart in between"
    assert [name for name, _ in rows(2, "carts")] == ["3 carts, 0", "4 carts, 1"]


def test_only_what_was_solved_is_compared():
    found = [{"outcome": "SOLVED", "cost": 2.0}, {"outcome": "STALLED", "cost": 1.0}, {"outcome": "SOLVED", "cost": 2.5}]
    compared(found)
    assert [row.get("above") for row in found] == [0.0, None, 0.25]


@pytest.mark.slow
def test_a_row_is_solved_and_told(cli, tmp_path):
    done = cli("plans", "--only", "3 carts, 0", "--pipeline", "softplus_dc+strict", "--out", str(tmp_path))
    assert done.returncode == 0, done.stderr
    (run,) = json.loads((tmp_path / "plans.json").read_text())["runs"]
    assert run["outcome"] == "SOLVED"
    assert run["above"] == 0.0
    assert "softplus_dc+strict: 1 of 1 solved" in done.stdout
