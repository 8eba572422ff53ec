"""How a solve ended, in words: every claim is held against residuals first."""

from __future__ import annotations

import math

from formulations.mpec.candidate import Candidate
from formulations.mpec.certificate.certificate import Certificate
from formulations.mpec.homotopy import Account
from formulations.mpec.settings import Settings
from formulations.solution import Outcome


def verdict(candidate: Candidate, residual: float, certificate: Certificate | None, settings: Settings) -> tuple[Outcome, str]:
    """Outcome and sentence of a candidate that has a point."""
    told = f"{candidate.strategy.name}: " + (
        certificate.sentence if certificate else f"complementarity {residual:.1e}, no certificate asked for"
    )
    if candidate.branch is None and candidate.outcome is not Outcome.SOLVED:
        return candidate.outcome, f"{candidate.message}; {told}"
    if certificate is not None and certificate.lives_on_tolerance:
        told = (
            f"violated by {certificate.forced:.1e} if the pairs held exactly" if certificate.forced < math.inf else "unknown at exact pairs"
        )
        return Outcome.STALLED, f"the point holds only because complementarity is not exact (constraints {told}); {certificate.sentence}"
    if certificate is not None and not certificate.feasible:
        worst = f" (worst: {certificate.worst})" if certificate.worst else ""
        return Outcome.STALLED, f"the point found is not feasible{worst}; {told}"
    if residual > settings.complementarity_tolerance:
        return Outcome.STALLED, f"the pairs could not be decided; {told}"
    if certificate is not None and certificate.b_stationary is False:
        if candidate.unbounded:
            return Outcome.DIVERGED, f"a branch of the problem is unbounded, and a direction goes down towards it; {told}"
        return Outcome.STALLED, f"the point is feasible, but a direction goes down; {told}"
    return Outcome.SOLVED, told


def outcome_without_point(outcome: Outcome, message: str, account: Account) -> tuple[Outcome, str]:
    """Outcome and sentence where no relaxation could be solved."""
    if account.is_over:
        return Outcome.TIME_LIMIT, f"the time limit was reached before any relaxation was solved; {message}"
    if outcome is Outcome.SOLVED:
        return Outcome.FAILED, "no relaxation was solved, for no known reason"
    return outcome, message
