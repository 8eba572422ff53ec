"""The rule of resolution and the truth table of verdicts, on made-up figures."""

from __future__ import annotations

import math

import pytest

from validate.replay.error_estimate import estimate
from validate.replay.result import Difference
from validate.score import Figure, Verdict, figure_names
from validate.score.verdict import CONTACT, GRID, TWINS, compare, explain, verdict_of


@pytest.mark.parametrize(
    ("value", "error", "limit", "expected"),
    [
        (0.04, 0.0, 0.05, (True, True)),
        (0.05, 0.0, 0.05, (True, True)),  # a limit is the largest value that still holds
        (0.0501, 0.0, 0.05, (False, True)),
        (1e-9, 1e-4, 1e-2, (True, True)),  # an error far above the figure, but far below the limit
        (0.0599, 1e-4, 0.06, (None, False)),
        (0.0601, 1e-4, 0.06, (None, False)),
        (0.0589, 1e-4, 0.06, (True, True)),  # ten errors below
        (0.0611, 1e-4, 0.06, (False, True)),  # ten errors above
        (0.0591, 1e-4, 0.06, (None, False)),  # nine errors below
        (0.0609, 1e-4, 0.06, (None, False)),  # nine errors above
        (0.0, 1e-3, 1e-6, (None, False)),  # an error larger than the limit resolves nothing
        (5.0, math.inf, 0.06, (None, False)),
        (0.0, 0.0, 0.0, (True, True)),
    ],
)
def test_a_figure_is_judged_only_ten_errors_away_from_its_limit(
    value: float, error: float, limit: float, expected: tuple[bool | None, bool]
):
    assert compare(value, error, limit) == expected


def figure(name: str, ok: bool | None, value: float | None = 0.07, limit: float | None = 0.06, **more: object) -> Figure:
    return Figure(name=name, value=value, unit="m", meaning="", ok=ok, limit=limit, resolved=ok is not None, **more)  # type: ignore[arg-type] - the rest is given by the test by name


FREE = figure("physics", None, limit=None)
BELOW, ABOVE, OPEN = figure("replay_error", True), figure("replay_terminal_error", False), figure("grid_error", None)


@pytest.mark.parametrize(
    ("figures", "verdict"),
    [
        ((BELOW,), Verdict.HOLDS),
        ((BELOW, FREE), Verdict.HOLDS),
        ((ABOVE,), Verdict.VIOLATES),
        ((BELOW, ABOVE), Verdict.VIOLATES),
        ((OPEN, ABOVE), Verdict.VIOLATES),  # one clear violation is enough
        ((BELOW, OPEN), Verdict.NOT_RESOLVED),
        ((OPEN,), Verdict.NOT_RESOLVED),
        ((FREE,), Verdict.NOT_RESOLVED),  # without limits there is nothing to hold
        ((), Verdict.NOT_RESOLVED),
    ],
)
def test_truth_table(figures: tuple[Figure, ...], verdict: Verdict):
    assert verdict_of(figures) is verdict
    assert verdict_of(reversed(figures)) is verdict


def test_every_group_names_figures_that_exist():
    assert set(CONTACT) | set(GRID) <= {*figure_names(), *TWINS.values()}
    assert set(TWINS) <= set(figure_names())
    assert not set(CONTACT) & set(GRID)


def test_the_sentence_names_the_miss_its_limit_and_the_ghost():
    figures = (
        figure("physics_scaled", False, value=0.7, limit=1e-5),
        figure("replay_terminal_position_error", False, value=0.27, limit=0.06),
        Figure(name="ghost_impulse", value=3.1, unit="N s", meaning=""),
    )
    assert explain(figures, Verdict.VIOLATES, planned_impulse=4.0) == (
        "the replay misses the goal by 0.27 m, limit 0.06 m: force from a distance of 3.1 N s; also above their limits: physics_scaled."
    )


