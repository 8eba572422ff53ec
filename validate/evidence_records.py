"""Certificate, starts and front of a Solution -> their records."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from reports.record import CertificateRecord, FrontPointRecord, StartRecord

if TYPE_CHECKING:
    from formulations.mpec import Certificate
    from formulations.solution import Solution
    from models.scene import Scene
    from models.trajectory import Trajectory
    from reports.record import StageRecord


def certificate_record(certificate: Certificate | None) -> CertificateRecord | None:
    if certificate is None:
        return None
    return CertificateRecord(
        holds=certificate.holds,
        feasible=certificate.feasible,
        primal=_finite(certificate.primal),
        worst=certificate.worst,
        complementarity=_finite(certificate.complementarity),
        dual=_finite(certificate.dual),
        letter=certificate.stationarity.letter,
        meaning=certificate.stationarity.value,
        pairs=certificate.pairs,
        biactive=certificate.biactive,
        least=_finite(certificate.least),
        unique=certificate.unique,
        b_stationary=certificate.b_stationary,
        sentence=certificate.sentence,
    )


def start_records(solution: Solution) -> tuple[StartRecord, ...]:
    return tuple(
        StartRecord(
            number=start.number,
            start=start.start,
            outcome=start.outcome.name.lower(),
            cost=_finite(start.cost),
            windows=start.windows,
            seconds=start.seconds,
        )
        for start in solution.starts
    )


def front_records(scene: Scene, solution: Solution) -> tuple[FrontPointRecord, ...]:
    return tuple(
        FrontPointRecord(
            tolerance=point.tolerance,
            outcome=point.solution.outcome.name.lower(),
            cost=_finite(point.solution.cost),
            terminal_error=_finite(point.solution.residuals.get("discrete_terminal_error")),
            windows=_windows(scene, point.solution.trajectory),
            certificate=certificate_record(point.solution.certificate),
        )
        for point in solution.front
    )


def with_certificate(record: StageRecord, scene: Scene, solution: Solution) -> StageRecord:
    """The record of the same stage, now that its plan and those of its front are certified."""
    told = {"certificate": certificate_record(solution.certificate), "front": front_records(scene, solution)}
    return record.model_copy(update=told)


def _windows(scene: Scene, plan: Trajectory | None) -> tuple[tuple[str, int, int], ...]:
    """(contact, first step, last step) of each time a force acts."""
    if plan is None:
        return ()
    found = []
    for contact, force in zip(scene.contacts, plan.lam.T, strict=False):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], force > 0, [False]]).astype(int)))
        found += [(contact.name, int(first), int(stop) - 1) for first, stop in zip(edges[::2], edges[1::2], strict=True)]
    return tuple(found)


def _finite(value: float | None) -> float | None:
    return float(value) if value is not None and math.isfinite(value) else None
