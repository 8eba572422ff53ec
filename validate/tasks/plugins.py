"""Plugins: replace methods, pipelines or the judge of a campaign, by a dotted name.

    python -m validate all --plugin my_method                       # defines METHOD, maybe PIPELINE
    python -m validate all --plugin my_package.my_module:PLUGIN

`METHOD` adds a method, and runs its pipeline before ours. A `Plugin` replaces more; its defaults
are ours. Child processes import the module too (installed, or on PYTHONPATH). Functions of children
are imported on their first call, because the campaign's process needs neither Pyomo nor FMPy.
"""

from __future__ import annotations

import importlib
import inspect
import reprlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from formulations.given_plan import GIVEN_PLAN
from formulations.method import Leg, Method, Pipeline
from formulations.pipelines import QUICK, load_method, pipelines_for
from models.errors import MachineError, TouchstoneError, UnknownNameError
from touchstone_annexes import load, present

if TYPE_CHECKING:
    from formulations.solution import Solution
    from models.scene import Scene
    from models.trajectory import Trajectory
    from validate.judge.judgement import Judgement
    from validate.judge.replay import Replay
    from validate.tasks.task import CheckTask, SceneReference

DEFAULT_PLUGIN = "validate.tasks.plugins:DEFAULT"
# Functions from scenes to the CheckTasks of a campaign, by kind; an annex may be missing.
CHECKS = {"FMU": "validate.tasks.fmu_checks:checks", "stress": "validate.stress.case:checks"}
# Functions of annexes, which may be missing.
_ANNEXES = present({"survey": "validate.judge.robustness:survey"})


def _late(reference: str) -> Callable[..., Any]:
    """Return the function `module:name`, imported on its first call."""
    return lambda *arguments: load(reference)(*arguments)


def no_survey(*_: Any) -> Any:
    """Stand for the missing annex of perturbed worlds. Raises TouchstoneError."""
    raise TouchstoneError("perturbed worlds are not installed.")


_compile = _late("models.codegen.kernel:load_kernel")
_build_fmu = _late("models.fmu:build_fmu")
_certify = _late("formulations.certificate.plan:certify_solution")
_judge = _late("validate.judge.judgement:judge_trajectory")
_survey = _late(_ANNEXES["survey"]) if "survey" in _ANNEXES else no_survey
_write_replay = _late("validate.judge.replay.netcdf:write_drawn")


def _checks(scenes: Sequence[SceneReference]) -> list[CheckTask]:
    return [task for reference in present(CHECKS).values() for task in _late(reference)(scenes)]


def _write_report(folder: Path) -> Path:
    from reports.load import ReportError
    from reports.render import REPORT, is_current, write_report

    try:
        return folder / REPORT if is_current(folder) else write_report(folder)
    except ReportError as error:  # reports do not know our errors
        raise MachineError(str(error)) from error


@dataclass(frozen=True, kw_only=True)
class Plugin:
    """Functions of a campaign.

    - quick: pipelines of `--quick`.
    - survey: tries a plan in perturbed worlds; `no_survey`: no plan is tried.
    """

    load_method: Callable[[str], Method] = load_method
    pipelines_for: Callable[[Scene], tuple[Pipeline, ...]] = pipelines_for
    quick: tuple[str, ...] = QUICK
    checks: Callable[[Sequence[SceneReference]], Sequence[CheckTask]] = _checks
    compile: Callable[[Scene], object] = _compile
    build_fmu: Callable[[Scene], Path] = _build_fmu
    certify: Callable[[Scene, Solution], Solution] = _certify
    judge: Callable[[Scene, Path, Trajectory], Judgement] = _judge
    survey: Callable[[Scene, Trajectory, Mapping[str, float], bool], Any] = _survey
    write_replay: Callable[[Path, Replay, Scene, Trajectory, int], None] = _write_replay
    write_report: Callable[[Path], Path] = _write_report

    def __post_init__(self) -> None:
        for item in fields(self):
            value, names = getattr(self, item.name), item.name == "quick"
            if not (
                isinstance(value, (tuple, list)) and all(isinstance(name, str) for name in value)
                if names
                else callable(value)
            ):
                wanted = "a tuple of names of pipelines" if names else "a function"
                raise TouchstoneError(
                    f"Plugin: {item.name} is {reprlib.repr(value)}, but must be {wanted}; without it ours is used."
                )

    def methods_of(self, pipeline: Pipeline) -> dict[str, Method]:
        """Return the methods of a pipeline's legs by name. Raises UnknownNameError."""
        return {
            leg.method: GIVEN_PLAN
            if leg.method == GIVEN_PLAN.name
            else self.load_method(leg.method)
            for leg in pipeline.legs
        }


DEFAULT = Plugin()


def load_plugin(reference: str) -> Plugin:
    """Return the Plugin `module:NAME`, or of a module with PLUGIN or METHOD.

    Raises UnknownNameError.
    """
    module_name, _, name = reference.partition(":")
    try:
        module = importlib.import_module(module_name)
    except (
        ImportError,
        TypeError,
        ValueError,
    ) as error:  # an invalid dotted name: '', '..x'
        raise UnknownNameError(
            f"--plugin {reference}: the module {module_name!r} cannot be imported ({error}); its folder must be on PYTHONPATH."
        ) from error
    plugin = getattr(module, name or "PLUGIN", None)
    if plugin is None and not name and isinstance(getattr(module, "METHOD", None), Method):
        return _of_method(reference, module.METHOD, getattr(module, "PIPELINE", None))
    if not isinstance(plugin, Plugin):
        wanted = (
            f"{name} that is a validate.tasks.plugins.Plugin"
            if name
            else "METHOD (a formulations.method.Method)"
        )
        raise UnknownNameError(f"--plugin {reference}: {module_name} has no {wanted}.")
    return plugin


def _of_method(reference: str, method: Method, pipeline: Pipeline | None) -> Plugin:
    """Return our plugin with a method and its pipeline first."""
    if pipeline is None and method.needs_eps:
        raise UnknownNameError(
            f"--plugin {reference}: method {method.name} needs eps; define PIPELINE, whose leg says which: Leg(method={method.name!r}, schedule=(..,))."
        )
    first = pipeline or Pipeline(
        name=method.name, title=method.title, legs=(Leg(method=method.name),)
    )
    return replace(
        DEFAULT,
        load_method=lambda name: method if name == method.name else load_method(name),
        pipelines_for=lambda scene: (first, *pipelines_for(scene)),
    )


def plugin_source(reference: str) -> str:
    """Return the source of the reference's module, for keys; "" for ours."""
    if reference == DEFAULT_PLUGIN:
        return ""
    return inspect.getsource(importlib.import_module(reference.partition(":")[0]))
