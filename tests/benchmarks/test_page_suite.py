"""The page of the benchmark suite: figures with their targets in words, the profile of what is missed, every name escaped."""

import html
import re

import pytest

from benchmarks.page import render
from benchmarks.results import stored


def suite_record(factory, rows, figures=(), **changes) -> dict:
    values = {
        "kind": "suite",
        "rows": rows,
        "figures": list(figures),
        "repeats": 5,
        "load": [0.5, 1.0],
    }
    return values | {"provenance": factory.provenance().model_dump(mode="json")} | changes


def row(stage: str, seconds: float, by: str = "touchstone", steps: int = 500, **changes) -> dict:
    samples = [seconds, 1.1 * seconds, 0.9 * seconds]
    values = {
        "stage": stage, "title": stage, "by": by, "n": 3, "steps": steps, "cpu_s": samples,
        "memory_mib": [4.0] * 3, "outcome": "solved",
    }  # fmt: skip
    return values | changes


def figure(met: bool | None, **changes) -> dict:
    values = {
        "name": "chain_against_casadi",
        "what": "chain against CasADi",
        "n": 3,
        "steps": 500,
        "target": 0.8,
    }
    return values | {"samples": [1.0, 1.2, 1.1], "measured": 1.1, "met": met} | changes


@pytest.fixture
def page(benches, tmp_path):
    def made(record):
        folder = tmp_path / "all"
        benches.leave(folder, record)
        assert stored(folder)[1] == []
        found = re.search(r'<section id="suite".*?</section>', render(folder), re.DOTALL)
        return html.unescape(found[0])

    return made


def test_a_missed_figure_is_told_with_its_profile(page, factory):
    """0.10 + 0.20 once, 40 times 0.001 and 0.005: 0.04 and 0.2 s."""
    rows = [
        row("softplus_chain", 1.0, iterations=40),
        row("pyomo_build", 0.1),
        row("translate", 0.2),
        row("evaluate", 1e-3),
    ]
    text = page(
        suite_record(
            factory,
            [*rows, row("linear_algebra", 5e-3), row("softplus_chain", 0.5, by="casadi")],
            [figure(False)],
        )
    )
    assert (
        "0 of 1 figure that could be judged are met. Missed: chain against CasADi (1.1 at T = 500; target 0.8)."
        in text
    )
    assert (
        "Of its 1.00 CPU s: pyomo build 0.10 s, translate 0.20 s, evaluate 40 × 0.0010 s = 0.04 s and linear algebra 40 × 0.0050 s = 0.20 s."
        in text
    )
    assert "✗</span> missed" in text
    assert "1 – 1.2" in text
    assert "0.5 times ours" in text


def test_met_and_not_judged_are_words(page, factory):
    text = page(
        suite_record(factory, [row("replay", 1.0)],
                     [figure(True, measured=0.5),
                      figure(None, steps=50, why="the target is set for T >= 500")]),
    )  # fmt: skip
    assert "1 of 1 figure that could be judged is met." in text
    assert "Missed:" not in text
    assert "✓</span> met" in text
    assert "○</span> not judged" in text
    assert "The target is set for T >= 500" in text


def test_a_missed_iteration_says_what_is_compiled(page, factory):
    rows = [row("gd_iteration", 60e-6), row("gd_kernel", 30e-6)]
    text = page(
        suite_record(
            factory, rows, [figure(False, name="gd_against_pytorch", what="against PyTorch")]
        )
    )
    assert "Of its 60 µs: compiled rollout and adjoint 30 µs" in text


def test_a_missed_step_of_eps_says_what_the_warm_start_saved(page, factory):
    rows = [
        row("eps_step", 0.3, iterations=12),
        row("cold_step", 1.0, iterations=40),
        row("pyomo_build", 0.1),
        row("translate", 0.2),
    ]
    text = page(suite_record(factory, rows, [figure(False, name="eps_step", what="a step of eps")]))
    assert (
        "12 iterations from the plan before in 0.30 s, against 40 from a cold start in 1.00 s; building and translating are 0.30 s of that."
        in text
    )


def test_a_load_above_the_cores_is_said(page, factory):
    assert "was busy" not in page(suite_record(factory, [row("replay", 1.0)]))
    assert "The machine was busy with other work: its load was 90" in page(
        suite_record(factory, [row("replay", 1.0)], load=[90.0, 80.0])
    )


def test_several_sizes_are_drawn_and_failures_are_told(page, factory):
    rows = [
        row("replay", 1.0),
        row("replay", 10.0, steps=5000),
        row("cs_replay", 1.0, by="fmpy", cpu_s=[], memory_mib=[], failed="fmpy: it hangs."),
    ]
    text = page(suite_record(factory, rows, left_out=["nosnoc is not measured."]))
    assert "CPU time of our stages over n T" in text
    assert "replay, n = 3, T = 5000: 10.0 s" in text or "replay, n = 3, T = 5000: 10 s" in text
    assert "fmpy: it hangs." in text
    assert "Nosnoc is not measured." in text


def test_names_are_escaped(factory, benches, tmp_path):
    hostile = factory.HOSTILE
    folder = tmp_path / "all"
    rows = [
        row(hostile, 1.0, by=hostile, outcome=hostile, failed=hostile, title=hostile),
        row(hostile, 1.0, steps=5000),
    ]
    benches.leave(
        folder,
        suite_record(
            factory,
            rows,
            [figure(False, what=hostile, why=hostile, unit=hostile)],
            left_out=[hostile],
        ),
    )
    text = render(folder)
    assert 'id="suite"' in text
    assert "<img" not in text
    assert "<b>" not in text
    assert "\u202e" not in text


def test_a_missed_replay_says_what_the_calls_cost_and_spreads_have_no_sign(page, factory):
    """0.9, 1.0, 1.1: the middle half lies within 10 % of the median."""
    rows = [row("cs_replay", 9e-3), row("cs_calls", 6e-3), row("cs_replay", 12e-3, by="fmpy")]
    text = page(
        suite_record(
            factory, rows, [figure(False, name="replay_against_fmpy", what="against FMPy")]
        )
    )
    assert (
        "Of its 9000 µs: the calls, with one internal step each 6000 µs; the rest is the other internal steps, in the FMU's own C."
        in text
    )
    assert ">10\u202f%<" in text
