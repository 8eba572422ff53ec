"""`python -m benchmarks engine-errors`: our FMU stands beside the exact motion, and an engine without an answer is a cell with the reason."""

from pathlib import Path

import pytest
from click.testing import CliRunner

from benchmarks import engine_errors


@pytest.mark.slow
@pytest.mark.process
def test_our_fmu_is_held_against_the_exact_motion(monkeypatch, tmp_path: Path):
    monkeypatch.setattr(engine_errors, "TENDONS", ())
    monkeypatch.setattr(engine_errors, "EXACT", {"bouncing_mass": 1e-9, "damped_collision": 1e-5})
    done = CliRunner().invoke(
        engine_errors.command, ["--plans", str(tmp_path)], standalone_mode=False
    )
    assert done.return_value == 0, done.output
    fine, coarse = (
        [cell.strip() for cell in line.split("|")]
        for line in done.output.splitlines()
        if "in 0." in line
    )
    assert float(fine[2].split()[0]) < 1e-10
    assert 1e-10 < float(coarse[2].split()[0]) < 1e-4
    assert "drake_cenic: the package pydrake" in coarse[3] or "its damping is another" in coarse[3]
