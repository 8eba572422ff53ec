"""The truth suite: its answers are right, two ways; it finds five faults planted in each adapter.

What it writes is equal twice but for times.
"""

import importlib
import importlib.util
import math
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import sympy as sp
from wording import unsaid

from models.scene import Scene
from reports.pages.simulators import as_markdown, truth_page
from validate.cli import truth
from validate.cli.truth import as_csv, drives, judged, observed_order, recorded, reference_is_right
from validate.judge.engines.simulator import (
    Came,
    EngineAnswer,
    describe_engine,
    load_engine,
    named_engines,
)
from validate.truth.exact_motion import Equations, Piece, true_motion
from validate.truth.problems import TruthProblem, problems, restitution

PROBLEMS = {f"{problem.phenomenon}: {problem.name}": problem for problem in problems()}
# What each fault is looked for with, the first of them that the engine expresses.
SHOWS = {
    "stiffness / 2": "rebound: undamped",
    "friction off": "creep under load: mu = 0.5, half of what friction holds",
    "step x 2": "two-body collision: masses 1 and 3", "sign of the normal": "rebound: undamped",
    "damping ignored": "rebound: Kelvin-Voigt damping",
}  # fmt: skip


def of_package(package: str):
    """Skipped where a package is missing."""
    return pytest.mark.skipif(
        importlib.util.find_spec(package) is None, reason=f"{package} is not installed"
    )


DRAKE = [
    pytest.param(f"drake_{name}", marks=[pytest.mark.peer, of_package("pydrake")])
    for name in ("continuous", "sap", "cenic")
]


def here(engine: str, drives) -> EngineAnswer:
    """What an engine answers that runs in this process."""
    return EngineAnswer(came=Came.DONE, motions=tuple(map(load_engine(engine), drives)))


def error_of(problem: TruthProblem, engine: str) -> float:
    """At the finest of its levels, in this process; infinite where it diverged."""
    row = judged(
        problem,
        engine,
        here(engine, drives(problem, describe_engine(engine))),
        problem.end(),
    )
    error = row.levels[-1].error
    return math.inf if error is None else error


def test_there_are_thirteen_phenomena():
    assert len({problem.phenomenon for problem in PROBLEMS.values()}) == 13


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        name
        for name, problem in PROBLEMS.items()
        if problem.exact and not name.startswith(("energy", "dying"))
    ],
)
def test_a_closed_form_is_what_our_own_integration_gives(name: str):
    problem = PROBLEMS[name]
    found = true_motion(
        Equations(problem.scene),
        [Piece(end=problem.duration, u=np.array(problem.u))],
        np.array([problem.duration]),
    )[0]
    scales = np.repeat([problem.position, problem.velocity], problem.scene.nq)
    assert np.nanmax(np.abs(found - problem.end()) / scales) <= 1e-9


def test_dying_bounces_rest_when_the_series_of_flights_says():
    """t_1 + (2 v/g) e/(1 - e) of flights and the contacts between them.

    gravity, which acts in contact too, takes a tenth of e here.
    """
    problem = PROBLEMS["dying bounces: damping ratio 0.2, until it rests"]
    v, e = math.sqrt(2 * 9.81 * 0.5), restitution(0.2)
    series = v / 9.81 + 2 * v / 9.81 * e / (1 - e)
    rest = next(ask.exact for ask in problem.asks if ask.name == "time of rest")
    assert 0.8 * series < rest < series + 8 * 0.1


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", sorted({problem.phenomenon: name for name, problem in PROBLEMS.items()}.values())
)
def test_our_reference_is_right(name: str):
    assert error_of(PROBLEMS[name], "fmu") <= truth.NEAR


@pytest.mark.slow
@pytest.mark.parametrize("fault", SHOWS)
@pytest.mark.parametrize(
    "engine", ["fmu", "fmu_everyday", pytest.param("mujoco", marks=of_package("mujoco")), *DRAKE]
)
def test_a_fault_planted_in_an_adapter_is_found(monkeypatch, engine: str, fault: str):
    damped = {
        "drake_continuous": "rebound: Hunt-Crossley damping",
        "drake_cenic": "rebound: Hunt-Crossley damping",
    }
    problem = PROBLEMS[
        damped.get(engine, SHOWS[fault]) if fault == "damping ignored" else SHOWS[fault]
    ]
    right = error_of(problem, engine)
    assert right < (0.1 if engine in ("drake_sap", "drake_cenic") else 2e-3)
    plant(monkeypatch, engine, fault)
    wrong = error_of(problem, engine)
    assert not wrong < max(2e-2, 3.0 * right)


