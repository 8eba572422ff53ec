"""The simulations of a replay as one job: what is asked of a child, what its end means, and how the runs are put together; with a child that answers what the test says."""

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from wording import unsaid

from models.errors import MachineError
from models.trajectory import Hold, Trajectory
from validate.fmi.archive import FmuError
from validate.judge.replay import ReplayOutcome
from validate.judge.replay import job as module
from validate.judge.replay.everyday import (
    base_step,
    everyday_refusal,
    require_some_method,
)
from validate.judge.replay.job import Job, Simulations
from validate.judge.replay.tracking import tracking_refusal
from validate.judge.replay.wiring import Feedback, HeldInputs, Variables
from validate.processes.isolated import Ending, Limits, unpacked_from

VARIABLES = Variables(q=(1,), v=(2,), u=(5,), lam=(3,), gap=(4,), energies={},
                      powers={"input_power": 6, "dissipated_power": 7}, zero=frozenset(),
                      parameters=(), start=(1, 2), internal_step=None)  # fmt: skip
PLAN = Trajectory(t=np.array([0.0, 0.5, 1.0]), q=np.zeros((3, 1)), v=np.zeros((3, 1)),
                  u=np.array([[1.0], [2.0]]), lam=np.zeros((2, 1)),
                  hold=Hold.LINEAR, u_end=np.array([3.0]))  # fmt: skip
START = np.array([8.0, 9.0])
NO_FMU: Any = SimpleNamespace(
    exchange=True, digest="sha", description=SimpleNamespace(defaultExperiment=None)
)
JOB = Job(package=NO_FMU, variables=VARIABLES, plan=PLAN, start=START, limits=None,
          tolerances=(1e-11, 1e-13), fineness=(50, 100), event_budget=7, parts=4, max_step=0.25)  # fmt: skip


def package(
    *, exchange: bool = True, cosimulation: bool = True, once: bool = False, saves: bool = True
) -> Any:
    def interface(there: bool) -> Any:
        return SimpleNamespace(canBeInstantiatedOnlyOncePerProcess=once, canGetAndSetFMUstate=saves,
                               canHandleVariableCommunicationStepSize=True) if there else None  # fmt: skip

    return SimpleNamespace(
        path=Path("some.fmu"), exchange=interface(exchange), cosimulation=interface(cosimulation)
    )


def ended(ending: Ending, **more: Any) -> Any:
    return SimpleNamespace(**({"ending": ending, "ok": ending is Ending.OK,
                               "sentence": f"it was {ending.name}.", "cpu": 2.5, "strays": 0,
                               "value": None, "output": "", "arrays": None} | more))  # fmt: skip


def told(kinds: list[str], refusal: str | None = None, note: str = "", strays: int = 0) -> Any:
    """A child that made such runs, each with numbers of its own."""
    value: dict[str, Any] = {"refusal": refusal, "note": note, "seconds": [0.25, 0.5], "runs": []}
    arrays: dict[str, np.ndarray] = {}
    for number, kind in enumerate(kinds):
        value["runs"].append(
            {
                "kind": kind,
                "outcome": "DIVERGED" if number else "OK",
                "message": f"run {number}",
                "events": [[0.5, 1.0, 1]],
            }
        )
        for place, name in enumerate(("t", "outputs", "accumulated", "knots", "applied", "local")):
            arrays[f"{number}_{name}"] = np.array([10.0 * number + place])
    return ended(Ending.OK, value=value, arrays=arrays, strays=strays)


def asked(
    monkeypatch: pytest.MonkeyPatch,
    answers: list[Any],
    fmu: Any,
    feedback: Feedback | None = None,
    **more: Any,
) -> tuple[Any, list[Any]]:
    """What comes of a job whose children end so, and what each was asked: (function, request, job, feedback, limits, what); more: what else the job is."""
    requests: list[Any] = []
    rest = iter(answers)

    def isolated(
        function: str, request: Any, *, arrays: Any, limits: Any, what: str, ours: bool
    ) -> Any:
        assert ours is bool(more.get("ours"))
        requests.append((function, dict(request), *unpacked_from(arrays), limits, what))
        return next(rest)

    monkeypatch.setattr(module, "run_isolated", isolated)
    monkeypatch.setattr(module, "library_path", lambda: Path("loops.so"))
    return replace(JOB, **({"package": fmu, "limits": Limits()} | more)).run(feedback), requests


