"""`doctor` tries things: what works is found to work, what is broken on purpose is found and a remedy is named."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from validate.cli.doctor import TRIALS, State, Trial, examine_machine


def doctor(*words: str, **environment: str) -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, "-m", "validate", "doctor", *words],
        capture_output=True,
        text=True,
        env={**os.environ, **environment},
        check=False,
    )


def named(name: str) -> tuple[Trial, ...]:
    return tuple(trial for trial in TRIALS if trial.name == name)


@pytest.mark.slow
def test_this_machine_runs_the_main_job(tmp_path):
    done = doctor("--out", str(tmp_path / "not" / "yet" / "there"), "--json")
    found = {finding["name"]: finding for finding in json.loads(done.stdout)["findings"]}
    assert {"Python", "store", "C compiler", "cache", "Ipopt", "PyTorch", "FMU"} <= set(found)
    assert all(
        finding["state"] == "works" for name, finding in found.items() if "extra" not in name
    ), found
    assert done.returncode == 0
    assert list(tmp_path.iterdir()) == [], "nothing is left behind"


def test_without_a_compiler_the_remedy_is_named(tmp_path, monkeypatch):
    monkeypatch.setenv("CC", "/nonexistent/cc")
    finding = list(examine_machine(tmp_path, named("C compiler")))[-1]
    assert finding.state is State.BROKEN
    assert "CC is '/nonexistent/cc'" in finding.sentence
    assert "pip install ziglang" in finding.remedy


@pytest.mark.slow
def test_what_rests_on_something_broken_is_not_to_be_installed_again(tmp_path, monkeypatch):
    monkeypatch.setenv("TOUCHSTONE_CACHE", str(Path(__file__) / "below_a_file"))
    cache, fmu = list(examine_machine(tmp_path, (*named("cache"), *named("FMU"))))[-2:]
    assert (cache.state, cache.remedy) == (
        State.BROKEN,
        "set TOUCHSTONE_CACHE to a folder you can write",
    )
    assert str(Path(__file__) / "below_a_file") in cache.sentence
    assert (fmu.state, fmu.remedy) == (State.BROKEN, "mend cache first")


def test_a_compiler_that_computes_something_else_is_found(tmp_path, monkeypatch):
    """A `cc` that adds one to whatever is returned."""
    wrapper = tmp_path / "cc"
    wrapper.write_text('#!/bin/sh\nexec /usr/bin/env cc "-Dreturn=return 1 +" "$@"\n')
    wrapper.chmod(0o755)
    monkeypatch.setenv("CC", str(wrapper))
    finding = list(examine_machine(tmp_path, named("C compiler")))[-1]
    assert finding.state is State.BROKEN
    assert "is 2.4142" in finding.sentence


@pytest.mark.slow
def test_an_unknown_linear_solver_is_a_finding(tmp_path, monkeypatch):
    monkeypatch.setenv("TOUCHSTONE_LINEAR_SOLVER", "nosuch")
    finding = list(examine_machine(tmp_path, named("Ipopt")))[-1]
    assert finding.state is State.BROKEN
    assert "nosuch" in finding.sentence


def test_a_trial_that_crashes_is_a_finding_too(tmp_path):
    crash = Trial(name="crash", function="nowhere", remedy="install it", needed=False)
    finding = list(examine_machine(tmp_path, (crash,)))[-1]
    assert finding.state is State.ABSENT
    assert finding.remedy == "install it"


def test_mujoco_is_tried_and_its_absence_is_no_fault(tmp_path, monkeypatch):
    pytest.importorskip("mujoco")
    (found,) = examine_machine(tmp_path, named("MuJoCo (extra [engines])"))
    assert (found.state, found.remedy) == (State.OK, "")
    assert "falls right" in found.sentence
    (tmp_path / "mujoco.py").write_text("raise ImportError")
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    monkeypatch.syspath_prepend(tmp_path)
    (found,) = examine_machine(tmp_path, named("MuJoCo (extra [engines])"))
    assert (found.state, found.remedy) == (State.ABSENT, "pip install mujoco")
    assert "engine mujoco and fmu --mjcf will say" in found.sentence


def test_a_store_that_is_a_file_is_said(tmp_path):
    (tmp_path / "taken").write_text("x")
    (store,) = examine_machine(tmp_path / "taken", named("store"))
    assert store.state is State.BROKEN
    assert "there is a file of that name" in store.sentence


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_store_without_permission_is_said(tmp_path):
    tmp_path.chmod(0o500)
    (store,) = examine_machine(tmp_path / "runs", named("store"))
    assert store.state is State.BROKEN


@pytest.mark.slow
def test_something_broken_is_exit_code_three(tmp_path):
    (tmp_path / "taken").write_text("x")
    done = doctor(
        "--out", str(tmp_path / "taken"), TOUCHSTONE_LINEAR_SOLVER="nosuch", CC="/nonexistent/cc"
    )
    assert done.returncode == 3
    assert "Traceback" not in done.stdout + done.stderr
    assert "to mend it" in done.stdout
