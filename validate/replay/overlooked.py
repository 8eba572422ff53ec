"""What an integrator steps over: a gap that closes and opens again between two of its steps leaves no change of sign behind.

    overlooked(scene, replayed)      # None, or a step [s] small enough to see it

Between two recorded points of the replay, with no event among them, the gap is the cubic with the gaps and their rates at both ends; a gap that falls at
the first and rises at the second has its least value between. Where that is below zero there was contact that the replay does not know of.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from models.codegen.kernel import Kernel
from models.collocation import penetration_rates
from models.scene import Scene
from validate.replay.everyday import base_step
from validate.replay.job import Settings
from validate.replay.result import Replay
from validate.replay.subject import Subject

# Steps within the contact that was overlooked; and steps in all that are taken for it.
_WITHIN, _MOST = 8, 1_000_000
_MOST_PARTS = 3000


def lowest_between(t: np.ndarray, gap: np.ndarray, rate: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n-1, nc) each: the least value of the cubic between two rows, and where, as a share of the piece; at an end where it falls or rises throughout.

    gap, rate (n, nc) [m, m/s] at t (n,).
    """
    h = np.diff(t)[:, None]
    first, last, slope_first, slope_last = gap[:-1], gap[1:], h * rate[:-1], h * rate[1:]
    # g(s) = first + b s + c s^2 + d s^3
    b, c, d = slope_first, 3.0 * (last - first) - 2.0 * slope_first - slope_last, 2.0 * (first - last) + slope_first + slope_last
    with np.errstate(divide="ignore", invalid="ignore"):
        root = np.sqrt(c * c - 3.0 * d * b)
        inner = np.stack([b / -(c + root), b / -(c - root)])  # of g'(s) = b + 2 c s + 3 d s^2, in the form that d = 0 does not harm
    places = np.clip(
        np.nan_to_num(np.concatenate([inner, [np.zeros_like(first), np.ones_like(first)]]), nan=0.0, posinf=1.0, neginf=0.0), 0.0, 1.0
    )
    values = first + places * (b + places * (c + places * d))
    best = values.argmin(axis=0)[None]
    return np.take_along_axis(values, best, 0)[0], np.take_along_axis(places, best, 0)[0]


def overlooked(kernel: Kernel, replayed: Replay) -> float | None:
    """None, or the step [s] with which a contact that the replay stepped over is seen."""
    if len(replayed.t) < 2:
        return None
    h = np.diff(replayed.t)[:, None]
    rate = -penetration_rates(kernel, replayed.q, replayed.v)
    lowest, _ = lowest_between(replayed.t, replayed.gap, rate)
    dips = (replayed.gap[:-1] > 0.0) & (replayed.gap[1:] > 0.0) & (rate[:-1] < 0.0) & (rate[1:] > 0.0) & (lowest < 0.0) & (h > 0.0)
    if not dips.any():
        return None
    bend = (rate[1:] - rate[:-1])[dips] / np.broadcast_to(h, dips.shape)[dips]
    return float(np.min(2.0 * np.sqrt(-2.0 * lowest[dips] / bend))) / _WITHIN


def with_steps_of(subject: Subject, times: np.ndarray, settings: Settings) -> Settings:
    """Settings for a plan of nodes `times` [s], however long its steps are: nothing is seen less often than on the task's own grid."""
    step = float(subject.task.step)  # type: ignore[union-attr] - every subject that is replayed has one
    longest = math.ceil(float(np.diff(times).max()) / step - 1e-6)
    parts = min(settings.parts * max(1, longest), _MOST_PARTS)
    factor = max(1, math.ceil(base_step(times) / step - 1e-6))
    return replace(settings, parts=parts, fineness=tuple(factor * fineness for fineness in settings.fineness))


def with_max_step(scene: Scene, times: np.ndarray, settings: Settings, longest: float) -> Settings | None:
    """The same with integrator steps of at most `longest` [s], in the everyday replay too; None where that takes more than a million."""
    if np.ptp(times) / longest > _MOST:
        return None
    factor = max(1, math.ceil(base_step(times) / min(settings.fineness, default=1) / longest))
    return replace(settings, max_step=longest, fineness=tuple(factor * fineness for fineness in settings.fineness))
