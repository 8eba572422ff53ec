"""The suite: ways through one stage end at the same answer, rounds take turns, what cannot be measured is said."""

import importlib
import platform
from pathlib import Path

import pytest
from wording import unsaid

from benchmarks.measure import Size
from benchmarks.records import SuiteRow
from benchmarks.suite.cases import CASES, OURS, YARDSTICK, Case
from benchmarks.suite.figures import RATIOS, figures
from benchmarks.suite.run import BenchError, Settings, failures, plan, run_suite

SIZE = Size(3, 12)
HERE = "suite_works"


def value_of(case: Case, folder: Path, size: Size = SIZE) -> float:
    module, _, name = case.function.partition(":")
    told = getattr(importlib.import_module(module), name)(size, folder)()
    assert told.get("outcome", "ok") in ("ok", "solved", "completed")
    return told["value"]


@pytest.mark.slow
@pytest.mark.parametrize("stage", ["softplus_chain", "cold_step", "gd_iteration", "cs_replay"])
def test_all_ways_through_a_stage_end_at_the_same_answer(stage: str, tmp_path: Path):
    """A faster way to another answer is no faster way: cost of the plan, norm of the gradient, position at the end."""
    cases = [case for case in CASES if case.stage == stage and not case.missing()]
    if len(cases) < 2:
        pytest.skip("no peer is installed: pip install -e '.[bench]'")
    values = {case.by: value_of(case, tmp_path, Size(3, 50)) for case in cases}
    loose = 1e-3 if "drake_snopt" in values else 1e-6  # SNOPT's feasibility of 1e-6 moves the cost
    assert values == pytest.approx(dict.fromkeys(values, values[OURS]), rel=loose)


@pytest.mark.slow
def test_the_hand_written_adjoint_is_the_derivative_of_its_loss(tmp_path: Path):
    """Central differences of the PyTorch loop's loss; the C code knows only its own."""
    torch = pytest.importorskip("torch")
    import numpy as np

    from benchmarks.suite.carts import INPUT_WEIGHT, numbers_of, push

    carts, u = numbers_of(SIZE), push(SIZE.steps)

    def loss(inputs):
        q, v, n = carts.start[:3].copy(), carts.start[3:].copy(), 3
        for row in inputs:
            contact = carts.stiffness * np.maximum(carts.length - np.diff(q), 0.0)
            force = (
                np.array([row[0] - contact[0], contact[0] - contact[1], row[1] + contact[1]])
                - carts.damping * v
            )
            v = v + carts.step / carts.mass * force
            q = q + carts.step * v
        return float(
            np.sum((np.concatenate([q, v]) - carts.goal) ** 2) / (2 * n)
            + INPUT_WEIGHT * np.sum(inputs**2)
        )

    gradient = np.zeros_like(u)
    for place in np.ndindex(*u.shape):
        step = np.zeros_like(u)
        step[place] = 1e-5
        gradient[place] = (loss(u + step) - loss(u - step)) / 2e-5
    norm = float(np.linalg.norm(gradient))
    for case in CASES:
        if case.stage == "gd_iteration":
            assert value_of(case, tmp_path) == pytest.approx(norm, rel=1e-6), case.by
    assert torch.get_num_threads() == 1


def test_the_suite_selects_and_says_why_not(monkeypatch):
    jobs, left_out = plan(Settings(sizes=(SIZE,), expression="gd_iteration"))
    assert {case.stage for case, _ in jobs} == {YARDSTICK, "gd_iteration"}
    assert {size for _, size in jobs} == {SIZE}
    assert not left_out
    jobs, left_out = plan(Settings(sizes=(SIZE,)))
    assert not {case.stage for case, _ in jobs} & {"report", "all_quick"}
    assert any("there is no stored campaign" in sentence for sentence in left_out)
    assert any("--slow" in sentence for sentence in left_out)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    _, left_out = plan(Settings(sizes=(SIZE,), expression="cs_replay or softplus_chain"))
    assert not unsaid(
        left_out, "softplus_chain by casadi … casadi is not installed (pip install -e '.[bench]')"
    )


def test_sizes_that_a_peer_is_not_for_are_said():
    jobs, left_out = plan(
        Settings(sizes=(SIZE, Size(3, 5000)), expression="drake_snopt or gd_kernel")
    )
    drake = [size for case, size in jobs if case.by == "drake_snopt"]
    assert drake in ([SIZE], [])
    assert any("drake_snopt" in sentence for sentence in left_out)


@pytest.mark.parametrize("expression", ["nosuchstage", "report", "all_quick"])
def test_nothing_selected_is_one_sentence(expression: str):
    with pytest.raises(BenchError, match="nothing is selected"):
        plan(Settings(expression=expression))


def work(name: str, stage: str = "", **more) -> Case:
    return Case(stage=stage or name, title=name, function=f"{HERE}:{name}", **more)


