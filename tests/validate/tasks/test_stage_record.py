"""A record says what its source says, field by field, with values that all differ.

What is not known is not 0. A scene's equations as they are written by hand.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import sympy as sp

from formulations.certificate.certificate import Certificate
from formulations.certificate.stationarity import Stationarity
from formulations.method import Pipeline
from formulations.pipelines import find_pipeline, load_method
from formulations.solution import ModelSize, Outcome, Seconds, Solution
from models.catalog import load_scene
from models.codegen.emit import step_operations
from models.dynamics import derive
from models.results.run import (
    CertificateRecord,
    ContactRecord,
    LegRecord,
    QuantityRecord,
    ReplayRecord,
    StageRecord,
    TrackedRecord,
)
from models.results.verdict import Metric, Question
from models.scene import Limit
from models.trajectory import Trajectory, uniform_grid
from tests.reports import record_factory as factory
from validate.judge.replay.result import (
    Difference,
    Event,
    Growth,
    Replay,
    ReplayError,
    ReplayOutcome,
)
from validate.judge.replay.wiring import Effort
from validate.judge.score import Score, Verdict
from validate.tasks import scene_record as module
from validate.tasks.leg import Planned
from validate.tasks.paper import paper_row
from validate.tasks.records import (
    LOG_LINES,
    Judged,
    run_record,
    stage_record,
    stages_of,
    unfinished_stage,
    with_certificate,
)
from validate.tasks.scene_record import equations, scene_record
from validate.tasks.task import RunTask

SCENE = load_scene("three_cart")
METHOD = load_method("softplus_dc")
UNJUDGED = Judged()
PLANNED = Planned(
    index=2, name="softplus_dc", method=METHOD, eps=1e-5, options=METHOD.read_options({})
)


def metric(**changes: Any) -> Metric:
    said = {
        "name": "replay_error", "question": Question.MOTION, "value": 1.5, "unit": "m",
        "meaning": "far", "error": 0.25, "limit": 2.5,
        "reason": "r", "ok": True, "default": False,
    }  # fmt: skip
    return Metric(**(said | changes))


def plan(*forces: tuple[float, float]) -> Trajectory:
    """A plan with these contact forces (left, right), one pair a step."""
    steps = len(forces)
    still = np.zeros((steps + 1, 3))
    return Trajectory(
        t=uniform_grid(0.01, steps), q=still, v=still, u=np.zeros((steps, 2)), lam=np.array(forces)
    )


def certificate(**changes: Any) -> Certificate:
    said = {
        "primal": 1e-7, "primal_relative": 2e-7, "complementarity": 3e-7, "forced": 5e-7,
        "dual": 6e-7, "given_dual": math.nan,
        "pairs": 40, "biactive": 3, "stationarity": Stationarity.STRONG, "obstacle": "a sign", "descent": 0.0,
        "worst": "constraint_time[3]", "objective": 12.5,
    }  # fmt: skip
    return Certificate(**(said | changes))


CERTIFIED = certificate()
CERTIFICATE = CertificateRecord(
    holds=True, feasible=True, primal=1e-7, worst="constraint_time[3]", complementarity=3e-7,
    dual=6e-7, strong=True, obstacle="a sign",
    pairs=40, biactive=3, b_stationary=True, sentence=CERTIFIED.sentence,
)  # fmt: skip


def replay(**changes: Any) -> Replay:
    nodes = np.zeros(2)
    said = {
        "scene": "three_cart", "outcome": ReplayOutcome.OK, "message": "", "method": "reference",
        "t": np.array([0.0, 1.0]), "q": np.zeros((2, 3)),
        "v": np.zeros((2, 3)), "lam": np.zeros((2, 2)), "gap": np.zeros((2, 2)),
        "friction": np.zeros((2, 0)), "knots": np.arange(2),
        "kinetic_energy": nodes, "potential_energy": nodes, "contact_energy": nodes,
        "input_work": None, "dissipated_work": None,
        "contact_impulse": None, "events": (Event(time=0.5, contact="left", closes=True),) * 7,
        "event_budget": 100, "error": error(0.0), "seconds_reference": 0.75,
        "seconds_everyday": 0.375, "fmu": "abc",
    }  # fmt: skip
    return Replay(**(said | changes))


def error(by: float) -> ReplayError:
    """Each part of it another number; by: added to all."""
    estimate, tolerance, step, everyday, lag = (
        Difference(position=by + n, state=by + 10 * n, gap=by + 100 * n) for n in range(1, 6)
    )
    return ReplayError(
        estimate=estimate, tolerance=tolerance, step=step, everyday=everyday, lag=lag
    )


def solution(**changes: Any) -> Solution:
    said = {
        "method": "softplus_dc", "outcome": Outcome.ITERATION_LIMIT, "message": "it took long",
        "trajectory": plan((0.0, 0.0)), "cost": 490.5,
        "iterations": 77, "solver": "Ipopt 3.14",
    }  # fmt: skip
    return Solution(**(said | changes))


def recorded(found: Solution, judged: Judged = UNJUDGED, index: int = 1) -> StageRecord:
    return stage_record(PLANNED, found, index, wall=7.0, cpu=6.5, before=100.0, judged=judged)


def scored(*metrics: Metric, **changes: Any) -> Score:
    return Score(**({"metrics": metrics, "verdict": Verdict.HOLDS, "why": "so"} | changes))


def test_every_field_of_a_stage_stands_in_its_own():
    found = solution(
        residuals={"defect": 1e-9, "lost": math.nan, "endless": math.inf, "none": 0.0},
        size=ModelSize(unknowns=11, equations=12), paper_size=ModelSize(unknowns=13, equations=14),
        seconds=Seconds(build=0.5, translate=0.25, evaluate=0.125, linear_algebra=2.0, wall=3.0,
                        cpu=4.0), certificate=CERTIFIED,
        options={"count": 3, "tight": True, "step": 0.5, "name": "x", "none": None,
                 "many": (1, 2.5), "endless": math.inf, "mixed": (1, math.nan), "empty": (),
                 "other": Outcome.SOLVED},
        history={"loss": (3.0, 2.0, 1.0), "norm": (30.0, 20.0, 10.0)},
    )  # fmt: skip
    judged = Judged(
        score=scored(metric(), questions=((Question.GOAL, "yes"), (Question.JUDGE, "undecided")),
                     not_asked=("friction: none",)),
        replay=replay(), seconds=8.0,
    )  # fmt: skip
    assert recorded(found, judged) == StageRecord(
        index=1, method="softplus_dc", method_title=METHOD.title, kind="indirect", eps=1e-5,
        outcome="iteration_limit",
        advice=Outcome.ITERATION_LIMIT.value, message="it took long", cost=490.5, iterations=77,
        solver="Ipopt 3.14",
        residuals={"defect": 1e-9, "none": 0.0},
        size=ModelSize(unknowns=11, equations=12), paper_size=ModelSize(unknowns=13, equations=14),
        options={"count": 3, "tight": True, "step": 0.5, "name": "x", "none": None,
                 "many": [1.0, 2.5], "endless": "inf", "mixed": "(1, nan)", "empty": [],
                 "other": "Outcome.SOLVED"},
        history={"loss": (3.0, 2.0, 1.0), "norm": (30.0, 20.0, 10.0)}, certificate=CERTIFICATE,
        seconds=Seconds(
            build=0.5, translate=0.25, evaluate=0.125, linear_algebra=2.0, wall=7.0,
            cpu=6.5, total=107.0, replay=8.0
        ),
        metrics=(
            Metric(
                name="replay_error", value=1.5, unit="m", meaning="far", question=Question.MOTION, error=0.25,
                limit=2.5, reason="r", ok=True, default=False
            ),
        ),
        verdict="holds", why="so",
        questions=(
            (Question.GOAL, "yes"),
            (Question.JUDGE, "undecided"),
        ),
        not_asked=("friction: none",), has_plan=True,
        replay=ReplayRecord(
            error_estimate=1.0, tolerance_difference=2.0, step_difference=3.0,
            everyday_difference=4.0, events=7, seconds_reference=0.75, seconds_everyday=0.375,
            fmu="abc", message=ReplayOutcome.OK.value,
        ),
    )  # fmt: skip


def test_what_a_stage_does_not_have_is_not_there():
    found = recorded(solution(trajectory=None, cost=math.nan))
    assert (found.cost, found.size, found.certificate, found.replay) == (None, None, None, None)
    assert (found.metrics, found.questions, found.not_asked, found.history) == ((), (), (), {})
    assert (found.verdict, found.why, found.has_plan, found.seconds.replay) == (
        "no plan",
        "it took long",
        False,
        0.0,
    )
    assert found.options == {name: found.options[name] for name in vars(PLANNED.options)}, (
        "none were said: those that were asked"
    )


@pytest.mark.parametrize(("changes", "judged", "said"), [
    ({"trajectory": None, "outcome": Outcome.REFUSED}, Judged(),
     ("not applicable", "it took long")),
    ({"trajectory": None, "message": ""}, Judged(), ("no plan", Outcome.ITERATION_LIMIT.value)),
    ({}, Judged(problem="the judge stumbled"), ("undecided", "the judge stumbled")),
    ({}, Judged(problem="unsaid", score=scored(verdict=Verdict.VIOLATES, why="it does not")),
     ("violates", "it does not")),
], ids=["refused", "without a plan", "without a score", "scored"])  # fmt: skip
def test_the_verdict_is_the_scores_or_says_why_there_is_none(
    changes: dict[str, Any], judged: Judged, said: tuple[str, str]
):
    found = recorded(solution(**changes), judged)
    assert (found.verdict, found.why) == said


def test_the_replay_with_feedback_stands_beside_the_open_one():
    effort = Effort(
        rms=(0.5, 0.25),
        peak=(1.5, 1.25),
        rms_share=0.0625,
        peak_share=0.125,
        plan_share=0.75,
        saturated=0.875,
    )
    followed = replay(
        error=error(0.5), events=(Event(time=0.5, contact="left", closes=True),) * 3,
        seconds_reference=5.0, seconds_everyday=6.0, effort=effort,
        outcome=ReplayOutcome.DIVERGED, message="",
    )  # fmt: skip
    growth = Growth(amplification=math.exp(6.0), begin=0.0, end=1.0, duration=2.0)
    judged = Judged(
        score=scored(judged="feedback"),
        replay=replay(tracked=followed, growth=growth, message="a word"),
    )
    found = recorded(solution(), judged).replay
    assert (found.judged, found.growth_rate, found.message) == (
        "feedback",
        pytest.approx(3.0),
        "a word",
    )
    assert found.tracked == TrackedRecord(
        error_estimate=1.5, events=3, seconds_reference=5.0, seconds_everyday=6.0,
        message=ReplayOutcome.DIVERGED.value, rms=(0.5, 0.25),
        peak=(1.5, 1.25), rms_share=0.0625, peak_share=0.125, plan_share=0.75, saturated=0.875,
    )  # fmt: skip
    said = replace(followed, message="its own word")
    record = recorded(solution(), Judged(score=scored(), replay=replay(tracked=said))).replay
    assert record.tracked.message == "its own word"


def test_an_error_of_the_replay_that_is_not_known_is_missing():
    unknown = ReplayError(
        estimate=None, tolerance=Difference(position=math.inf, state=1.0, gap=1.0)
    )
    found = recorded(solution(), Judged(replay=replay(error=unknown), problem="no score")).replay
    assert (
        found.error_estimate,
        found.tolerance_difference,
        found.step_difference,
    ) == (None, None, None)
    assert (found.judged, found.growth_rate, found.tracked) == ("open", None, None)


def test_iterations_that_are_not_finite_are_left_out_and_long_histories_are_thinned():
    found = recorded(
        solution(history={"loss": (1.0, math.nan, 3.0, 4.0), "norm": (1.5, 2.5, 3.5, math.inf)})
    )
    assert found.history == {"loss": (1.0, 3.0), "norm": (1.5, 3.5)}
    assert recorded(solution(history={"loss": (math.nan,)})).history == {"loss": ()}
    assert recorded(solution(history={"loss": ()})).history == {"loss": ()}
    long = recorded(solution(history={"loss": tuple(map(float, range(4000)))})).history["loss"]
    assert (len(long), long[0], long[-1]) == (340, 0.0, 3999.0)


def test_a_certificate_comes_to_its_stage_alone():
    before = replace(recorded(solution()), certificate_missing=True)
    after = with_certificate(before, solution(certificate=CERTIFIED))
    assert (after.certificate, after.certificate_missing) == (CERTIFICATE, False)
    assert replace(after, certificate=None, certificate_missing=True) == before


def test_what_a_certificate_does_not_know_is_missing():
    found = recorded(
        solution(
            certificate=certificate(
                primal=math.inf,
                complementarity=math.nan,
                dual=math.nan,
            )
        )
    ).certificate
    assert (found.primal, found.complementarity, found.dual) == (None, None, None)
    assert (found.holds, found.feasible) == (False, False)


def test_a_plan_that_is_feasible_need_not_hold():
    found = recorded(
        solution(certificate=certificate(stationarity=Stationarity.WEAK, descent=-1.0))
    ).certificate
    assert (found.feasible, found.holds, found.b_stationary) == (True, False, False)


def leg(pipeline: str, *totals: float) -> LegRecord:
    stages = tuple(
        replace(recorded(solution(), index=place), seconds=Seconds(wall=1.0, total=total))
        for place, total in enumerate(totals)
    )
    return LegRecord(key="k", pipeline=pipeline, stages=stages, files={})


def test_the_stages_of_a_run_are_those_of_its_legs_one_after_the_other():
    """Each is counted on from the legs before it, its seconds too.

    What another run made names it.
    """
    found = stages_of(
        (leg("softplus_dc+relu_gd", 1.0, 3.0, 6.0), leg("softplus_dc+strict", 10.0)),
        "three_cart",
        "softplus_dc+strict",
    )
    assert [stage.index for stage in found] == [0, 1, 2, 3]
    assert [stage.seconds.total for stage in found] == [1.0, 3.0, 6.0, 16.0]
    assert [stage.seconds.wall for stage in found] == [1.0] * 4
    assert [stage.shared_from for stage in found] == ["softplus_dc+relu_gd"] * 3 + [""]
    assert [stage.paper["cost"] for stage in found] == [197.86, 261.23, 339.53, 16619.35]
    assert [stage.paper for stage in stages_of((leg("mpcc", 1.0),), "three_cart", "mpcc")] == [{}]
    assert stages_of((), "three_cart", "mpcc") == []


@pytest.mark.parametrize(
    ("outcome", "verdict"), [(Outcome.REFUSED, "not applicable"), (Outcome.CRASHED, "no plan")]
)
def test_a_stage_without_an_answer_says_why(outcome: Outcome, verdict: str):
    found = unfinished_stage("three_cart", "softplus_dc+strict", PLANNED, outcome, "signal 11")
    assert found == StageRecord(
        index=2, method="softplus_dc", method_title=METHOD.title, kind="indirect", eps=1e-5,
        outcome=outcome.name.lower(), advice=outcome.value,
        message="signal 11", options=recorded(solution()).options, verdict=verdict, why="signal 11",
        paper={"cost": 339.53, "stability": 0.0, "physics": 239.50, "time": 12.40},
    )  # fmt: skip


def run_of(pipeline: Pipeline, *stages: StageRecord, **changes: Any):
    task = RunTask(
        key="key",
        scene="file.py",
        scene_name="three_cart",
        pipeline=pipeline,
        plugin="",
        time_limit=60.0,
    )
    said = {"wall": 1.5, "cpu": 2.5, "log": "first\nlast"}
    return run_record(task, factory.scene(), stages, factory.provenance(), **(said | changes))


def test_a_run_ends_as_its_last_stage_does():
    stages = (
        recorded(solution()),
        recorded(solution(outcome=Outcome.REFUSED, trajectory=None, message="no"), index=2),
    )
    found = run_of(find_pipeline("softplus_dc+strict"), *stages, profile={"replay": 0.25})
    assert (found.key, found.pipeline, found.pipeline_title) == (
        "key",
        "softplus_dc+strict",
        find_pipeline("softplus_dc+strict").title,
    )
    assert (found.outcome, found.message, found.verdict, found.must_hold) == (
        "refused",
        "no",
        "not applicable",
        False,
    )
    assert (found.wall_seconds, found.cpu_seconds, found.profile, found.log_tail) == (
        1.5,
        2.5,
        {"replay": 0.25},
        "first\nlast",
    )
    assert found.stages == stages
    assert found.title == "three_cart x softplus_dc+strict"


def test_what_is_said_of_a_run_counts_more_than_its_last_stage():
    stage = replace(recorded(solution()), kind="direct")
    log = "\n".join(map(str, range(LOG_LINES + 1)))
    found = run_of(find_pipeline("mpcc"), stage, outcome="crashed", message="", log=log)
    assert (found.outcome, found.message, found.must_hold) == ("crashed", "", True)
    assert found.log_tail.splitlines() == [str(line) for line in range(1, 41)]
    assert found.title == "three_cart x mpcc"


EQUATIONS = {
    # Kelvin-Voigt and Hunt-Crossley, no input, no cost.
    "damped_collision": """
        motion of q1: Eq(m1*Derivative(v1, t), lambda_bumper - lambda_pair)
        motion of q2: Eq(m2*Derivative(v2, t), lambda_pair)
        penetration of contact pair (its gap is the negative): Eq(phi_pair, q1 - q2 + 2*r)
        rate of penetration of contact pair: Eq(Derivative(phi_pair, t), v1 - v2)
        force of contact pair, Kelvin-Voigt without adhesion, where its penetration is positive; elsewhere 0: Eq(lambda_pair, Max(0, c*Derivative(phi_pair, t) + k*phi_pair))
        penetration of contact bumper (its gap is the negative): Eq(phi_bumper, -q1 + r - 1/2)
        rate of penetration of contact bumper: Eq(Derivative(phi_bumper, t), -v1)
        force of contact bumper, Hunt-Crossley: Eq(lambda_bumper, b*Max(0, phi_bumper)*Max(0, d*Derivative(phi_bumper, t) + 1))
        time step of v1, contact forces at its start: Eq(m1*(-v1 + v1__t+1), h*(lambda_bumper - lambda_pair))
        time step of v2, contact forces at its start: Eq(m2*(-v2 + v2__t+1), h*lambda_pair)
        time step of q1: Eq(q1__t+1, h*v1__t+1 + q1)
        time step of q2: Eq(q2__t+1, h*v2__t+1 + q2)
        cost, summed over the steps: Eq(J, Sum(0, (t, 0, T - 1)))""",
    "transport": """
        motion of cargo: Eq(m*Derivative(v_cargo, t), friction_belt - lambda_front + lambda_rear)
        motion of cart: Eq(m_c*Derivative(v_cart, t), -friction_belt + lambda_front - lambda_rear + u)
        penetration of contact front (its gap is the negative): Eq(phi_front, cargo - cart - half)
        force of contact front: Eq(lambda_front, k*Max(0, phi_front))
        penetration of contact rear (its gap is the negative): Eq(phi_rear, -cargo + cart - half)
        force of contact rear: Eq(lambda_rear, k*Max(0, phi_rear))
        slip speed of friction belt: Eq(slip_belt, v_cargo - v_cart)
        largest force of friction belt: Abs(friction_belt) <= g*m*mu
        force of friction belt where it slips; where it sticks, the slip is zero: Eq(friction_belt, -g*m*mu*sign(slip_belt))
        time step of v_cargo, contact forces at its start, friction to the slip at its end: Eq(m*(-v_cargo + v_cargo__t+1), h*(friction_belt - lambda_front + lambda_rear))
        time step of v_cart, contact forces at its start, friction to the slip at its end: Eq(m_c*(-v_cart + v_cart__t+1), h*(-friction_belt + lambda_front - lambda_rear + u))
        time step of cargo: Eq(cargo__t+1, cargo + h*v_cargo__t+1)
        time step of cart: Eq(cart__t+1, cart + h*v_cart__t+1)
        cost, summed over the steps: Eq(J, Sum(0.0001*u**2, (t, 0, T - 1)))""",
}


@pytest.fixture
def written(monkeypatch: pytest.MonkeyPatch):
    """written(scene): its equations as plain text."""
    monkeypatch.setattr(module, "presentation", str)
    return lambda scene: [f"{item.caption}: {item.mathml}" for item in equations(derive(scene))]


@pytest.mark.parametrize("name", EQUATIONS)
def test_each_equation_stands_in_its_place(name: str, written):
    assert written(load_scene(name)) == [
        line.strip() for line in EQUATIONS[name].strip().splitlines()
    ]


def test_the_cost_of_the_last_state_is_added_to_the_sum(written):
    assert (
        written(load_scene("two_discs"))[-1]
        == "cost of the last state, added to that sum: Eq(J_T, x2**2 + y2**2)"
    )


def test_forces_are_greek_by_the_beginning_of_their_names_alone_where_they_limit_friction_too(
    written,
):
    limits = " ".join(
        text for text in written(load_scene("push_box")) if "friction" in text.partition(":")[0]
    )
    assert "lambda_" in limits
    assert "lam_" not in limits
    scene = load_scene("transport")
    first, *others = scene.contacts
    found = " ".join(written(replace(scene, contacts=(replace(first, name="slam_wall"), *others))))
    assert "lambda_slam_wall" in found
    assert "slambda" not in found


@pytest.mark.parametrize("name", ["three_cart", "two_finger", "transport"])
def test_a_scene_record_says_each_quantity_with_its_own_words(name: str):
    scene = load_scene(name)
    record, values = scene_record(scene), scene.parameter_values

    def said(items):
        return tuple(
            QuantityRecord(name=item.name, unit=item.unit, description=item.description)
            for item in items
        )

    def number(expression):
        return float(sp.sympify(expression).subs(values))

    assert (record.name, record.title, record.source, record.unstable) == (
        scene.name,
        scene.title,
        scene.source,
        scene.unstable,
    )
    assert record.coordinates == said(scene.coordinates)
    assert record.inputs == said(scene.inputs)
    assert record.velocities == tuple(
        QuantityRecord(
            name=item.velocity_name,
            unit=item.velocity_unit,
            description=f"velocity of {item.description}",
        )
        for item in scene.coordinates
    )
    assert record.parameters == tuple(
        QuantityRecord(
            name=item.name, unit=item.unit, description=item.description, value=item.value
        )
        for item in scene.parameters
    )
    assert record.contacts == tuple(
        ContactRecord(
            name=item.name,
            unit="N/m",
            description=item.description,
            bodies=item.bodies,
            value=number(item.stiffness),
        )
        for item in scene.contacts
    )
    assert record.frictions == tuple(
        QuantityRecord(
            name=item.force_name,
            unit="1",
            description=item.description,
            value=number(item.coefficient),
        )
        for item in scene.frictions
    )
    assert record.answers == tuple(
        QuantityRecord(name=item.quantity, unit="", description=item.source, value=item.value)
        for item in scene.answers
    )
    shapes = [(item.name, item.kind, tuple(map(number, item.size))) for item in scene.shapes]
    assert [(item.name, item.kind, item.size) for item in record.shapes] == shapes
    assert (record.start, record.goal, record.step, record.steps) == (
        scene.task.start,
        scene.task.goal,
        scene.task.step,
        scene.task.steps,
    )
    assert record.operations == step_operations(scene)
    assert record.absent == derive(scene).absent


def test_three_carts_by_hand():
    record = scene_record(load_scene("three_cart"))
    assert "friction" in record.absent
    assert [(shape.name, shape.size) for shape in record.shapes] == [
        (name, (0.5, 0.5)) for name in ("left", "middle", "right")
    ]
    assert [(contact.value, contact.bodies) for contact in record.contacts] == [
        (30.0, ("left", "middle")),
        (30.0, ("middle", "right")),
    ]


def test_what_has_no_words_is_called_by_its_name():
    scene = load_scene("transport")
    silent = replace(
        scene,
        coordinates=tuple(replace(item, description="") for item in scene.coordinates),
        frictions=tuple(replace(item, description="") for item in scene.frictions),
    )
    record = scene_record(silent)
    assert [item.description for item in record.velocities] == [
        "velocity of cargo",
        "velocity of cart",
    ]
    assert [item.description for item in record.frictions] == ["belt"]


def test_limits_that_are_waived_stand_with_their_reasons():
    scene = load_scene("wall_pendulum")
    waived = Limit(metric="ghost_impulse", value=None, reason="the first reason")
    kept = Limit(metric="missed_impulse", value=0.5, reason="the second reason")
    asked = replace(scene, limits=(waived, kept))
    assert scene_record(asked).waived == ("ghost_impulse: the first reason",)


def test_a_body_whose_place_the_goal_leaves_open_or_that_never_moves_has_no_goal():
    goals = {shape.name: shape.goal for shape in scene_record(load_scene("hopper_planar")).shapes}
    assert goals == {"body": (2.0, 1.0, 0.0), "leg": None, "foot": None, "floor": None}
    assert [shape.goal for shape in scene_record(load_scene("three_cart")).shapes] == [
        (x, 0.25, 0.0) for x in (2.5, 3.5, 4.5)
    ]


@pytest.mark.parametrize(
    ("scene", "name", "published"),
    [
        ("three_cart", "three_cart", "three_cart"),
        ("/own/three_cart.py", "three_cart", ""),
        ("three_cart", "slow_cart", ""),
    ],
)
def test_the_papers_numbers_stand_beside_the_scene_of_the_catalog_and_no_file_of_that_name(
    scene: str, name: str, published: str
):
    pipeline = Pipeline(name="softplus_dc+strict", title="", legs=())
    task = RunTask(
        key="key", scene=scene, scene_name=name, pipeline=pipeline, plugin="", time_limit=60.0
    )
    assert task.published == published
    assert bool(paper_row(task.published, pipeline.name, 3)) == bool(published)
