"""A plan whose times are those of a clock, on somebody's FMU: counted from the FMU's own start, which is said; other times stay."""

from pathlib import Path

import numpy as np
import pytest
from edited_fmu import edited
from foreign_fmu import FULL_MAP, build_foreign, foreign_plan, write_plan

from models.plan_table import PlanTable
from models.trajectory import Trajectory
from validate.fmi.description import read_package
from validate.judge.replay.map_schema import read_map
from validate.judge.replay.mapping import wire
from validate.judge.replay.run import replay_foreign
from validate.judge.replay.subject import Foreign
from validate.processes.isolated import Limits

_SINCE_1970 = 1_762_345_678.25


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_foreign(tmp_path_factory.mktemp("clock") / "cart.fmu")


def _wired(fmu: Path, folder: Path, first: float) -> tuple[Foreign, Trajectory]:
    plan = foreign_plan()
    plan[:, 0] += first
    path = write_plan(folder / "plan.csv", plan=plan)
    (folder / "map.toml").write_text(FULL_MAP, encoding="utf-8")
    return wire(read_package(fmu), PlanTable(path), read_map(folder / "map.toml"), None, "map")


def _starting_at(fmu: Path, folder: Path, start: str) -> Path:
    experiment = f'<DefaultExperiment startTime="{start}"/><ModelVariables>'
    return edited(
        fmu, folder / "late.fmu", lambda text: text.replace("<ModelVariables>", experiment)
    )


@pytest.mark.parametrize("start", [None, "3.5"])
def test_times_of_a_clock_are_counted_from_the_start_of_the_fmu(
    start: str | None, fmu: Path, tmp_path: Path
):
    path = fmu if start is None else _starting_at(fmu, tmp_path, start)
    foreign, plan = _wired(path, tmp_path, _SINCE_1970)
    first = float(start or 0.0)
    assert plan.t[0] == first
    # A clock that shows so many seconds tells 0.24 us apart.
    np.testing.assert_allclose(plan.t, first + foreign_plan()[:, 0], rtol=0.0, atol=1e-9)
    (note,) = [text for text in foreign.model.notes if "clock" in text]
    assert "1762345678" in note
    assert f"t = {first:g} s" in note


@pytest.mark.parametrize(("first", "start"), [(0.0, None), (12.5, None), (1.7e9, "1.7e9")])
def test_other_times_stay(first: float, start: str | None, fmu: Path, tmp_path: Path):
    """Also of an FMU that starts at a clock's time itself."""
    path = fmu if start is None else _starting_at(fmu, tmp_path, start)
    foreign, plan = _wired(path, tmp_path, first)
    assert plan.t[0] == first
    assert not [text for text in foreign.model.notes if "clock" in text]


def test_verdict_is_that_of_the_plan_from_zero(fmu: Path, tmp_path: Path):
    values = []
    for first in (0.0, _SINCE_1970):
        foreign, plan = _wired(fmu, tmp_path, first)
        replayed = replay_foreign(foreign, read_package(fmu), plan, limits=Limits(seconds=100.0))
        assert replayed.ok, replayed.message
        values.append(replayed.q[replayed.knots])
    np.testing.assert_allclose(values[1], values[0], rtol=0.0, atol=1e-9)
