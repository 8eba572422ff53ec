"""Methods that behave and methods that misbehave in every way, and a judge that is quick, for tests of the campaign's machinery.

python -m validate all --plugin campaign_fakes:PLUGIN        # with this folder on PYTHONPATH
"""

import ctypes
import os
import subprocess
import sys
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from formulations.method import Clock, Kind, Leg, Method, Options, Pipeline, Session, option
from formulations.solution import Outcome, Solution
from models.scene import Scene
from models.trajectory import Trajectory, uniform_grid
from validate.judge.judgement import Judgement
from validate.judge.replay import Difference, Replay, ReplayError, ReplayOutcome
from validate.judge.score import Metric, Question, Score, Verdict
from validate.tasks.plugins import Plugin


@dataclass(frozen=True, kw_only=True)
class FakeOptions(Options):
    iterations: int = option(7, "does nothing", lower=1)


class _Session(Session):
    def __init__(self, scene: Scene, act, options: FakeOptions, name: str) -> None:
        self._scene, self._act, self._options, self._name = scene, act, options, name

    def solve(
        self, *, eps: float | None, warm_start: Trajectory | None, time_limit: float
    ) -> Solution:
        outcome = self._act() or Outcome.SOLVED
        if not isinstance(outcome, Outcome):
            return outcome
        trajectory = None
        if outcome.has_answer:
            scene, nodes = self._scene, self._scene.task.steps + 1
            state = np.tile(np.array(scene.task.start), (nodes, 1))
            shift = (
                0.0 if warm_start is None else warm_start.u[0, 0] + 1.0
            )  # shows whose plan it started from
            trajectory = Trajectory(
                t=uniform_grid(scene.task.step, scene.task.steps), q=state[:, : scene.nq],
                v=state[:, scene.nq :],
                u=np.full((nodes - 1, scene.nu), shift), lam=np.zeros((nodes - 1, scene.nc)),
            )  # fmt: skip
        cost = None if trajectory is None else float(np.sum(trajectory.u**2))
        return Solution(
            method=self._name,
            outcome=outcome,
            trajectory=trajectory,
            cost=cost,
            iterations=3,
            options=asdict(self._options),
        )


class FakeMethod(Method[FakeOptions]):
    options = FakeOptions

    def __init__(
        self,
        name: str,
        act=lambda: None,
        *,
        kind: Kind = Kind.DIRECT,
        needs_eps: bool = False,
        refuses: str | None = None,
    ) -> None:
        self.name, self.title, self.kind, self.needs_eps = (
            name,
            f"fake method {name}",
            kind,
            needs_eps,
        )
        self._act, self._refuses = act, refuses

    def accepts(self, scene: Scene) -> str | None:
        return self._refuses

    def session(self, scene: Scene, options: FakeOptions, clock: Clock) -> Session:
        return _Session(scene, self._act, options, self.name)


def hang() -> None:
    while True:
        time.sleep(1)


def _hang_with_family() -> None:
    """A child in the same group, and one that left it."""
    subprocess.Popen([sys.executable, "-c", "import time; time.sleep(1000)"])
    subprocess.Popen(
        [sys.executable, "-c", "import time; time.sleep(1000)"], start_new_session=True
    )
    hang()


def _leave_family() -> None:
    """Ends well, but leaves grandchildren and files behind."""
    subprocess.Popen([sys.executable, "-c", "import time; time.sleep(1000)"])
    subprocess.Popen(
        [sys.executable, "-c", "import time; time.sleep(1000)"], start_new_session=True
    )
    Path("litter.txt").write_text("left in the working folder")


def _garbage() -> None:
    os.write(1, bytes(range(256)) * 2000)
    print("\x1b[31m not for the terminal \x1b[0m")


def _raise() -> None:
    raise ValueError("the method's own mistake\nwith a second line")


def _spoil_result() -> None:
    """Stands for a process that died while it wrote its result."""
    folder = Path(os.getcwd()).parent
    (folder / "record.json").write_text('{"key": "half a rec')
    os._exit(0)


def _plan_of_another_scene() -> Solution:
    two = np.zeros((2, 1))
    return Solution(
        method="misfit",
        outcome=Outcome.SOLVED,
        trajectory=Trajectory(t=np.arange(2.0), q=two, v=two, u=two[:1], lam=two[:1]),
    )


