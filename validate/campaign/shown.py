"""Show one plan in a notebook, or as the page that `replay --html` writes.

    plan = SolvedPlan.of(solution, scene, "softplus_dc+strict")  # a Solution with its scene
    verdict = JudgedPlan.of(judgement, "plan.csv")  # a Judgement with the name of its plan
    verdict.page("python -m validate replay plan.csv --scene three_cart")

The page is that of a run in the report. The module is separate from the judge, which depends on
neither methods nor reports. `touchstone` exports the classes as `Solution` and `Judgement`.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from formulations.pipelines import load_method
from formulations.solution import Solution
from models.errors import TrajectoryError
from models.kinematics import gap_columns, pose_columns
from models.netcdf import Column, write_columns
from models.results.run import (
    LONGEST,
    ContactRecord,
    QuantityRecord,
    RunRecord,
    SceneRecord,
    StageRecord,
    stage_files,
)
from models.scene import Scene
from models.trajectory import Trajectory, data_frame
from reports.render import framed, render_run
from validate.judge.judgement import Judgement
from validate.judge.replay.netcdf import storable, storable_name, write_drawn
from validate.judge.replay.result import Replay
from validate.judge.replay.subject import ForeignModel, Subject
from validate.store.provenance import gather
from validate.tasks.leg import Planned
from validate.tasks.records import Judged, given_stage, stage_record
from validate.tasks.scene_record import scene_record

if TYPE_CHECKING:
    import pandas as pd

_KEY = "plan"
_NOT_JUDGED = Judged(
    problem="nobody judged it yet: touchstone.judge(scene, plan) replays it and says whether it holds."
)


@dataclass(frozen=True, kw_only=True, repr=False)
class SolvedPlan(Solution):
    """A Solution with its scene and its pipeline, or its method and eps.

    >>> plan = ts.solve("three_cart", "softplus_dc", eps=1e-3)
    >>> plan
    Solution(three_cart by softplus_dc, eps 0.001: solved, cost 197.9, 500 steps)
    """

    scene: Scene
    pipeline: str
    eps: float | None = None

    @classmethod
    def of(
        cls, solution: Solution, scene: Scene, pipeline: str, eps: float | None = None
    ) -> SolvedPlan:
        """Return the Solution with its scene."""
        return cls(
            **{item.name: getattr(solution, item.name) for item in fields(Solution)},
            scene=scene,
            pipeline=pipeline,
            eps=eps,
        )

    @property
    def title(self) -> str:
        """Return the pipeline, or the method and its eps."""
        return self.pipeline if self.eps is None else f"{self.pipeline}, eps {self.eps:g}"

    def __repr__(self) -> str:
        found = [self.outcome.name.lower().replace("_", " ")]
        found += [] if self.cost is None else [f"cost {self.cost:.4g}"]
        found += ["no plan"] if self.trajectory is None else [f"{self.trajectory.steps} steps"]
        return f"Solution({self.scene.name} by {self.title}: {', '.join(found)})"

    def to_dataframe(self) -> pd.DataFrame:
        """Return the plan: one row for each node, columns named as in the scene.

        See `Trajectory.to_dataframe`. Raises MachineError, and TrajectoryError if there is no plan.
        """
        return self._found().to_dataframe(self.scene)

    def plot(self) -> np.ndarray:
        """Draw the plan over time [s] and return (panels,) matplotlib Axes.

        See `Trajectory.plot`. Raises MachineError, and TrajectoryError if there is no plan.
        """
        return self._found().plot(self.scene)

    def _found(self) -> Trajectory:
        if self.trajectory is None:
            raise TrajectoryError(
                f"{self.title} on {self.scene.name}: no plan was found. {self.message or self.outcome.value}"
            )
        return self.trajectory

    def stage(self, judged: Judged) -> StageRecord:
        """Return the record of the last stage, with the judge's result."""
        method = load_method(self.method)
        planned = Planned(
            index=0, name=self.method, method=method, eps=self.eps, options=method.read_options({})
        )
        seconds = self.seconds
        return stage_record(
            planned,
            self,
            0,
            wall=seconds.wall,
            cpu=seconds.cpu,
            before=0.0,
            judged=judged,
        )

    def _repr_html_(self) -> str:
        command = f"touchstone.solve({self.scene.name!r}, {self.pipeline!r}{'' if self.eps is None else f', eps={self.eps!r}'})"
        return framed(
            _page(self.scene, self.trajectory, None, self.stage(_NOT_JUDGED), self.title, command)
        )


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class JudgedPlan(Judgement):
    """A Judgement with the name of its plan: the pipeline, or the file of the plan.

    >>> ts.judge("three_cart", plan)
    Judgement(three_cart, softplus_dc, eps 0.001: violates, cost 197.9, replay error 0.3546 m)
    """

    name: str = "plan"
    solution: SolvedPlan | None = None

    @classmethod
    def of(cls, judgement: Judgement, plan: object) -> JudgedPlan:
        """Return the Judgement with the name of a plan in any form that `judge` takes."""
        solution = plan if isinstance(plan, SolvedPlan) else None
        name = (
            solution.title
            if solution is not None
            else Path(plan).name
            if isinstance(plan, (str, Path))
            else "plan"
        )
        return cls(
            **{item.name: getattr(judgement, item.name) for item in fields(Judgement)},
            name=name,
            solution=solution,
        )

    def __repr__(self) -> str:
        found = [self.verdict.value]
        for name in ("cost", "replay_error"):
            metric = self.score.metric(name)
            if metric is not None and metric.value is not None:
                found.append(
                    f"{name.replace('_', ' ')} {metric.value:.4g}{'' if metric.unit == '1' else f' {metric.unit}'}"
                )
        return f"Judgement({self.scene.name}, {self.name}: {', '.join(found)})"

    def __str__(self) -> str:
        return super().__repr__()

    def to_dataframe(self) -> pd.DataFrame:
        """Return the metrics, one row each.

        Columns: question, metric, value, error, unit, limit, ok (None: undecided), meaning, reason.
        Raises MachineError.
        """
        return data_frame(
            {
                "question": [metric.question.number for metric in self.score.metrics],
                "metric": [metric.name for metric in self.score.metrics],
                **{
                    name: [getattr(metric, name) for metric in self.score.metrics]
                    for name in _COLUMNS
                },
            }
        )

    def plot(self) -> np.ndarray:
        """Draw the plan and its replay over time [s] and return (panels,) Axes.

        The replay with feedback is drawn if the verdict is on that replay. Raises as `SolvedPlan.plot`.
        """
        if self.plan is None:
            raise TrajectoryError(f"{self.name} on {self.scene.name}: there is no plan to draw.")
        replay = (
            self.replay.tracked
            if self.replay is not None and self.score.judged == "feedback"
            else self.replay
        )
        # A ForeignModel has the attributes of a Scene that are read here.
        return self.plan.plot(cast(Scene, self.scene), replay)

    def page(
        self,
        command: str,
        warnings: Sequence[str] = (),
        additions: Mapping[str, Any] = MappingProxyType({}),
    ) -> str:
        """Return the page of a run for this plan: one self-contained HTML file.

        command: repeats the judgement.
        warnings: sentences on the page.
        additions: JSON data of further sections by name (reports.render).
        """
        return _page(
            self.scene, self.plan, self.replay, self._stage(warnings), self.name, command, additions
        )

    def _repr_html_(self) -> str:
        return framed(self.page(f"touchstone.judge({self.scene.name!r}, plan)"))

    def _stage(self, warnings: Sequence[str] = ()) -> StageRecord:
        seconds = _seconds(self.replay)
        if self.solution is None:
            return given_stage(self.name, self.replay, self.score, seconds, " ".join(warnings))
        return self.solution.stage(Judged(replay=self.replay, score=self.score, seconds=seconds))


