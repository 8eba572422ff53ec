"""Tables and sentences fit a terminal: columns go in a stated order, sentences break between words."""

import re

import click
import pytest

from validate.cli.table import say, short, table, terminal_width, wide_option, wrapped

TITLES = ["scene", "cost", "eps", "why"]
ROWS = [["three_cart", "490.55", "0.001", "the plan does not reach the goal within its limit"], ["two_discs", "1.0", "", "it holds"]]


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
    ]


def test_a_sentence_breaks_between_words_before_a_column_goes(monkeypatch):
    assert lines(monkeypatch, 60, drop=("eps", "cost"))[2:] == [
        "three_cart  490.55  0.001  the plan does not reach the goal",
        "                           within its limit",
        "two_discs      1.0         it holds",
    ]


@pytest.mark.parametrize(
    ("width", "shown", "gone"), [(50, TITLES, []), (44, ["scene", "cost", "why"], ["eps"]), (36, ["scene", "why"], ["eps", "cost"])]
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
    assert wrapped("a_word_that_is_longer_than_a_line and more", 10) == "a_word_that_is_longer_than_a_line\nand more"


def test_a_verdict_has_its_colour_in_its_own_cell_alone(monkeypatch):
    monkeypatch.delenv("COLUMNS", raising=False)
    text = table(["verdict", "why"], [["violates", "violates its limit"]])
    assert re.findall(r"\x1b\[31m(.*?)\x1b\[0m", text) == ["violates"]
    assert text.splitlines()[-1].endswith("  violates its limit")


def test_a_zero_has_no_sign():
    assert short(-0.0, ".4e") == "0.0000e+00"