METHODS = {
    method.name: method
    for method in (
        FakeMethod("good"), FakeMethod("soft", kind=Kind.INDIRECT, needs_eps=True),
        FakeMethod("bad_soft", _raise, kind=Kind.INDIRECT, needs_eps=True),
        FakeMethod("refuses", refuses="it wants friction."),
        FakeMethod("infeasible", lambda: Outcome.INFEASIBLE),
        FakeMethod("segfault", lambda: ctypes.string_at(0)), FakeMethod("abort", os.abort),
        FakeMethod("exit_zero", lambda: os._exit(0)), FakeMethod("exit_seven", lambda: os._exit(7)),
        FakeMethod("hang", hang),
        FakeMethod("family", _hang_with_family), FakeMethod("litter", _leave_family),
        FakeMethod("garbage", _garbage), FakeMethod("raises", _raise),
        FakeMethod("spoiled", _spoil_result), FakeMethod("misfit", _plan_of_another_scene),
        FakeMethod("no_solution", lambda: "solved!"),
        FakeMethod("quits", lambda: sys.exit(0)), FakeMethod("slow", lambda: time.sleep(0.6)),
        FakeMethod("violating"),
    )
}  # fmt: skip

PIPELINES = (
    Pipeline(name="soft+good", title="fake chain",
             legs=(Leg(method="soft", schedule=(1e-1, 1e-2), stage_options=({"iterations": 2},)),
                   Leg(method="good"))),
    Pipeline(name="broken_chain", title="fake chain whose middle breaks",
             legs=(Leg(method="soft", schedule=(1e-1,)), Leg(method="bad_soft", schedule=(1e-1,)),
                   Leg(method="good"))),
    Pipeline(name="soft_alone", title="fake indirect",
             legs=(Leg(method="soft", schedule=(1e-1,)),)),
    *(Pipeline(name=f"only_{name}", title=f"only {name}",
               legs=(Leg(method=name, schedule=(1e-1,) if METHODS[name].needs_eps else (None,)),
                     )) for name in METHODS if name not in {"soft"}),
)  # fmt: skip


def _judge(score, scene: Scene, fmu: Path, trajectory: Trajectory) -> Judgement:
    nodes = len(trajectory.t)
    still, lam = np.zeros(nodes), np.vstack([trajectory.lam, trajectory.lam[-1:]])
    replay = Replay(
        scene=scene.name, outcome=ReplayOutcome.OK, message="", method="everyday", t=trajectory.t,
        q=trajectory.q, v=trajectory.v, lam=lam,
        gap=np.zeros((nodes, scene.nc)), friction=np.zeros((nodes, scene.nf)),
        knots=np.arange(nodes), kinetic_energy=still, potential_energy=still,
        contact_energy=still, input_work=None, dissipated_work=None, contact_impulse=None,
        events=(), event_budget=0,
        error=ReplayError(estimate=Difference(position=1e-9, state=1e-9, gap=1e-9)),
        seconds_reference=0.0, seconds_everyday=0.0, fmu="none",
    )  # fmt: skip
    return Judgement(scene=scene, plan=trajectory, replay=replay, score=score(scene, trajectory))


def _score(scene: Scene, trajectory: Trajectory) -> Score:
    error = float(np.linalg.norm(trajectory.end - np.array(scene.task.goal)))
    shown = {
        "terminal_error": (error, "m"),
        "physics": (0.0, "N^2"),
        "replay_error": (float("nan"), "m"),
    }
    metrics = [
        Metric(name=name, question=Question.SHOWN, value=value, unit=unit, meaning="fake")
        for name, (value, unit) in shown.items()
    ]
    return Score(metrics=tuple(metrics), verdict=Verdict.HOLDS, why="it is a fake")


def _score_badly(scene: Scene, trajectory: Trajectory) -> Score:
    return replace(
        _score(scene, trajectory), verdict=Verdict.VIOLATES, why="the fake judge is strict"
    )


def _stumble(scene: Scene, trajectory: Trajectory) -> Score:
    raise ZeroDivisionError("the judge's own mistake")


def _write_report(folder: Path) -> Path:
    (folder / "report.html").write_text("fake report")
    return folder / "report.html"


def _fake_plugin(score=_score) -> Plugin:
    return Plugin(
        load_method=METHODS.__getitem__, pipelines_for=lambda scene: PIPELINES,
        quick=("soft+good",), checks=lambda scenes: (),
        compile=lambda scene: None, build_fmu=lambda scene: Path(os.devnull),
        judge=lambda scene, fmu, trajectory: _judge(score, scene, fmu, trajectory),
        write_replay=lambda *_: None,
        write_report=_write_report,
    )  # fmt: skip


PLUGIN = _fake_plugin()
STRICT = _fake_plugin(_score_badly)
STUMBLING = _fake_plugin(_stumble)


def _no_report(folder: Path) -> Path:
    raise RuntimeError("the report room is on fire")


BROKEN = replace(PLUGIN, write_report=_no_report)