# Columns of a metric in a data frame after its question and name.
_COLUMNS = ("value", "error", "unit", "limit", "ok", "meaning", "reason")


def _seconds(replay: Replay | None) -> float:
    """Return the CPU time of the replays [s]."""
    return (
        0.0
        if replay is None
        else replay.seconds_reference + replay.seconds_everyday + _seconds(replay.tracked)
    )


def _page(
    subject: Subject, plan: Trajectory | None, replay: Replay | None, stage: StageRecord, name: str,
    command: str, additions: Mapping[str, Any] = MappingProxyType({})
) -> str:  # fmt: skip
    drawn, record = _drawn(subject, plan)
    run = _run(record, stage, name, command)
    with tempfile.TemporaryDirectory(prefix="touchstone-") as place:
        folder, files = Path(place) / "runs" / _KEY, stage_files(0, 1)
        folder.mkdir(parents=True)
        if plan is not None:
            _write_plan(folder / files["trajectory"], plan, drawn)
        for what, motion in (
            ("replay", replay),
            ("tracked", None if replay is None else replay.tracked),
        ):
            if plan is not None and motion is not None and len(motion.t):
                write_drawn(folder / files[what], motion, drawn, plan, LONGEST)
        return render_run(run, Path(place), additions)


def _drawn(subject: Subject, plan: Trajectory | None) -> tuple[Subject, SceneRecord]:
    """Return the subject with names valid in files, and its record."""
    if isinstance(subject, Scene):
        return subject, scene_record(subject)
    named = _with_common_names(subject)
    return named, _foreign_record(named, plan)


