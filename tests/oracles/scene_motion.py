"""The motion that inputs give in a scene, by an integration that shares no code with the judge: no kernel, no FMU, no `models.dynamics`.

    truth = Motion(load_scene("three_cart"))
    # inputs held over each step; path.q, path.v at t, path.lam_mean, path.depth ..
    path = truth.run(t, u)

The equations (`scene_equations`) are integrated by SciPy's DOP853 at rtol 1e-11, from one event to the
next: an input jumps, a contact closes or opens, a slip begins, stops or turns. Between events
everything is smooth. A friction that sticks gives whatever keeps the slip's rate at 0, one that
slips gives mu N against the slip. Undamped contacts only.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from scipy.integrate import DOP853
from scipy.optimize import brentq

from tests.oracles.scene_equations import FREE, STICK, Equations

RTOL = 1e-11
ATOL = 1e-13
# Events within one step of a plan; more is a motion that cannot be followed.
MOST_EVENTS = 2000


@dataclass(frozen=True, kw_only=True)
class Path:
    """A motion at the nodes t (n,), with the forces of the steps between them (n - 1, nc) and (n - 1, nf) [N].

    lam_start, lam_end: the contact forces at the ends of each step; lam_mean, friction_mean:
        impulse over step; friction_start, friction_end: just
    after its start, just before its end. depth (nc,): the deepest penetration [m]. ended: False
        where the motion ran away, and the rest is NaN.
    """

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    lam_start: np.ndarray
    lam_end: np.ndarray
    lam_mean: np.ndarray
    friction_start: np.ndarray
    friction_end: np.ndarray
    friction_mean: np.ndarray
    depth: np.ndarray
    ended: bool


class RanAwayError(Exception):
    """The motion cannot be followed: it grows without bound, or its events pile up."""


class Motion(Equations):
    """The motions of one scene; see the module docstring."""

    def run(
        self, t: np.ndarray, u: np.ndarray, *, nodes: np.ndarray | None = None,
        linear_to: np.ndarray | None = None, rtol: float = RTOL,
        start: np.ndarray | None = None,
    ) -> Path:  # fmt: skip
        """The motion from the task's start (or `start`, (2 nq,)) under u (n - 1, nu), held over the steps of t (n,).

        linear_to: (nu,) inputs at the last node; then they change linearly from node to node.
            nodes: where the path is wanted, t unless given, of the
        same span.
        """
        t = np.asarray(t, dtype=float)
        nodes = t if nodes is None else np.asarray(nodes, dtype=float)
        corners = np.unique(np.concatenate([t, nodes]))
        corners = corners[np.concatenate([[True], np.diff(corners) > 1e-12])]
        ends = None if linear_to is None else np.vstack([u[1:], linear_to])
        state = np.concatenate(
            [self.scene.task.start if start is None else start, np.zeros(self.nc + self.nf)]
        ).astype(float)
        nq, (q, v) = self.nq, (state[: self.nq].tolist(), state[self.nq : 2 * self.nq].tolist())
        closed = [depth > 0.0 for depth in self.phi(q)]
        modes = [FREE] * self.nf
        self._deepest = np.array(self.phi(q)) if self.nc else np.zeros(0)
        states = np.full((len(nodes), len(state)), np.nan)
        ends_of = np.full((2, len(nodes), self.nf), np.nan)  # just after, just before a node
        states[0], at, ended = state, 0, True
        for low, high in itertools.pairwise(corners):
            step = min(int(np.searchsorted(t, low + 1e-12, side="right")) - 1, len(u) - 1)
            slope = (
                np.zeros(self.scene.nu)
                if ends is None
                else (ends[step] - u[step]) / (t[step + 1] - t[step])
            )
            first = u[step] + slope * (low - t[step])
            try:
                q, v = state[:nq].tolist(), state[nq : 2 * nq].tolist()
                modes = self._modes(q, v, first.tolist(), closed, modes)
                if abs(low - nodes[at]) < 1e-12:
                    ends_of[0, at] = self.friction_forces(
                        q, v, first.tolist(), self.contact_forces(q, closed), modes
                    )
                state, closed, modes = self._advance(
                    low, high, state, first, slope, closed, modes, rtol
                )
            except (RanAwayError, OverflowError, np.linalg.LinAlgError, ValueError):
                ended = False
                break
            if at + 1 < len(nodes) and abs(high - nodes[at + 1]) < 1e-12:
                at += 1
                states[at] = state
                q, v = state[:nq].tolist(), state[nq : 2 * nq].tolist()
                last = (first + slope * (high - low)).tolist()
                ends_of[1, at] = self.friction_forces(
                    q, v, last, self.contact_forces(q, closed), modes
                )
        spans = np.diff(nodes)[:, None]
        impulses = np.diff(states[:, 2 * nq :], axis=0) / spans
        force = self.forces(states[:, :nq])
        return Path(
            t=nodes, q=states[:, :nq], v=states[:, nq : 2 * nq], depth=self._deepest, ended=ended,
            lam_start=force[:-1], lam_end=force[1:], lam_mean=impulses[:, : self.nc],
            friction_start=ends_of[0, :-1], friction_end=ends_of[1, 1:],
            friction_mean=impulses[:, self.nc :],
        )  # fmt: skip

    def _modes(
        self, q: list[float], v: list[float], u: list[float], closed: list[bool], modes: list
    ) -> list:
        """After a jump of the inputs, and at the start: what slips goes on, what is at rest is asked again."""
        lam = self.contact_forces(q, closed)
        slips = self.slip(q, v)
        known = [
            mode if mode is STICK else (int(np.sign(s)) if abs(s) > 1e-10 else STICK)
            for mode, s in zip(modes, slips, strict=True)
        ]
        limits = self.limit(q, lam)
        known = [FREE if most <= 0.0 else mode for mode, most in zip(known, limits, strict=True)]
        return self.settled(
            q, v, u, lam, known, [j for j, mode in enumerate(known) if mode is STICK]
        )

    def _advance(self, low, high, state, first, slope, closed, modes, rtol):
        """From low to high, event by event: (state, closed, modes) at high."""
        nq, origin, steady = self.nq, low, not slope.any()
        constant = first.tolist()

        def inputs(time: float) -> list[float]:
            return constant if steady else (first + slope * (time - origin)).tolist()

        def rates(time: float, y: np.ndarray) -> list[float]:
            values = y.tolist()
            q, v, u = values[:nq], values[nq : 2 * nq], inputs(time)
            lam = self.contact_forces(q, closed)
            f = self.friction_forces(q, v, u, lam, modes)
            return [*v, *self.acceleration(q, v, u, lam, f), *lam, *f]

        def watched(time: float, y: np.ndarray) -> list[float]:
            """What must not fall below 0 in this phase."""
            values = y.tolist()
            q, v = values[:nq], values[nq : 2 * nq]
            depths = self.phi(q)
            found = [depth if shut else -depth for depth, shut in zip(depths, closed, strict=True)]
            if self.nf:
                u, lam = inputs(time), self.contact_forces(q, closed)
                f, most, slips = (
                    self.friction_forces(q, v, u, lam, modes),
                    self.limit(q, lam),
                    self.slip(q, v),
                )
                found += [
                    1.0
                    if mode is FREE
                    else (most[j] - abs(f[j]) if mode is STICK else mode * slips[j])
                    for j, mode in enumerate(modes)
                ]
            return found

        longest = min(self.scene.task.step, high - low) / (2.0 if self.nc + self.nf else 1.0)
        guess = longest
        for _ in range(MOST_EVENTS):
            solver = DOP853(
                rates,
                low,
                state,
                high,
                rtol=rtol,
                atol=ATOL,
                max_step=longest,
                first_step=min(guess, high - low),
            )
            before, event = watched(low, state), None
            while solver.status == "running" and event is None:
                solver.step()
                if (
                    solver.status == "failed"
                    or not np.isfinite(solver.y).all()
                    or np.abs(solver.y).max() > 1e8
                ):
                    raise RanAwayError
                guess = max(solver.h_abs, 1e-9)
                after = watched(solver.t, solver.y)
                if self.nc:
                    self._deepest = np.maximum(self._deepest, self.phi(solver.y[:nq].tolist()))
                event = self._first_event(watched, solver, before, after)
                before = after
            if event is None:
                return solver.y, closed, modes
            low, which, state = event
            closed, modes = self._after(which, state, inputs(low), closed, modes)
            if high - low < 1e-13:
                return state, closed, modes
        raise RanAwayError

    def _first_event(self, watched, solver, before, after):
        """(time, which, state) of the earliest that fell below 0 in the last step of the solver, or None."""
        fallen = [i for i, value in enumerate(after) if value < 0.0]
        if not fallen:
            return None
        dense, times = solver.dense_output(), {}
        for i in fallen:
            if before[i] <= 0.0:
                # It began at 0 and went the wrong way: at once, unless that is rounding.
                if after[i] > -1e-13:
                    continue
                times[i] = solver.t_old
            else:
                times[i] = brentq(
                    lambda time, i=i: watched(time, dense(time))[i],
                    solver.t_old,
                    solver.t,
                    xtol=1e-15,
                    rtol=1e-15,
                )
        if not times:
            return None
        which = min(times, key=lambda i: times[i])
        return times[which], which, dense(times[which])

    def _after(self, which, state, u, closed, modes):
        """(closed, modes) behind an event."""
        q, v = state[: self.nq].tolist(), state[self.nq : 2 * self.nq].tolist()
        closed = list(closed)
        if which < self.nc:
            closed[which] = not closed[which]
            lam = self.contact_forces(q, closed)
            slips, fresh = self.slip(q, v), list(modes)
            for j, friction in enumerate(self.scene.frictions):
                if friction.contact == self.scene.contacts[which].name:
                    fresh[j] = (int(np.sign(slips[j])) or 1) if closed[which] else FREE
            return closed, fresh if self.nf else modes
        j, lam = which - self.nc, self.contact_forces(q, closed)
        if modes[j] is STICK:
            force = self.friction_forces(q, v, u, lam, modes)[j]
            return closed, [
                (-1 if force > 0.0 else 1) if i == j else mode for i, mode in enumerate(modes)
            ]
        return closed, self.settled(q, v, u, lam, modes, [j])
