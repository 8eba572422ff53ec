"""Tables and sentences fit a terminal: columns go in a stated order, sentences break between words.

What a terminal is shown while a campaign runs: how much is done, how long it may take, what runs;
and where there are no colours.
"""

import functools
import io
import re
from dataclasses import replace

import click
import pytest
import rich.console
from wording import unsaid

from models.errors import MachineError
from tests.reports import record_factory as factory
from validate.cli import narrator
from validate.cli.table import (
    say,
    short,
    table,
    terminal_width,
    use_colour,
    wide_option,
    wrapped,
)
from validate.processes.disk import write_durably
from validate.store.store import progress

TITLES = ["scene", "cost", "eps", "why"]
ROWS = [
    ["three_cart", "490.55", "0.001", "the plan does not reach the goal within its limit"],
    ["two_discs", "1.0", "", "it holds"],
]


def lines(monkeypatch, width: int | None, **options) -> list[str]:
    monkeypatch.delenv("COLUMNS", raising=False)
    if width is not None:
        monkeypatch.setenv("COLUMNS", str(width))
    return table(TITLES, ROWS, ("cost", "eps"), **options).splitlines()


def test_a_pipe_has_every_column_and_one_line_a_row(monkeypatch):
    assert lines(monkeypatch, None, drop=("eps", "cost")) == [
        "scene         cost    eps  why",
        "----------  ------  -----  -------------------------------------------------",
        "three_cart  490.55  0.001  the plan does not reach the goal within its limit",
        "two_discs      1.0         it holds",
    ]  # fmt: skip


def test_table_in_a_pipe_fits_100_columns(monkeypatch):
    monkeypatch.delenv("COLUMNS", raising=False)
    rows = [["three_cart", "1.0", "0.001", "word " * 60]]
    found = table(TITLES, rows, ("cost", "eps"), drop=("eps",)).splitlines()
    assert max(map(len, found)) == 100
    assert "eps" in found[0]


def test_a_sentence_breaks_between_words_before_a_column_goes(monkeypatch):
    assert lines(monkeypatch, 60, drop=("eps", "cost"))[2:] == [
        "three_cart  490.55  0.001  the plan does not reach the goal",
        "                           within its limit",
        "two_discs      1.0         it holds",
    ]


@pytest.mark.parametrize(
    ("width", "shown", "gone"),
    [
        (50, TITLES, []),
        (44, ["scene", "cost", "why"], ["eps"]),
        (36, ["scene", "why"], ["eps", "cost"]),
    ],
)
def test_columns_go_in_the_stated_order(monkeypatch, width, shown, gone):
    found = lines(monkeypatch, width, drop=("eps", "cost"))
    assert found[0].split() == shown
    assert max(map(len, found)) <= width
    last = " ".join(found[-2:])
    assert (f"(no room for: {', '.join(gone)}; --wide shows" in last) == bool(gone)


def test_no_word_is_broken_where_nothing_may_go(monkeypatch):
    words = " ".join(lines(monkeypatch, 10)).split()
    assert {"three_cart", "490.55", "within", "limit"} <= set(words)


