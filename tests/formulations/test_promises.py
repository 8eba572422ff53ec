"""What a method promises of a plan that it calls solved is checked on the plan itself: broken on purpose, one promise at a time."""

from dataclasses import asdict

import pytest

from formulations.pipelines import load_method
from formulations.solution import Outcome, Solution
from formulations.transcription.residuals import PlanResiduals
from models.catalog import load_scene

COMMON = ("dynamics_defect", "start_error", "terminal_error", "input_bound_excess", "velocity_bound_excess")
PROMISED = {
    "softplus_dc": (*COMMON, "contact_law", "regularised_friction"),
    "relaxed_lcp": (*COMMON, "complementarity", "force_sign", "friction_cone", "friction_law"),
    "strict_lcp": (*COMMON, "force_sign", "friction_cone", "friction_law", "physics"), "mpcc": (*COMMON, "force_sign"), "collocation": COMMON,
}  # fmt: skip
# Options that say how large a residual may be, where it is not the method's plan_tolerance; and what the relaxation adds.
LIMITED_BY = {
    ("strict_lcp", "physics"): ("physics_tolerance",),
    ("strict_lcp", "terminal_error"): ("terminal_tolerance",),
    ("mpcc", "terminal_error"): ("terminal_tolerance", "goal_tolerance"),
}
RELAXED = {("relaxed_lcp", "complementarity"): 1e-2, ("relaxed_lcp", "friction_law"): 2e-2}


def limit(name: str, residual: str) -> float:
    options = asdict(load_method(name).options())
    return RELAXED.get((name, residual), 0.0) + sum(options[item] for item in LIMITED_BY.get((name, residual), ("plan_tolerance",)))


def solved(name: str) -> Solution:
    method = load_method(name)
    with method.open(load_scene("wall_pendulum")) as session:
        return session.solve(eps=1e-2 if method.needs_eps else None, warm_start=None, time_limit=60.0)


def told(monkeypatch: pytest.MonkeyPatch, residual: str, value: float) -> None:
    """Every plan is told to miss this residual by that much."""
    true = PlanResiduals.of
    monkeypatch.setattr(PlanResiduals, "of", lambda *given, **named: {**true(*given, **named), residual: value})


@pytest.mark.parametrize("name", PROMISED)
def test_it_is_solved_where_nothing_is_broken(name: str):
    found = solved(name)
    assert found.outcome is Outcome.SOLVED, found.message
    assert "Checked on the plan itself" not in found.message


@pytest.mark.parametrize(("name", "residual"), [(name, residual) for name, residuals in PROMISED.items() for residual in residuals])
def test_a_broken_promise_is_no_solution(name: str, residual: str, monkeypatch: pytest.MonkeyPatch):
    told(monkeypatch, residual, 1.01 * limit(name, residual))
    found = solved(name)
    assert found.outcome is Outcome.STALLED
    assert "Checked on the plan itself" in found.message
    assert f"{residual} is " in found.message
    told(monkeypatch, residual, 0.99 * limit(name, residual))
    assert solved(name).outcome is Outcome.SOLVED
