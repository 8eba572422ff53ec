"""The page made of what benchmarks left. Sentences are computed, names are escaped."""

import html
import re

import pytest

from benchmarks.page import render
from benchmarks.pages.cosimulation import at, reached
from benchmarks.records import Table
from benchmarks.results import store_tables, stored, tables_of
from reports.records.load import ReportError


@pytest.fixture
def page(benches, tmp_path):
    """The page's text over these records."""

    def made(*records):
        folder = tmp_path / "all"
        benches.leave(folder, *records)
        return html.unescape(render(folder))

    return made


def sentences(text):
    return re.findall(r'<p class="conclusion">(.*?)</p>', text)


def test_what_is_not_measured_has_no_section(page, benches):
    with pytest.raises(ReportError, match="no benchmark has left figures there"):
        page()
    assert re.findall('<section id="(.*?)"', page(benches.cosim())) == ["overview", "cosimulation"]


def test_what_splitting_costs_is_concluded_from_the_rows(page, benches):
    """omega h = 0.1 is h = 1e-3 s: 100 h, 30 h, 1e3 h^2, 100 h^2 there.

    1 % at h = 1e-4, 3.3e-4, 3.2e-3, 1e-2 s.
    """
    text = page(benches.cosim())
    first, second = sentences(text)
    assert (
        "At ωh = 0.1, here h = 0.001 s, the energy is off by 10 % (Jacobi), 3 % (contact first (Gauss-Seidel)), "
        "0.1 % (contact first, force extrapolated) and 0.01 % (iterated with rollback)." in first
    )
    assert (
        "For an error below 1 % it takes ωh of at most 0.01 (Jacobi), 0.033 (contact first (Gauss-Seidel)), "
        "0.32 (contact first, force extrapolated) and 1, the largest tried (iterated with rollback)."
        in first
    )
    assert "The whole scene in one FMU is right to 1.0×10⁻¹⁰ at every one of these steps" in first
    assert "0.0010 s by" in second
    assert "0.10 s by Jacobi" in second
    assert (
        "Momentum is right to 1.0×10⁻¹⁴ kg m/s in every one of these runs, also where the energy is off by 100 %"
        in text
    )
    assert "libcosim, ECCO (libcosimpy is not installed)" in text
    assert text.count('class="touch"') >= 1


def test_a_master_that_never_gets_there_is_said(page, benches):
    record = benches.cosim()
    rows = record["cases"][0]["masters"][0]["rows"]
    for row in rows:
        row["energy_error"] = -0.5
    first, second = sentences(page(record))
    assert "No step of this sweep is small enough for Jacobi." in first
    assert "No step of this sweep gets Jacobi there." in second


def test_speed_against_error_is_concluded_from_the_rows(page, benches):
    (only,) = sentences(page(benches.speed()))
    assert only.startswith(
        "Cheapest for an error of at most 10⁻³ m by Co-Simulation, heun at h/1 (0.00010 CPU s), an error of at most 10⁻⁶ m by Model Exchange "
        "at rtol 10⁻⁷ (0.10 CPU s) and an error of at most 10⁻⁹ m by Model Exchange at rtol 10⁻¹⁰ (0.10 CPU s)."
    )
    assert "exact to 2.0×10⁻¹⁰ m" in only
    assert "restitution to 3.0×10⁻¹²" in only


def test_one_way_that_is_best_for_several_errors_is_named_once(page, benches):
    record = benches.speed()
    for row in record["scenes"][0]["sweep"]:
        row["error_m"] = 1e-7
    (only,) = sentences(page(record))
    assert only.startswith(
        "Cheapest for an error of at most 10⁻³ and 10⁻⁶ m by Co-Simulation, heun at h/1 (0.00010 CPU s)."
    )
    assert "Nothing in this sweep reaches 10⁻⁹ m." in only


def test_rows_without_an_error_are_named(page, benches):
    assert "Co-Simulation, heun h/1000 (not a number)." in page(benches.speed())


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", "it is not complete JSON"),
        ('{"kind": "other"}', "does not follow record schema"),
        ('{"kind": "cosim", "cases": [{"name": 3}]}', "does not follow record schema"),
        ('{"kind": "replay_speed", "scenes": [], "more": 1}', "does not follow record schema"),
    ],
)
def test_a_file_that_is_no_benchmark_is_one_sentence(tmp_path, text, words):
    (tmp_path / "odd.json").write_text(text)
    records, (only,) = stored(tmp_path)
    assert records == []
    assert only.path == "odd.json"
    assert words in only.sentence
    assert words in html.unescape(render(tmp_path))


def test_names_from_files_are_escaped(factory, benches, tmp_path):
    folder = tmp_path / "all"
    odd = benches.cosim(title=factory.HOSTILE)
    odd["cases"][0]["masters"][0]["name"] = factory.HOSTILE
    odd["cases"][0]["masters"][-1]["failed"] = factory.HOSTILE
    benches.leave(folder, odd, benches.speed(factory.HOSTILE))
    text = render(folder)
    assert "<img" not in text
    assert "\u202e" not in text
    assert "<b>" not in text
    benches.leave(folder, benches.cosim(), benches.speed())
    assert text.count("</script>") == render(folder).count("</script>")


def test_reading_curves():
    line = [(10.0**-n, 10.0 ** (-2 * n)) for n in range(1, 5)]
    assert reached(line, 1e-3) == pytest.approx(10**-1.5)
    assert reached(line, 1.0) == 0.1
    assert reached(line, 1e-9) is None
    assert reached([(1e-3, 1e-2), (1e-2, 1e-5), (1e-1, 1e-1)], 1e-3) is None, (
        "a lucky zero crossing above is not convergence"
    )
    assert at(line, 3e-3) == pytest.approx(9e-6)
    assert at(line, 1.0) is None
    assert at([(1.0, 0.0), (2.0, 1.0)], 1.5) is None


def test_tables_are_told_as_they_are_and_found_again(page, tmp_path, factory):
    told = Table(
        caption="Two rows.", columns=("row", "cost", "remark"),
        rows=(("first", 1.25, None), ("second", None, factory.HOSTILE)), notes=("So it is.",),
    )  # fmt: skip
    store_tables(
        tmp_path / "all",
        "proof",
        "What can be proved",
        "About it.",
        [told],
        [{"T": 20}],
        quiet=True,
    )
    text = page()
    assert re.findall('<section id="(.*?)"', text) == ["overview", "table-proof"]
    assert "So it is." in text
    assert ">1.25<" in text
    assert "<img" not in render(tmp_path / "all")
    kept = tables_of(tmp_path / "all", "proof")
    assert kept.runs == ({"T": 20},)
    assert kept.provenance.commit[:12] in text
