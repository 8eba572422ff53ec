"""Masters for coupled FMUs, as small as they can be: what the common ways of coupling do with a stiff contact.

    system.begin(start, u)
    motion = jacobi(system, h=1e-3, steps=500)
        (steps + 1, 2 nq) positions and velocities at t = n h

All parts meet at t = n h only. Between two meetings the bodies see a force that somebody chose for
them, and the masters differ in nothing but this choice. lam(q_n) is the force at the positions of
t_n:

    jacobi          all step at once with what all gave at the end of the step before: the force is
                    lam(q_{n-1}), one step and a half late
    contact_first   the contacts step first (Gauss-Seidel): lam(q_n), half a step late
    extrapolated    contacts first; the force runs on as a line through lam(q_{n-1}) and lam(q_n)
    iterated        steps are taken back (set FMU state) and repeated until the force is the line
                    from lam(q_n) to lam(q_{n+1})

A force that is tau late does the work of a negative damper k tau: it *adds* energy. Half a period
pi/omega of contact multiplies the energy of the relative motion by about exp(pi omega tau).
Momentum shows nothing of it, since both bodies get the same force.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.cosim.system import System

# Repetitions of a step by `iterated`: it ends when no force changes by more than the share of the
# largest one, or after so many.
ITERATIONS = 50
AGREEMENT = 1e-9

Master = Callable[[System, float, int], np.ndarray]


def jacobi(system: System, h: float, steps: int) -> np.ndarray:
    """Everybody steps with what everybody gave at the last meeting."""
    motion, values = _begin(system, steps), system.values
    for n in range(steps):
        for part in system.parts:
            part.set_inputs(values)
        for part in system.parts:
            part.step(n, h)
        for part in system.parts:
            part.get_outputs(values)
        motion[n + 1] = values[system.states]
    return motion


def contact_first(system: System, h: float, steps: int) -> np.ndarray:
    """Gauss-Seidel: contacts see the bodies where they are, bodies the forces that follow."""
    motion, values = _begin(system, steps), system.values
    for n in range(steps):
        _forces(system)
        for part in system.contacts:
            part.step(n, h)
        for body in system.bodies:
            body.set_inputs(values)
            body.step(n, h)
            body.get_outputs(values)
        motion[n + 1] = values[system.states]
    return motion


def extrapolated(system: System, h: float, steps: int) -> np.ndarray:
    """Contacts first.

    Then all bodies at once, with forces that go on as they went during the last step.
    """
    motion, values = _begin(system, steps), system.values
    before = values.copy()
    for n in range(steps):
        _forces(system)
        slopes = (values - before) / h
        before[:] = values
        _bodies(system, values, slopes, n, h)
        for part in system.contacts:
            part.step(n, h)
        motion[n + 1] = values[system.states]
    return motion


def iterated(system: System, h: float, steps: int) -> np.ndarray:
    """Steps repeated from saved states until the forces at their ends are those they were made with."""
    motion, values = _begin(system, steps), system.values
    forces = system.forces
    largest = 0.0
    for n in range(steps):
        _forces(system)
        begin = values.copy()
        guess = begin[forces]
        for body in system.bodies:
            body.save()
        for repetition in range(ITERATIONS):
            if repetition > 0:
                for body in system.bodies:
                    body.restore()
            slopes = np.zeros_like(begin)
            slopes[forces] = (guess - begin[forces]) / h
            _bodies(system, begin, slopes, n, h)
            values[:] = begin
            for body in system.bodies:
                body.get_outputs(values)
            _forces(system)
            change = float(np.abs(values[forces] - guess).max())
            guess = values[forces].copy()
            largest = max(largest, float(np.abs(guess).max()))
            if change <= AGREEMENT * largest:
                break
        for part in system.contacts:
            part.step(n, h)
        motion[n + 1] = values[system.states]
    return motion


MASTERS: dict[str, Master] = {
    "jacobi": jacobi,
    "contact_first": contact_first,
    "extrapolated": extrapolated,
    "iterated": iterated,
}


def _begin(system: System, steps: int) -> np.ndarray:
    motion = np.empty((steps + 1, len(system.states)))
    motion[0] = system.values[system.states]
    return motion


def _forces(system: System) -> None:
    """The contacts' forces at the bodies' present positions, without a step: an algebraic FMU gives them at once."""
    for part in system.contacts:
        part.set_inputs(system.values)
        part.get_outputs(system.values)


def _bodies(system: System, values: np.ndarray, slopes: np.ndarray, n: int, h: float) -> None:
    """All bodies one step further, with inputs that begin at `values` and have `slopes`."""
    for body in system.bodies:
        body.set_inputs(values)
        body.set_slopes(slopes)
        body.step(n, h)
    for body in system.bodies:
        body.get_outputs(system.values)
