"""The exact contact problem by its contact windows: softplus homotopy, modes read off, what is left solved exactly, windows searched.

Where the end is free and has a cost, a plan that touches nothing is a local optimum from which no slope leads to a contact (two_discs_wall: nothing
done costs 0.61, a throw off the wall 0.39). There throws by constant inputs are tried, and the cheapest are solved with their contact modes.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from formulations.method import Kind, Method, OptionSpec, Session
from formulations.windows.homotopy_options import FIRST_SHARPNESS, HOMOTOPY_TOLERANCE, SHARPNESS_GROWTH

if TYPE_CHECKING:
    from models.scene import Scene


class Mpcc(Method):
    name = "mpcc"
    title = "Exact contact by its windows"
    kind = Kind.DIRECT
    needs_eps = False
    exact = True
    options = (
        OptionSpec(name="search", default=True, description="search for cheaper contact windows around those found", choices=(True, False)),
        OptionSpec(
            name="search_windows",
            default=2000,
            description="most contact windows that are tried; a twentieth of them where each is a run of Ipopt",
            lower=0,
            upper=10**9,
        ),
        OptionSpec(
            name="search_share",
            default=0.5,
            description="part of the work that is left, and of the time, which this search may take",
            lower=0.0,
            upper=1.0,
        ),
        OptionSpec(
            name="work",
            default=100.0,
            description="most work of all starts together: Ipopt iterations times nonzeros of its matrices, so that no clock decides",
            unit="millions",
            lower=0.0,
        ),
        OptionSpec(
            name="first_work",
            default=25.0,
            description="most of this work until a start has a plan: those of the bank that had one needed up to 10, and what has spent more goes on in vain",
            unit="millions",
            lower=0.0,
        ),
        OptionSpec(
            name="throw_work",
            default=20.0,
            description="most work, beside that of the starts, of throws: tried where the end is free and has a cost, and the best plan touches nothing",
            unit="millions",
            lower=0.0,
        ),
        FIRST_SHARPNESS,
        OptionSpec(
            name="last_sharpness",
            default=448.0,
            description="no stage is sharper; modes read off much softer contact often have no plan",
            lower=1e-3,
            upper=700.0,
        ),
        SHARPNESS_GROWTH,
        OptionSpec(
            name="coarse_steps",
            default=600,
            description="a task of more steps is first solved on a grid of at most so many, whose windows are then refined",
            lower=2,
            upper=10**9,
        ),
        OptionSpec(
            name="goal_tolerance",
            default=0.0,
            description="how far from the goal the plan may end, in the norm of (q, v): the cheapest end within this ball is chosen",
            lower=0.0,
        ),
        OptionSpec(
            name="starts",
            default=1,
            description="so many starts - the one given, softplus chain and gradient descent, both mirrored, random - the cheapest plan is kept",
            lower=1,
            upper=10**6,
        ),
        OptionSpec(
            name="first_start",
            default=0,
            description="number of the first of these starts, so that others can be run elsewhere",
            lower=0,
            upper=10**6,
        ),
        OptionSpec(
            name="seed", default=0, description="of random starts, also of those tried where the first guess leads nowhere", lower=0
        ),
        OptionSpec(name="tolerance", default=1e-8, description="Ipopt's tol for fixed modes of a nonlinear scene", lower=1e-12, upper=1e-2),
        HOMOTOPY_TOLERANCE,
        OptionSpec(name="max_iterations", default=3000, description="most Ipopt iterations of a solve", lower=1, upper=10**9),
        OptionSpec(
            name="plan_tolerance",
            default=1e-6,
            description="solved only if start, time step, bounds and signs are met to this, recomputed from the scene [m, rad, N ..]",
            lower=0.0,
            upper=1.0,
        ),
        OptionSpec(
            name="terminal_tolerance",
            default=1e-9,
            description="solved only if the plan and its replay end this near to the goal (or the ball around it)",
            lower=0.0,
        ),
        OptionSpec(
            name="physics_tolerance",
            default=1e-12,
            description="solved only if the sum of abs(lam (lam - k phi)) is at most this; the method leaves exactly zero",
            unit="N^2",
            lower=0.0,
        ),
    )

    def accepts(self, scene: Scene) -> str | None:
        from formulations.windows.applies import why_not

        return why_not(scene)

    def session(self, scene: Scene, options: Mapping[str, object], opening: tuple[float, float]) -> Session:
        from formulations.windows.session import MpccSession

        return MpccSession(self, scene, options, opening)


METHOD = Mpcc()
