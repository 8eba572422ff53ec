"""Sweeps and stress cases: which runs are a sweep, along which number.

Each mark at its number, medians joined, zeros below everything else.
"""

import re
from dataclasses import replace

import pytest
from wording import unsaid

from models.results.check import AxisRecord, ChartRecord, CheckRecord, SeriesRecord
from models.results.run import QuantityRecord, RunRecord, SceneRecord
from models.results.stored import from_data
from models.results.verdict import Metric
from reports.load import Stored
from reports.pages import checks, sweeps
from reports.pages.section import Report
from reports.pages.sweeps import Mark, Quantity, draw_against, keys_of, styles_of
from reports.render import Templates
from tests.reports import drawn as back
from tests.reports import record_factory as factory
from tests.reports.drawn import drawn
from tests.reports.record_factory import judged, ran

K = Quantity("k", "N/m")


def test_curves_of_a_sweep():
    styles = styles_of(["a", "b"])
    marks = [
        Mark("a", 2.0, 5.0, "first", "to a", True), Mark("a", 1.0, 3.0, "second", "", False),
        Mark("b", 1.0, 4.0, "third", "", True), Mark("a", 2.0, 9.0, "fourth", "", True),
        Mark("a", 2.0, 6.0, "fifth", "", True),
    ]  # fmt: skip
    plot = draw_against(K, "some error", "m", marks, styles)
    assert plot is not None
    assert drawn(plot).lines == {
        "a": ("c0", [(1.0, 3.0), (2.0, 5.0), (2.0, 6.0), (2.0, 9.0)]), "b": ("c1", [(1.0, 4.0)]),
    }  # fmt: skip
    assert drawn(plot).marks[:3] == [
        back.Mark("c0 full", "circle", "first", "to a", (2.0, 5.0)),
        back.Mark("c0", "circle", "second", "", (1.0, 3.0)),
        back.Mark("c1 full", "square", "third", "", (1.0, 4.0)),
    ]  # fmt: skip
    assert plot.words == "a: 3 to 9 m; b: 4 to 4 m. Filled: the plan holds."
    assert (plot.title, plot.x.quantity, plot.x.unit, plot.y.quantity, plot.y.unit) == (
        "Some error against k", "k", "N/m", "some error", "m",
    )  # fmt: skip
    assert (plot.x.low, plot.x.high, plot.y.low, plot.y.high) == tuple(
        map(pytest.approx, (0.94, 2.06, 2.52, 9.48))
    )


@pytest.mark.parametrize(
    ("xs", "ys", "logs"),
    [
        ((1.0, 20.1), (1.0, 20.0), (True, False)), ((1.0, 20.0), (2.0, 40.1), (False, True)),
        ((0.0, 20.0), (-1.0, 20.0), (False, False)), ((1.0, 2.0), (3.0, 3.0), None),
        ((1.0, 1.0), (3.0, 4.0), None),
    ],
)  # fmt: skip
def test_wide_ranges_are_logarithmic_and_one_place_or_value_is_no_curve(
    xs: tuple, ys: tuple, logs: tuple | None
):
    marks = [Mark("a", x, y, "", "", True) for x, y in zip(xs, ys, strict=True)]
    plot = draw_against(K, "cost", "", marks, styles_of(["a"]))
    assert (plot and (plot.x.log, plot.y.log)) == logs


def test_styles_and_keys():
    names = [f"curve {place}" for place in range(8)]
    assert list(styles_of(names).values())[:7:3] == [
        ("c0", "circle"),
        ("c3", "triangle"),
        ("c0", "diamond"),
    ]
    assert styles_of(["a", "b", "a"]) == {"a": ("c0", "circle"), "b": ("c1", "square")}
    assert [(key.style, key.words, key.marker) for key in keys_of(styles_of(["a", "b"]))] == [
        ("c0", "a", "circle"),
        ("c1", "b", "square"),
    ]
    assert keys_of(styles_of(["a"])) == []


def swept(name: str, k: float, verdict: str = "holds", **changes: object) -> RunRecord:
    where = factory.scene(f"hill_k_{k:g}")
    parameters = tuple(
        replace(item, value=k) if item.name == "k" else item for item in where.parameters
    )
    metrics = (
        judged("replay_error", k / 100, "rad"), judged("odd_metric", 1 / k, "J"),
        judged("replay_terminal_position_error", 2 * k),
        judged("replay_terminal_velocity_error", 3 * k, "m/s"),
    )  # fmt: skip
    run = ran(
        name,
        *metrics,
        cost=100.0 * k,
        cpu=k / 10,
        verdict=verdict,
        of=replace(where, **{"parameters": parameters, **changes}),
    )
    return replace(
        run,
        key=f"{name}-{k:g}",
        stages=tuple(replace(stage, method="soft") for stage in run.stages),
    )


