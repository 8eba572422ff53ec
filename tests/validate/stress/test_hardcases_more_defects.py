"""The other half of the seeded defects: a wrong sign, a wrong step or a loosened tolerance in the product makes the case fail."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import torch

from formulations.solution import Outcome
from models.catalog import load_scene
from models.codegen.kernel import Kernel
from models.trajectory import Hold
from validate.stress.cases import (
    h03_mass_ratio,
    h06_zeno,
    h07_unstable,
    h08_long_horizon,
    h09_dead_relu,
    h16_units,
    h17_front,
    h18_hold,
    h19_chatter,
    h21_float32,
)


def broken(finding) -> str:
    """Names of the figures that fail."""
    assert not finding.passed
    return "; ".join(figure.name for figure in finding.figures if figure.ok is False)


class Changed:
    """A method whose sessions hand back what `change` makes of their solutions."""

    def __init__(self, method, change):
        self.method, self.change = method, change

    def open(self, scene, options=None):
        session = self.method.open(scene, options or {})
        solve = session.solve
        session.solve = lambda **given: self.change(solve(**given))
        return session


def changed(monkeypatch, case, change):
    """All methods of a case, changed so."""
    load = case.load_method
    monkeypatch.setattr(case, "load_method", lambda name: Changed(load(name), change))


# Of carts that cost and err as they should.
PLANNED = h03_mass_ratio._Planned(limit=0.026, ratios=[1.0], costs=[240.0], errors=[0.01])


def test_a_replay_with_another_stiffness(monkeypatch):
    """A millionth more: the contact time is half of that too short."""
    replayed = h03_mass_ratio.replayed
    monkeypatch.setattr(h03_mass_ratio, "RATIOS", (1e-4,))
    monkeypatch.setattr(h03_mass_ratio, "planned", lambda: PLANNED)
    monkeypatch.setattr(
        h03_mass_ratio,
        "replayed",
        lambda scene, plan, **given: replayed(scene.with_parameters(k=(1.0 + 1e-6) * scene.parameter_values[_k(scene)]), plan, **given),
    )
    assert broken(h03_mass_ratio.measure()) == "relative error of the contact time"


def test_a_plan_that_loses_momentum_in_contact(monkeypatch):
    rolled = h03_mass_ratio.rolled

    def lossy(scene):
        plan = rolled(scene)
        return replace(plan, v=plan.v * [[1.0, 1.0 + 1e-9]])

    monkeypatch.setattr(h03_mass_ratio, "RATIOS", (1.0,))
    monkeypatch.setattr(h03_mass_ratio, "planned", lambda: PLANNED)
    monkeypatch.setattr(h03_mass_ratio, "rolled", lossy)
    assert "momentum of the plan's time step" in broken(h03_mass_ratio.measure())


@pytest.mark.slow
@pytest.mark.parametrize("defect", ["warning", "replay", "goal"])
def test_plans_of_unequal_masses_that_are_warned_of_wrongly_or_do_not_hold(monkeypatch, defect: str):
    """A limit four times too near; a replay of carts a tenth heavier; a method that gives up where there is a plan."""
    said, replayed = h03_mass_ratio.step_stability, h03_mass_ratio.replayed
    monkeypatch.setattr(h03_mass_ratio, "simulated", lambda: h03_mass_ratio._Simulated([0.0], [0.0], [0.0], [0.0]))
    monkeypatch.setattr(h03_mass_ratio, "RATIOS", (1.0,))
    monkeypatch.setattr(h03_mass_ratio, "PLANNED", (1e-1,) if defect == "warning" else (1e1,))
    if defect == "warning":
        monkeypatch.setattr(h03_mass_ratio, "step_stability", lambda scene: said(scene, 4.0 * scene.task.step))
    elif defect == "replay":
        monkeypatch.setattr(h03_mass_ratio, "replayed", lambda scene, plan, like: replayed(scene.with_parameters(m=1.1), plan, like=like))
    else:
        changed(monkeypatch, h03_mass_ratio, lambda solution: replace(solution, outcome=Outcome.STALLED, trajectory=None))
    failed = broken(h03_mass_ratio.measure())
    assert ("largest replay error" if defect == "replay" else "neither planned nor told") in failed


def _k(scene):
    return next(parameter.symbol for parameter in scene.parameters if parameter.name == "k")


def test_a_budget_of_events_that_nobody_keeps(monkeypatch):
    replayed = h06_zeno.replayed
    monkeypatch.setattr(h06_zeno, "replayed", lambda scene, plan, event_budget=None: replayed(scene, plan))
    assert broken(h06_zeno.measure()) == "what does not end, or is not told"


def test_growth_of_other_equations_and_descent_that_keeps_silent(monkeypatch):
    """The steps of a pole under half the gravity; and `solved`, whatever happened."""
    steps = h07_unstable.load_steps
    monkeypatch.setattr(h07_unstable, "ITERATIONS", 2)
    monkeypatch.setattr(h07_unstable, "load_steps", lambda scene: steps(scene.with_parameters(g=4.9)))
    changed(monkeypatch, h07_unstable, lambda solution: replace(solution, outcome=Outcome.SOLVED))
    failed = broken(h07_unstable.measure())
    assert "growth rate of the gradient" in failed
    assert "what descent kept silent about" in failed


@pytest.mark.slow
def test_an_adjoint_that_is_a_hundred_thousandth_off(monkeypatch):
    adjoint = Kernel.adjoint
    monkeypatch.setattr(h08_long_horizon, "LENGTHS", (500, 1000))
    monkeypatch.setattr(h08_long_horizon, "MODEL_LENGTHS", (50, 100))
    monkeypatch.setattr(h08_long_horizon, "EXPONENT", 100.0)  # seconds are for the campaign
    monkeypatch.setattr(h08_long_horizon, "A_STEP", 100.0)

    def wrong(self: Kernel, *arguments: object, **bars: object) -> tuple[Any, Any]:
        u_bar, start_bar = adjoint(self, *arguments, **bars)
        return (1.0 + 1e-5) * u_bar, start_bar

    monkeypatch.setattr(Kernel, "adjoint", wrong)
    assert "adjoint against differences" in broken(h08_long_horizon.measure())


@pytest.mark.slow
def test_a_dead_descent_without_a_diagnosis(monkeypatch):
    changed(monkeypatch, h09_dead_relu, lambda solution: replace(solution, message="stopped."))
    assert "what the diagnosis lacks" in broken(h09_dead_relu.measure())


def test_smoothing_that_is_lost_on_the_way(monkeypatch):
    """The relaxed plans are not handed on: the last descent starts as dead as the first."""
    run = h09_dead_relu._run
    monkeypatch.setattr(
        h09_dead_relu, "_run", lambda scene, method, eps, plan, iterations: run(scene, method, eps, None, min(iterations, 20))
    )
    assert "terminal position error after smoothing" in broken(h09_dead_relu.measure())


@pytest.mark.slow
def test_a_length_that_is_hidden_in_the_law_and_an_optimum_that_depends_on_it(monkeypatch):
    """A micrometre, or a thousandth of one where lengths are millimetres; a cost that is a hundred-thousandth dearer there."""
    rolled = h16_units.rolled

    def shifted(scene, **given):
        contacts = tuple(replace(contact, penetration=contact.penetration + 1e-6) for contact in scene.contacts)
        return rolled(replace(scene, contacts=contacts), **given)

    metres = h16_units._solved(load_scene("three_cart"))
    assert metres.cost is not None
    dearer = replace(metres, cost=(1.0 + 1e-5) * metres.cost)
    monkeypatch.setattr(h16_units, "_solved", lambda scene: metres if scene.length == 1.0 else dearer)
    monkeypatch.setattr(h16_units, "rolled", shifted)
    failed = broken(h16_units.measure())
    assert "plan's step: difference after rescaling" in failed
    assert "relative difference of the costs" in failed


@pytest.mark.slow
def test_a_front_whose_plans_end_elsewhere(monkeypatch):
    """Inputs a thousandth stronger than those that were certified."""

    def stronger(solution):
        def point(item):
            plan = item.solution.trajectory
            return replace(item, solution=replace(item.solution, trajectory=replace(plan, u=1.001 * plan.u)))

        return replace(solution, front=tuple(point(item) for item in solution.front))

    monkeypatch.setattr(h17_front, "TOLERANCES", (0.0, 0.1))
    monkeypatch.setattr(h17_front, "certify_solution", lambda scene, solution: solution)  # a certificate of other inputs would say nothing
    changed(monkeypatch, h17_front, stronger)
    assert "end beyond its tolerance, true contact law" in broken(h17_front.measure())


@pytest.mark.slow
def test_a_replay_that_holds_what_a_plan_joins(monkeypatch):
    replayed = h18_hold.replayed
    monkeypatch.setattr(h18_hold, "COUNTS", (10, 40))
    monkeypatch.setattr(h18_hold, "FINE", 320)
    monkeypatch.setattr(h18_hold, "replayed", lambda scene, plan: replayed(scene, replace(plan, hold=Hold.ZERO_ORDER)))
    assert "order with lines" in broken(h18_hold.measure())


def test_a_replay_that_does_not_converge_and_is_believed(monkeypatch):
    """Its differences do not shrink with its step, and the verdict is one all the same."""
    replayed = h19_chatter.replayed

    def stuck(scene, plan, **given):
        told = replayed(scene, plan, **given)
        return replace(told, error=replace(told.error, step_ratio=1.0))

    monkeypatch.setattr(h19_chatter, "replayed", stuck)
    failed = broken(h19_chatter.measure())
    assert "neither converging nor marked" in failed
    assert "ratio of the differences" in failed


@pytest.mark.parametrize("defect", ["reference", "compiled"])
def test_float32_where_float64_is_said(monkeypatch, defect: str):
    reference, compiled = h21_float32.reference_rollout, h21_float32.rollout
    monkeypatch.setattr(h21_float32, "STEPS", 200)
    if defect == "reference":
        monkeypatch.setattr(
            h21_float32,
            "reference_rollout",
            lambda scene, u, start, **given: tuple(part.to(start.dtype) for part in reference(scene, u.float(), start.float(), **given)),
        )
        assert "error of float64" in broken(h21_float32.measure())
    else:
        monkeypatch.setattr(h21_float32, "rollout", lambda scene, u: compiled(scene, u.to(torch.float64)))
        assert "what is taken in float32" in broken(h21_float32.measure())