@pytest.mark.slow
def test_rounds_take_turns_and_a_failure_costs_only_its_row(monkeypatch, tmp_path: Path):
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parent))
    monkeypatch.setenv("BENCH_LOG", str(tmp_path / "log"))
    cases = (work("steady", YARDSTICK), work("heavy"), work("broken"), work("dies", by="peer"))
    record = run_suite(Settings(sizes=(SIZE,), repeats=2), cases=cases)
    assert (tmp_path / "log").read_text().split() == ["steady", "heavy"] * 2
    rows = {row.stage: row for row in record.rows}
    assert len(rows[YARDSTICK].cpu_s) == len(rows["heavy"].cpu_s) == 2
    assert min(rows["heavy"].memory_mib) > 60, "it keeps 64 MiB"
    assert 0.001 < max(rows[YARDSTICK].cpu_s) < 0.05, (
        "short work is repeated, and the seconds are those of one call"
    )
    assert rows["broken"].failed.endswith("it cannot.")
    assert "SIGSEGV" in rows["dies"].failed
    assert rows["dies"].cpu_s == ()
    assert failures(record) == [rows["broken"].failed], "a peer that dies is no failure of ours"


@pytest.mark.skipif(
    platform.libc_ver()[0] != "glibc", reason="only glibc gives back what was freed"
)
def test_memory_that_preparing_freed_does_not_hide_what_the_work_needs(monkeypatch, tmp_path: Path):
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parent))
    record = run_suite(Settings(sizes=(SIZE,), repeats=1), cases=(work("freed_before"),))
    assert min(record.rows[0].memory_mib) > 35


def row(
    stage: str, by: str = OURS, n: int = 3, steps: int = 500, cpu=(1.0,) * 5, **more
) -> SuiteRow:
    values = {
        "stage": stage, "title": stage, "by": by, "n": n, "steps": steps, "cpu_s": cpu,
        "memory_mib": (8.0,) * len(cpu), "outcome": "ok",
    }  # fmt: skip
    return SuiteRow.model_validate(values | more)


def test_ratios_are_those_of_one_round():
    """Both were three times as slow in one round: the ratio does not see it."""
    rows = [
        row("softplus_chain", cpu=(1.0, 3.0, 1.0)),
        row("softplus_chain", "casadi", cpu=(2.0, 6.0, 2.0)),
    ]
    rows += [row("pyomo_build", cpu=(0.1, 0.3, 0.1)), row("translate", cpu=(0.2, 0.6, 0.2))]
    found = {figure.name: figure for figure in figures(rows)}
    assert set(found) == {"chain_against_casadi", "pyomo_share"}
    assert found["chain_against_casadi"].samples == pytest.approx((0.5, 0.5, 0.5))
    assert found["chain_against_casadi"].met is True
    assert found["pyomo_share"].measured == pytest.approx(0.3)


def test_a_figure_is_judged_only_where_its_target_is_set():
    small = [row("cs_replay", steps=50), row("cs_replay", "fmpy", steps=50)]
    assert [(figure.met, figure.measured) for figure in figures(small)] == [(None, 1.0)]
    large = [row("cs_replay"), row("cs_replay", "fmpy")]
    assert [(figure.met, figure.measured) for figure in figures(large)] == [(False, 1.0)]
    failed = [row("cs_replay"), row("cs_replay", "fmpy", cpu=(), failed="fmpy: it hangs.")]
    assert [(figure.met, figure.measured, figure.why) for figure in figures(failed)] == [
        (None, None, "fmpy: it hangs.")
    ]


def test_growth_is_that_of_the_steepest_stage():
    """Time as T and as T^1.5, memory as T: the exponents come out, and a stage of two sizes has none."""
    rows = [row(stage, steps=steps, cpu=(1e-3 * steps**power,) * 3, memory_mib=(steps / 100,) * 3)
            for stage,
            power in (("translate", 1.0), ("replay", 1.5)) for steps in (500, 1000, 2000)]  # fmt: skip
    found = {
        figure.name: figure
        for figure in figures([*rows, row("evaluate", steps=500), row("evaluate", steps=1000)])
    }
    assert found["growth_time"].measured == pytest.approx(1.5)
    assert found["growth_time"].met is False
    assert "replay" in found["growth_time"].why
    assert found["growth_memory"].measured == pytest.approx(1.0)
    assert found["growth_memory"].met is True


def test_growth_leaves_out_what_was_cut_off():
    """A solve that ended at its limit took as long as that is, whatever its size."""
    rows = [row("translate", steps=steps, cpu=(1e-3 * steps,) * 3) for steps in (500, 1000, 2000)]
    cut = [row("cold_step", steps=steps, cpu=(1e-6 * steps**2,) * 3, outcome=outcome)
           for steps,
           outcome in ((500, "solved"), (1000, "iteration_limit"), (2000, "iteration_limit"))]  # fmt: skip
    (found,) = (figure for figure in figures([*rows, *cut]) if figure.name == "growth_time")
    assert found.measured == pytest.approx(1.0)
    assert not unsaid(found.why, "left out there: cold_step")


def test_importing_pyomo_to_list_is_a_miss():
    light = row("list", n=0, steps=0, cpu=(0.2,) * 3)
    assert [figure.met for figure in figures([light])] == [True]
    heavy = light.model_copy(update={"outcome": "imports pyomo"})
    assert [(figure.met, figure.why) for figure in figures([heavy])] == [(False, "imports pyomo")]


def test_every_target_of_a_ratio_names_stages_that_exist():
    known = {(case.stage, case.by) for case in CASES}
    for ratio in RATIOS:
        assert {*ratio.over, ratio.under} <= known
    assert len(known) == len(CASES), "a row is known by its stage and who runs it"
