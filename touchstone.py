"""Does this plan through contact hold? The public API of touchstone.

>>> import touchstone as ts
>>> scene = ts.scene("three_cart")           # a name, or the path of a scene file
>>> plan = ts.solve(scene, "softplus_dc+strict")      # a pipeline or a method: a Solution
>>> # a plan may also be a CSV, a DataFrame, arrays by name; an FMU may replace the scene
>>> verdict = ts.judge(scene, plan)
>>> verdict
Judgement(three_cart, softplus_dc+strict: holds, cost 490.8, replay error 0.006839 m)

Pyomo's `SolverFactory("touchstone_ipopt")` and `SolverFactory("mpec_ipopt")` are registered once
both modules are imported.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from touchstone_annexes import is_present

if TYPE_CHECKING:
    from models.scene import Scene
    from models.trajectory import Trajectory
    from validate.campaign.campaign import CampaignResult
    from validate.campaign.shown import JudgedPlan as Judgement
    from validate.campaign.shown import SolvedPlan as Solution
    from validate.judge.time_step import EnergyTest

# Names imported on first use: importing touchstone costs as much as NumPy.
_HOME = {
    "CampaignResult": ("validate.campaign.campaign", "CampaignResult"),
    "CheckReport": ("validate.fmu_check", "CheckReport"),
    "EnergyTest": ("validate.judge.time_step", "EnergyTest"),
    "Judgement": ("validate.campaign.shown", "JudgedPlan"),
    "Outcome": ("formulations.solution", "Outcome"),
    "Robustness": ("validate.judge.robustness", "Robustness"),
    "Scene": ("models.scene", "Scene"),
    "Solution": ("validate.campaign.shown", "SolvedPlan"),
    "Trajectory": ("models.trajectory", "Trajectory"),
    "Verdict": ("models.results.verdict", "Verdict"),
    "check": ("validate.fmu_check.host", "check"),
    "robustness": ("validate.judge.robustness.public", "robustness"),
}
_HOME = {name: home for name, home in _HOME.items() if is_present(home[0])}  # without lost annexes
_FUNCTIONS = (
    "campaign",
    "energy_test",
    "export_fmu",
    "judge",
    "methods",
    "pipelines",
    "read_plan",
    "scene",
    "scenes",
    "solve",
)
__all__ = sorted((*_HOME, *_FUNCTIONS))  # pyright: ignore[reportUnsupportedDunderAll]
_PACKAGES = ("models", "formulations", "validate", "reports")


def name_clash() -> str | None:
    """Return why another package with one of our names prevents a run, or None."""
    home = Path(__file__).resolve().parent
    for name in _PACKAGES:
        module = sys.modules.get(name) or find_spec(name)
        where = next(
            iter(
                getattr(module, "__path__", None)
                or getattr(module, "submodule_search_locations", None)
                or ()
            ),
            None,
        )
        place = where or getattr(module, "__file__", None) or getattr(module, "origin", None)
        if place is None or Path(place).resolve().parent != home:
            state = "is missing" if place is None else f"is {place}"
            return (
                f"touchstone needs its own package {name!r} in {home}, but here {name!r} {state}; "
                "use the command `touchstone` instead of `python -m validate`, work in a folder without that name, take it out of PYTHONPATH, or rename yours."
            )
    return None


def not_installed(error: Exception) -> str | None:
    """Return what to do about a missing required package, None for any other error."""
    package = (error.name or "").partition(".")[0] if isinstance(error, ModuleNotFoundError) else ""
    if not package or find_spec(package) is not None:
        return None
    return (
        f"{package}, which touchstone needs, is not installed in {sys.executable}: activate the environment that README.md makes (. .venv/bin/activate), "
        "or install touchstone into this one (pip install -e . in the checkout)."
    )


def scenes() -> tuple[str, ...]:
    """Return the names of the scenes that come with touchstone, sorted.

    >>> "three_cart" in ts.scenes()
    True
    """
    from models.catalog import scene_names

    return tuple(scene_names())


def scene(name: Scene | str | Path) -> Scene:
    """Return a scene by its name, or from a scene file (docs/extending.md).

    Raises
    ------
    SceneError, UnknownNameError
        In one sentence.

    >>> ts.scene("three_cart").nq
    3
    """
    from models.catalog import as_scene

    return as_scene(name)


_scene = scene  # for functions with a parameter of that name


def methods() -> tuple[str, ...]:
    """Return the names of the methods, sorted; `solve` takes these and `pipelines`.

    >>> "mpcc" in ts.methods()
    True
    """
    from formulations.pipelines import method_names

    return method_names()


def pipelines() -> tuple[str, ...]:
    """Return the names of the pipelines: chains of methods with their eps schedules.

    >>> ts.pipelines()[0]
    'strict'
    """
    from formulations.pipelines import pipeline_names

    return pipeline_names()


def solve(
    scene: Scene | str | Path,
    name: str = "softplus_dc+strict",
    *,
    eps: float | None = None,
    start: Solution | Trajectory | Mapping[str, Any] | str | Path | None = None,
    time_limit: float = 600.0,
    **options: Any,
) -> Solution:
    """Find a plan of a scene.

    Parameters
    ----------
    scene
        Scene, its name, or the path of its file.
    name
        A pipeline, or a method. With `eps` or options the method of that name is used.
    eps
        Relaxation of a method that has one.
    start
        Plan on the scene's grid to start from, in any form of `judge`; None: the first guess.
    time_limit
        For all stages [s].
    options
        Options of the method by name (`python -m validate list --json`).

    Returns
    -------
    Solution
        Outcome, trajectory or None, cost and certificate of the last stage; `plot()`,
        `to_dataframe()`.

    Raises
    ------
    SceneError, UnknownNameError, OptionError, MachineError
        In one sentence.

    >>> ts.solve("three_cart", "softplus_dc", eps=1e-3)
    Solution(three_cart by softplus_dc, eps 0.001: solved, cost 197.9, 500 steps)
    """
    from formulations.pipelines import solve_scene
    from models.errors import check_positive
    from validate.campaign.shown import SolvedPlan
    from validate.judge.judgement import as_trajectory

    check_positive("time_limit", time_limit)
    subject = _scene(scene)
    first = None if start is None else as_trajectory(start, subject)
    solution = solve_scene(
        subject, name, eps=eps, warm_start=first, time_limit=time_limit, options=options
    )
    return SolvedPlan.of(solution, subject, name, eps)


def read_plan(path: str | Path, scene: Scene | str | Path) -> Trajectory:
    """Return a plan of a scene from a CSV, or a NetCDF file of touchstone (docs/replay.md).

    Raises
    ------
    TrajectoryError
        With file, line and column.
    """
    from validate.judge.judgement import as_trajectory

    subject = _scene(scene)
    plan = as_trajectory(path, subject)
    assert plan is not None, "a file is a plan"
    return plan


def judge(
    scene: Scene | str | Path,
    plan: Solution | Trajectory | Mapping[str, Any] | str | Path | Any,
    *,
    map: str | Path | None = None,
    hold: str | None = None,
    scheme: str | None = None,
    feedback: bool = False,
) -> Judgement:
    """Replay a plan by an independent simulation and judge it (docs/verdict.md).

    Parameters
    ----------
    scene
        Scene, its name, or the path of its file; or the path of an external FMU (.fmu), which runs
        in
        a child process.
    plan
        Solution, Trajectory, or path of a CSV or NetCDF file; for a scene also a DataFrame or
        arrays
        by column name: `t` (nodes,) [s] and names of the scene.
    map
        File that maps columns to the FMU's variables; None maps equal names.
    hold, scheme
        Hold ("zero" or "linear") and time step of columns and CSV that declare none.
    feedback
        Replay with feedback even if the verdict does not need it.

    Returns
    -------
    Judgement
        `print` gives the sentence; `holds`, `verdict`, `score.value(metric)`, `replay`; `plot()`,
        `to_dataframe()`. In a notebook: the page with player, plots and metrics.

    Raises
    ------
    SceneError, TrajectoryError, MapError, FmuError, MachineError
        In one sentence.
    """
    from validate.campaign.shown import JudgedPlan
    from validate.judge.judgement import as_wired_fmu
    from validate.judge.judgement import judge as judge_scene

    if (wired := as_wired_fmu(scene, plan, map, hold)) is not None:
        return JudgedPlan.of(wired.judge(feedback), plan)
    return JudgedPlan.of(
        judge_scene(scene, plan, hold=hold, scheme=scheme, feedback=feedback), plan
    )


def energy_test(scene: Scene | str | Path, step: Callable[..., Any] | str) -> EnergyTest:
    """Test whether a time step keeps the energy of free motion, the better the smaller the step.

    Parameters
    ----------
    scene : Scene, or its name, or the path of its file.
    step : `step(q, v, u, h, parameters) -> (q, v)`, or FILE.py:FUNCTION, or a scheme of ours by its
        name (docs/field.md).

    Returns
    -------
    EnergyTest : `vanishes`, `order`, `errors` [J] at `steps` [s], `sentence`.

    Raises
    ------
    SceneError, StepError : in one sentence.

    >>> ts.energy_test("cart_pole_walls", "semi_implicit_euler").vanishes
    True
    """
    from validate.judge.time_step import energy_test as tested

    return tested(_scene(scene), step)


def export_fmu(scene: Scene | str | Path, path: str | Path, *, version: str = "2.0") -> Path:
    """Write a scene as an FMU 2.0 or 3.0, Model Exchange and Co-Simulation; return its path.

    Raises
    ------
    SceneError
        If no FMU can express the scene.
    MachineError
        Without a compiler, or if the file cannot be written.
    """
    import shutil

    from models.errors import MachineError, check_text
    from models.fmu import build_fmu

    check_text("path", path)
    try:
        return Path(shutil.copyfile(build_fmu(_scene(scene), version=str(version)), path))
    except OSError as error:
        raise MachineError(f"{path}: it cannot be written ({error.strerror or error}).") from error


def campaign(
    out: str | Path,
    *,
    scenes: Sequence[str | Path] = (),
    select: str = "",
    quick: bool = False,
    jobs: int | None = None,
    time_limit: float = 240.0,
    file: str | Path | None = None,
) -> CampaignResult:
    """Replay, score and report every scene by every pipeline, like `python -m validate all`.

    Results stored in the folder are reused.

    Parameters
    ----------
    out
        Folder for runs, tables and report.html.
    scenes
        Names or files; empty for all that come with touchstone.
    select
        Words in the names of scenes and pipelines, with `and`, `or`, `not` (as -k).
    quick
        Run a small selection.
    jobs
        Runs at a time; None for the number of cores.
    time_limit
        For a run [s].
    file
        A campaign file, such as one with plans of other planners (docs/campaigns.md):
        `python -m validate run`. The file names scenes and time limit.

    Raises
    ------
    TouchstoneError
        For errors of the caller, in one sentence.
    """
    from models.errors import check_positive, check_text, listed
    from validate.campaign.campaign import run_campaign
    from validate.campaign.read import read_campaign
    from validate.campaign.runs import CampaignSettings
    from validate.cli.narrator import narrator

    check_text("out", out)
    check_text("select", select, empty=True)
    check_positive("time_limit", time_limit)
    if jobs is not None:
        check_positive("jobs", jobs, int)
    named = tuple(map(str, listed(scenes)))
    if file is not None:
        check_text("file", file)
        given = read_campaign(
            Path(file), out=Path(out), expression=select or None, quick=quick, jobs=jobs
        )
        return run_campaign(given, narrator())
    settings = CampaignSettings(
        out=Path(out),
        scenes=named,
        expression=select or None,
        quick=quick,
        jobs=jobs,
        time_limit=time_limit,
    )
    return run_campaign(settings, narrator())


def __getattr__(name: str) -> Any:
    if name in _HOME:
        home, known_as = _HOME[name]
        return getattr(importlib.import_module(home), known_as)
    raise AttributeError(
        f"module 'touchstone' has no attribute {name!r}; it has {', '.join(__all__)}."
    )


def __dir__() -> list[str]:
    return list(__all__)


_clash = name_clash()
if _clash is not None:
    raise ImportError(_clash)
importlib.import_module("formulations")  # registers the Pyomo solvers, after the check for a clash
