"""What the sections compute: rows, fronts, sweeps, the command that runs a cell again, and the paper's numbers."""

import math
import shlex

import pytest
from wording import unsaid

from reports.causes import again
from reports.pages import pareto, table1, tightening
from reports.pages.section import Report
from reports.paper import TABLE_1
from reports.records.load import load
from reports.rows import lacking
from validate.plan.selection import matches


def report_of(factory, folder, runs) -> Report:
    return Report(load(factory.store(folder, runs)), folder)


@pytest.fixture
def converged(factory):
    """The same methods and eps as softplus_gd+relu_gd, other options, no row of the paper."""
    run = factory.run("softplus_gd+relu_gd", "softplus_gd", "relu_gd", key="converged-0")
    stages = tuple(stage.model_copy(update={"paper": {}, "options": {"iterations": "until converged"}}) for stage in run.stages)
    return run.model_copy(update={"pipeline": "gd_converged", "stages": stages})


def test_rows_follow_the_papers_order_and_share_stages(factory, tmp_path):
    report = report_of(factory, tmp_path / "all", factory.runs())
    assert [(row.methods, row.stage.eps) for row in report.rows] == [(row.methods, row.eps) for row in TABLE_1]
    assert lacking(report.scenes[0], report.rows) == []
    warm = report.rows[10]
    assert warm.paper_total == pytest.approx(11.64 + 9.78 + 12.40 + 100.07)


@pytest.mark.slow
def test_the_same_methods_with_other_options_are_other_rows_and_another_sweep(factory, tmp_path, converged):
    report = report_of(factory, tmp_path / "all", [*factory.runs(), converged])
    assert len(report.rows) == len(TABLE_1) + 4
    assert len({row.label for row in report.rows}) == len(report.rows), "labels tell rows apart"
    section = tightening.build(report, report.scenes[0])
    sweeps = section.values["sweeps"]
    assert [sweep.title.split(":")[0] for sweep in sweeps[:3]] == ["Fig. 4", "Fig. 5", "Fig. 6"]
    assert sweeps[3].title.endswith("(gd_converged)")
    assert all(len(sweep.keys) == 3 for sweep in sweeps)


def test_the_front_is_unbeaten(factory, tmp_path):
    report = report_of(factory, tmp_path / "all", factory.runs())
    points = [(row.metric("replay_terminal_error"), row.stage.cost, row) for row in report.rows]
    best = pareto.unbeaten(points)
    for missed, price, row in points:
        beaten = any(m <= missed and c <= price and (m, c) != (missed, price) for m, c, _ in best)
        assert beaten != any(row is other for _, _, other in best)
    assert len(best) < len(points)


@pytest.mark.slow
def test_the_command_runs_this_cell_again_and_no_other(factory, tmp_path, converged):
    report = report_of(factory, tmp_path / "all", [*factory.runs(), converged])
    for run in report.stored.runs:
        words = shlex.split(again(run))
        expression = words[words.index("-k") + 1]
        names = {other.pipeline: ["three_cart", other.pipeline, *(stage.method for stage in other.stages)] for other in report.stored.runs}
        chosen = [pipeline for pipeline, own in names.items() if matches(expression, own, f"three_cart x {pipeline}")]
        assert chosen == [run.pipeline]


@pytest.mark.parametrize(
    ("recorded", "kept"),
    [
        ("all --quick -k strict -j 2 --out runs/all.toml", "all"),
        ("all --scene my/own.py --time-limit=9 --lf", "all --scene my/own.py --time-limit=9"),
        ("run -x mine.toml --retry 2", "run mine.toml"),
        ("run --engine dask:file.json 'my springs'", "run 'my springs'"),
    ],
)
def test_the_command_keeps_what_says_which_cells_there_are(factory, recorded, kept):
    own = factory.provenance(command=f"python -m validate {recorded}")
    run = factory.run("strict", None, "strict_lcp", provenance=own)
    assert again(run) == f"""python -m validate {kept} -k '="three_cart x strict"' --fresh --out runs/again"""
    for name in ("in (one) leap", 'the "great" leap', '"', "it's"):
        odd = run.model_copy(update={"pipeline": name})
        assert matches(shlex.split(again(odd))[-4], [], f"three_cart x {name}")


@pytest.mark.parametrize("command", ["python -m benchmarks suite", "make 'half", ""])
def test_a_recorded_command_of_another_kind_is_repeated_as_it_is(factory, command):
    assert again(factory.run("strict", None, "strict_lcp", provenance=factory.provenance(command=command))) == command


def test_a_cost_below_the_best_exact_one_is_never_told_without_its_error(factory, tmp_path):
    report = report_of(factory, tmp_path / "all", factory.runs())
    told = next(text for text in table1.conclude(report.rows) if "best known cost" in text)
    assert not unsaid(
        told,
        "relu_gd after relaxed_lcp (490.10 at 0.0030 m), relu_gd after softplus_dc (360.31 at 0.047 m) and relu_gd after softplus_gd (309.42 at 0.047 m).",
    )


@pytest.mark.parametrize(("costs", "wide"), [((490.0, 500.0, 600.0), False), ((4.9, 50.0, 600.0), True), ((-1.0, 50.0, 600.0), False)])
def test_costs_far_apart_are_drawn_on_a_logarithmic_axis_and_others_are_not(factory, tmp_path, costs, wide):
    scene = factory.scene().model_copy(update={"answers": ()})
    runs = []
    for number, cost in enumerate(costs):
        run = factory.run("strict", None, "strict_lcp", key=f"strict-{number}")
        stages = tuple(stage.model_copy(update={"cost": cost, "options": {"start": number}}) for stage in run.stages)
        runs.append(run.model_copy(update={"pipeline": f"p{number}", "stages": stages, "scene": scene}))
    report = report_of(factory, tmp_path / "all", runs)
    section = pareto.ends(report, report.scenes[0])
    assert len(section.values["plots"]) == 2, "positions and velocities apart"
    for plot in section.values["plots"]:
        assert (plot.x.log, plot.y.log) == (True, wide)
        assert plot.y.low < min(costs) < max(costs) < plot.y.high
        # A tenth of what is drawn is left on either side, by decades on a logarithmic axis.
        low, high, least, most = (math.log10(value) if wide else value for value in (plot.y.low, plot.y.high, min(costs), max(costs)))
        assert (least - low, high - most) == pytest.approx((0.1 * (most - least), 0.1 * (most - least)), rel=0.02)