def _run(scene: SceneRecord, stage: StageRecord, name: str, command: str) -> RunRecord:
    return RunRecord(
        key=_KEY,
        scene=scene,
        pipeline=name,
        pipeline_title="" if stage.kind == "given" else stage.method_title,
        stages=(stage,),
        outcome=stage.outcome,
        message=stage.message,
        verdict=stage.verdict,
        must_hold=stage.kind != "indirect",
        wall_seconds=stage.seconds.wall + stage.seconds.replay,
        cpu_seconds=stage.seconds.cpu + stage.seconds.replay,
        provenance=gather(command),
    )


def _write_plan(path: Path, plan: Trajectory, subject: Subject) -> None:
    """Write the columns that the plan states, and the gaps and poses of a scene."""
    forces = [f"lam_{item.name}" for item in subject.contacts] + [
        item.force_name for item in subject.frictions
    ]
    said = ["lam" not in plan.missing] * subject.nc + ["friction" not in plan.missing] * subject.nf
    groups = [
        ("node", ["t"], plan.t[:, None]),
        ("node", [item.name for item in subject.coordinates] if plan.has_states else [], plan.q),
        ("step", [item.name for item in subject.inputs], plan.u),
        (
            "step",
            [name for name, is_said in zip(forces, said, strict=True) if is_said],
            plan.lam[:, said],
        ),
    ]
    columns = [
        Column(name=name, dimension=dimension, values=values[:, index], unit="", description="")
        for dimension, names, values in groups
        for index, name in enumerate(names)
    ]
    if isinstance(subject, Scene) and plan.has_states:
        columns += [*gap_columns(subject, plan.q, "node"), *pose_columns(subject, plan.q, "node")]
    write_columns(path, storable(columns), {})


def _with_common_names(model: ForeignModel) -> ForeignModel:
    """Return the model with names valid in files; forces and gaps are named as in reports."""
    contacts = []
    for item in model.contacts:
        name = storable_name(item.name)
        contacts.append(replace(item, name=name, force_name=f"lam_{name}", gap_name=f"gap_{name}"))
    coordinates = tuple(replace(item, name=storable_name(item.name)) for item in model.coordinates)
    inputs = tuple(replace(item, name=storable_name(item.name)) for item in model.inputs)
    return replace(model, coordinates=coordinates, inputs=inputs, contacts=tuple(contacts))


def _foreign_record(model: ForeignModel, plan: Trajectory | None) -> SceneRecord:
    """Return the record of an external FMU: names, units, start and goal."""
    start = () if plan is None else tuple(plan.start.tolist())
    return SceneRecord(
        name=model.name,
        title="Somebody's FMU: what its map names.",
        source="",
        coordinates=tuple(
            _quantity(item.name, item.unit, item.description) for item in model.coordinates
        ),
        velocities=tuple(
            _quantity(item.velocity_name, item.velocity_unit, f"velocity of {item.name}")
            for item in model.coordinates
        ),
        inputs=tuple(_quantity(item.name, item.unit, item.description) for item in model.inputs),
        contacts=tuple(
            ContactRecord(name=item.name, unit="N/m", description=item.description)
            for item in model.contacts
        ),
        parameters=(),
        start=start,
        goal=model.task.goal,
        step=model.task.step,
        steps=0 if plan is None else plan.steps,
        waived=tuple(
            f"{limit.metric}: {limit.reason}" for limit in model.limits if limit.value is None
        ),
    )


def _quantity(name: str, unit: str, description: str) -> QuantityRecord:
    return QuantityRecord(name=name, unit=unit, description=description)
