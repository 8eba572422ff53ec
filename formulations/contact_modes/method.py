"""Options of methods by contact modes, and the scenes these accept; light to import (no Pyomo)."""

from __future__ import annotations

from dataclasses import dataclass

from formulations.method import Options, option, without_inputs
from formulations.transcription.method import TranscriptionOptions, check_smooth
from models.errors import SceneError
from models.scene import Scene
from models.scene.scene import named_expressions


@dataclass(frozen=True, kw_only=True)
class MpccOptions(Options):
    """Options of `mpcc`."""

    search: bool = option(True, "search for cheaper contact modes around those found")
    search_windows: int = option(
        2000,
        "most contact mode sequences that are tried; a twentieth of them where each is a run of Ipopt",
        lower=0,
        upper=10**9,
    )
    search_share: float = option(
        0.5,
        "part of the work that is left, and of the time, which this search may take",
        lower=0.0,
        upper=1.0,
    )
    work: float = option(
        100.0,
        "most work of all starts together: Ipopt iterations times nonzeros of its matrices, so that no clock decides",
        unit="millions",
        lower=0.0,
    )
    first_work: float = option(
        25.0,
        "most of this work until a start has a plan: those of the bank that had one needed up to 10, and what has spent more goes on in vain",
        unit="millions",
        lower=0.0,
    )
    throw_work: float = option(
        20.0,
        "most work, beside that of the starts, of throws: tried where the end is free and has a cost, and the best plan touches nothing",
        unit="millions",
        lower=0.0,
    )
    first_sharpness: float = option(
        7.0,
        "sharpness of the first softplus stage, |ln eps|: b times the length that the scene counts it in",
        lower=1e-3,
        upper=700.0,
    )
    last_sharpness: float = option(
        448.0,
        "no stage is sharper; modes read off much softer contact often have no plan",
        lower=1e-3,
        upper=700.0,
    )
    sharpness_growth: float = option(2.0, "factor between two stages", lower=1.01, upper=1e3)
    coarse_steps: int = option(
        600,
        "a task of more steps is first solved on a grid of at most so many, whose contact modes are then refined",
        lower=2,
        upper=10**9,
    )
    starts: int = option(
        1,
        "so many starts - the one given, softplus chain and gradient descent, both mirrored, random - the cheapest plan is kept",
        lower=1,
        upper=10**6,
    )
    seed: int = option(
        0, "of random starts, also of those tried where the first guess leads nowhere", lower=0
    )
    tolerance: float = option(
        1e-8, "Ipopt's tol for fixed modes of a nonlinear scene", lower=1e-12, upper=1e-2
    )
    homotopy_tolerance: float = option(
        1e-6, "Ipopt's tol in the softplus stages", lower=1e-12, upper=1e-2
    )
    max_iterations: int = option(3000, "most Ipopt iterations of a solve", lower=1, upper=10**9)
    plan_tolerance: float = option(
        1e-6,
        "solved only if start, time step, bounds and signs are met to this, recomputed from the scene [m, rad, N ..]",
        lower=0.0,
        upper=1.0,
    )
    terminal_tolerance: float = option(
        1e-9,
        "solved only if the plan and its replay end this near to the goal",
        lower=0.0,
    )
    physics_tolerance: float = option(
        1e-12,
        "solved only if the sum of abs(lam (lam - k phi)) is at most this; the method leaves exactly zero",
        unit="N^2",
        lower=0.0,
    )


@dataclass(frozen=True, kw_only=True)
class CollocationOptions(TranscriptionOptions):
    """Options of `collocation`."""

    scheme: str = option(
        "radau_iia_2",
        "the time step: Radau IIA with two stages (order 3), or the implicit midpoint (order 2, keeps energy)",
        choices=("radau_iia_2", "implicit_midpoint"),
    )
    integrate_cost: bool = option(
        False,
        "minimise the scheme's quadrature of the running cost instead of its sum over the starts of the steps, the task's own",
    )
    first_sharpness: float = option(
        7.0,
        "sharpness of the first softplus stage, |ln eps|: b times the length that the scene counts it in",
        lower=1e-3,
        upper=700.0,
    )
    last_sharpness: float = option(
        448.0,
        "sharpness from which on the modes of the contacts are read off",
        lower=1e-3,
        upper=700.0,
    )
    sharpness_growth: float = option(2.0, "factor between two stages", lower=1.01, upper=1e3)
    homotopy_tolerance: float = option(
        1e-6, "Ipopt's tol in the softplus stages", lower=1e-12, upper=1e-2
    )


def why_not(scene: Scene) -> str | None:
    """Return the reason why open and closed modes cannot plan this scene, or None."""
    if not scene.inputs:
        return without_inputs(scene, "plan")
    if scene.nf:
        return f"scene {scene.name} has friction, and open and closed contacts do not determine where it sticks; best_exact and strict_lcp plan it."
    if scene.damped:
        names = ", ".join(scene.contacts[index].name for index in scene.damped)
        return f"scene {scene.name} has damped contacts ({names}), and open and closed contacts do not determine where they are released; best_exact and strict_lcp plan it."
    try:
        # Derivatives of smooth expressions are smooth.
        for field, expression, *_ in named_expressions(scene):
            check_smooth(scene, field, (expression,))
    except SceneError as error:
        return str(error)
    return None
