"""Contact laws: closed forms, no overflow, and refusal where they have no meaning."""

import math

import numpy as np
import pytest

from models.contact_law import ContactLaw, RelaxationError, contact_force, sharpness, worst_case_violation

K = 30.0


def test_relu_is_the_true_law():
    assert contact_force(np.array([-1.0, 0.0, 0.5]), K).tolist() == [0.0, 0.0, 15.0]


@pytest.mark.parametrize("eps", [0.999, 0.1, 1e-3, 1e-16, 1e-300])
def test_softplus_is_finite_above_relu_and_right_far_away(eps: float):
    phi = np.array([-1e3, -1.0, 0.0, 1.0, 1e3])
    lam = contact_force(phi, K, ContactLaw.SOFTPLUS, eps)
    assert np.isfinite(lam).all()
    assert (lam >= contact_force(phi, K) * (1 - 1e-15)).all()  # k/b times b*phi rounds
    assert lam[2] == pytest.approx(K * math.log(2) / sharpness(eps), rel=1e-15)
    assert lam[4] == pytest.approx(K * (1e3 + math.log1p(math.exp(-1e3 * sharpness(eps))) / sharpness(eps)), rel=1e-15)


@pytest.mark.parametrize("eps", [0.0, 1.0, -1e-3, 2.0, float("nan"), float("inf"), "1e-3", True, None])
def test_meaningless_eps_is_refused(eps: object):
    with pytest.raises(RelaxationError, match="0 < eps < 1"):
        sharpness(eps)  # pyright: ignore[reportArgumentType] - the mistake under test


def test_worst_case_violation_of_the_paper():
    """PAPER erratum 4: D = (k ln2 / ln eps)^2."""
    for eps, expected in ((1e-3, 9.0619), (1e-5, 3.2623), (1e-7, 1.6644), (1e-9, 1.0069)):
        assert worst_case_violation(K, eps) == pytest.approx(expected, abs=5e-5)


def test_eps_is_counted_in_the_length_of_the_scene():
    """The same eps on a scene a tenth as large reaches a tenth as far: forces and distances shrink alike, and so does what it violates at most."""
    phi = np.linspace(-0.3, 0.1, 9)
    large = contact_force(phi, 30.0, ContactLaw.SOFTPLUS, 1e-3)
    small = contact_force(phi / 10.0, 30.0, ContactLaw.SOFTPLUS, 1e-3, length=0.1)
    assert small == pytest.approx(large / 10.0, rel=1e-14)
    assert sharpness(1e-3, 0.1) == pytest.approx(10.0 * sharpness(1e-3), rel=1e-15)
    assert worst_case_violation(30.0, 1e-3, 0.1) == pytest.approx(worst_case_violation(30.0, 1e-3) / 100.0, rel=1e-14)
