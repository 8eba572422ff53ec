"""Seeded defects: what a case is there for, made wrong in the product, makes that case fail."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from formulations.mpec import Stationarity
from formulations.solution import Outcome
from models.codegen.kernel import Kernel
from models.contact_law import ContactLaw
from models.trajectory import Trajectory
from validate.stress.cases import (
    h01_stiffness,
    h02_restitution,
    h04_grazing,
    h05_simultaneous,
    h10_out_of_reach,
    h11_overlap,
    h12_biactive,
    h13_b_stationary,
    h14_creep,
    h15_softplus_eps,
    h20_warm_starts,
)


def broken(finding) -> str:
    """Names of the figures that fail."""
    assert not finding.passed
    return "; ".join(figure.name for figure in finding.figures if figure.ok is False)


def test_a_step_that_loses_speed_in_contact(monkeypatch):
    rollout = Kernel.rollout

    def lossy(self, *arguments, **options):
        found = rollout(self, *arguments, **options)
        return replace(found, v=found.v * np.where((found.lam[-1:] == 0.0) & (found.lam.max() > 0.0), 0.95, 1.0))

    monkeypatch.setattr(h02_restitution, "SWEEP", (0.5,))
    monkeypatch.setattr(Kernel, "rollout", lossy)
    assert "restitution" in broken(h02_restitution.measure())


@pytest.mark.slow
def test_a_limit_that_is_twice_too_far(monkeypatch):
    said = h01_stiffness.step_stability
    monkeypatch.setattr(h01_stiffness, "STIFFNESSES", (1e2, 2e4))
    monkeypatch.setattr(h01_stiffness, "SWEPT", 2)
    monkeypatch.setattr(h01_stiffness, "step_stability", lambda scene: said(scene, scene.task.step / math.sqrt(2.0)))
    assert "warned of wrongly" in broken(h01_stiffness.measure())


def test_a_gradient_that_is_one_percent_off(monkeypatch):
    adjoint = Kernel.adjoint
    monkeypatch.setattr(Kernel, "adjoint", lambda self, *a, **o: tuple(1.01 * array for array in adjoint(self, *a, **o)))
    assert "gradient" in broken(h04_grazing.measure())


def test_contacts_whose_order_matters(monkeypatch):
    """The first contact of the list a little stiffer than the others."""
    rolled = h05_simultaneous.rolled

    def biased(scene, **options):
        first, *others = scene.contacts
        return rolled(replace(scene, contacts=(replace(first, stiffness=first.stiffness * (1 + 1e-9)), *others)), **options)

    monkeypatch.setattr(h05_simultaneous, "rolled", biased)
    assert "listed the other way round" in broken(h05_simultaneous.measure())


@pytest.mark.slow
def test_a_goal_out_of_reach_that_is_called_solved(monkeypatch):
    load = h10_out_of_reach.load_method

    class Liar:
        def __init__(self, method):
            self.method = method

        def open(self, scene):
            session = self.method.open(scene)
            solve = session.solve
            session.solve = lambda **given: replace(solve(**given), outcome=Outcome.SOLVED)
            return session

    monkeypatch.setattr(h10_out_of_reach, "METHODS", {"strict_lcp": None})
    monkeypatch.setattr(h10_out_of_reach, "load_method", lambda name: Liar(load(name)))
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
        return replace(scene, contacts=(replace(pair, penetration=2 * r - ((x2 - x1) ** 2 + (y2 - y1) ** 2) ** 0.5),))

    monkeypatch.setattr(h11_overlap, "load_scene", plain)
    monkeypatch.setattr(h11_overlap, "DISTANCES", (0.3, 0.0))
    assert "not finite" in broken(h11_overlap.measure())


@pytest.mark.slow
@pytest.mark.parametrize("case", [h12_biactive, h13_b_stationary])
def test_a_certificate_that_finds_all_points_strongly_stationary(monkeypatch, case):
    certify = case.certify
    monkeypatch.setattr(case, "certify", lambda *a, **o: replace(certify(*a, **o), stationarity=Stationarity.STRONG))
    assert broken(case.measure())


def test_stiction_that_creeps(monkeypatch):
    rolled = h14_creep.rolled
    monkeypatch.setattr(h14_creep, "COEFFICIENTS", (0.2,))
    monkeypatch.setattr(h14_creep, "STEPS", (0.02, 0.01))
    monkeypatch.setattr(h14_creep, "rolled", lambda scene, **given: rolled(scene, **{**given, "law": ContactLaw.SOFTPLUS, "eps": 1e-3}))
    assert "must stick" in broken(h14_creep.measure())


def test_an_eps_above_one_that_is_taken(monkeypatch):
    monkeypatch.setattr("models.codegen.kernel.sharpness", lambda eps, length: abs(math.log(abs(eps))) / length if eps else 1.0 / length)
    finding = h15_softplus_eps.measure()
    assert "accepted nonsense inputs" in broken(finding)
    assert "the compiled law takes 1.5" in next(figure.meaning for figure in finding.figures if figure.ok is False)


def test_a_plan_that_takes_anything(monkeypatch):
    monkeypatch.setattr(h20_warm_starts, "METHODS", {})
    monkeypatch.setattr(Trajectory, "__post_init__", lambda self: None)
    assert "refused" in broken(h20_warm_starts.measure())