def plant(monkeypatch, engine: str, fault: str) -> None:
    """The fault, where the adapter reads the scene or makes its steps."""
    module, ours = (
        importlib.import_module(f"validate.judge.engines.adapters.{engine}"),
        engine.startswith("fmu"),
    )
    shared = (
        importlib.import_module(
            "validate.judge.engines.adapters.fmu"
            if ours
            else "validate.judge.engines.adapters._drake"
        )
        if ours or "drake" in engine
        else module
    )
    if fault == "step x 2" and engine == "drake_sap":  # its plant has the step
        given = module.Plant
        monkeypatch.setattr(
            module,
            "Plant",
            lambda drive, time_step, **how: given(drive, time_step=2.0 * time_step, **how),
        )
        return
    if fault == "step x 2" and not ours:
        monkeypatch.setattr(
            module, "stepped", lambda drive, advance,
            given=module.stepped: given(drive, lambda u, slope, count,
                                        h: advance(u, slope, count, 2 * h)),
        )  # fmt: skip
        return
    if fault == "step x 2":
        monkeypatch.setattr(
            shared,
            "HeldInputs",
            lambda plan, feedback, held=shared.HeldInputs: held(
                replace(plan, t=2.0 * plan.t), feedback
            ),
        )
        return
    name = "build_fmu" if ours else "mechanism_of"
    read = getattr(shared, name)
    monkeypatch.setattr(shared, name, lambda scene, **given: read(spoilt(scene, fault), **given))


def spoilt(scene: Scene, fault: str) -> Scene:
    """A scene as a faulty adapter reads it."""
    if fault == "friction off":
        return replace(
            scene, frictions=tuple(replace(item, coefficient=sp.S.Zero) for item in scene.frictions)
        )
    change = {
        "stiffness / 2": lambda contact: replace(contact, stiffness=contact.stiffness / 2),
        "sign of the normal": lambda contact: replace(contact, penetration=-contact.penetration),
        "damping ignored": lambda contact: replace(contact, damping=sp.S.Zero),
    }[fault]
    return replace(scene, contacts=tuple(map(change, scene.contacts)))


def test_order_is_the_slope_of_error_over_step():
    assert observed_order([1.6e-3, 4e-4, 1e-4, 2.5e-5]) == pytest.approx(2.0)
    assert observed_order([1e-3, 1e-14, math.nan, 0.0]) is None


def test_rows_without_a_number_stand_in_the_table():
    problem = PROBLEMS["rebound: Hunt-Crossley damping"]
    lost = judged(
        problem,
        "mujoco",
        EngineAnswer(came=Came.MISSING, why="engine mujoco: not installed"),
        problem.end(),
    )
    fine = replace(lost, engine="fmu", came="cannot express it", why="it has no such contact")
    record = recorded(("fmu", "mujoco"), [fine, lost])
    assert "cannot express it | not installed" in as_markdown(record, "x")
    assert not reference_is_right(record.rows)


@pytest.mark.slow
def test_what_is_written_is_equal_twice_but_for_times(monkeypatch):
    few = [PROBLEMS["rebound: Hunt-Crossley damping"]]
    monkeypatch.setattr(truth, "problems", lambda: few)
    runs = [
        recorded(("fmu", "fmu_everyday"), truth.measure(("fmu", "fmu_everyday"))) for _ in range(2)
    ]
    one, other = (
        [line.rsplit(",", 2)[0] for line in as_csv(record).splitlines()] for record in runs
    )
    assert one == other
    assert len(one) == 1 + 2 * 4
    assert as_markdown(runs[0], "x") == as_markdown(runs[1], "x")
    page = truth_page(runs[0], "python -m validate truth")
    assert "Hunt-Crossley" in page
    assert "grid-of-figs" in page


def test_a_name_that_is_no_engine_is_one_sentence(cli):
    done = cli("truth", "--engine", "mujuco")
    assert done.returncode == 2
    assert not unsaid(done.stderr, "no engine 'mujuco'; did you mean mujoco")
    assert named_engines("fmu, fmu") == ("fmu",)


@pytest.mark.slow
@pytest.mark.process
def test_an_engine_that_is_missing_is_exit_code_3_where_it_is_asked_for(
    cli_environment, tmp_path: Path
):
    (tmp_path / "sitecustomize.py").write_text("import sys\nsys.modules['mujoco'] = None\n")
    paths = os.pathsep.join([str(tmp_path), cli_environment["PYTHONPATH"]])
    command = [sys.executable, "-m", "validate", "truth", "--engine", "mujoco"]
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        env={**cli_environment, "PYTHONPATH": paths},
        check=False,
    )
    assert done.returncode == 3
    assert not unsaid(done.stderr, "not installed; pip install")
    assert "Traceback" not in done.stderr
