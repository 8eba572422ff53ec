"""`plans`: its random tasks are the same everywhere, and rows are compared with the cheapest plan that was solved."""

from __future__ import annotations

import json

import numpy as np
import pytest

from benchmarks.suite.plans import compared, rows, task


def test_tasks_are_seeded_and_bodies_stand_apart_at_their_goal():
    for seed in range(20):
        scene = task(seed)
        assert scene.nq == 3 + seed % 4
        assert task(seed).task == scene.task
        for end in (scene.task.start, scene.task.goal):
            assert np.diff(np.array(end[: scene.nq], dtype=float)).min() >= 0.5 + 0.01 - 1e-12
        assert all(value == 0.0 for value in (*scene.task.start[scene.nq :], *scene.task.goal[scene.nq :]))
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
