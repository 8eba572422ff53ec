"""Does this plan through contact hold? The public face of touchstone.

>>> import touchstone as ts
>>> scene = ts.scene("three_cart")           # a name, or the path of a scene file
>>> plan = ts.solve(scene, "softplus_dc+strict")      # a pipeline or a method: a Solution
>>> # a plan may also be a CSV, a DataFrame, arrays by name; an FMU may replace the scene
>>> verdict = ts.judge(scene, plan)
>>> verdict
Judgement(three_cart, softplus_dc+strict: holds, cost 490.8, replay error 0.006839 m)

Importing it costs as much as NumPy. Pyomo solvers: `SolverFactory("touchstone_ipopt")` and
`SolverFactory("mpec_ipopt")` are registered as soon as Pyomo is imported, before or after this
module.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from formulations.solution import Outcome
    from models.scene import Scene
    from models.trajectory import Trajectory
    from validate.campaign.campaign import CampaignResult
    from validate.campaign.shown import JudgedPlan as Judgement
    from validate.campaign.shown import SolvedPlan as Solution
    from validate.fmu_check import CheckReport
    from validate.judge.judgement import WiredFmu
    from validate.judge.robustness import Robustness
    from validate.judge.score import Verdict
    from validate.judge.time_step import EnergyTest

# The types that the functions below give and take, and where each is at home: imported when one is
# asked for.
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
    "Verdict": ("validate.judge.score", "Verdict"),
}
__all__ = [
    "CampaignResult",
    "CheckReport",
    "EnergyTest",
    "Judgement",
    "Outcome",
    "Robustness",
    "Scene",
    "Solution",
    "Trajectory",
    "Verdict",
    "campaign",
    "check",
    "energy_test",
    "export_fmu",
    "judge",
    "methods",
    "pipelines",
    "read_plan",
    "robustness",
    "scene",
    "scenes",
    "solve",
]
_PACKAGES = ("models", "formulations", "validate", "reports")


def name_clash() -> str | None:
    """Why touchstone cannot run beside what else is called like one of its packages, and how to go on; None where nothing is."""
    home = Path(__file__).resolve().parent
    for name in _PACKAGES:
        found = sys.modules.get(name) or find_spec(name)
        where = next(
            iter(
                getattr(found, "__path__", None)
                or getattr(found, "submodule_search_locations", None)
                or ()
            ),
            None,
        )
        place = where or getattr(found, "__file__", None) or getattr(found, "origin", None)
        if place is None or Path(place).resolve().parent != home:
            said = "is missing" if place is None else f"is {place}"
            return (
                f"touchstone needs its own package {name!r} in {home}, but here {name!r} {said}; "
                "use the command `touchstone` instead of `python -m validate`, work in a folder without that name, take it out of PYTHONPATH, or rename yours."
            )
    return None


def not_installed(error: Exception) -> str | None:
    """What to do where a package that touchstone needs is not in this Python: most often it is not that of the environment; None for any other error."""
    package = (error.name or "").partition(".")[0] if isinstance(error, ModuleNotFoundError) else ""
    if not package or find_spec(package) is not None:
        return None
    return (
        f"{package}, which touchstone needs, is not installed in {sys.executable}: activate the environment that README.md makes (. .venv/bin/activate), "
        "or install touchstone into this one (pip install -e . in the checkout)."
    )


def scenes() -> tuple[str, ...]:
    """Names of the scenes that come with touchstone, sorted.

    >>> "three_cart" in ts.scenes()
    True
    """
    from models.catalog import scene_names

    return tuple(scene_names())


def scene(name: Scene | str | Path) -> Scene:
    """A scene by its name, or from a scene file of one's own (docs/extending.md).

    A scene itself comes back.

    Raises
    ------
    SceneError, UnknownNameError : in one sentence.

    >>> ts.scene("three_cart").nq
    3
    """
    from models.catalog import as_scene

    return as_scene(name)


_scene = scene  # where a parameter has its name


def _listed(given: Any) -> tuple[Any, ...]:
    """Names: one by itself is one, and not its letters."""
    return tuple(given) if isinstance(given, Iterable) and not isinstance(given, str) else (given,)


def _text(name: str, given: str | Path, *, empty: bool = False) -> None:
    """Raise TouchstoneError for what is neither text nor a path."""
    from models.errors import TouchstoneError

    if not isinstance(given, (str, Path)) or not (empty or str(given)):
        raise TouchstoneError(f"{name}: {given!r} must be a name, as text or Path.")


def _positive(name: str, given: float, kind: type | tuple[type, ...] = (int, float)) -> None:
    """Raise TouchstoneError for what is not a positive number."""
    from models.errors import TouchstoneError

    if isinstance(given, bool) or not isinstance(given, kind) or not 0 < given < float("inf"):
        raise TouchstoneError(
            f"{name}: {given!r} must be a positive {'whole number' if kind is int else 'number of seconds'}."
        )


def methods() -> tuple[str, ...]:
    """Names of the methods that find plans, sorted: what `solve` takes, beside `pipelines`.

    >>> "mpcc" in ts.methods()
    True
    """
    from formulations.pipelines import method_names

    return method_names()


def pipelines() -> tuple[str, ...]:
    """Names of the pipelines: methods one after the other, with their eps schedules.

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
    scene : Scene, or its name, or the path of its file
    name : a pipeline or a method. A pipeline has its own eps and options; where `eps` or options
        are given, the method of that name is meant.
    eps : the relaxation of a method that has one.
    start : a plan on the scene's grid to start from, in any form that `judge` takes; None for the
        scene's own first guess.
    time_limit : of all stages [s].
    options : of the method, by name (`python -m validate list --json`).

    Returns
    -------
    Solution of the last stage that ran: outcome (its value is advice), trajectory or None, cost,
        certificate; `plot()`, `to_dataframe()`.

    Raises
    ------
    SceneError, UnknownNameError, OptionError, MachineError : in one sentence.

    >>> ts.solve("three_cart", "softplus_dc", eps=1e-3)
    Solution(three_cart by softplus_dc, eps 0.001: solved, cost 197.9, 500 steps)
    """
    from formulations.pipelines import solve_scene
    from validate.campaign.shown import SolvedPlan
    from validate.judge.judgement import as_trajectory

    _positive("time_limit", time_limit)
    wanted = _scene(scene)
    first = None if start is None else as_trajectory(start, wanted)
    found = solve_scene(
        wanted, name, eps=eps, warm_start=first, time_limit=time_limit, options=options
    )
    return SolvedPlan.of(found, wanted, name, eps)


def read_plan(path: str | Path, scene: Scene | str | Path) -> Trajectory:
    """A plan of a scene from a CSV of any planner, or a NetCDF file of touchstone. docs/replay.md says what may stand in it.

    Raises
    ------
    TrajectoryError : the file, the line and the column.
    """
    from validate.judge.judgement import as_trajectory

    wanted = _scene(scene)
    plan = as_trajectory(path, wanted)
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
    scene : Scene, or its name, or the path of its file; or the path of somebody's FMU (it ends in
        .fmu and runs in a child process)
    plan : Solution, Trajectory, path of a CSV or NetCDF file; of a scene also a DataFrame or arrays
        by column name: `t` (nodes,) [s] and the scene's names
    map : of an FMU: the file that says what of the plan is what of the FMU; equal names without it.
    hold : "zero" or "linear", the inputs within a step; scheme : the time step that made it. Of
        columns and CSV alone, where they do not say so.
    feedback : replay with feedback too, whether or not the verdict needs it.

    Returns
    -------
    Judgement : print it for the sentence; `holds`, `verdict`, `score.value(metric)`, `replay`;
        `plot()`, `to_dataframe()`. In a notebook: the page
        with player, plots and metrics.

    Raises
    ------
    SceneError, TrajectoryError, MapError, FmuError, MachineError : in one sentence.
    """
    from validate.campaign.shown import JudgedPlan
    from validate.judge.judgement import judge as judge_scene

    if (wired := _wired(scene, plan, map, hold)) is not None:
        return JudgedPlan.of(wired.judge(feedback), plan)
    return JudgedPlan.of(
        judge_scene(scene, plan, hold=hold, scheme=scheme, feedback=feedback), plan
    )