def test_a_miss_by_the_grid_alone_is_not_blamed_on_contact():
    figures = (
        figure("physics_scaled", True, value=0.0, limit=1e-5),
        figure("replay_terminal_position_error", False, value=0.08, limit=0.06),
        figure("grid_error", None, value=0.079, limit=None),
        Figure(name="ghost_impulse", value=3.1, unit="N s", meaning=""),
    )
    why = explain(figures, Verdict.VIOLATES, planned_impulse=4.0)
    assert (
        why
        == "the replay misses the goal by 0.08 m, limit 0.06 m: contact physics holds, but the time step is 0.079 m off the continuous motion."
    )


@pytest.mark.parametrize(
    ("more", "cause"),
    [
        ((figure("law_error", None, value=0.2, limit=None),), "on the plan's own grid already, the true contact law leads its inputs astray by 0.2 m"),
        ((figure("law_error", None, value=0.001, limit=None),), "contact physics holds, but the time step is 0.079 m off the continuous motion"),
        ((figure("defect", False, value=0.1, limit=1e-6),), "the plan misses its own time step by 0.1 m; also above their limits: defect"),
        (
            (figure("defect", False, value=0.1, limit=1e-6), figure("bound_violation", False, value=47.0, limit=1e-6)),
            "the inputs leave their bounds by 47 m; also above their limits: defect, bound_violation",
        ),
        ((figure("start_error", False, value=0.1, limit=1e-6),), "the plan starts 0.1 m away from the task's start; also above their limits: start_error"),
    ],
)  # fmt: skip
def test_a_miss_is_blamed_on_what_the_figures_show(more: tuple[Figure, ...], cause: str):
    """A plan through a wall whose forces are 0 is complementary by its product; inputs that are not the plan's leave its motion."""
    figures = (
        figure("physics_scaled", True, value=0.0, limit=1e-5),
        figure("replay_error", False, value=0.2, limit=0.06),
        figure("grid_error", None, value=0.079, limit=None),
        *more,
    )
    assert explain(figures, Verdict.VIOLATES, planned_impulse=4.0) == f"the replay leaves the plan by 0.2 m, limit 0.06 m: {cause}."


def test_what_is_not_resolved_says_why():
    unmeasured = figure("replay_error", None, value=None, reason="the plan was not replayed.")
    assert explain((unmeasured,), Verdict.NOT_RESOLVED, 0.0) == "replay_error could not be measured: the plan was not replayed."
    blurred = figure("replay_error", None, value=0.0599, error=1e-4)
    why = explain((blurred,), Verdict.NOT_RESOLVED, 0.0)
    assert "the replay leaves the plan by 0.0599 m, limit 0.06 m" in why
    assert "own error of 0.0001 m" in why
    assert "there are no limits" in explain((FREE,), Verdict.NOT_RESOLVED, 0.0)


def test_what_holds_shows_the_figure_closest_to_its_limit():
    figures = (figure("defect", True, value=1e-9, limit=1e-6), figure("replay_terminal_position_error", True, value=0.03, limit=0.06))
    assert "closest to its own: the replay misses the goal by 0.03 m, limit 0.06 m" in explain(figures, Verdict.HOLDS, 0.0)


def _difference(position: float) -> Difference:
    return Difference(position=position, state=10 * position, gap=2 * position)


def test_the_estimate_is_the_tolerance_difference_where_the_everyday_replay_agrees():
    error = estimate(tolerance=_difference(1e-9), step=_difference(1e-6), everyday=_difference(1.2e-6), has_reference=True)
    assert error.estimate == _difference(1e-9)


def test_an_everyday_replay_that_disagrees_beyond_its_own_error_becomes_the_estimate():
    """Both tolerances may share a mistake (an event that neither saw); an independent method shows it."""
    error = estimate(tolerance=_difference(1e-9), step=_difference(1e-8), everyday=_difference(1e-4), has_reference=True)
    assert error.estimate == _difference(1e-4)


def test_the_estimate_without_one_of_the_two_methods():
    alone = estimate(tolerance=_difference(1e-9), step=None, everyday=None, has_reference=True)
    assert alone.estimate == _difference(1e-9)
    everyday = estimate(tolerance=None, step=_difference(1e-6), everyday=None, has_reference=False)
    assert everyday.estimate == _difference(1e-6)
    failed = estimate(tolerance=None, step=_difference(1e-6), everyday=None, has_reference=True)
    assert failed.estimate is None
