"""Plain English in the product and its pages: the counts of each area may only fall."""

from collections import Counter
from functools import cache
from pathlib import Path

import pytest

from benchmarks.english import (
    HEADLESS_OPENING,
    LISTED_WORD,
    LONG_FIRST_LINE,
    LONG_SENTENCE,
    SHARED_COMMENT,
    Finding,
    violations,
)

ROOT = Path(__file__).parents[1]
RULES = (HEADLESS_OPENING, LISTED_WORD, LONG_SENTENCE, LONG_FIRST_LINE, SHARED_COMMENT)
# Largest counts by rule, in the order of RULES. Lower a number after rewriting; never raise one.
CEILINGS = {
    "README.md": (0, 0, 0, 0, 0),
    "docs": (2, 3, 13, 0, 0),
    "formulations": (0, 0, 2, 0, 0),
    "models": (1, 0, 25, 0, 3),
    "reports": (0, 0, 0, 0, 0),
    "touchstone.py": (0, 0, 0, 0, 0),
    "touchstone_annexes.py": (0, 0, 0, 0, 0),
    "touchstone_command.py": (0, 0, 0, 0, 0),
    "validate/__init__.py": (0, 0, 0, 0, 0),
    "validate/__main__.py": (0, 0, 0, 0, 0),
    "validate/campaign": (0, 0, 0, 0, 0),
    "validate/cli": (0, 0, 0, 1, 0),
    "validate/fmi": (0, 0, 0, 0, 0),
    "validate/fmu_check": (0, 0, 0, 12, 0),
    "validate/judge": (0, 0, 0, 0, 0),
    "validate/processes": (0, 0, 0, 0, 0),
    "validate/store": (0, 0, 0, 0, 0),
    "validate/stress": (0, 0, 0, 0, 0),
    "validate/tasks": (0, 0, 0, 0, 0),
    "validate/truth": (0, 0, 0, 0, 0),
}


def _area(path: Path) -> str:
    room, *below = path.parts
    return f"{room}/{below[0]}" if room == "validate" else room


@cache
def _files() -> dict[str, list[Path]]:
    """Return the product's Python files and pages by area."""
    rooms = ("models", "formulations", "validate", "reports")
    paths = [path for room in rooms for path in (ROOT / room).rglob("*.py")]
    paths += [*ROOT.glob("touchstone*.py"), ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    areas: dict[str, list[Path]] = {}
    for path in sorted(paths):
        areas.setdefault(_area(path.relative_to(ROOT)), []).append(path)
    return areas


def test_english_every_area_has_a_ceiling():
    assert _files().keys() <= CEILINGS.keys()


@pytest.mark.parametrize("area", CEILINGS)
def test_english_counts_only_fall(area: str):
    broken = [finding for path in _files().get(area, []) for finding in violations(path)]
    counts = Counter(finding.rule for finding in broken)
    exceeded = {
        rule: most for rule, most in zip(RULES, CEILINGS[area], strict=True) if counts[rule] > most
    }
    assert not exceeded, "\n" + "\n".join(
        line
        for rule, most in exceeded.items()
        for line in (
            f"{area}: {counts[rule]} x {rule}, at most {most} (rewrite the new ones):",
            *(_place(finding) for finding in broken if finding.rule == rule),
        )
    )


def _place(finding: Finding) -> str:
    return f"  {finding.path.relative_to(ROOT)}:{finding.line}: {finding.text}"


MODULE = '''"""{first}

{body}
"""

{code}
'''


def _rules(
    folder: Path, first: str = "Return it.", body: str = "Text.", code: str = ""
) -> list[tuple[str, int]]:
    """Return (rule, line) of each finding in a module with this docstring and code."""
    path = folder / "module.py"
    path.write_text(MODULE.format(first=first, body=body, code=code), encoding="utf-8")
    return [(finding.rule, finding.line) for finding in violations(path)]


@pytest.mark.parametrize(
    "sentence",
    [
        "What the wheel weighs is stored.",
        "Of all springs the stiffest counts.",
        "So much as a row is drawn.",
        "Where no spring is, the gap is free.",
        "That the wheel slips is reported.",
        "Whether the wheel slips.",
        "By how much the wheel slips is reported.",
        "A spring is linear. Who needs another adds one.",
    ],
)
def test_english_headless_opening_is_found(sentence: str, tmp_path: Path):
    assert _rules(tmp_path, body=sentence) == [(HEADLESS_OPENING, 3)]


@pytest.mark.parametrize(
    "sentence",
    [
        "The page says so.",
        "Somebody builds it anew.",
        "A factorisation is dear.",
        "The page has so many rows.",
        "The solver is told the bound.",
    ],
)
def test_english_listed_word_is_found(sentence: str, tmp_path: Path):
    assert _rules(tmp_path, code=f"# Fine.\n\nx = 1  # {sentence}") == [(LISTED_WORD, 8)]


@pytest.mark.parametrize(
    "text",
    [
        "The left contact opens in its own frame, on its own.",
        "The wheel is so much as touched.",
        "Why a step fails: what is stiff must be small.",
        "The option `told` is asserted, mending aside.",
        "What is a contact?",
        "    what = weighed(wheel)",
        "wheel = told(somebody)  # of it\nwheel.says()",
        "Parameters\n----------\ntell\n    A function.",
    ],
)
def test_english_terms_and_examples_are_no_finding(text: str, tmp_path: Path):
    assert _rules(tmp_path, body=text) == []


def test_english_long_sentence_is_found(tmp_path: Path):
    words = " ".join(["wheel"] * 30)
    assert _rules(tmp_path, body=f"{words}.") == []
    assert _rules(tmp_path, body=f"Short.\n{words}\nwheel.") == [(LONG_SENTENCE, 3)]
    assert _rules(tmp_path, body=f"- {words}.\n- {words}.") == []
    assert _rules(tmp_path, body=f"- {words}\n  wheel.\n- {words}") == [(LONG_SENTENCE, 3)]
    assert _rules(tmp_path, body=f"Returns\n-------\nfloat\n    {words} wheel.") == [
        (LONG_SENTENCE, 6)
    ]


def test_english_first_line_has_at_most_100_characters(tmp_path: Path):
    assert _rules(tmp_path, first="x" * 97) == []
    assert _rules(tmp_path, first="x" * 98) == [(LONG_FIRST_LINE, 1)]


def test_english_comment_on_several_numbers_is_found(tmp_path: Path):
    shared = "# Length, and width [m].\nLENGTH = 2.0\nWIDTH = 1.0\n\nNAME = 1"
    assert _rules(tmp_path, code=shared) == [(SHARED_COMMENT, 7)]
    each = "# Length [m].\nLENGTH = 2.0\n# Width [m].\nWIDTH = 1.0\n# Names.\nA = 'a'\nB = 'b'"
    assert _rules(tmp_path, code=each) == []


def test_english_markdown_without_tables_and_code(tmp_path: Path):
    path = tmp_path / "page.md"
    path.write_text(
        "# What it does\n\n| What | told |\n|---|---|\n\n```\nWhat is told\n```\n\n"
        "The page\nreports.\n\n1. What is\n   told.\n",
        encoding="utf-8",
    )
    assert [(finding.rule, finding.line) for finding in violations(path)] == [
        (HEADLESS_OPENING, 13),
        (LISTED_WORD, 13),
    ]