def _wired(scene: Any, plan: Any, map: str | Path | None, hold: str | None) -> WiredFmu | None:
    """The FMU that is named and the plan, brought together; None for a scene, which has no map."""
    if isinstance(scene, (str, Path)) and Path(scene).suffix.lower() == ".fmu":
        from validate.judge.judgement import wire_fmu

        return wire_fmu(Path(scene), plan, map_path=None if map is None else Path(map), hold=hold)
    if map is not None:
        from models.errors import SceneError

        raise SceneError("map: a map belongs to an FMU; a scene knows its own names.")
    return None


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


def robustness(
    scene: Scene | str | Path,
    plan: Solution | Trajectory | Mapping[str, Any] | str | Path | Any,
    *,
    samples: int = 1000,
    seed: int = 0,
    kinds: Sequence[str] = ("parameters", "start", "gain", "noise", "delay"),
    anyway: bool = False,
    map: str | Path | None = None,
    hold: str | None = None,
) -> Robustness:
    """Try a plan in perturbed worlds: in what share of them it still arrives, and what it takes least of (docs/robustness.md).

    Parameters
    ----------
    scene, plan, map, hold : as `judge` takes them.
    samples : worlds, from 10 to 10^6; a quarter of them with feedback too.
    seed : of the worlds; the same numbers, to the bit, for the same seed.
    kinds : what is perturbed, or single ones by their names.
    anyway : measure a plan too that does not hold to begin with.

    Returns
    -------
    Robustness : `alone` and `feedback` with their `share` and `checked`; `failures`,
        `weakest`.

    Raises
    ------
    SceneError, TrajectoryError, MachineError : in one sentence.
    """
    from validate.judge.robustness import robustness as measured

    wired = _wired(scene, plan, map, hold)
    subject = scene if wired is None else wired
    return measured(
        subject, plan, samples=samples, seed=seed, kinds=_listed(kinds), anyway=anyway, hold=hold
    )


