"""What a method hands back is looked at before anybody believes it: its type, its outcome, its shapes, and how long its plan lasts."""

import itertools
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from formulations.method import Kind
from formulations.solution import Outcome, Solution
from models.catalog import load_scene
from models.errors import MachineError, TrajectoryError
from models.trajectory import Trajectory, uniform_grid
from validate.tasks import stage as module
from validate.tasks.stage import Judge, OpenLeg, SolvedStage, first_line, prepare

SCENE = load_scene("wall_pendulum")
SOLVED = Solution(method="m", outcome=Outcome.SOLVED)


def planned_by(solve: Any, kind: Kind = Kind.INDIRECT, **session: Any) -> Any:
    """A stage of a method whose session answers so."""
    given = {"solve": solve, "start_used": lambda start: start, "close": lambda: None} | session
    method = SimpleNamespace(
        kind=kind, exact=kind is Kind.DIRECT, open=lambda scene, options: SimpleNamespace(**given)
    )
    return SimpleNamespace(name="m", method=method, options="options", eps=0.125)


def run(answer):
    planned = planned_by(lambda **given: answer, Kind.DIRECT)
    with closing(OpenLeg(SCENE, planned)) as leg:
        return leg.run(planned, None, 10.0).solution


def plan(step: float, steps: int) -> Trajectory:
    state = np.zeros((steps + 1, 1))
    return Trajectory(t=uniform_grid(step, steps), q=state, v=state, u=state[1:], lam=state[1:])


def test_a_plan_on_another_grid_of_the_same_duration_is_taken():
    task = SCENE.task
    found = run(
        Solution(method="m", outcome=Outcome.SOLVED, trajectory=plan(task.step / 2, 2 * task.steps))
    )
    assert found.trajectory.steps == 2 * task.steps


def test_the_first_stage_pays_for_the_opening_and_no_other_does(monkeypatch: pytest.MonkeyPatch):
    """With clocks that go on by 1 s and by 8 s whenever they are looked at: a stage takes one look, and so do opening and asking before it."""
    walls, cpus = itertools.count(5.0, 1.0), itertools.count(70.0, 8.0)
    monkeypatch.setattr(module.time, "perf_counter", lambda: next(walls))
    monkeypatch.setattr(module.time, "process_time", lambda: next(cpus))
    planned = planned_by(lambda **given: SOLVED)
    with closing(OpenLeg(SCENE, planned)) as leg:
        leg.leaves(None)
        first, second, third = (leg.run(planned, None, 10.0) for _ in range(3))
    assert [(stage.wall, stage.cpu) for stage in (first, second, third)] == [
        (3.0, 24.0),
        (1.0, 8.0),
        (1.0, 8.0),
    ]


@pytest.mark.parametrize(
    ("longer", "refused"),
    [(1 + 5e-10, False), (1 - 5e-10, False), (1 + 2e-9, True), (1 - 2e-9, True), (100.0, True)],
)
def test_a_plan_lasts_as_long_as_the_task_but_for_rounding(longer: float, refused: bool):
    """Any damped scene comes to rest if one waits: the goal belongs to the task's end."""
    task = SCENE.task
    answer = Solution(
        method="m", outcome=Outcome.SOLVED, trajectory=plan(longer * task.step, task.steps)
    )
    if refused:
        with pytest.raises(
            TrajectoryError,
            match=f"lasts {longer * task.horizon:.6g} s, .*wall_pendulum {task.horizon:.6g} s",
        ):
            run(answer)
    else:
        assert run(answer).trajectory is not None