def test_every_metric_of_a_sweep_is_drawn_in_its_unit():
    report = Report(Stored(None, (swept("a", 4.0), swept("a", 1.0, "violates"), swept("a", 2.0))))
    section = sweeps.build(report)
    assert (section.anchor, section.title, section.entries) == (
        "sweeps",
        "Sweeps",
        (("sweep-1", "k on hill"),),
    )
    assert not unsaid(section.said, "1 sweep: k on hill")
    (sweep,) = section.values["sweeps"]
    assert [(item.run.key, item.link, item.curve, item.x) for item in sweep.runs] == [
        ("a-1", "pages/hill_k_1--a.html", "a", 1.0), ("a-2", "pages/hill_k_2--a.html", "a", 2.0),
        ("a-4", "pages/hill_k_4--a.html", "a", 4.0),
    ]  # fmt: skip
    assert sweep.words == "a holds at k = 2 N/m and 4 N/m."
    cost, error, position, velocity, cpu = sweep.first
    (other,) = sweep.others
    values = {
        "Integral cost (cost times h) against k": (cost, (1.0, 2.0, 4.0), ""),
        "Replay error against k": (error, (0.01, 0.02, 0.04), "rad"),
        "Replay terminal position error against k": (position, (2.0, 4.0, 8.0), "m"),
        "Replay terminal velocity error against k": (velocity, (3.0, 6.0, 12.0), "m/s"),
        "CPU time of solving against k": (cpu, (0.1, 0.2, 0.4), "s"),
        "Odd metric against k": (other, (1.0, 0.5, 0.25), "J"),
    }  # fmt: skip
    for title, (plot, ys, unit) in values.items():
        assert (plot.title, plot.y.unit) == (title, unit)
        assert [mark.at for mark in drawn(plot).marks] == list(
            zip((1.0, 2.0, 4.0), ys, strict=True)
        )
    assert drawn(error).marks[0] == back.Mark(
        "c0",
        "circle",
        "a on hill_k_1: k 1 N/m, replay error 0.01 rad, violates",
        "pages/hill_k_1--a.html",
        (1.0, 0.01),
    )
    assert (
        "a holds at no value of k."
        in sweeps.build(
            Report(Stored(None, (swept("a", 4.0, "violates"), swept("a", 1.0, "violates"))))
        )
        .values["sweeps"][0]
        .words
    )


def test_where_the_last_state_is_in_the_cost_the_cost_itself_is_drawn():
    from models.results.run import FINAL_COST, EquationRecord

    final = (EquationRecord(caption=FINAL_COST, mathml="<math/>"),)
    (sweep,) = sweeps.build(
        Report(Stored(None, tuple(swept("a", k, equations=final) for k in (1.0, 2.0))))
    ).values["sweeps"]
    assert (sweep.first[0].title, [mark.at for mark in drawn(sweep.first[0]).marks]) == (
        "Cost against k",
        [(1.0, 100.0), (2.0, 200.0)],
    )


def test_pipelines_side_by_side_are_curves_of_their_own():
    found = sweeps.build(
        Report(
            Stored(
                None,
                (swept("a", 1.0), swept("a", 2.0), swept("b", 1.0), swept("b", 2.0, "violates")),
            )
        )
    )
    (sweep,) = found.values["sweeps"]
    assert [key.words for key in sweep.keys] == ["a", "b"]
    assert sweep.words == "a holds at k = 1 N/m and 2 N/m; b holds at k = 1 N/m."
    assert sweeps.build(Report(Stored(None, (swept("a", 1.0), swept("b", 2.0))))) is None, (
        "other pipelines, not one with other numbers"
    )


@pytest.mark.parametrize(
    "other",
    [
        {"source": "another book"}, {"coordinates": ()}, {"velocities": ()}, {"inputs": ()},
        {"contacts": ()}, {"frictions": (QuantityRecord(name="f", unit="N"),)}, {"shapes": ()},
    ],
    ids=lambda other: next(iter(other)),
)  # fmt: skip
def test_scenes_of_other_equations_are_no_sweep(other: dict):
    assert sweeps.build(Report(Stored(None, (swept("a", 1.0), swept("a", 2.0, **other))))) is None