def check(
    fmu: str | Path, *, only: Sequence[str] | None = None, seconds: float = 60.0
) -> CheckReport:
    """Check whether an FMU does what its files say.

    Its files, and how its code behaves, in child processes (docs/fmu_check.md).

    only : names of checks; None for all. seconds : for each check [s].

    Raises
    ------
    FmuError : no FMU of version 2.0 or 3.0.
    """
    from validate.fmu_check import check_fmu

    _text("fmu", fmu)
    _positive("seconds", seconds)
    return check_fmu(Path(fmu), names=None if only is None else _listed(only), seconds=seconds)


def export_fmu(scene: Scene | str | Path, path: str | Path, *, version: str = "2.0") -> Path:
    """Write a scene as an FMU, Model Exchange and Co-Simulation in one file, and give its path. version : "2.0" or "3.0".

    Raises
    ------
    SceneError : no FMU can carry it; MachineError : no compiler, or the file cannot be written.
    """
    import shutil

    from models.errors import MachineError
    from models.fmu import build_fmu

    _text("path", path)
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
    """Every scene by every pipeline, replayed, scored and reported: `python -m validate all`.

    What is stored in the folder is not run again.

    Parameters
    ----------
    out : the folder for runs, tables and report.html.
    scenes : names or files; empty for all that come with touchstone.
    select : words in the names of scenes and pipelines, with `and`, `or`, `not` (as -k).
    quick : a small choice of pipelines and scenes.
    jobs : runs at a time; None for the number of cores.
    time_limit : of a run [s].
    file : a campaign file, such as one with plans of other planners (docs/campaigns.md):
        `python -m validate run`. The file names scenes and time limit.

    Raises
    ------
    TouchstoneError : for what the caller can mend, in one sentence.
    """
    from validate.campaign.campaign import run_campaign
    from validate.campaign.read import read_campaign
    from validate.campaign.runs import CampaignSettings
    from validate.cli.narrator import narrator

    _text("out", out)
    _text("select", select, empty=True)
    _positive("time_limit", time_limit)
    if jobs is not None:
        _positive("jobs", jobs, int)
    named = tuple(map(str, _listed(scenes)))
    if file is not None:
        _text("file", file)
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
importlib.import_module(
    "formulations"
)  # registers the Pyomo solvers; not above, where a clash is not yet told