@pytest.mark.parametrize("kind", list(Kind))
def test_a_session_is_asked_as_planned_and_the_plan_of_a_direct_method_is_looked_at(
    kind: Kind, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(
        module,
        "as_asked",
        lambda scene, solution: replace(solution, message=f"asked of {scene.name}"),
    )
    task, asked = SCENE.task, []
    answer = Solution(method="m", outcome=Outcome.SOLVED, trajectory=plan(task.step, task.steps))
    planned = planned_by(lambda **given: asked.append(given) or answer, kind)
    start = plan(task.step, task.steps)
    with closing(OpenLeg(SCENE, planned)) as leg:
        assert (leg.leaves(start), leg.leaves(None)) == (False, True)
        found = leg.run(planned, start, 7.0)
    assert asked == [{"eps": 0.125, "warm_start": start, "time_limit": 7.0}]
    assert (found.planned, found.solution.message) == (
        planned,
        "asked of wall_pendulum" if kind is Kind.DIRECT else "",
    )
    without = planned_by(lambda **given: SOLVED, kind)
    with closing(OpenLeg(SCENE, without)) as leg:
        assert leg.run(without, None, 7.0).solution is SOLVED


def test_what_is_no_solution_is_refused_and_a_session_that_does_not_close_keeps_what_was_found(
    capsys: pytest.CaptureFixture[str],
):
    def stuck() -> None:
        raise RuntimeError("does not close")

    with pytest.raises(TypeError, match="must hand back a Solution, not str"):
        run("solved")
    with pytest.raises(TypeError, match="must be an Outcome, not str"):
        run(Solution(method="m", outcome="solved"))  # type: ignore[arg-type] - what a method of somebody else may hand back
    planned = planned_by(lambda **given: SOLVED, close=stuck)
    with closing(OpenLeg(SCENE, planned)) as leg:
        assert leg.run(planned, None, 1.0).solution is SOLVED
    assert "does not close" in capsys.readouterr().err


def stage(kind: Kind, has_plan: bool) -> SolvedStage:
    task = SCENE.task
    found = replace(SOLVED, trajectory=plan(task.step, task.steps) if has_plan else None)
    return SolvedStage(planned_by(None, kind), found, wall=3.0, cpu=2.0)


def test_exact_plans_can_be_certified():
    assert stage(Kind.DIRECT, True).can_be_certified
    assert not stage(Kind.DIRECT, False).can_be_certified
    assert not stage(Kind.INDIRECT, True).can_be_certified


def test_each_method_is_opened_once_before_anything_is_timed(monkeypatch, capsys, tmp_path):
    log: list[Any] = []
    monkeypatch.setattr(module, "progress", lambda folder, text: log.append((folder, text)))

    def opens(name: str, error: Exception | None = None) -> Any:
        def opened(scene: Any, options: Any) -> Any:
            log.append((name, scene, options))
            if error is not None:
                raise error
            return SimpleNamespace(close=lambda: log.append(f"close {name}"))

        return SimpleNamespace(name=name, method=SimpleNamespace(open=opened), options=f"of {name}")

    profile: Any = SimpleNamespace(lap=lambda name: log.append(f"lap {name}"))
    plugin: Any = SimpleNamespace(compile=lambda scene: log.append(("compile", scene)))
    prepare(
        plugin, SCENE, (opens("a"), opens("b", ValueError("later")), opens("a")), tmp_path, profile
    )
    assert log == [
        (tmp_path, "the compilation of the scene"), ("compile", SCENE), "lap compile",
        (tmp_path, "the preparation of a"), ("a", SCENE, "of a"), "close a",
        (tmp_path, "the preparation of b"), ("b", SCENE, "of b"), "lap opening",
    ]  # fmt: skip
    assert "ValueError: later" in capsys.readouterr().err
    with pytest.raises(MachineError):
        prepare(plugin, SCENE, (opens("c", MachineError("full")),), tmp_path, profile)


@pytest.fixture
def log(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """What is written, and what a record is made of; clocks that go on by a second."""
    found: list[Any] = []
    monkeypatch.setattr(
        module,
        "write_netcdf",
        lambda path, plan, scene, gains=None: found.append((path.name, gains)),
    )
    monkeypatch.setattr(module, "stage_record", lambda *given, **named: (given, named))
    monkeypatch.setattr(module, "replace", lambda record, **update: (*record, update))
    monkeypatch.setattr(module, "with_certificate", lambda *given: given)
    walls = itertools.count(5.0, 1.0)
    monkeypatch.setattr(module.time, "perf_counter", lambda: next(walls))
    return found


def judge_of(log: list[Any], answer: Any) -> Judge:
    def judge(scene: Any, fmu: Any, trajectory: Any) -> Any:
        log.append(("judge", scene, fmu))
        if isinstance(answer, Exception):
            raise answer
        return answer

    plugin: Any = SimpleNamespace(
        build_fmu=lambda scene: log.append("build") or "the FMU", judge=judge, certify=lambda scene,
        solution: replace(solution, message="certified"),
        write_replay=lambda path, replay, *_: log.append((path.name, replay)),
    )  # fmt: skip
    return Judge(plugin, SCENE, SimpleNamespace(lap=lambda name: log.append(f"lap {name}")))  # type: ignore[arg-type]


@pytest.mark.parametrize("tracked", [False, True])
def test_a_plan_is_judged_and_what_was_seen_is_written_beside_it(
    log: list[Any], tracked: bool, tmp_path: Path
):
    followed = SimpleNamespace(feedback=SimpleNamespace(gains="gains")) if tracked else None
    replayed = SimpleNamespace(tracked=followed)
    judge, item = (
        judge_of(log, SimpleNamespace(replay=replayed, score="score")),
        stage(Kind.DIRECT, True),
    )
    given, named, update = judge.record(item, tmp_path, 1, 4.0)  # type: ignore[misc] - of the fixture
    judged = named.pop("judged")
    assert given == (item.planned, item.solution, 1)
    assert named == {"wall": 3.0, "cpu": 2.0, "before": 4.0}
    assert (judged.replay, judged.score, judged.seconds, judged.problem) == (
        replayed,
        "score",
        1.0,
        "",
    )
    assert update == {"certificate_missing": True}
    files = module.leg_files(2)
    rest = [(files["tracked"], followed), (files["trajectory"], "gains")] if tracked else []
    assert log == [
        "build", "lap fmu_build", (files["trajectory"], None), "lap writing",
        ("judge", SCENE, "the FMU"), "lap replay", (files["replay"], replayed),
        *rest, "lap writing",
    ]  # fmt: skip
    log.clear()
    judge.record(item, tmp_path, 2, 0.0)
    assert log[0] == "lap fmu_build", "its FMU is built once"


def test_without_a_plan_nothing_is_built_and_nothing_judged(log: list[Any], tmp_path: Path):
    _, named, update = judge_of(log, ValueError()).record(
        stage(Kind.DIRECT, False), tmp_path, 0, 0.0
    )
    assert (log, named["judged"].score, named["judged"].problem, update) == (
        ["lap fmu_build"],
        None,
        "",
        {"certificate_missing": False},
    )


def test_a_judge_that_stumbles_leaves_the_plan_and_its_words(
    log: list[Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    item = stage(Kind.INDIRECT, True)
    for error, words in (
        (ValueError("odd\nmore"), "the judge ended with ValueError: odd"),
        (KeyError(), "the judge ended with KeyError: no further words."),
    ):
        _, named, _ = judge_of(log, error).record(item, tmp_path, 0, 0.0)  # type: ignore[misc]
        assert (named["judged"].problem, named["judged"].seconds, named["judged"].score) == (
            words,
            1.0,
            None,
        )
    assert "ValueError: odd" in capsys.readouterr().err
    assert log[-2:] == [("judge", SCENE, "the FMU"), "lap replay"]
    with pytest.raises(MachineError):
        judge_of(log, MachineError("full")).record(item, tmp_path, 0, 0.0)


def test_a_certificate_is_that_of_the_plan_unless_its_maker_stumbles(
    log: list[Any], capsys: pytest.CaptureFixture[str]
):
    item, judge = stage(Kind.DIRECT, True), judge_of(log, None)
    record, solution = judge.certified("record", item)  # type: ignore[arg-type,misc]
    assert (record, solution.message, log) == ("record", "certified", ["lap certificate"])

    def fails(scene: Any, solution: Any) -> Any:
        raise ValueError("singular")

    judge._plugin.certify = fails  # type: ignore[method-assign]
    assert judge.certified("record", item)[1] is item.solution  # type: ignore[arg-type,index]
    assert "singular" in capsys.readouterr().err


def test_the_first_line_of_an_error():
    lines = {"one": "one", "one\ntwo": "one", "": "no further words.", "\ntwo": "no further words."}
    assert {text: first_line(ValueError(text)) for text in lines} == lines
