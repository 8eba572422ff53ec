"""Plans of the cart-pole between walls under tracking: an exact one is followed, one that cheats is not saved, and the command shows both replays."""

import json
import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from wording import unsaid

from formulations.pipelines import load_method
from formulations.solution import Outcome, Solution
from models.catalog import load_scene
from models.fmu import build_fmu
from models.netcdf import read_columns
from models.scene import Scene
from models.trajectory import Trajectory, write_csv
from models.trajectory_netcdf import write_netcdf
from reports.records.record import RunRecord
from reports.traces import read_motion
from validate.cli.group import run
from validate.judge.judgement import judge
from validate.judge.replay import Replay
from validate.judge.replay.netcdf import write_replay
from validate.judge.replay.run import replay
from validate.judge.score import Score, Verdict, score
from validate.store.results import COLUMNS, _row
from validate.tasks.leg import Planned
from validate.tasks.records import Judged, stage_record
from validate.tasks.scene_record import scene_record

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def scene() -> Scene:
    """Half the bank's step: of 0.02 s the plan is so coarse that feedback has to give most of what the plan itself gives."""
    return load_scene("cart_pole_walls").with_task(step=0.01, steps=200)


@pytest.fixture(scope="module")
def plans(scene: Scene) -> dict[str, Trajectory]:
    """cheat: force from a distance; exact: what strict complementarity makes of its last tightening."""
    found: dict[str, Trajectory] = {}
    plan = None
    with load_method("softplus_dc").open(scene, {}) as session:
        for eps in (1e-3, 1e-5, 1e-7):
            plan = session.solve(eps=eps, warm_start=plan, time_limit=60.0).trajectory
            found.setdefault("cheat", plan)
    with load_method("strict_lcp").open(scene, {}) as session:
        exact = session.solve(eps=None, warm_start=plan, time_limit=60.0).trajectory
    return found | {"exact": exact}


@pytest.fixture(scope="module")
def exact(scene: Scene, plans: dict[str, Trajectory]) -> Replay:
    return replay(scene, build_fmu(scene), plans["exact"], track=True)


def above(told: Score) -> set[str]:
    return {metric.name for metric in told.metrics if metric.ok is False}


def test_an_exact_plan_is_followed_where_alone_it_falls(scene: Scene, plans: dict[str, Trajectory], exact: Replay):
    told = score(scene, plans["exact"], exact)
    assert (told.verdict, told.judged) == (Verdict.HOLDS_WITH_FEEDBACK, "feedback"), told.why
    assert not unsaid(told.why, "not for the inputs alone: … the motion ends")
    assert "unstable in the open loop (amplification 1" in told.why
    assert abs(exact.growth.rate - 3.67) < math.log(2.0) / 2.0  # of the upright pole, within a factor of two over its two seconds
    assert (told.value("replay_terminal_velocity_error") or 0.0) > 0.2 > (told.value("tracked_replay_terminal_velocity_error") or 1.0)
    assert (told.value("feedback_effort") or 1.0) < 0.25
    assert (told.value("feedback_share") or 1.0) < 0.5
    assert (told.value("tracked_energy_residual") or 1.0) < 1e-9
    planned = scene.task.step * plans["exact"].lam.sum()
    assert exact.tracked.contact_impulse[-1].sum() == pytest.approx(planned, rel=0.1)  # by the wall, as planned
    assert planned > 0.5
    assert np.abs(exact.tracked.applied).max() <= 4.0  # type: ignore[arg-type] - of a type that was checked or made so above


@pytest.mark.parametrize("tells", [True, False])
@pytest.mark.parametrize("declares", [True, False])
def test_feedback_does_not_save_a_plan_whose_walls_push_from_a_distance(scene, plans, tells, declares):
    """With its forces in the plan, and with a plan that keeps them to itself, its scheme too: feedback is not even tried, and would not help."""
    plan = plans["cheat"]
    plan = plan if tells else replace(plan, lam=0.0 * plan.lam, missing=frozenset({"lam"}))
    plan = plan if declares else replace(plan, scheme=None)
    told = judge(scene, plan)
    assert told.verdict is Verdict.VIOLATES
    assert told.replay.tracked is None
    named = {(True, True): "physics_scaled", (True, False): "contact_law_error"}.get((tells, declares), "unexplained_force")
    assert named in above(told.score)
    forced = score(scene, plan, replay(scene, build_fmu(scene), plan, track=True))
    assert (forced.verdict, forced.judged) == (Verdict.VIOLATES, "open")


