"""The true motion over each step of a plan, from the plan's own states and under its inputs: small steps of the compiled kernel, as many as it takes.

A step is cut into 50 parts, and into twice as many until twice as many change its end by less than
a thousandth of what the plan's steps turn over: a light body in a strong damper, or a hard bounce
within one step, needs thousands. Where none are enough, a thousandth of the force that unexplained
ones are measured by is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from models.codegen.kernel import Kernel
from validate.judge.replay.wiring import HeldInputs
from validate.judge.score.verdict import Unmeasured

_FIRST = 50
_DOUBLINGS = 8
# What 200 small steps, each of which rounds, may lose of a number of doubles.
ROUNDED = 100.0 * float(np.finfo(float).eps)
# Of the largest change of momentum in a step: a hundredth of what unexplained_force allows.
_SETTLED = 1e-3
# Newton steps towards a velocity, and what is then missed at most: in nominals, of a shorter step
# by the square of its share of the longest, as the force that would make up for it is the miss over
# h^2; no less than the rounding of a position.
_SHOTS = 20
_MISSED = 1e-10

# Parts of steps in one call of the kernel: 200 MB for three carts.
_AT_ONCE = 2_000_000

Size = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, kw_only=True, eq=False)
class OwnSteps:
    """The true motion over each step.

    ends (steps, 2 nq): true states at the ends of the steps; least, most (steps, nl): forces of the
    true law within them [N].
    """

    ends: np.ndarray
    least: np.ndarray
    most: np.ndarray


@dataclass(frozen=True, kw_only=True, eq=False)
class Departures:
    """The velocities with which the true motion arrives at each next position.

    v (steps, nq): at the starts of the steps; last (nq,): at the end of the last; missed (steps,
    nq) [m]: by how much it does not arrive; gains (steps,) [1/s]: by how much a position that is
    off by 1 changes them.
    """

    v: np.ndarray
    last: np.ndarray
    missed: np.ndarray
    gains: np.ndarray


class Stepper:
    """Of one plan's inputs and their grid."""

    def __init__(self, kernel: Kernel, held: HeldInputs) -> None:
        self._kernel, self._held, self._h = kernel, held, np.diff(held.times)

    def run(self, x: np.ndarray, size: Size, scale: float, force: Callable[[], float]) -> OwnSteps:
        """The true motion over each step, in as many parts as it takes.

        Parameters
        ----------
        x : (steps, 2*nq) states at the starts [m or rad], [m/s or rad/s].
        size : (n,) of velocities (n, nq), with their step's mass.
        scale : what that is measured by.
        force : what a mean force over a step is measured by, in the norm of M^-1 [kg^0.5 m/s^2]:
            asked where no number of parts settles by `scale`.

        Raises
        ------
        Unmeasured : where no number of parts settles.
        """
        nq, steps = x.shape[1] // 2, np.arange(len(x))
        found, off = self._parts(steps, x, _FIRST), np.full(len(x), np.inf)
        lost = ROUNDED * np.maximum(size(np.abs(x[:, nq:])), size(np.abs(x[:, :nq])) / self._h)
        ends, least, most = found.ends.copy(), found.least.copy(), found.most.copy()
        for doubling in range(1, _DOUBLINGS + 1):
            finer = self._parts(steps, x[steps], _FIRST * 2**doubling)
            with np.errstate(invalid="ignore", over="ignore"):
                change = np.zeros((2, len(x), nq))
                change[0, steps] = finer.ends[:, nq:] - ends[steps, nq:]
                change[1, steps] = (finer.ends[:, :nq] - ends[steps, :nq]) / self._h[steps, None]
                off = np.maximum(size(change[0]), size(change[1]))[steps]
            ends[steps], least[steps], most[steps] = finer.ends, finer.least, finer.most
            open_yet = ~(
                off <= _SETTLED * scale + lost[steps]
            )  # not a number is not settled either
            steps, off = steps[open_yet], off[open_yet]
            if not len(steps):
                break
        # A body that rests turns over nothing, and one that bounces in every part is told by no
        # number of them: what counts is the force that is left open.
        steps = steps[~(off <= _SETTLED * force() * self._h[steps])] if len(steps) else steps
        if len(steps):
            raise Unmeasured(
                f"the true motion from the plan's own state at t = {self._held.times[steps[0]]:g} s, over one step, is not to be had: {_FIRST * 2**_DOUBLINGS} "
                "parts of the step do not tell it."
            )
        return OwnSteps(ends=ends, least=least, most=most)

    def _parts(self, steps: np.ndarray, x: np.ndarray, parts: int) -> OwnSteps:
        """Of some of the steps, (n,) their places, from states x (n, 2 nq); each in so many parts.

        Not a number where it leaves every bound.
        """
        nl, held = self._kernel.scene.nl, self._held
        ends, least, most = np.empty_like(x), np.empty((len(x), nl)), np.empty((len(x), nl))
        for rows in self._alike(steps, parts):
            h = self._h[steps[rows[0]]]
            within = (np.arange(parts) + 0.5)[None, :, None] * (h / parts)
            u = held.values[steps[rows], None] + held.slopes[steps[rows], None] * within
            lam, ends[rows] = self._kernel.rollouts(x[rows], u, float(h) / parts)
            least[rows], most[rows] = lam.min(axis=1), lam.max(axis=1)
        return OwnSteps(ends=ends, least=least, most=most)

    def _alike(self, steps: np.ndarray, parts: int) -> Iterator[np.ndarray]:
        """Places among the steps of those that are equally long, so many at a time that they fit in memory."""
        lengths = np.round(self._h[steps] / self._h.max(), 9)
        for length in sorted(set(lengths.tolist())):  # numpy.unique imports masked arrays: 10 ms
            rows = np.flatnonzero(lengths == length)
            yield from np.array_split(rows, -(-len(rows) * parts // _AT_ONCE))

    def departures(self, q: np.ndarray, v0: np.ndarray, nominal: np.ndarray) -> Departures:
        """The velocities that lead from each position to the next.

        The first guess is that with which the step before arrived.

        Parameters
        ----------
        q : (nodes, nq) positions [m or rad].
        v0 : (nq,) velocities of the task's start [m/s or rad/s].
        nominal : (nq,) typical sizes of the positions [m or rad].

        Raises
        ------
        numpy.linalg.LinAlgError : if a Newton matrix has no pseudo-inverse.
        """
        found, missed, gains, before = (
            np.empty((len(q) - 1, q.shape[1])),
            np.empty((len(q) - 1, q.shape[1])),
            np.empty(len(q) - 1),
            v0,
        )
        enough = _SETTLED * float(
            np.abs(np.diff(q, axis=0) / self._h[:, None]).max()
        ) + _MISSED * float(nominal.max())
        near = np.maximum(
            _MISSED * nominal * (self._h / self._h.max())[:, None] ** 2,
            ROUNDED * np.abs(q).max(axis=0),
        )
        for step in range(len(found)):
            best = None
            for guess in (before, (q[step + 1] - q[step]) / self._h[step]):
                one = self._departure(step, q, guess, nominal, near[step], enough)
                best = one if best is None or np.abs(one[2]).max() < np.abs(best[2]).max() else best
                if (np.abs(best[2]) <= near[step]).all():
                    break
            assert best is not None
            found[step], arrived, missed[step], gains[step] = best
            # A step too short to tell a velocity goes on with that of the one before, known as well
            # as there.
            if step and (found[step] == before).all():
                gains[step] = min(gains[step], gains[step - 1])
            before = arrived
        return Departures(v=found, last=before, missed=missed, gains=gains)

    def _departure(
        self,
        step: int,
        q: np.ndarray,
        v: np.ndarray,
        nominal: np.ndarray,
        near: np.ndarray,
        enough: float,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
        """The velocity, that of arrival, what is missed, and the gain, with so many parts that more change the velocity by less than `enough` [m/s]."""
        before, found = np.full(len(v), np.inf), self._newton(step, q, v, nominal, near, _FIRST)
        for doubling in range(2, _DOUBLINGS + 1, 2):
            if np.abs(found[0] - before).max() <= enough:
                break
            before, found = (
                found[0],
                self._newton(step, q, found[0], nominal, near, _FIRST * 2**doubling),
            )
        return found

    def _newton(
        self,
        step: int,
        q: np.ndarray,
        v: np.ndarray,
        nominal: np.ndarray,
        near: np.ndarray,
        parts: int,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
        """The best of some steps, each halved until it is better: friction that sticks makes corners."""
        nq, h = q.shape[1], self._h[step]
        places, nudge = np.full(nq + 1, step), 1e-6 * nominal / h
        best, move = None, np.zeros(nq)
        for _ in range(_SHOTS):
            x = np.tile(np.concatenate([q[step], v + move]), (nq + 1, 1))
            x[1:, nq:] += np.diag(nudge)
            ends = self._parts(places, x, parts).ends
            miss = q[step + 1] - ends[0, :nq]
            if best is None or np.abs(miss).max() < np.abs(best[2]).max():
                slope = np.nan_to_num((ends[1:, :nq] - ends[0, :nq]).T / nudge)
                inverse = np.linalg.pinv(slope, rcond=1e-6)
                v, move = v + move, inverse @ np.nan_to_num(miss)
                best = (
                    v,
                    ends[0, nq:],
                    np.nan_to_num(miss, nan=np.inf),
                    float(np.abs(inverse).sum(axis=1).max()),
                )
            else:
                move = move / 2.0
            if (np.abs(best[2]) <= near).all():
                break
        assert best is not None
        return best


def force_window(
    lam: np.ndarray, step_of: np.ndarray, steps: int, mean: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Range of a replay's forces from the step before each of the plan's to the one after.

    A planned force may be one of the start of its step, of its end, or a mean, and a contact may
    open or close a step sooner or later than on the plan's grid.

    Parameters
    ----------
    lam : (n, nc) forces of the replay [N].
    step_of : (n-1,) the plan's step of each piece of the replay's grid [-].
    steps : of the plan.
    mean : (steps, nc) over each step, where it is known [N].

    Returns
    -------
    Least and largest, (steps, nc) each [N].

    Raises
    ------
    ValueError : if a step has no row, or the shapes do not fit.
    """
    first, last = (
        np.searchsorted(step_of, np.arange(steps)),
        np.searchsorted(step_of, np.arange(steps), side="right"),
    )
    least = np.array(
        [lam[i : j + 1].min(axis=0) for i, j in zip(first, last, strict=True)]
    ).reshape(steps, lam.shape[1])
    largest = np.array(
        [lam[i : j + 1].max(axis=0) for i, j in zip(first, last, strict=True)]
    ).reshape(steps, lam.shape[1])
    if mean is not None:
        least, largest = np.minimum(least, mean), np.maximum(largest, mean)
    before, after = [0, *range(steps - 1)], [*range(1, steps), steps - 1]
    return np.minimum(np.minimum(least[before], least), least[after]), np.maximum(
        np.maximum(largest[before], largest), largest[after]
    )


def least_slip(slips: np.ndarray) -> np.ndarray:
    """The slip of least magnitude of each step; 0 where it turns round.

    Parameters
    ----------
    slips : (n, steps, nf) slips of each step [m/s].

    Returns
    -------
    (steps, nf) [m/s]

    Raises
    ------
    ValueError : for no slips.
    """
    low, high = slips.min(axis=0), slips.max(axis=0)
    return np.where(low * high <= 0.0, 0.0, np.where(np.abs(low) < np.abs(high), low, high))
