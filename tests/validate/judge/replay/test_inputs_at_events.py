"""An FMU's event sees the inputs of its time: those on a line where they are then, those that jump there the new ones. Against closed forms."""

from pathlib import Path

import numpy as np
import pytest
from foreign_fmu import EXCHANGE, FULL_MAP, MASS, build_foreign, write_plan

from validate.judge.judgement import wire_fmu
from validate.judge.replay import Replay
from validate.judge.replay.run import replay_foreign


def moved(folder: Path, define: str, t: np.ndarray, force: np.ndarray, hold: str) -> Replay:
    """The replay of forces (nodes,) [N] at t (nodes,) [s] on a cart at rest 0.3 m, without contact."""
    still = np.column_stack([t, np.full_like(t, 0.3), np.zeros_like(t), force, np.zeros_like(t)])
    plan = write_plan(folder / "plan.csv", plan=still)
    plan.write_text(f"# hold: {hold}\n" + plan.read_text(encoding="utf-8"), encoding="utf-8")
    at_rest = FULL_MAP.replace('"body.vel" = 2000', '"body.vel" = 0')
    (folder / "cart.toml").write_text(at_rest, encoding="utf-8")
    wired = wire_fmu(
        build_foreign(folder / "cart.fmu", kinds=EXCHANGE, defines=(define,)),
        plan,
        map_path=folder / "cart.toml",
    )
    found = replay_foreign(wired.foreign, wired.package, wired.plan, limits=wired.limits)
    assert found.ok
    return found


@pytest.mark.parametrize("rows", [3, 9])
def test_a_latch_opens_when_the_line_of_the_input_gets_there(tmp_path: Path, rows: int):
    """F = 20 t N, held until it is 5 N at 0.25 s.

    Then x - x(0) = (5 s^2/2 + 20 s^3/6)/m with s = t - 0.25 s.
    """
    t = np.linspace(0.0, 0.4, rows)
    found = moved(tmp_path, "LATCH=0.005", t, 20.0 * t, "linear")
    s = np.maximum(t - 0.25, 0.0)
    assert found.q[found.knots, 0] - 0.3 == pytest.approx(
        (2.5 * s**2 + 20.0 * s**3 / 6.0) / MASS, abs=1e-9
    )
    assert found.events[0].time == pytest.approx(0.25, abs=1e-12)


@pytest.mark.parametrize("rounding", [0.0, 1e-15, -1e-15])
def test_a_time_event_at_a_row_samples_the_input_of_that_row(tmp_path: Path, rounding: float):
    """Rows every 0.05 s, samples every 0.1 s: a force that is sampled acts until the next sample."""
    t, force = 0.05 * np.arange(9), np.array([1.0, 7.0, -2.0, 5.0, 3.0, -9.0, 4.0, 1.0, 0.0])
    shifted = t + np.where((t > 0.0) & (np.arange(9) % 2 == 0), rounding, 0.0)
    found = moved(tmp_path, "SAMPLED=0.1", shifted, force, "zero")
    felt = np.repeat(force[:-1:2], 2) / MASS
    v = np.concatenate([[0.0], np.cumsum(0.05 * felt)])
    x = 0.3 + np.concatenate([[0.0], np.cumsum(0.05 * v[:-1] + 0.05**2 * felt / 2.0)])
    assert found.v[found.knots, 0] == pytest.approx(v, abs=1e-9)
    assert found.q[found.knots, 0] == pytest.approx(x, abs=1e-9)
