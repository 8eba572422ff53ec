"""Where the seconds of a campaign went: nothing is left out, and what runs share counts once."""

from types import SimpleNamespace
from typing import Any

import pytest

from benchmarks.account import PARTS, SECONDS, by_method, by_part


def test_parts_leave_nothing_out():
    profiles = [
        {"start": 1.0, "imports": 0.5, "replay": 2.0},
        {"start": 0.25, "replay": 1.0, "a lap of tomorrow": 4.0},
    ]
    parts = by_part(profiles)
    assert parts["processes start, import"] == 1.75
    assert parts["replay and verdict"] == 3.0
    assert parts["a lap of tomorrow"] == 4.0
    assert sum(parts.values()) == pytest.approx(sum(sum(profile.values()) for profile in profiles))
    assert set(PARTS) < set(parts)


def test_a_shared_stage_counts_where_it_was_made():
    seconds = SimpleNamespace(**dict.fromkeys(SECONDS, 1.0))
    own = SimpleNamespace(
        method="mpcc", iterations=7, seconds=seconds, shared_from="", outcome="solved"
    )
    shared = SimpleNamespace(
        method="mpcc", iterations=7, seconds=seconds, shared_from="mpcc", outcome="solved"
    )
    refused = SimpleNamespace(
        method="collocation", iterations=0, seconds=seconds, shared_from="", outcome="refused"
    )
    runs: list[Any] = [
        SimpleNamespace(stages=(own, own)),
        SimpleNamespace(stages=(shared, refused)),
    ]
    found = by_method(runs)
    assert found == {"mpcc": {"stages": 2, "iterations": 14, **dict.fromkeys(SECONDS, 2.0)}}