def test_a_child_is_asked_for_all_of_a_job(monkeypatch: pytest.MonkeyPatch):
    found, requests = asked(
        monkeypatch,
        [told(["reference", "everyday"], "refused", "noted")],
        package(),
        limits=Limits(seconds=3.0),
        ours=True,
    )
    ((function, request, job, feedback, limits, what),) = requests
    assert (function, limits.seconds, what, feedback) == (
        "validate.judge.replay.job:simulate",
        3.0,
        "FMU some.fmu",
        None,
    )
    assert request == {"path": str(Path("some.fmu").resolve()), "loops": "loops.so", "kept": False}
    assert type(job) is Simulations, "the child has its own FMU, and no limits of its own to set"
    names = (
        "variables",
        "tolerances",
        "fineness",
        "event_budget",
        "parts",
        "max_step",
        "world",
    )
    assert [getattr(job, name) for name in names] == [
        VARIABLES,
        (1e-11, 1e-13),
        (50, 100),
        7,
        4,
        0.25,
        None,
    ]
    sent, given = (
        [one.t, one.u, start, one.u_end] for one, start in ((job.plan, job.start), (PLAN, START))
    )
    assert [array.tolist() for array in sent] == [array.tolist() for array in given]
    assert job.plan.hold is Hold.LINEAR
    ((reference,), (everyday,)) = found.reference, found.everyday
    assert (reference.t, reference.outputs, reference.accumulated, reference.knots,
            reference.applied) == ([0.0], [1.0], [2.0], [3.0], [4.0])  # fmt: skip
    assert (reference.outcome, everyday.outcome) == (ReplayOutcome.OK, ReplayOutcome.DIVERGED)
    assert (everyday.message, everyday.t) == ("run 1", [10.0])
    assert reference.events == [(0.5, 1, True)]
    assert (found.refusal, found.seconds_reference, found.seconds_everyday, found.note) == (
        "refused",
        0.25,
        0.5,
        "noted",
    )


def test_a_child_is_given_the_feedback_and_an_endless_step(monkeypatch: pytest.MonkeyPatch):
    feedback = Feedback(
        gains=np.zeros(1), reference=np.ones(1), u=np.ones(2), lower=np.ones(3), upper=np.ones(4),
        scale=np.ones(5)
    )  # fmt: skip
    constant = replace(PLAN, hold=Hold.ZERO_ORDER, u_end=None)
    _, requests = asked(
        monkeypatch, [told([])], package(), feedback, plan=constant, max_step=math.inf
    )
    job, law = requests[0][2:4]
    assert (job.max_step, job.plan.hold, job.plan.u_end) == (math.inf, Hold.ZERO_ORDER, None)
    assert [array.tolist() for array in vars(law).values()] == [
        array.tolist() for array in vars(feedback).values()
    ]


@pytest.mark.parametrize(("exchange", "cosimulation"), [(True, True), (True, False), (False, True)])
def test_one_instance_a_process_takes_a_process_a_run(
    exchange: bool, cosimulation: bool, monkeypatch: pytest.MonkeyPatch
):
    fmu = package(exchange=exchange, cosimulation=cosimulation, once=True)
    answers = [
        told(["reference"], note="a"), told(["reference"], "no first", "b"),
        told(["everyday"], "no second", "a"), told(["everyday"], note="c"),
    ]  # fmt: skip
    chosen = (answers[:2] if exchange else []) + (answers[2:] if cosimulation else [])
    found, requests = asked(monkeypatch, chosen, fmu)
    runs = [((1e-11,), ()), ((1e-13,), ())] if exchange else []
    runs += [((), (50,)), ((), (100,))] if cosimulation else []
    assert [(job.tolerances, job.fineness) for _, _, job, *_ in requests] == runs
    assert (len(found.reference), len(found.everyday)) == (2 * exchange, 2 * cosimulation)
    assert (found.seconds_reference, found.seconds_everyday) == (0.25 * len(runs), 0.5 * len(runs))
    assert found.refusal == ("no first" if exchange else "no second" if cosimulation else None)
    assert found.note == " ".join(
        (["a", "b"] if exchange else [])
        + (["c"] if exchange and cosimulation else ["a", "c"] if cosimulation else [])
    )


@pytest.mark.parametrize(
    ("ending", "outcome"),
    [
        (Ending.TIME_LIMIT, ReplayOutcome.TIME_LIMIT),
        (Ending.MEMORY_LIMIT, ReplayOutcome.MEMORY_LIMIT), (Ending.SIGNAL, ReplayOutcome.CRASHED),
        (Ending.ABORT, ReplayOutcome.ABORTED), (Ending.NO_RESULT, ReplayOutcome.NO_RESULT),
    ],
)  # fmt: skip
@pytest.mark.parametrize("exchange", [True, False])
def test_what_ended_a_child_is_the_outcome_of_its_one_run(ending, outcome, exchange, monkeypatch):
    found, requests = asked(monkeypatch, [ended(ending)], package(exchange=exchange, saves=False))
    runs, others = (
        (found.reference, found.everyday) if exchange else (found.everyday, found.reference)
    )
    assert ([(run.outcome, run.message) for run in runs], others) == (
        [(outcome, f"it was {ending.name}.")],
        (),
    )
    assert (
        found.refusal,
        found.seconds_reference,
        found.seconds_everyday,
        found.note,
        len(requests),
    ) == (None, 2.5, 0.0, "", 1)
    without, _ = asked(monkeypatch, [ended(ending)], package(saves=False), tolerances=())
    assert (len(without.reference), len(without.everyday)) == (0, 1)


