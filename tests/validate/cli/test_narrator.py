"""What a terminal is shown while a campaign runs: how much is done, how long it may take, what runs; and where there are no colours."""

import functools
import io
import re

import pytest
import rich.console
from wording import unsaid

from models.errors import MachineError
from tests.reports import record_factory as factory
from validate.cli import narrator
from validate.cli.table import use_colour
from validate.store.disk import write_durably


class _Busy:
    class task:  # noqa: N801 - stands for a worker's task
        title = "three_cart_steps_50_step_0p1 x softplus_dc+strict"

    def progress(self) -> str:
        return "the certificate of stage 1 (strict_lcp)"


@pytest.mark.parametrize("width", [60, 80, 200])
def test_the_bar_has_the_numbers_whole_and_what_runs_as_far_as_there_is_room(monkeypatch, width):
    """The bar is drawn when something is told; the last time when it ends."""
    shown, clock = io.StringIO(), iter(range(1000, 100000, 10))
    terminal = functools.partial(rich.console.Console, file=shown, force_terminal=True, width=width, no_color=True)
    monkeypatch.setenv("TERM", "xterm")  # on a dumb one no bar moves
    monkeypatch.setattr(rich.console, "Console", lambda **_: terminal())
    monkeypatch.setattr(narrator.time, "monotonic", lambda: float(next(clock)))
    bar = narrator.BarNarrator()
    bar.begins(30, 4, 2)
    bar.runs([_Busy(), _Busy()])  # type: ignore[list-item]
    bar.finished(factory.run("strict", None, "strict_lcp"))
    bar.runs([_Busy()])  # type: ignore[list-item]
    bar.ends()
    lines = re.split(r"[\r\n]+", re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", shown.getvalue()))
    assert max(map(len, lines)) <= width
    assert "4 stored, 26 to run, 2 of them again" in lines
    assert not unsaid(" ".join(" ".join(lines).split()), "[5/30] three_cart x strict: solved")
    before, after = lines[: (done := next(place for place, line in enumerate(lines) if "[5/30]" in line))], lines[done:]
    assert not any("about" in line for line in before), "nobody knows before a cell has finished"
    assert any(re.search(r" 5/30 \d+:\d\d:\d\d about \d+ min left three_cart", line) for line in after), lines
    assert any("strict_lcp" in line for line in lines) == (width == 200)


@pytest.mark.parametrize(("seconds", "words"), [(3.24, "3.2 s"), (0.456, "0.46 s"), (12.3, "12 s"), (600, "10 min"), (9000, "2.5 h")])
def test_a_time_is_told_as_roughly_as_it_is_known(seconds, words):
    assert narrator.in_words(seconds) == words


def test_of_a_folder_that_is_gone_nothing_is_said_to_be_stored(tmp_path):
    plain = narrator.PlainNarrator()
    plain.begins(3, 1, 0)
    assert plain.so_far(tmp_path) == f"1 of 3 runs are stored in {tmp_path}"
    gone = tmp_path / "gone"
    assert not unsaid(plain.so_far(gone), f"{gone} is gone")
    with pytest.raises(MachineError, match=r"campaign.json \(its folder is gone\).*removed or moved"):
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