def test_the_command_shows_both_and_keeps_the_gains(scene, plans, tmp_path, capsys):
    write_csv(tmp_path / "plan.csv", plans["exact"], scene)
    arguments = ["replay", str(tmp_path / "plan.csv"), "--scene", scene.name, "--track"]
    assert run([*arguments, "--out", str(tmp_path / "told")]) == 0
    out, _ = capsys.readouterr()
    header = next(line for line in out.splitlines() if line.startswith("question"))
    assert header.split()[2:6] == ["inputs", "alone", "with", "feedback"]
    row = next(line.split() for line in out.splitlines() if line.split()[1:2] == ["replay_terminal_velocity_error"])
    assert float(row[2]) > 0.2 > float(row[3])
    assert not unsaid(out, "\nholds with feedback: not for the inputs alone")
    assert sorted(path.name for path in (tmp_path / "told").iterdir()) == ["plan.nc", "replay.nc", "score.json", "tracked.nc"]
    columns, _ = read_columns(tmp_path / "told/plan.nc")
    assert [len(column.values) for name, column in columns.items() if name.startswith("gain_")] == [200] * 4
    told = json.loads((tmp_path / "told/score.json").read_text())
    assert told["judged"] == "feedback"
    assert told["tracked"]["effort"]["rms_share"] == pytest.approx(0.13, abs=0.03)
    assert abs(told["growth"]["rate"] - 3.67) < math.log(2.0) / 2.0


def test_a_campaign_keeps_and_tells_both(scene: Scene, plans: dict[str, Trajectory], exact: Replay, tmp_path: Path):
    """The record of a stage: which replay is judged, growth, effort, the tracked motion with the inputs as applied; the last columns of results.csv."""
    plan, method = plans["exact"], load_method("strict_lcp")
    planned = Planned(index=0, name="strict_lcp", method=method, eps=None, options=method.read_options({}))
    told = score(scene, plan, exact)
    record = stage_record(
        scene, planned, Solution(method="strict_lcp", outcome=Outcome.SOLVED, trajectory=plan, cost=0.2), 0, wall=1.0, cpu=1.0, before=0.0,
        judged=Judged(replay=exact, score=told),
    )  # fmt: skip
    assert (record.replay.judged, record.replay.growth_rate) == ("feedback", exact.growth.rate if exact.growth else None)
    assert record.replay.tracked.rms_share == told.value("feedback_effort")
    run = RunRecord.model_construct(scene=scene_record(scene), stages=(record,))
    write_netcdf(tmp_path / "trajectory.nc", plan, scene)
    write_replay(tmp_path / "replay.nc", exact, scene)
    write_replay(tmp_path / "tracked.nc", exact.tracked, scene)
    motion = read_motion(tmp_path, run, record)
    assert motion.judged(record) is motion.tracked is not None
    name = scene.inputs[0].name
    for time, applied in zip(motion.tracked.t, motion.tracked.columns[name], strict=True):
        step = min(int(np.searchsorted(plan.t, time, side="right")) - 1, plan.steps - 1)
        assert applied == exact.tracked.applied[step, 0]
    assert motion.tracked.columns["position_error"].max() == pytest.approx(told.value("tracked_replay_error"))
    assert name not in motion.replay.columns
    row = _row(SimpleNamespace(scene=scene, pipeline="strict"), record)  # type: ignore[arg-type] - of a type that was checked or made so above
    last = ["judged", "tracked_replay_terminal_error", "tracked_replay_error", "feedback_effort", "feedback_share", "growth_rate"]
    place = COLUMNS.index(last[0])
    assert (list(COLUMNS)[place : place + 6], sorted(row)) == (last, sorted(COLUMNS))
    assert [row[name] for name in last[:2]] == ["feedback", told.value("tracked_replay_terminal_error")]


def test_a_scene_without_inputs_cannot_be_tracked(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "plan.csv").write_text("t,q,v\n0,1,0\n0.01,1,0\n", encoding="utf-8")
    code = run(["replay", str(tmp_path / "plan.csv"), "--scene", "bouncing_mass", "--track"])
    _, err = capsys.readouterr()
    assert (code, err.count("\n")) == (2, 1)
    assert not unsaid(err, "no inputs, so … nothing to feed back to")
