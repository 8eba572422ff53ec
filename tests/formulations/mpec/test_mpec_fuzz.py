"""Random MPECs of every kind against all their branches, and a judge that can say no: a share of what `python -m benchmarks fuzz mpec` counts."""

import io
from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, note, settings

from benchmarks.mpec import enumeration, generator
from formulations.solution import Outcome

_CONVEX = 52  # a seed of a convex problem with few branches


KINDS = generator.KINDS
FAULTS = (*enumeration.WRONG, "refused")


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(26, 26 + len(KINDS)), ids=lambda seed: f"{KINDS[seed % len(KINDS)]}-{seed}")
def test_nothing_wrong_is_claimed_of_a_problem_of_each_kind(seed):
    """Beside those of hypothesis, which prefers plain numbers: of defects planted in the solver, each of the two tests found some that the other missed."""
    verdict = enumeration.judge(generator.random_mpec(seed))
    assert verdict.agreement not in FAULTS, verdict


@pytest.mark.slow
def test_nothing_wrong_is_claimed_and_little_left_open():
    """Where it fails, it takes up to five minutes to find a smaller problem that fails."""
    answers: Counter[str] = Counter()

    @settings(max_examples=len(KINDS))
    @given(generator.drawn_mpec())
    def nothing_wrong_is_claimed(problem):
        shown = io.StringIO()
        problem.model.pprint(shown)
        note(shown.getvalue())
        verdict = enumeration.judge(problem)
        answers[verdict.agreement] += 1
        assert verdict.agreement not in FAULTS, verdict

    nothing_wrong_is_claimed()
    # A wrong model ends here: the solver holds its point against the user's model, and does not claim what does not belong to it.
    assert answers["undecided"] <= answers.total() / 10, answers


def test_a_pair_stated_twice():
    """Both copies held on the same side are dependent rows: Ipopt's multipliers of 1e17 once ended 2e-4 above the optimum, undecided."""
    problem = generator.random_mpec(7)
    assert problem.conditions[-1] is problem.conditions[0]
    assert enumeration.judge(problem).agreement == "same"


def _claiming(change: Any, monkeypatch: pytest.MonkeyPatch) -> str:
    """What the judge says of a convex problem whose result was changed."""
    honest = enumeration.solve_mpec
    monkeypatch.setattr(enumeration, "solve_mpec", lambda model: change(honest(model)))
    return enumeration.judge(generator.random_mpec(_CONVEX)).agreement


@pytest.mark.slow
def test_the_judge_sees_a_point_off_its_rows(monkeypatch):
    assert enumeration.judge(generator.random_mpec(_CONVEX)).agreement == "same"
    assert _claiming(lambda result: replace(result, x=result.x + 1e-3), monkeypatch) == "wrong optimal"


def test_the_judge_sees_a_point_that_is_not_the_lowest_of_its_branch(monkeypatch):
    assert _claiming(lambda result: replace(result, objective=result.objective + 1e-3 * result.sense), monkeypatch) == "wrong optimal"


@pytest.mark.parametrize(("outcome", "wrong"), [(Outcome.INFEASIBLE, "wrong infeasible"), (Outcome.DIVERGED, "wrong unbounded")])
def test_the_judge_sees_a_wrong_ending(outcome, wrong, monkeypatch):
    nothing = np.full(0, np.nan)
    assert _claiming(lambda result: replace(result, outcome=outcome, x=nothing), monkeypatch) == wrong