def series(name: str, x: tuple, y: tuple, line: bool = True) -> SeriesRecord:
    return SeriesRecord(name=name, x=x, y=y, line=line)


def charted(*curves: SeriesRecord, log: tuple[bool, bool] = (False, False), **changes: object):
    said = {
        "title": "Chart",
        "x": AxisRecord(quantity="time", unit="s", log=log[0]),
        "y": AxisRecord(quantity="error", unit="m", log=log[1]),
    }
    chart = from_data(ChartRecord, {**said, "series": curves, **changes})
    record = CheckRecord(
        key="1", kind="stress case", name="07 a case", expected="", outcome="answered", passed=True,
        charts=(chart,), wall_seconds=1.0,
        cpu_seconds=1.0, provenance=factory.provenance(),
    )  # fmt: skip
    section = checks.stress_cases(Report(Stored(None, (), (), (), 0, (record,))))
    (row,) = section.values["rows"]
    return row.plots[0]


def test_a_chart_is_drawn_as_its_record_says():
    plot = charted(
        series("one", (0.0, 1.0), (3.0, 5.0)),
        series("two", (0.5, 2.0), (4.0, 1.0), line=False),
        level=6.0,
        level_words="limit",
    )
    assert drawn(plot).lines == {
        "one": ("c0", [(0.0, 3.0), (1.0, 5.0)]),
        "limit": ("level", [(-0.1, 6.0), (2.1, 6.0)]),
    }
    assert [(mark.style, mark.marker, mark.tip, mark.at) for mark in drawn(plot).marks] == [
        ("c0", "circle", "one: time 0, error 3", (0.0, 3.0)),
        ("c0", "circle", "one: time 1, error 5", (1.0, 5.0)),
        ("c1", "square", "two: time 0.5, error 4", (0.5, 4.0)),
        ("c1", "square", "two: time 2, error 1", (2.0, 1.0)),
    ]  # fmt: skip
    assert plot.words == "Error against time, 2 curves."
    assert [(key.style, key.words, key.marker) for key in plot.keys] == [
        ("c0", "one", "circle"),
        ("c1", "two", "square"),
    ]
    assert (plot.width, plot.height, plot.y.low, plot.y.high) == (
        480,
        300,
        pytest.approx(0.75),
        pytest.approx(6.25),
    )
    assert charted(series("one", (0.0, 1.0), (3.0, 5.0)), words="In words.").words == "In words."


@pytest.mark.parametrize(
    ("points", "line", "marked"), [(60, True, True), (61, True, False), (61, False, True)]
)
def test_long_lines_have_no_markers(points: int, line: bool, marked: bool):
    plot = charted(
        series("one", tuple(map(float, range(points))), tuple(map(float, range(points))), line=line)
    )
    assert len(drawn(plot).marks) == (points if marked else 0)
    assert plot.keys[0].marker == ("circle" if marked else "")
    assert bool(drawn(plot).lines) == line


def test_zeros_of_a_logarithmic_axis_stand_below_and_off_the_line():
    plot = charted(series("one", (1.0, 2.0, 3.0), (1e-4, 0.0, 1.0)), log=(False, True))
    assert drawn(plot).lines == {"one": ("c0", [(1.0, 1e-4), (3.0, 1.0)])}
    least = 1e-4 * 1e4**-0.08 / 2
    low = plot.y.low
    assert [mark.at for mark in drawn(plot).marks] == [
        (1.0, 1e-4),
        (2.0, float(f"{low:.4g}")),
        (3.0, 1.0),
    ]
    assert plot.y.low < least < 1e-4
    assert plot.y.low == pytest.approx(least * 10 ** -(0.05 * (4 + 0.32 + 0.30103)), rel=1e-4)
    assert not unsaid(plot.words, "Error against time, 1 curve. … logarithmic axis")
    whole = charted(series("one", (1.0, 2.0), (1e-4, 1.0)), log=(False, True))
    assert (whole.y.low, "Zeros" in whole.words) == (pytest.approx(1e-4 * 10**-0.2), False)
    across = charted(series("one", (0.0, 2.0, 4.0), (-1.0, 0.0, 1.0)), log=(True, False))
    assert drawn(across).lines == {"one": ("c0", [(2.0, 0.0), (4.0, 1.0)])}
    assert charted(series("one", (0.0, 2.0), (0.0, 0.0)), log=(False, True)).y.log is False, (
        "nothing positive"
    )


