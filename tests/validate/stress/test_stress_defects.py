"""Seeded defects: a wrong sign, a wrong step or a loosened tolerance in the product makes the stress case fail that is there for it."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from formulations.certificate.stationarity import Stationarity
from formulations.solution import Outcome
from models.catalog import load_scene
from models.codegen.kernel import Kernel
from models.contact_law import ContactLaw
from models.trajectory import Hold
from validate.judge.replay import Difference
from validate.stress import motion
from validate.stress.cases import (
    h01_stiffness,
    h02_restitution,
    h03_mass_ratio,
    h04_grazing,
    h05_simultaneous,
    h06_zeno,
    h07_unstable,
    h08_long_horizon,
    h09_dead_relu,
    h10_out_of_reach,
    h11_overlap,
    h12_biactive,
    h14_creep,
    h16_units,
    h18_hold,
    h19_chatter,
    h21_float32,
)


def broken(finding) -> str:
    """Names of the figures that fail."""
    assert not finding.passed
    return "; ".join(figure.name for figure in finding.figures if figure.ok is False)


def test_a_step_that_loses_speed_in_contact(monkeypatch):
    rollout = Kernel.rollout

    def lossy(self, *arguments, **options):
        found = rollout(self, *arguments, **options)
        return replace(
            found,
            v=found.v * np.where((found.lam[-1:] == 0.0) & (found.lam.max() > 0.0), 0.95, 1.0),
        )

    monkeypatch.setattr(h02_restitution, "SWEEP", (0.5,))
    monkeypatch.setattr(Kernel, "rollout", lossy)
    assert "restitution" in broken(h02_restitution.measure())


@pytest.mark.slow
def test_a_limit_that_is_twice_too_far(monkeypatch):
    said = h01_stiffness.step_stability
    monkeypatch.setattr(h01_stiffness, "STIFFNESSES", (1e2, 2e4))
    monkeypatch.setattr(h01_stiffness, "SWEPT", 2)
    monkeypatch.setattr(
        h01_stiffness,
        "step_stability",
        lambda scene: said(scene.with_task(step=scene.task.step / math.sqrt(2.0))),
    )
    assert "warned of wrongly" in broken(h01_stiffness.measure())


def test_a_gradient_that_is_one_percent_off(monkeypatch):
    adjoint = Kernel.adjoint
    monkeypatch.setattr(
        Kernel,
        "adjoint",
        lambda self, *a, **o: tuple(1.01 * array for array in adjoint(self, *a, **o)),
    )
    assert "gradient" in broken(h04_grazing.measure())


@pytest.mark.slow
def test_contacts_whose_order_matters(monkeypatch):
    """The first contact of the list a little stiffer than the others."""
    rolled = motion.rolled

    def biased(scene, **options):
        first, *others = scene.contacts
        return rolled(
            replace(
                scene, contacts=(replace(first, stiffness=first.stiffness * (1 + 1e-9)), *others)
            ),
            **options,
        )

    monkeypatch.setattr(motion, "rolled", biased)
    assert "listed the other way round" in broken(h05_simultaneous.measure())


@pytest.mark.slow
def test_a_goal_out_of_reach_that_is_called_solved(monkeypatch):
    monkeypatch.setattr(h10_out_of_reach, "METHODS", {"strict_lcp": None})
    changed(
        monkeypatch, h10_out_of_reach, lambda solution: replace(solution, outcome=Outcome.SOLVED)
    )
    finding = h10_out_of_reach.measure()
    assert "do not say so" in broken(finding)
    assert "hands back a plan" in finding.figures[0].meaning


@pytest.mark.slow
def test_coincident_centres_without_a_direction(monkeypatch):
    """The scene with the plain distance, whose gradient is 0/0 there."""
    load = h11_overlap.load_scene

    def plain(name: str):
        scene = load(name)
        pair = scene.contacts[0]
        x1, y1, x2, y2 = (coordinate.symbol for coordinate in scene.coordinates)
        r = next(parameter.symbol for parameter in scene.parameters if parameter.name == "r")
        return replace(
            scene,
            contacts=(replace(pair, penetration=2 * r - ((x2 - x1) ** 2 + (y2 - y1) ** 2) ** 0.5),),
        )

    monkeypatch.setattr(h11_overlap, "load_scene", plain)
    monkeypatch.setattr(h11_overlap, "DISTANCES", (0.3, 0.0))
    assert "not finite" in broken(h11_overlap.measure())


@pytest.mark.slow
def test_a_certificate_that_finds_all_points_strongly_stationary(monkeypatch):
    certify = h12_biactive.certify
    monkeypatch.setattr(
        h12_biactive,
        "certify",
        lambda *a, **o: replace(certify(*a, **o), stationarity=Stationarity.STRONG),
    )
    assert broken(h12_biactive.measure())


@pytest.mark.slow
def test_stiction_that_creeps(monkeypatch):
    rolled = motion.rolled
    monkeypatch.setattr(h14_creep, "COEFFICIENTS", (0.2,))
    monkeypatch.setattr(h14_creep, "STEPS", (0.01, 0.005))
    monkeypatch.setattr(
        motion,
        "rolled",
        lambda scene, **given: rolled(scene, **{**given, "law": ContactLaw.SOFTPLUS, "eps": 1e-3}),
    )
    assert "must stick" in broken(h14_creep.measure())


def changed(monkeypatch, case, change):
    """All methods of a case hand back what `change` makes of their solutions."""
    solved = case.solved
    monkeypatch.setattr(case, "solved", lambda *a, **o: change(solved(*a, **o)))


# Of carts that cost and err as they should.
PLANNED = h03_mass_ratio._Planned(limit=0.026, plans=[(1.0, 240.0, 0.01)])


def test_a_replay_with_another_stiffness(monkeypatch):
    """A millionth more: the contact time is half of that too short."""
    replayed = motion.replayed
    monkeypatch.setattr(h03_mass_ratio, "RATIOS", (1e-4,))
    monkeypatch.setattr(h03_mass_ratio, "planned", lambda: PLANNED)
    monkeypatch.setattr(
        motion,
        "replayed",
        lambda scene, plan, **given: replayed(
            scene.with_parameters(k=(1.0 + 1e-6) * scene.parameter_values[_k(scene)]), plan, **given
        ),
    )
    assert broken(h03_mass_ratio.measure()) == "relative error of the contact time"


def test_a_plan_that_loses_momentum_in_contact(monkeypatch):
    rolled = motion.rolled

    def lossy(scene, **options):
        plan = rolled(scene, **options)
        return replace(plan, v=plan.v * [[1.0, 1.0 + 1e-9]])

    monkeypatch.setattr(h03_mass_ratio, "RATIOS", (1.0,))
    monkeypatch.setattr(h03_mass_ratio, "planned", lambda: PLANNED)
    monkeypatch.setattr(motion, "rolled", lossy)
    assert "momentum of the plan's time step" in broken(h03_mass_ratio.measure())


@pytest.mark.slow
@pytest.mark.parametrize("defect", ["warning", "replay", "goal"])
def test_plans_of_unequal_masses_that_are_warned_of_wrongly_or_do_not_hold(
    monkeypatch, defect: str
):
    """A limit four times too near; a replay of carts a tenth heavier.

    A method that gives up where there is a plan.
    """
    said, replayed = h03_mass_ratio.step_stability, h03_mass_ratio.replayed
    monkeypatch.setattr(h03_mass_ratio, "simulated", lambda: (np.zeros((4, 1)), []))
    monkeypatch.setattr(h03_mass_ratio, "RATIOS", (1.0,))
    monkeypatch.setattr(h03_mass_ratio, "PLANNED", (1e-1,) if defect == "warning" else (1e1,))
    if defect == "warning":
        monkeypatch.setattr(
            h03_mass_ratio,
            "step_stability",
            lambda scene: said(scene.with_task(step=4.0 * scene.task.step)),
        )
    elif defect == "replay":
        monkeypatch.setattr(
            h03_mass_ratio,
            "replayed",
            lambda scene, plan, like: replayed(scene.with_parameters(m=1.1), plan, like=like),
        )
    else:
        chained = h03_mass_ratio._chained
        monkeypatch.setattr(
            h03_mass_ratio,
            "_chained",
            lambda scene: replace(chained(scene), outcome=Outcome.STALLED, trajectory=None),
        )
    failed = broken(h03_mass_ratio.measure())
    assert ("largest replay error" if defect == "replay" else "neither planned nor told") in failed


def _k(scene):
    return next(parameter.symbol for parameter in scene.parameters if parameter.name == "k")


def test_a_budget_of_events_that_nobody_keeps(monkeypatch):
    replayed = h06_zeno.replayed
    monkeypatch.setattr(
        h06_zeno, "replayed", lambda scene, plan, event_budget=None: replayed(scene, plan)
    )
    assert broken(h06_zeno.measure()) == "what does not end, or is not told"


def test_growth_of_other_equations_and_descent_that_keeps_silent(monkeypatch):
    """The steps of a pole under half the gravity; and `solved`, whatever happened."""
    steps = h07_unstable.load_steps
    monkeypatch.setattr(h07_unstable, "ITERATIONS", 2)
    monkeypatch.setattr(
        h07_unstable, "load_steps", lambda scene: steps(scene.with_parameters(g=4.9))
    )
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
    monkeypatch.setattr(h08_long_horizon, "TIME_EXPONENT", 100.0)

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
    solved = h09_dead_relu.solved
    monkeypatch.setattr(
        h09_dead_relu,
        "solved",
        lambda scene, method, eps=None, plan=None, **given: solved(
            scene, method, eps, **{**given, "max_iterations": 20}
        ),
    )
    assert "terminal position error after smoothing" in broken(h09_dead_relu.measure())


@pytest.mark.slow
def test_a_length_that_is_hidden_in_the_law_and_an_optimum_that_depends_on_it(monkeypatch):
    """A micrometre, or a thousandth of one where lengths are millimetres.

    A cost that is a hundred-thousandth dearer there.
    """
    rolled = h16_units.rolled

    def shifted(scene, **given):
        contacts = tuple(
            replace(contact, penetration=contact.penetration + 1e-6) for contact in scene.contacts
        )
        return rolled(replace(scene, contacts=contacts), **given)

    metres = motion.solved(load_scene("three_cart"), "mpcc", seconds=20.0, search=False)
    dearer = replace(metres, cost=(1.0 + 1e-5) * metres.cost)
    monkeypatch.setattr(
        h16_units,
        "solved",
        lambda scene, method, **given: metres if scene.length == 1.0 else dearer,
    )
    monkeypatch.setattr(h16_units, "rolled", shifted)
    failed = broken(h16_units.measure())
    assert "plan's step: difference after rescaling" in failed
    assert "relative difference of the costs" in failed


@pytest.mark.slow
def test_a_replay_that_holds_what_a_plan_joins(monkeypatch):
    replayed = h18_hold.replayed
    monkeypatch.setattr(h18_hold, "COUNTS", (10, 40))
    monkeypatch.setattr(h18_hold, "FINE", 320)
    monkeypatch.setattr(
        h18_hold,
        "replayed",
        lambda scene, plan: replayed(scene, replace(plan, hold=Hold.ZERO_ORDER)),
    )
    assert "order with lines" in broken(h18_hold.measure())


def test_a_replay_that_does_not_converge_and_is_believed(monkeypatch):
    """Its differences do not shrink with its step, and the verdict is one all the same."""
    replayed = h19_chatter.replayed

    def stuck(scene, plan, **given):
        told = replayed(scene, plan, **given)
        same = Difference(position=1e-6, state=1e-6, gap=1e-6)
        return replace(told, error=replace(told.error, step=same))

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
            lambda scene, u, start, **given: tuple(
                part.to(start.dtype) for part in reference(scene, u.float(), start.float(), **given)
            ),
        )
        assert "error of float64" in broken(h21_float32.measure())
    else:
        monkeypatch.setattr(
            h21_float32, "rollout", lambda scene, u: compiled(scene, u.to(torch.float64))
        )
        assert "what is taken in float32" in broken(h21_float32.measure())