def test_wide_shows_all_in_a_narrow_terminal(monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")

    @click.command()
    @wide_option
    def command() -> None:
        click.echo(str(terminal_width()))

    from click.testing import CliRunner

    assert CliRunner().invoke(command, ["--wide"]).output == "None\n"
    assert CliRunner().invoke(command, []).output == "40\n"


def test_a_sentence_is_indented_after_its_first_line(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "24")
    say("one two three four five six", begin="error: ", indent="  ", err=True)
    assert capsys.readouterr().err == "error: one two three\n  four five six\n"
    monkeypatch.delenv("COLUMNS")
    say("one two\nthree \x1b[31mfour")
    assert capsys.readouterr().out == "one two three [31mfour\n"
    assert (
        wrapped("a_word_that_is_longer_than_a_line and more", 10)
        == "a_word_that_is_longer_than_a_line\nand more"
    )


def test_a_verdict_has_its_colour_in_its_own_cell_alone(monkeypatch):
    monkeypatch.delenv("COLUMNS", raising=False)
    text = table(["verdict", "why"], [["violates", "violates its limit"]])
    assert re.findall(r"\x1b\[31m(.*?)\x1b\[0m", text) == ["violates"]
    assert text.splitlines()[-1].endswith("  violates its limit")


def test_a_zero_has_no_sign_and_a_number_too_large_for_decimals_is_short():
    assert [short(-0.0, ".4e"), short(490.554, ".2f"), short(-1e200, ".2f")] == [
        "0.0000e+00",
        "490.55",
        "-1e+200",
    ]


@pytest.mark.parametrize("width", [60, 80, 200])
def test_the_bar_has_the_numbers_whole_and_what_runs_as_far_as_there_is_room(
    monkeypatch, tmp_path, width
):
    """The bar is drawn when something is told; the last time when it ends."""
    shown, clock = io.StringIO(), iter(range(1000, 100000, 10))
    terminal = functools.partial(
        rich.console.Console, file=shown, force_terminal=True, width=width, no_color=True
    )
    monkeypatch.setenv("TERM", "xterm")  # on a dumb one no bar moves
    monkeypatch.setattr(rich.console, "Console", lambda **_: terminal())
    monkeypatch.setattr(narrator.time, "monotonic", lambda: float(next(clock)))
    bar = narrator.BarNarrator()
    bar.begins(30, 4)
    progress(tmp_path, "the certificate of stage 1 (strict_lcp)")
    busy = "three_cart_steps_50_step_0p1 x softplus_dc+strict"
    bar.runs({busy: tmp_path, f"{busy} (2 of 2)": tmp_path})
    bar.finished(factory.run("good", None, "strict_lcp"))
    bar.finished(factory.run("strict", None, "strict_lcp", outcome="crashed", verdict="no plan"))
    bar.found([factory.run("good", None, "strict_lcp")])
    bar.runs({busy: tmp_path})
    bar.ends()
    lines = re.split(r"[\r\n]+", re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", shown.getvalue()))
    assert max(map(len, lines)) <= width
    assert "4 stored, 26 to run" in lines
    assert not unsaid(" ".join(" ".join(lines).split()), "[6/30] three_cart x strict: crashed")
    assert not any("three_cart x good" in line for line in lines), "runs that hold have no line"
    assert any(line.startswith("so far: three_cart: 1 of 1 runs") for line in lines)
    before, after = (
        lines[: (done := next(place for place, line in enumerate(lines) if "[6/30]" in line))],
        lines[done:],
    )
    assert not any("about" in line for line in before), "nobody knows before a cell has finished"
    assert any(
        re.search(r" 6/30 \d+:\d\d:\d\d about \d+ min left three_cart", line) for line in after
    ), lines
    assert any("strict_lcp" in line for line in lines) == (width == 200)


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(3.24, "3.2 s"), (0.456, "0.46 s"), (12.3, "12 s"), (600, "10 min"), (9000, "2.5 h")],
)
def test_a_time_is_told_as_roughly_as_it_is_known(seconds, words):
    assert narrator.in_words(seconds) == words


def refused(pipeline: str, why: str):
    return replace(
        factory.run(pipeline, None, "strict_lcp", outcome="refused", verdict="not applicable"),
        message=why,
    )


def test_what_does_not_apply_to_a_scene_is_told_once_for_each_reason_when_its_runs_have_ended(
    capsys,
):
    runs = [
        refused("mpcc", "mpcc: it has friction: none."),
        refused("chain", "strict_lcp: it has friction: none."),
        refused("own", "a reason: so."),
    ]
    plain = narrator.PlainNarrator()
    plain.begins(4, 0)
    for run in (*runs, factory.run("strict", None, "strict_lcp")):
        plain.finished(run)
    assert plain.done == 4
    plain.found(runs)
    first, ended, *told = capsys.readouterr().err.splitlines()
    assert (first, ended[:30]) == ("0 stored, 4 to run", "[4/4] three_cart x strict: sol")
    assert told[:2] == [
        "not applicable: mpcc, chain: it has friction: none.",
        "not applicable: own: a reason: so.",
    ]


def test_what_does_not_apply_is_told_at_the_end_where_the_other_runs_of_its_scene_have_not_ended(
    capsys,
):
    """Ctrl-C, or -x: the scene is never whole."""
    run = refused("mpcc", "m: it has none.")
    plain = narrator.PlainNarrator()
    plain.begins(3, 0)
    plain.finished(run)
    plain.ends()
    assert capsys.readouterr().err.splitlines() == [
        "0 stored, 3 to run",
        "not applicable: mpcc: it has none.",
    ]
    whole = narrator.PlainNarrator()
    whole.begins(1, 0)
    whole.finished(run)
    whole.found([run])
    capsys.readouterr()
    whole.ends()
    assert capsys.readouterr().err == "", "once is enough"


def test_of_a_folder_that_is_gone_nothing_is_said_to_be_stored(tmp_path):
    plain = narrator.PlainNarrator()
    plain.begins(3, 1)
    assert plain.so_far(tmp_path) == f"1 of 3 runs are stored in {tmp_path}"
    gone = tmp_path / "gone"
    assert not unsaid(plain.so_far(gone), f"{gone} is gone")
    with pytest.raises(
        MachineError, match=r"campaign.json \(its folder is gone\).*removed or moved"
    ):
        write_durably(gone / "campaign.json", "{}")


def test_a_terminal_without_colours_gets_none(monkeypatch):
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setenv("TERM", "xterm")
    assert use_colour() is None
    monkeypatch.setenv("TERM", "dumb")
    assert use_colour() is False
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("NO_COLOR", "1")
    assert use_colour() is False