def figure(name: str, ok: bool | None, **changes: object) -> Metric:
    return from_data(Metric, {
            "name": name, "value": 0.25, "unit": "m^2", "meaning": f"meaning of {name}",
            "limit": 0.5, "reason": f"reason of {name}", "ok": ok,
            **changes,
        })  # fmt: skip


def examined(name: str, **changes: object) -> CheckRecord:
    said = {
        "key": name, "kind": "stress case", "name": name, "expected": "e", "outcome": "answered",
        "passed": True, "wall_seconds": 1.0,
        "cpu_seconds": 1.5,
    }  # fmt: skip
    return from_data(CheckRecord, {**said, "provenance": factory.provenance(), **changes})


def test_a_stress_case_is_a_row_with_its_decisive_figures():
    figures = (
        figure("shown", None, limit=None), figure("good", True, at_least=True),
        figure("fine", True, unit="1"), figure("bad", False, value=None),
    )  # fmt: skip
    records = (
        examined("10 later", passed=False, figures=figures),
        examined("02 early", found="it went well."),
        examined("003", outcome="time_limit", passed=False, message="late."),
        examined("00 zero", outcome="time_limit", passed=False), examined("x", kind="FMU"),
    )  # fmt: skip
    section = checks.stress_cases(Report(Stored(None, (), (), (), 0, records)))
    rows = section.values["rows"]
    assert [(row.number, row.title, row.anchor, row.sign.word, row.happened) for row in rows] == [
        ("00", "zero", "stress-case-00", "no answer", "It ended as time limit, without a message."),
        ("3", "003", "stress-case-003", "no answer", "late."),
        ("2", "early", "stress-case-02", "pass", "it went well."),
        ("10", "later", "stress-case-10", "fail", "It ended as answered, without a message."),
    ]  # fmt: skip
    assert rows[3].decisive == (figures[3], figures[1])
    assert (
        section.values["passed"], [row.number for row in section.values["failed"]],
        section.values["seconds"],
    ) == ("1 of 4 stress cases pass", ["00", "3", "10"], 6.0)  # fmt: skip
    assert section.said.startswith("1 of 4 stress cases pass: stiff, grazing")
    assert (
        checks.stress_cases(Report(Stored(None, (), (), (), 0, records[1:2]))).values["passed"]
        == "1 of 1 stress case passes"
    )
    assert checks.stress_cases(Report(Stored(None, (), (), (), 0, records[4:]))) is None


def test_figures_of_a_stress_case_are_shown_with_unit_limit_and_reason():
    figures = (
        figure("shown", None, limit=None), figure("good", True, at_least=True),
        figure("fine", True, unit="1", reason=""),
        figure("bad", False, value=None),
    )  # fmt: skip
    section = checks.stress_cases(
        Report(Stored(None, (), (), (), 0, (examined("10 later", passed=False, figures=figures),)))
    )
    text = Templates().render(section.template, section=section, **section.values)
    first, second = (
        text[place:] for place in (text.index("Stress cases"), text.index("Metrics of case 10"))
    )

    def cells(part: str) -> list[str]:
        rows = re.findall(
            r"<tr>(.*?)</tr>", part[part.index("<tbody>") : part.index("</tbody>")], re.DOTALL
        )
        return [
            " | ".join(
                " ".join(re.sub(r"<[^>]*>", "", cell).split())
                for cell in re.findall(r"<t[hd].*?</t[hd]>", row)
            )
            for row in rows
        ]

    assert cells(first) == [
        "10 | later | ✗ fail | e | It ended as answered, without a message. | bad: no number (≤ 0.5 m²); good: 0.25 m² (≥ 0.5 m²)"
    ]
    assert cells(second) == [
        "shown meaning of shown | 0.25 m² | – | shown | reason of shown",
        "good meaning of good | 0.25 m² | ≥ 0.5 m² | ✓ pass | reason of good",
        "fine meaning of fine | 0.25 | ≤ 0.5 | ✓ pass | –",
        "bad meaning of bad | no number | ≤ 0.5 m² | ✗ fail | reason of bad",
    ]  # fmt: skip


def scene(factory, name: str, **changes) -> SceneRecord:
    """Three carts with another stiffness, start, or grid."""
    plain = factory.scene(name)
    k = changes.pop("k", 30.0)
    parameters = tuple(
        replace(item, value=k) if item.name == "k" else item for item in plain.parameters
    )
    return replace(plain, **{"parameters": parameters, **changes})