@pytest.mark.parametrize(
    ("strays", "words"),
    [(1, "The FMU left 1 process behind"), (3, "The FMU left 3 processes behind"), (0, "")],
)
def test_what_an_fmu_leaves_behind_is_said(
    strays: int, words: str, monkeypatch: pytest.MonkeyPatch
):
    found, _ = asked(monkeypatch, [told([], strays=strays)], package())
    assert not unsaid(found.note, words)
    assert bool(found.note) is bool(words)


def test_mistakes_of_the_machine_and_of_others_are_raised(monkeypatch: pytest.MonkeyPatch):
    with pytest.raises(MachineError, match="it was MACHINE"):
        asked(monkeypatch, [ended(Ending.MACHINE)], package())
    with pytest.raises(FmuError, match="it was ERROR"):
        asked(monkeypatch, [ended(Ending.ERROR)], package())


# What an interface must offer


def test_an_everyday_replay_is_refused_where_steps_must_be_equal():
    even, uneven = HeldInputs(PLAN), HeldInputs(replace(PLAN, t=np.array([0.0, 0.5, 1.1])))
    takes, equal = (
        SimpleNamespace(cosimulation=SimpleNamespace(canHandleVariableCommunicationStepSize=takes))
        for takes in (True, False)
    )
    assert [
        everyday_refusal(fmu, inputs) is None for fmu in (takes, equal) for inputs in (even, uneven)
    ] == [True, True, True, False]  # type: ignore[arg-type]
    assert "differ in length" in str(everyday_refusal(equal, uneven))  # type: ignore[arg-type]
    rounded = HeldInputs(replace(PLAN, t=np.array([0.0, 0.5, 1.0 + 2e-10])))
    assert everyday_refusal(equal, rounded) is None  # type: ignore[arg-type]
    assert (
        everyday_refusal(SimpleNamespace(cosimulation=None), even)
        == "the FMU offers no Co-Simulation"
    )
    require_some_method(package(), "no")
    require_some_method(package(exchange=False), None)
    with pytest.raises(FmuError, match=r"some\.fmu: it offers no Model Exchange, and no; .*cannot"):
        require_some_method(package(exchange=False), "no")


@pytest.mark.parametrize(
    ("times", "expected"), [([0.0, 0.5, 1.5], 0.5), ([0.0, 1e-6, 2.0], 0.1), ([0.0, 1.5, 2.0], 0.5)]
)
def test_a_step_of_a_microsecond_is_not_the_measure_of_all(times: list[float], expected: float):
    assert base_step(np.array(times)) == pytest.approx(expected)


def described(states: list[int], *, three: bool = False, **claims: str) -> Any:
    derivatives = [
        SimpleNamespace(
            variable=SimpleNamespace(
                derivative=SimpleNamespace(valueReference=item, name=f"state {item}")
            )
        )
        for item in states
    ]
    return SimpleNamespace(
        exchange="there", is_three=three, can=lambda kind,
        ability: kind == "ModelExchange" and ability in claims,
        description=SimpleNamespace(derivatives=derivatives),
    )  # fmt: skip


def test_feedback_needs_derivatives_of_states_that_are_the_positions_and_velocities():
    whole = described([2, 1], providesDirectionalDerivative="true")
    assert tracking_refusal(whole, VARIABLES) is None
    assert (
        tracking_refusal(
            described([2, 1], three=True, providesDirectionalDerivatives="true"), VARIABLES
        )
        is None
    )
    for fmu, variables, words in (
        (SimpleNamespace(exchange=None), VARIABLES, "no Model Exchange"),
        (
            described([2, 1], three=True, providesDirectionalDerivative="true"),
            VARIABLES,
            "no directional derivatives",
        ),
        (described([2, 1]), VARIABLES, "no directional derivatives"),
        (whole, replace(VARIABLES, u=()), "no inputs"),
        (
            described([2, 9, 8], providesDirectionalDerivative="true"),
            VARIABLES,
            "its state state 9 is none of",
        ),
        (described([2], providesDirectionalDerivative="true"), VARIABLES, "one for one"),
        (
            described([2, 1], providesDirectionalDerivative="true"),
            replace(VARIABLES, v=(1,)),
            "its state state 2 is none",
        ),
        (
            described([1, 1], providesDirectionalDerivative="true"),
            replace(VARIABLES, v=(1,)),
            "one for one",
        ),
    ):
        assert not unsaid(str(tracking_refusal(fmu, variables)), words)


# From runs to a replay
