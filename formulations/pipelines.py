"""Pipelines: chains of methods with their eps schedules, as data; and the methods by name.

    find_pipeline("softplus_dc+strict").legs
    stages = solve_stages(load_scene("three_cart"), find_pipeline("softplus_dc+strict"),
    time_limit=60.0)
    stages[-1].trajectory

A name is `warm starter + finisher`; the first eight are the rows of the paper's Table I. Methods,
Pyomo and PyTorch are imported on demand.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping
from itertools import groupby
from pathlib import Path
from time import monotonic
from types import MappingProxyType
from typing import TYPE_CHECKING

from formulations.method import Leg, Method, OptionError, Pipeline
from models.errors import UnknownNameError, did_you_mean

if TYPE_CHECKING:
    from formulations.solution import Solution
    from models.scene import Scene
    from models.trajectory import Trajectory


_FOLDER = Path(__file__).parent / "methods"


def method_names() -> tuple[str, ...]:
    """Return the names of all methods, sorted, from file names."""
    return tuple(
        sorted(path.stem for path in _FOLDER.glob("*.py") if not path.stem.startswith("_"))
    )


def load_method(name: str) -> Method:
    """Load a method by name. Raises UnknownNameError for an unknown name."""
    if name not in method_names():
        hint = did_you_mean(name, method_names(), f"there are {', '.join(method_names())}.")
        raise UnknownNameError(f"there is no method {name!r}; {hint}")
    module = importlib.import_module(f"formulations.methods.{name}")
    method = module.METHOD
    if method.name != name:
        raise UnknownNameError(
            f"method file {name}.py: METHOD.name is {method.name!r} but must equal the file's name."
        )
    return method


PAPER = "Suh and Wang, Table I"
PAPER_SCENE = "three_cart"
FREE_MOTION = "free_motion"
BEST_EXACT = "best_exact"

RELAXED_EPS = (1e-2, 1e-3, 1e-4)
SOFTPLUS_EPS = (1e-3, 1e-5, 1e-7)
# Start of a relaxed walk; the limit is 1. Looser bounds than 0.9 N^2 do not locate contact better
# (the carts push with 3.6 N).
RELAXED_FROM = 0.9
# End of a relaxed walk.
RELAXED_TO = RELAXED_EPS[-1]

# Gradient steps of softplus in the paper's rows, recovered from its costs (149.17 / 166.45 /
# 215.14).
SOFTPLUS_GD_COUNTS = (15, 14, 11)
# Gradient steps of cold ReLU, recovered from the cost 542.56.
RELU_GD_COLD_COUNT = 200
# Gradient steps of ReLU after softplus GD, recovered from the cost 309.42.
RELU_GD_AFTER_SOFTPLUS_GD = 10
# Gradient steps of ReLU after softplus DC, recovered from the cost 360.31.
RELU_GD_AFTER_SOFTPLUS_DC = 6
# Not in the paper, and its cost (492.06) cannot be reproduced: the number after softplus GD.
RELU_GD_AFTER_RELAXED = 10

# Multiple shooting has cheap stages, hence a wider schedule than the paper.
MULTIPLE_SHOOTING_EPS = (1e-3, 1e-6, 1e-12, 1e-24, 1e-48)
# Iterations per stage; a nearly settled plan is as good a start for the next one.
MULTIPLE_SHOOTING_COUNT = 60


def _counts(*iterations: int) -> tuple[Mapping[str, object], ...]:
    return tuple({"iterations": count} for count in iterations)


_RELAXED = Leg(method="relaxed_lcp", schedule=RELAXED_EPS)
_SOFTPLUS_DC = Leg(method="softplus_dc", schedule=SOFTPLUS_EPS)
_SOFTPLUS_GD = Leg(
    method="softplus_gd", schedule=SOFTPLUS_EPS, stage_options=_counts(*SOFTPLUS_GD_COUNTS)
)


def _relu_gd(iterations: int) -> Leg:
    return Leg(method="relu_gd", stage_options=_counts(iterations))


def _row(name: str, title: str, source: str, *legs: Leg | str, only: str = "") -> Pipeline:
    """Return a pipeline; a leg given by name has neither eps nor options."""
    chain = tuple(Leg(method=leg) if isinstance(leg, str) else leg for leg in legs)
    return Pipeline(name=name, title=title, legs=chain, source=source, only=only)


_SHOT_SOFTLY = Leg(
    method="softplus_multiple_shooting",
    schedule=MULTIPLE_SHOOTING_EPS,
    options={"max_iterations": MULTIPLE_SHOOTING_COUNT},
)

# A row: name, title, source, legs.
PIPELINES: tuple[Pipeline, ...] = (
    _row("strict", "Strict LCP from a cold start", PAPER, "strict_lcp"),
    _row(
        "relu_gd",
        "Gradient descent on ReLU contact from a cold start",
        PAPER,
        _relu_gd(RELU_GD_COLD_COUNT),
    ),
    _row(
        "relaxed+strict", "Relaxed LCP, tightened, then strict LCP", PAPER, _RELAXED, "strict_lcp"
    ),
    _row(
        "relaxed+relu_gd",
        "Relaxed LCP, tightened, then gradient descent on ReLU contact",
        f"{PAPER}; the number of gradient steps is ours (the paper gives none)",
        _RELAXED,
        _relu_gd(RELU_GD_AFTER_RELAXED),
    ),
    _row(
        "softplus_dc+strict",
        "Softplus collocation, tightened, then strict LCP",
        PAPER,
        _SOFTPLUS_DC,
        "strict_lcp",
    ),
    _row(
        "softplus_dc+relu_gd",
        "Softplus collocation, tightened, then gradient descent on ReLU contact",
        PAPER,
        _SOFTPLUS_DC,
        _relu_gd(RELU_GD_AFTER_SOFTPLUS_DC),
    ),
    _row(
        "softplus_gd+strict",
        "Softplus gradient descent, tightened, then strict LCP",
        PAPER,
        _SOFTPLUS_GD,
        "strict_lcp",
        # 40 gradient steps do not converge. On other scenes strict_lcp then takes as long as from a
        # cold start, without a best plan on any scene.
        only=PAPER_SCENE,
    ),
    _row(
        "softplus_gd+relu_gd",
        "Softplus gradient descent, tightened, then gradient descent on ReLU contact",
        PAPER,
        _SOFTPLUS_GD,
        _relu_gd(RELU_GD_AFTER_SOFTPLUS_GD),
    ),
    _row(
        "gd_converged",
        "Softplus gradient descent, then ReLU, each to convergence",
        "ours: what the paper's gradient descent reaches when it is not cut off",
        Leg(method="softplus_gd", schedule=SOFTPLUS_EPS),
        "relu_gd",
    ),
    _row(
        "lbfgs",
        "L-BFGS on softplus contact, tightened, then on ReLU contact",
        "ours: the loss of gradient descent, a method that learns its curvature, and the goal met by multipliers",
        Leg(method="softplus_lbfgs", schedule=SOFTPLUS_EPS),
        "relu_lbfgs",
    ),
    _row(
        "softplus_dc+lbfgs",
        "Softplus collocation, tightened, then fine tuning by L-BFGS on softplus and on ReLU contact",
        "ours: the outlook of the paper, collocation followed by fine tuning on what is simulated",
        _SOFTPLUS_DC,
        Leg(method="softplus_lbfgs", schedule=SOFTPLUS_EPS[-1:]),
        "relu_lbfgs",
    ),
    _row(
        "multiple_shooting",
        "Multiple shooting on softplus contact, tightened, then on ReLU contact",
        "ours: for unstable and long scenes, whose gradients explode in single shooting",
        _SHOT_SOFTLY,
        "relu_multiple_shooting",
    ),
    _row(
        "mpcc",
        "Exact contact from a cold start, by its modes",
        "ours: softplus homotopy, contact modes read off, what is left solved exactly, mode sequences searched",
        "mpcc",
    ),
    _row(
        BEST_EXACT,
        "Exact contact from a cold start, the cheapest plan of several pipelines",
        "ours: mpcc where contacts are open or closed, random pushes corrected, relaxed and softplus contact, softly shot plans, the last three then strict",
        BEST_EXACT,
    ),
    _row(
        "collocation",
        "Exact contact by collocation of order 3, from a cold start",
        "ours: Radau IIA with two stages on the scene's own grid, contact modes by a softplus homotopy; frictionless scenes",
        "collocation",
    ),
    _row(
        FREE_MOTION,
        "Free motion, for scenes without inputs: nothing is planned",
        "ours: the replay of the start, held against the scene's closed forms",
        "free_motion",
    ),
)

# Pipelines for `best_exact` only.
RELAXED_WALK = _row(
    "relaxed_walk+strict",
    "Relaxed LCP from a loose bound, tightened by steps that adapt, then strict LCP",
    "ours",
    Leg(method="relaxed_lcp", schedule=RELAXED_EPS[-1:], options={"first_eps": RELAXED_FROM}),
    "strict_lcp",
)
SOFTLY_SHOT = _row(
    "softly_shot+strict",
    "Multiple shooting on softplus contact, tightened, then strict LCP",
    "ours",
    _SHOT_SOFTLY,
    "strict_lcp",
)

# Pipelines of `--quick`: the cheapest collocation chain that ends in a direct method, the cheapest
# gradient chain, and the one for scenes without inputs.
QUICK: tuple[str, ...] = ("softplus_dc+strict", "softplus_gd+relu_gd", FREE_MOTION)


def pipeline_names() -> tuple[str, ...]:
    """Return the names of all pipelines, in order."""
    return tuple(pipeline.name for pipeline in PIPELINES)


def pipelines_for(scene: Scene) -> tuple[Pipeline, ...]:
    """Return the pipelines of a campaign on a scene by default, in order.

    Inapplicable methods are refused later, with a reason. `free_motion` is for scenes without
    inputs.
    """
    return tuple(
        pipeline
        for pipeline in PIPELINES
        if pipeline.only in ("", scene.name) and (not scene.nu or pipeline.name != FREE_MOTION)
    )


def find_pipeline(name: str) -> Pipeline:
    """Return a pipeline by name. Raises UnknownNameError for an unknown name."""
    match = next((pipeline for pipeline in PIPELINES if pipeline.name == name), None)
    if match is None:
        hint = did_you_mean(name, pipeline_names(), f"there are {', '.join(pipeline_names())}.")
        raise UnknownNameError(f"there is no pipeline {name!r}; {hint}")
    return match


def stage_plan(pipeline: Pipeline) -> tuple[tuple[Leg, float | None, dict[str, object]], ...]:
    """Return leg, eps and options of each stage; stage options override those of the leg."""
    stages = []
    for leg in pipeline.legs:
        for index, eps in enumerate(leg.schedule):
            own = leg.stage_options[index] if index < len(leg.stage_options) else {}
            stages.append((leg, eps, {**leg.options, **own}))
    return tuple(stages)


def solve_scene(
    scene: Scene,
    name: str,
    *,
    eps: float | None = None,
    options: Mapping[str, object] = MappingProxyType({}),
    warm_start: Trajectory | None = None,
    time_limit: float = 600.0,
) -> Solution:
    """Return the Solution of the last stage of a pipeline or method.

    name: a method if eps or options are given, or no pipeline has the name
    time_limit: of all stages [s]
    Raises UnknownNameError, OptionError.
    """
    solutions = list(
        solve_stages(
            scene, _pipeline(name, eps, options), warm_start=warm_start, time_limit=time_limit
        )
    )
    return solutions[-1]


def solve_stages(
    scene: Scene,
    pipeline: Pipeline,
    *,
    warm_start: Trajectory | None = None,
    time_limit: float = 600.0,
) -> Iterator[Solution]:
    """Yield the Solutions of the stages, each from the plan of the previous one.

    Stages with equal method and options share a session. time_limit: of all stages [s]; only the
    first runs without remaining time. Raises OptionError.
    """
    ends = monotonic() + time_limit
    plan, is_first = warm_start, True
    for (method, options), stages in groupby(_read(pipeline), key=lambda stage: stage[:2]):
        with load_method(method).open(scene, options) as session:
            for _, _, eps in stages:
                left = ends - monotonic()
                if not is_first and left <= 0.0:
                    return
                solution = session.solve(
                    eps=eps, warm_start=plan, time_limit=left if left > 0.0 else time_limit
                )
                plan, is_first = solution.trajectory or plan, False
                yield solution


def _read(pipeline: Pipeline):
    for leg, eps, options in stage_plan(pipeline):
        yield leg.method, load_method(leg.method).read_options(options), eps


def _pipeline(name: str, eps: float | None, options: Mapping[str, object]) -> Pipeline:
    known, name = {pipeline.name: pipeline for pipeline in PIPELINES}, str(name)
    if name in known and eps is None and not options:
        return known[name]
    if name in known and name not in method_names():
        raise OptionError(
            f"pipeline {name}: its stages have their own eps and options; leave them out, or name a method: {', '.join(method_names())}."
        )
    if name not in method_names():
        what = f"there are the pipelines {', '.join(known)} and the methods {', '.join(method_names())}."
        raise UnknownNameError(
            f"there is no pipeline or method {name!r}; {did_you_mean(name, (*known, *method_names()), what)}"
        )
    method = load_method(name)
    method.check_eps(eps)
    return Pipeline(
        name=name, title=method.title, legs=(Leg(method=name, schedule=(eps,), options=options),)
    )