def run(
    factory,
    name: str,
    where: SceneRecord,
    cost: float,
    verdict: str = "holds",
    error: float = 0.01,
    **options,
) -> RunRecord:
    one = factory.run("strict", None, "strict_lcp", key=f"{name}-{where.name}", verdict=verdict)
    (stage,) = one.stages
    metrics = tuple(
        replace(item, value=error) if item.name == "replay_error" else item
        for item in stage.metrics
    )
    stage = replace(
        stage, cost=cost, verdict=verdict, metrics=metrics, options={**stage.options, **options}
    )
    return replace(one, pipeline=name, scene=where, stages=(stage,))


def found(*runs: RunRecord) -> list[sweeps.Sweep]:
    section = sweeps.build(Report(Stored(None, runs)))
    return [] if section is None else section.values["sweeps"]


def marks(plot) -> list[tuple[float, float]]:
    """Pixels of the marks of a plot."""
    return [
        (float(x), float(y))
        for x, y in re.findall(
            r'<circle cx="([\d.]+)" cy="([\d.]+)"', str(plot.markup(hidden=False))
        )
    ]


def test_two_swept_numbers_are_curves_over_the_one_with_more_values(factory):
    runs = [
        run(
            factory,
            "strict",
            scene(factory, f"s_{k}_{start}", k=k, start=(start, 3.0, 4.0, 0.0, 0.0, 0.0)),
            k * start,
        )
        for k in (1.0, 2.0, 3.0)
        for start in (1.5, 2.0)
    ]
    (sweep,) = found(*runs)
    assert sweep.axis.name == "k"
    assert [key.words for key in sweep.keys] == ["start q1 = 1.5 m", "start q1 = 2 m"]


def test_what_goes_with_the_axis_is_told_by_it(factory):
    """The length of a step with the number of steps, over one horizon.

    Costs of several grids are not put side by side.
    """
    runs = [
        run(
            factory,
            "strict",
            scene(factory, f"s_{steps}", steps=steps, step=5.0 / steps),
            4.9 * steps,
        )
        for steps in (100, 200, 400)
    ]
    (sweep,) = found(*runs)
    assert sweep.keys == []
    assert [item.run.integral_cost for item in sweep.runs] == [pytest.approx(24.5)] * 3
    assert not unsaid(sweep.words, "Grids differ: … integral costs, not sums")
    assert "Integral cost (cost times h) against step h" not in [
        plot.title for plot in sweep.first
    ], "24.5 on every grid: nothing to draw"


def test_an_option_of_many_values_is_swept_over_pipelines_that_are_named_after_it(factory):
    where = scene(factory, "bank")
    runs = [run(factory, f"work {work}", where, 500.0 - work, work=work) for work in (1, 10, 100)]
    (sweep,) = found(*runs)
    assert (sweep.axis.name, [item.x for item in sweep.runs]) == (
        "strict_lcp work",
        [1.0, 10.0, 100.0],
    )
    assert sweep.first[0].x.log, "two powers of ten"
    assert found(*runs[:2]) == [], "two pipelines are two pipelines"


def test_runs_that_differ_in_more_than_numbers_are_no_sweep(factory):
    where = scene(factory, "bank")
    assert (
        found(run(factory, "a", where, 1.0, rule="x"), run(factory, "b", where, 2.0, rule="y"))
        == []
    )
    assert (
        found(run(factory, "a", where, 1.0), run(factory, "a", factory.scene("hill"), 2.0)) == []
    ), "nothing differs but the name"
    many = [
        run(
            factory,
            "a",
            scene(
                factory,
                f"s{place}",
                k=float(place),
                start=tuple(float(place + item) for item in range(6)),
            ),
            1.0 + place,
        )
        for place in range(3)
    ]
    assert found(*many) == [], "seven numbers at once are another scene"
    assert found(*factory.runs()) == []


def test_metrics_are_drawn_against_eps_on_the_page_of_the_scene(factory, tmp_path):
    report = Report(Stored(None, tuple(factory.runs())), tmp_path)
    section = sweeps.tightening(report, report.scenes[0])
    plots = {plot.title: plot for plot in section.values["against"]}
    off = plots["Replay terminal position error against ε"]
    values = [0.8 * value for value in (0.4512, 0.2666, 0.1201)]
    expected = [
        (off.px(eps), off.py(value)) for eps, value in zip((1e-3, 1e-5, 1e-7), values, strict=True)
    ]
    drawn = marks(off)
    assert all(
        any(place == pytest.approx(other, abs=0.06) for other in drawn) for place in expected
    )
    assert len(section.values["keys"]) == 3
