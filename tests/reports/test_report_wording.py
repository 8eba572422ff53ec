"""Sentences of records as a person would write them: no number in a program's notation, and no reason told twice."""

import math
import re
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from wording import unsaid

from reports.render import write_single
from reports.wording import cost, error, number, prose

_SUPERSCRIPT = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")


@pytest.mark.parametrize(
    ("said", "written"),
    [
        (
            "The error is 1.2e-02 m for k = 1 and 9e+228 m for k = 1e+08; at most 8.10e+00 m.",
            "The error is 0.012 m for k = 1 and 9×10²²⁸ m for k = 10⁸; at most 8.10 m.",
        ),
        (
            "primal 0.0e+00, dual 2.18e-04, violation 8.84e+02",
            "primal 0, dual 0.000218, violation 884",
        ),
        ("one more step promises -0 %; off by -0.0 m", "one more step promises 0 %; off by 0 m"),
        ("ratios 1e-4 .. 1e4, to 1e-300", "ratios 0.0001 .. 10\u202f000, to 10⁻³⁰⁰"),
        (
            "about e^(3.3 T) in 1-0, -05, -0.5, 3d12e7f, 0x1e5, v1.2e3.4",
            "about e^(3.3 T) in 1-0, -05, -0.5, 3d12e7f, 0x1e5, v1.2e3.4",
        ),
    ],
)
def test_numbers_in_sentences(said: str, written: str):
    assert prose(said) == written
    assert prose(written) == written


@given(st.floats(allow_nan=False, allow_infinity=False), st.integers(0, 6))
def test_no_digit_is_lost_or_made_up(value: float, places: int):
    told = f"{value:.{places}e}"
    written = prose(told)
    plain = written.replace("−", "-").replace("\u202f", "").translate(_SUPERSCRIPT)
    back = (
        re.sub(
            r"(^|-|×)10(-?\d+)$",
            lambda found: f"{'' if found[1] == '×' else found[1] + '1'}e{found[2]}",
            plain,
        )
        if "⁰" in written or any(letter in "⁻¹²³⁴⁵⁶⁷⁸⁹" for letter in written)
        else plain
    )
    assert float(back) == float(told) or math.isclose(float(back), float(told), rel_tol=1e-15)
    assert "e+" not in written
    assert "e-" not in written


def read(text: str) -> float:
    """A number as a page writes it."""
    plain = text.replace("−", "-").replace("\u202f", "").translate(_SUPERSCRIPT)
    mantissa, times, exponent = plain.partition("×10")
    if times:
        return float(f"{mantissa}e{exponent}")
    power = (
        re.fullmatch(r"(-?)10(-?\d+)", plain)
        if any(letter in text for letter in "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
        else None
    )
    return float(f"{power[1]}1e{power[2]}") if power else float(plain)


# Of each writer the relative and the absolute rounding.
WRITERS = [(number, 5.1e-4, 0.0), (cost, 5.1e-4, 0.0051), (error, 0.051, 0.0)]


@pytest.mark.parametrize(
    ("writer", "relative", "absolute"), WRITERS, ids=["number", "cost", "error"]
)
@given(
    value=st.floats(1e-14, 1e14)
    | st.sampled_from(
        [1.0, 9.9996, 99.95, 999.95, 9999.5, 12345.678, 123456.7, 999999.0, 1e6, 1e-3]
    )
)
def test_a_number_reads_back_and_its_negative_is_the_same_with_a_minus(
    writer, relative: float, absolute: float, value: float
):
    told = writer(value)
    assert read(told) == pytest.approx(value, rel=relative, abs=absolute)
    assert writer(-value) == (f"−{told}" if read(told) else told)


def test_why_there_is_no_plan_is_told_once_a_stage(factory, tmp_path):
    """Not again as the message, as the reason of a missing trace, and as that of missing figures.

    A stage that never ran has no table of noughts.
    """
    why = "the run's time was used up before this stage, past 2.18e-04 m."
    nothing = {
        "has_plan": False,
        "replay": None,
        "metrics": (),
        "history": {},
        "residuals": {},
        "cost": None,
    }
    late = factory.stage(
        0,
        "strict_lcp",
        None,
        None,
        0.0,
        outcome="time_limit",
        message=why,
        why=why,
        verdict="no plan",
        **nothing,
    )
    idle = replace(late, iterations=0, seconds=replace(late.seconds, wall=0.0))
    run = factory.run(
        "late",
        None,
        "strict_lcp",
        stages=(idle,),
        outcome="time_limit",
        message=why,
        verdict="no plan",
    )
    article = re.search(
        r'<article class="run".*?</article>',
        write_single(factory.store(tmp_path / "late", [run])).read_text(encoding="utf-8"),
        re.S,
    )
    assert article[0].count("time was used up before this stage, past 0.000218 m.") == 1
    assert not unsaid(article[0], "There is no plan")
    for absent in (
        "e-04",
        "No replay is stored",
        "No figure was measured",
        "<caption>Seconds",
        "cost –",
    ):
        assert absent not in article[0]
