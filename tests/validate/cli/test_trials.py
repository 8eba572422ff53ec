"""The trials of `--dry-run`: what works is found to work; what is broken on purpose is found, with an advice."""

import json
import os
from pathlib import Path

import pytest
from wording import unsaid

from validate.cli.trials import TRIALS, Trial, try_machine

WORDS = ("all", "--scene", "two_body_collision", "--dry-run")


def named(*names: str) -> tuple[Trial, ...]:
    return tuple(trial for trial in TRIALS if trial.name in names)


@pytest.mark.slow
def test_dry_run_sound_machine_ends_with_0_and_leaves_nothing(cli, tmp_path):
    done = cli(*WORDS, "--out", str(tmp_path / "not" / "yet" / "there"), "--json")
    found = json.loads(done.stdout)
    assert [trial["name"] for trial in found["machine"]] == [
        "disk",
        "C compiler",
        "cache",
        "Ipopt",
        "PyTorch",
        "FMU",
    ]
    assert all(trial["works"] for trial in found["machine"]), found["machine"]
    assert (done.returncode, found["exit_code"]) == (0, 0)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_dry_run_broken_machine_ends_with_3_and_still_plans(cli, tmp_path):
    (tmp_path / "taken").write_text("x")
    broken = {"TOUCHSTONE_LINEAR_SOLVER": "nosuch", "CC": "/nonexistent/cc"}
    done = cli(*WORDS, "--out", str(tmp_path / "taken"), **broken)
    assert done.returncode == 3
    assert "Traceback" not in done.stdout + done.stderr
    lines = done.stdout.splitlines()
    assert [line[:7] for line in lines[:4]] == ["fails: ", "fails: ", "works: ", "fails: "]
    assert lines[-1] == "the campaign needs what fails here: disk, C compiler, Ipopt"
    assert "0 stored, 2 to run" in lines[-2]


def test_trial_without_compiler_names_it(tmp_path, monkeypatch):
    monkeypatch.setenv("CC", "/nonexistent/cc")
    (finding,) = try_machine(tmp_path, named("C compiler", "PyTorch", "FMU"))
    assert not finding.works
    assert not unsaid(finding.sentence, "CC is '/nonexistent/cc'", "correct it or unset it")


def test_trial_without_cache_leaves_out_what_needs_it(tmp_path, monkeypatch):
    monkeypatch.setenv("TOUCHSTONE_CACHE", str(Path(__file__) / "below_a_file"))
    (finding,) = try_machine(tmp_path, named("cache", "FMU"))
    assert (finding.name, finding.works) == ("cache", False)
    assert str(Path(__file__) / "below_a_file") in finding.sentence
    assert "set TOUCHSTONE_CACHE to a folder you can write" in finding.sentence


def test_trial_wrong_compiler_is_found(tmp_path, monkeypatch):
    """A `cc` that adds one to whatever is returned."""
    wrapper = tmp_path / "cc"
    wrapper.write_text('#!/bin/sh\nexec /usr/bin/env cc "-Dreturn=return 1 +" "$@"\n')
    wrapper.chmod(0o755)
    monkeypatch.setenv("CC", str(wrapper))
    (finding,) = try_machine(tmp_path, named("C compiler"))
    assert not finding.works
    assert not unsaid(finding.sentence, "is 2.4142", "Set CC to another compiler.")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("module", "trial"), [("cyipopt", "Ipopt"), ("torch", "PyTorch"), ("fmpy", "FMU")]
)
def test_trial_of_a_missing_package_says_what_to_install(tmp_path, monkeypatch, module, trial):
    (tmp_path / f"{module}.py").write_text("raise ImportError('it is shadowed')")
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    monkeypatch.syspath_prepend(tmp_path)
    (finding,) = try_machine(tmp_path, named(trial))
    assert not finding.works
    assert not unsaid(finding.sentence, "it is shadowed", "Run `pip install", module)


@pytest.mark.slow
def test_trial_unknown_linear_solver_needs_no_new_ipopt(tmp_path, monkeypatch):
    monkeypatch.setenv("TOUCHSTONE_LINEAR_SOLVER", "nosuch")
    (finding,) = try_machine(tmp_path, named("Ipopt"))
    assert not finding.works
    assert "nosuch" in finding.sentence
    assert "pip install" not in finding.sentence


def test_trial_that_crashes_is_a_finding(tmp_path):
    (finding,) = try_machine(tmp_path, (Trial("crash", "nowhere", "Install it."),))
    assert not finding.works
    assert finding.sentence.endswith("Install it.")


def test_trial_disk_that_is_a_file_fails(tmp_path):
    (tmp_path / "taken").write_text("x")
    (finding,) = try_machine(tmp_path / "taken", named("disk"))
    assert not finding.works
    assert not unsaid(finding.sentence, "Not a directory", "another folder with --out")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_trial_disk_without_permission_fails(tmp_path):
    tmp_path.chmod(0o500)
    (finding,) = try_machine(tmp_path / "runs", named("disk"))
    assert not finding.works
