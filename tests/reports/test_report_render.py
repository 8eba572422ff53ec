"""The page as text: complete, self-contained, escaped, honest about what is missing."""

import base64
import hashlib
import json
import re
import subprocess
import sys
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from wording import unsaid

from models.results.run import StageRecord
from models.results.stored import from_data, to_data
from reports.load import ReportError
from reports.pages.section import run_pages
from reports.render import write_report, write_single


class Parsed(HTMLParser):
    """Elements with attributes, and the text of each element by id or tag."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.raw: dict[str, list[str]] = {"style": [], "script": []}
        self.words: list[str] = []
        self._stack: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag in self.raw:
            self._stack.append(tag)
            self.raw[tag].append("")

    def handle_endtag(self, tag: str) -> None:
        if self._stack and self._stack[-1] == tag:
            self._stack.pop()

    def handle_data(self, data: str) -> None:
        if self._stack:
            self.raw[self._stack[-1]][-1] += data
        else:
            self.words.append(data)

    @property
    def text(self) -> str:
        return re.sub(r"[ \n\t]+", " ", " ".join(self.words))


def render(folder) -> tuple[str, Parsed]:
    """All of the report in one file."""
    text = write_single(folder).read_text(encoding="utf-8")
    return text, Parsed(text)


@pytest.fixture(scope="module")
def full(full_folder) -> tuple[str, Parsed]:
    return render(full_folder)


@pytest.mark.slow
def test_every_section_is_there_and_the_contents_lead_to_it(full):
    _, page = full
    ids = [attributes["id"] for _, attributes in page.elements if attributes.get("id")]
    assert len(ids) == len(set(ids))
    links = [str(attributes["href"]) for tag, attributes in page.elements if tag == "a"]
    assert links
    assert all(link.startswith("#") and link[1:] in ids for link in links)
    names = (
        "overview", "table1", "failures", "index", "scene-1", "pareto-1", "front-1", "tightening-1",
        "model-1", "runs", "violation", "provenance",
    )  # fmt: skip
    for name in names:
        assert name in ids


def test_the_page_asks_for_nothing_and_allows_only_its_own_style_and_script(full):
    _, page = full
    assert not [
        attributes
        for _, attributes in page.elements
        if {"src", "srcset", "style", "action", "data"} & set(attributes)
    ]
    assert not [
        tag
        for tag, _ in page.elements
        if tag in ("link", "img", "iframe", "object", "base", "form", "video")
    ]
    assert not [
        name for _, attributes in page.elements for name in attributes if name.startswith("on")
    ]
    assert not re.search(r"url\(|@import|https?:", page.raw["style"][0])
    policy = next(
        str(attributes["content"])
        for tag, attributes in page.elements
        if tag == "meta" and "Security" in str(attributes.get("http-equiv"))
    )
    assert policy.startswith("default-src 'none'")
    assert "unsafe" not in policy
    for kind, text in (("style", page.raw["style"][0]), ("script", page.raw["script"][-1])):
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert f"{kind}-src 'sha256-{digest}'" in policy


@pytest.mark.slow
def test_the_page_is_a_pure_function_of_the_records(full, full_folder):
    assert render(full_folder)[0] == full[0]


def test_numbers_are_written_for_readers(full):
    _, page = full
    assert not re.search(r"\b(None|nan|NaN|inf|Undefined)\b", page.text)
    assert not re.search(r"\d\.\d{8,}", page.text), "a wall of digits"


def test_table_1_shows_ours_beside_the_paper(full):
    text, _ = full
    rows = [
        re.sub(r"<[^>]+>|[ \n\t]+", " ", row)
        for row in re.findall(r"<tr class=\"(?:in)?direct\">.*?</tr>", text, re.S)
    ]
    assert len(rows) == 17, "shared stages are one row each"
    first = next(row for row in rows if "softplus_dc" in row and "10⁻³" in row)
    assert first.count("197.86") == 2
    assert "2445.98" in first
    warm = next(row for row in rows if "strict_lcp" in row and "after softplus_dc" in row)
    for number in ("490.83", "16\u202f619.35", "−97\u202f%", "100", "134"):
        assert number in re.sub(" +", " ", warm), number


@pytest.mark.slow
def test_rows_that_one_side_lacks_are_shown_as_such(factory, tmp_path):
    only = factory.run("softplus_dc+strict", "softplus_dc", "strict_lcp")
    ours = replace(factory.stage(0, "strict_lcp", None, None, 0.0, paper={}), method="mpcc")
    other = factory.run("mpcc", None, "strict_lcp", key="mpcc-0", stages=(ours,))
    text, page = render(factory.store(tmp_path / "part", [only, other]))
    assert text.count("not in our records") == 17 - 4 + 1
    assert page.text.count("not in the paper") == 1


def test_failures_are_told_with_their_sentence_and_log(full):
    _, page = full
    for words in (
        "8 of 10 runs that end with exact contact hold (2 found no plan).",
        "The process ended with signal 11.",
        "Segmentation fault",
        "Stopped at its time limit; allow more time",
        "The scene has friction, which this method does not know.",
        "runs/cut-1/record.json",
        "not complete JSON",
        "gone-1",
        "the long pipelines",
    ):
        assert not unsaid(page.text, words, words)
    assert "\x1b" not in page.text


def test_hostile_strings_stay_text(factory, hostile_folder):
    text, page = render(hostile_folder)
    assert not [tag for tag, _ in page.elements if tag in ("img", "b", "iframe")]
    assert page.text.count("<img src=x onerror=") > 20, "the strings are shown, as text"
    assert sum(tag == "script" for tag, _ in page.elements) == 1 + sum(
        attributes.get("type") == "application/json"
        for tag, attributes in page.elements
        if tag == "script"
    )
    assert "\u202e" not in text
    for data in page.raw["script"][:-1]:
        assert json.loads(data)["t"][0] == 0.0
        assert "<" not in data


# Of a stage, each odd in its way.
_ODD_DATA = (
    {"has_plan": False}, {"replay": None},
    {"has_plan": False, "replay": None, "metrics": (), "cost": None, "verdict": "no plan",
     "history": {}, "residuals": {}, "options": {}},
    {"history": {"objective": ()}},
    {"history": {"objective": (1.0,), "mu": (0.0, 0.0, 0.0), "step": (1e-300, 1e300)}},
    {"cost": 0.0, "paper": {"cost": 0.0}}, {"cost": -1e300, "paper": {"time": 0.0}}, {"eps": 0.0},
)  # fmt: skip


@pytest.mark.slow
def test_missing_and_odd_data_are_a_dash_and_never_an_exception(factory, tmp_path):
    plain = to_data(factory.stage(0, "softplus_dc", 1e-3, None, 0.0))
    odd = [from_data(StageRecord, plain | changes) for changes in _ODD_DATA]
    runs = [
        factory.run(f"odd{place}", None, "strict_lcp", stages=(stage,), must_hold=False)
        for place, stage in enumerate(odd)
    ]
    write_report(folder := factory.store(tmp_path / "odd", [*runs, factory.runs()[0]]))
    for run, stage in zip(runs, odd, strict=True):
        page = Parsed((folder / "pages" / run_pages([run])[run.key]).read_text(encoding="utf-8"))
        assert "softplus_dc" in page.text
        told = [
            not unsaid(page.text, words)
            for words in ("There is no plan", "No planned trajectory is stored")
        ]
        assert sum(told) == (not stage.has_plan), (run.pipeline, told)


# The columns of a file of motion, none where it is missing, or its bytes; and what is said of it.
_ODD_MOTIONS = (
    (None, "cannot be read (there is no such file)"), (b"", "cannot be read ("),
    (b"CDF\x01 an old one", "cannot be read ("), ({}, "stored"),
    ({"t": ()}, "stored"), ({"t": (0.0, float("nan")), "q1": (1.0, 2.0)}, "stored"),
    ({"t": (0.0, 1.0, 2.0), "q1": (1.0,), "lam_left": (), "other": (1.0, 2.0), "knots": (0, 9)},
     ""),
    ({"t": (1.0,), "q1": (1.0,), "gap_left": (-1.0,), "pose_x_1": (0.0,), "pose_y_1": (0.0,),
      "pose_angle_1": (0.0,)}, ""),
    ({"t": (0.0, 1.0), "q1": (b"a", b"b"), "u1": ((1.0, 2.0), (3.0, 4.0)),
      "gap_left": (0.0, 1.0, 2.0)}, ""),
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("what", ["trajectory", "replay"])
def test_missing_and_odd_motions_are_a_dash_and_never_an_exception(factory, tmp_path, what):
    runs = [factory.run(f"odd{place}", None, "strict_lcp") for place in range(len(_ODD_MOTIONS))]
    folder = factory.store(tmp_path / "odd", [*runs, factory.runs()[2]])
    for run, (columns, _) in zip(runs, _ODD_MOTIONS, strict=True):
        path = folder / "runs" / run.key / f"{what}.nc"
        path.unlink()
        if isinstance(columns, bytes):
            path.write_bytes(columns)
        elif columns is not None:
            factory.write_motion(path, columns)
    write_report(folder)
    for run, (_, said) in zip(runs, _ODD_MOTIONS, strict=True):
        page = Parsed((folder / "pages" / run_pages([run])[run.key]).read_text(encoding="utf-8"))
        assert (
            f"{what}.nc {said}" in page.text
            or f"No {'planned trajectory' if what == 'trajectory' else 'replay'} is {said}"
            in page.text
            or not said
        )
        assert "strict_lcp" in page.text


def test_an_empty_campaign_is_a_page_too(factory, tmp_path):
    _, page = render(factory.store(tmp_path / "none", []))
    assert "No run is stored here yet" in page.text


@pytest.mark.slow
def test_pages_of_long_motions_stay_small(factory, tmp_path):
    """Of ten thousand times a page shows as many as can be seen."""
    run = factory.runs()[2]
    folder = factory.store(tmp_path / "long", [run])
    short, times = factory.simulate(None, 2.5, every=1), np.linspace(0.0, 5.0, 10_000)
    long = {name: np.interp(times, short["t"], values) for name, values in short.items()}
    for path in folder.glob("runs/*/*.nc"):
        factory.write_motion(path, {**long, "t": times})
    write_report(folder)
    sizes = {
        path.name: path.stat().st_size
        for path in (folder / "report.html", *(folder / "pages").iterdir())
    }
    assert {"report.html", "scene-three_cart.html", run_pages([run])[run.key]} <= set(sizes)
    assert max(sizes.values()) < 300_000


@pytest.mark.slow
def test_the_report_needs_no_solver(full_folder):
    program = (
        "import sys; from pathlib import Path; from reports.render import write_report; write_report(Path(sys.argv[1])); "
        "print(sorted({'torch', 'pyomo', 'sympy', 'scipy', 'models.scene', 'formulations', 'validate'} & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, str(full_folder)],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == "[]"


@pytest.mark.slow
def test_the_command_rebuilds_the_page(full_folder):
    (full_folder / "report.html").unlink(missing_ok=True)
    done = subprocess.run(
        [sys.executable, "-m", "reports", str(full_folder)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout.strip()) == (0, str(full_folder / "report.html"))
    assert (full_folder / "report.html").is_file()


def test_a_folder_in_the_place_of_the_report_is_one_sentence(factory, tmp_path):
    folder = factory.store(tmp_path / "blocked", [])
    (folder / "report.html").mkdir()
    with pytest.raises(ReportError, match="cannot be written"):
        write_report(folder)
    assert [path.name for path in folder.iterdir() if path.name.startswith(".partial")] == []
