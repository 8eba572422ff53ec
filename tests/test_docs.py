"""What the docs print runs as printed: files are written, commands run in order with the exit code that is promised, Python is executed.

A block marked `output` has lines of what was printed so far, with `..` for what differs between machines.
"""

import csv
import importlib
import re
import shlex
import shutil
import signal
from collections import Counter
from pathlib import Path

import pytest
from wording import unsaid

from formulations.ampl.command import main as solve_mpec_file
from models.contact_law import worst_case_violation
from validate.cli.group import run

DOCS = Path(__file__).parents[1] / "docs"
TEXTS = {
    name: (DOCS / f"{name}.md").read_text(encoding="utf-8")
    for name in (
        "campaigns",
        "planning",
        "field",
        "tutorial/scene",
        "tutorial/plan",
        "tutorial/fmu",
        "tutorial/mpec",
        "tutorial/robot",
        "extending",
        "equations",
        "verdict",
        "robustness",
        "mpec",
    )
}
_BLOCK = re.compile(
    r"(?:<!-- (?P<mark>\w+)(?:: (?P<word>[^>\n]+))? -->\n)?```(?P<language>\w+)\n(?P<text>.*?)```",
    re.DOTALL,
)


def _words(text: str) -> list[list[str]]:
    """The arguments of each line `python -m validate ...`."""
    lines = [shlex.split(line) for line in text.splitlines()]
    assert all(line[:3] == ["python", "-m", "validate"] for line in lines)
    return [line[3:] for line in lines]


@pytest.fixture
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """An empty folder to work in, importable there and in children.

    Signal handlers are put back.
    """
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP)}
    yield tmp_path
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.whole) if name == "tutorial/plan" else name
        for name in TEXTS
    ],
)
def test_every_snippet_runs(
    name: str,
    elsewhere: Path,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
):
    monkeypatch.setattr("validate.cli.trials.TRIALS", ())  # they have tests of their own
    for path in (DOCS / name).glob("*.py"):  # files beside a page
        shutil.copy(path, elsewhere)
    space: dict = {}
    printed = ""
    for block in _BLOCK.finditer(TEXTS[name]):
        mark, word, text = block["mark"], block["word"], block["text"]
        if mark == "file":
            (elsewhere / word).write_text(text, encoding="utf-8")
        elif mark in ("into", "below"):
            continue  # a change of our own files, which tests/test_recipes.py makes
        elif block["language"] == "python":
            exec(compile(text, f"docs/{name}.md", "exec"), space)
            printed += capfd.readouterr().out
        elif mark == "output":
            for line in text.splitlines():
                assert not unsaid(printed, line.replace("..", "…")), line
        elif mark == "mpec":
            for line in text.splitlines():
                assert solve_mpec_file(shlex.split(line, comments=True)[1:]) == 0, line
        elif mark == "long":  # a dry run finds mistakes
            for words in _words(text):
                assert run([*words, "--dry-run"]) == 0, words
        else:
            assert mark == "run", f"docs/{name}.md: a block without a mark: {text}"
            for words in _words(text):
                code = run(words)
                told = capfd.readouterr()
                printed += told.out + told.err
                assert code == int(word), (words, told)
                assert "Traceback" not in told.err
    # A conclusion in a text is one that was printed.
    for line in re.findall(r"^    - (.*)$", TEXTS[name], re.MULTILINE):
        assert line in " ".join(printed.split()), line


def test_the_mistakes_are_those_printed(elsewhere: Path, capfd: pytest.CaptureFixture[str]):
    (wrong,) = re.findall(
        r"<!-- file: wrong.toml -->\n```toml\n(.*?)```", TEXTS["campaigns"], re.DOTALL
    )
    (elsewhere / "wrong.toml").write_text(wrong, encoding="utf-8")
    run(["run", "wrong.toml"])
    printed = "".join(f"    {line}\n" for line in capfd.readouterr().err.splitlines())
    assert printed in TEXTS["campaigns"]


@pytest.mark.parametrize(
    "place", sorted(set(re.findall(r"`([a-z_.]+:[a-z_]+)`", TEXTS["equations"])))
)
def test_an_equation_has_its_function(place: str):
    module, _, name = place.partition(":")
    assert callable(getattr(importlib.import_module(module), name))


def test_the_rule_lists_every_metric_beside_its_question():
    from validate.judge.score.table import FEEDBACK, TABLE
    from validate.judge.score.verdict import Question

    rows = re.findall(r"^\| ([1-6-]) \| [^|]*\| ([^|]*)\|", TEXTS["verdict"], re.MULTILINE)
    told = {name: number for number, names in rows for name in re.findall(r"`(\w+)`", names)}
    shown = set(
        re.findall(
            r"`(\w+)`",
            re.search(
                r"^Shown, and judging nothing:.*?\n\n", TEXTS["verdict"], re.MULTILINE | re.DOTALL
            )[0],
        )
    )
    for entry in TABLE:
        number = "-" if entry.question is Question.JUDGE else str(entry.question.number)
        assert (
            entry.name in shown
            if entry.question is Question.SHOWN
            else told.get(entry.name) == number
        ), entry.name
    assert all(f"`{entry.name}`" in TEXTS["verdict"] for entry in FEEDBACK)


def test_the_errata_say_what_the_closed_form_says():
    told = re.search(r"- ([\d., ]+) N² at ε = 1e-3, 1e-5, 1e-7", TEXTS["equations"])
    assert told is not None
    assert [float(number) for number in told[1].split(", ")] == [
        round(worst_case_violation(30.0, eps), 4) for eps in (1e-3, 1e-5, 1e-7)
    ]


def _column(table: str, name: str) -> list[str]:
    with (DOCS / table).open(encoding="utf-8", newline="") as file:
        return [row[name] for row in csv.DictReader(file)]


def test_mpec_sets_summary_counts_the_rows_of_its_table():
    text = (DOCS / "mpec_sets.md").read_text(encoding="utf-8")
    results = Counter(
        result.split()[0] for result in _column("mpec_sets.csv", "against it") if result
    )
    assert f"| reached | {results['reached']} |" in text
    assert f"| better | {results['better']}: " in text
    assert f"of other data | {results['proved']} |" in text
    strategies = Counter(
        strategy
        for strategy, status in zip(
            _column("mpec_sets.csv", "strategy"), _column("mpec_sets.csv", "status"), strict=True
        )
        if status == "solved"
    )
    assert all(f"`{name}` ({count})" in text for name, count in strategies.items())


def test_results_of_carts_are_those_of_their_table():
    text = (DOCS / "results.md").read_text(encoding="utf-8")
    costs = {
        name: [float(cost or "inf") for cost in _column("carts.csv", name)]
        for name in ("mpcc", "softplus_dc+strict", "casadi")
    }
    excesses = [own / min(others) - 1 for own, *others in zip(*costs.values(), strict=True)]
    assert [f"{excess:.1e}" for excess in excesses if excess > 1e-6] == ["4.0e-04"]
    assert "better by 4.0e-4 of the cost" in text
    assert "solves all twenty rows; the other two miss one" in text
    assert [sum(cost < float("inf") for cost in each) for each in costs.values()] == [20, 19, 19]


@pytest.mark.parametrize("path", sorted(DOCS.rglob("*.md")), ids=lambda path: path.name)
def test_links_of_the_docs_lead_somewhere(path: Path):
    for target in re.findall(r"\]\(([^)#]+)\)", path.read_text(encoding="utf-8")):
        assert target.startswith("http") or (path.parent / target).exists(), target
