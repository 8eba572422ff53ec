"""The table of metrics row by row, and how a row becomes a metric: limits of the scene, of the table, waived, out of bounds, not measured."""

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from models.catalog import load_scene
from models.errors import SceneError, TrajectoryError
from models.scene import Limit, Scene
from validate.judge import score as score_module
from validate.judge.replay.result import ReplayOutcome
from validate.judge.replay.wiring import Effort
from validate.judge.score import _check_belongs, _metric, _not_asked, _of_what_is_asked, _worst
from validate.judge.score import table as module
from validate.judge.score.evidence import Evidence
from validate.judge.score.measures import Measured
from validate.judge.score.table import EXPLAINING, FEEDBACK, FOLLOWED, TABLE, MetricEntry
from validate.judge.score.verdict import (
    Contradicted,
    LeavesBounds,
    Metric,
    Question,
    Unmeasured,
    Verdict,
)

# name: question, unit on `transport`, what the plan must say, default limit, whether it is of the
# replay, and which of the scenes below it is of.
ROWS = """
    start_error 1 [m, m/s] q 1e-06 - abcd
    duration_error 1 [s] - 0.5 - abcd
    bound_violation 1 [N] - 1e-06 - acd
    velocity_bound_violation 1 [m/s] v 1e-06 - d
    terminal_position_error 2 [m] q - - ac
    terminal_velocity_error 2 [m/s] v - - ac
    terminal_error None [m, m/s] q - - ac
    velocity_error 3 [m] q,v,no scheme 0.01 - abcd
    contact_law_error 3 [N s] lam,q,no scheme 0.01 - abcd
    contact_force_error 3 [N] lam,q,no scheme 0.005 - abcd
    physics_scaled 3 [s] lam,q,scheme 2e-06 - abcd
    force_sign_violation 3 [N] lam 1e-06 - abcd
    friction_violation 3 [N] friction,q 0.0001 - a
    friction_dissipation_error 3 [W] friction,q,v 0.0001 - a
    replay_error 4 [m] q 0.01 replay abcd
    replay_terminal_position_error 4 [m] - - replay ac
    replay_terminal_velocity_error 4 [m/s] - - replay ac
    replay_terminal_error None [m, m/s] - - replay ac
    replay_cost 4 [1] - - replay abcd
    max_penetration 5 [m] - 1.0 replay abcd
    ghost_impulse 5 [N s] lam 0.01 replay abcd
    missed_impulse 5 [N s] lam 0.01 replay abcd
    friction_impulse_error 5 [N s] friction,q,no scheme 0.1 replay a
    replay_velocity_bound_violation 5 [m/s] - 0.01 replay d
    defect 6 [m, m/s] q,v,lam,friction,scheme 1e-06 - abcd
    law_error 6 [m] q,v,scheme 10.0 - abcd
    discrete_terminal_position_error 6 [m] q,v,scheme 10.0 - ac
    discrete_terminal_velocity_error 6 [m/s] q,v,scheme 10.0 - ac
    discrete_terminal_error None [m, m/s] q,v - - ac
    answer_error None [1] - 1.0 - b
    energy_residual_relative None [1] - 1e-06 replay abcd
    cost None [1] q,v - - abcd
    physics None [N^2] lam,q - - abcd
    feedback_effort 4 [1] - 0.25 - acd
    feedback_share 4 [1] - 0.25 - abcd
    grid_error None [m] q,v,scheme - - abcd
    grid_order None [1] q,v,scheme - - abcd"""
SCENES = {"a": "transport", "b": "bouncing_mass", "c": "hopper", "d": "wall_pendulum"}


def test_every_row_of_the_table_stands_as_it_was_decided():
    """Apart from what is measured, and the words."""
    scenes = {letter: load_scene(name) for letter, name in SCENES.items()}
    found = [
        f"{row.name} {row.question.number} [{row.unit(scenes['a'])}] {','.join(row.needs) or '-'} {row.default[0] if row.default else '-'} "
        f"{'replay' if row.of_replay else '-'} {''.join(letter for letter, scene in scenes.items() if row.applies(scene))}"
        for row in (*TABLE, *FEEDBACK, *EXPLAINING)
    ]
    assert found == [line.strip() for line in ROWS.strip().splitlines()]


def coordinate(bounded: bool = False) -> Any:
    return SimpleNamespace(unit="m", velocity_unit="m/s", has_velocity_bounds=bounded)


def foreign(**asked: Any) -> Any:
    """Somebody's FMU of which nothing is asked, but for what is given."""
    nothing = {
        "nc": 0,
        "nf": 0,
        "nq": 1,
        "inputs": [],
        "coordinates": [coordinate()],
        "depths": (),
        "answers": (),
    }
    task = SimpleNamespace(horizon=None, goal=(None, None), has_goal=False)
    return SimpleNamespace(**(nothing | {"task": task} | asked))


def bounds(lower: float, upper: float) -> Any:
    return SimpleNamespace(lower=lower, upper=upper)


def goal(*of: float | None) -> Any:
    return SimpleNamespace(horizon=None, goal=of, has_goal=any(value is not None for value in of))


@pytest.mark.parametrize(
    ("asked", "rows"),
    [
        ({}, set()),
        ({"task": SimpleNamespace(horizon=2.0, goal=(None, None), has_goal=False)},
         {"duration_error"}),
        ({"inputs": [bounds(-math.inf, math.inf), bounds(-math.inf, 1.0)]}, {"bound_violation"}),
        ({"inputs": [bounds(-1.0, math.inf)]}, {"bound_violation"}),
        ({"inputs": [bounds(-1.0, 1.0), bounds(-math.inf, math.inf)]},
         {"bound_violation", "feedback_effort"}),
        ({"coordinates": [coordinate(bounded=True)]},
         {"velocity_bound_violation", "replay_velocity_bound_violation"}),
        ({"task": goal(1.0, None)},
         {"terminal_position_error", "replay_terminal_position_error", "terminal_error",
          "replay_terminal_error"}),
        ({"task": goal(None, 0.0)},
         {"terminal_velocity_error", "replay_terminal_velocity_error", "terminal_error",
          "replay_terminal_error"}),
        ({"nc": 1, "depths": (None,)}, {"force_sign_violation", "ghost_impulse", "missed_impulse"}),
        ({"nc": 2, "depths": (None, 0.5)},
         {"force_sign_violation", "ghost_impulse", "missed_impulse", "max_penetration"}),
        ({"nc": 0, "depths": (0.5,)}, set()),
        ({"nf": 1}, {"friction_violation", "friction_dissipation_error"}),
        ({"answers": [SimpleNamespace(measure=measure) for measure in ("", "depth")]},
         {"answer_error"}),
    ],
)  # fmt: skip
def test_an_fmu_is_asked_only_what_it_can_show(asked: dict[str, Any], rows: set[str]):
    """What needs equations is asked of no FMU, whatever it has."""
    always = {
        "start_error",
        "velocity_error",
        "replay_error",
        "feedback_share",
    }
    assert {
        row.name for row in (*TABLE, *FEEDBACK, *EXPLAINING) if row.applies(foreign(**asked))
    } == rows | always


def test_units_of_several_components_are_told_once_each():
    items = [SimpleNamespace(unit=unit, velocity_unit=f"{unit}/s") for unit in ("m", "rad", "m")]
    asked = goal(0.5, None, 0.7, None, 0.0, None)
    scene = foreign(
        nq=3,
        coordinates=items,
        inputs=[SimpleNamespace(unit=unit) for unit in ("N", "N m", "N")],
        task=asked,
    )
    units = {row.name: row.unit(scene) for row in TABLE}
    assert (units["replay_error"], units["velocity_bound_violation"], units["bound_violation"]) == (
        "m, rad",
        "m/s, rad/s",
        "N, N m",
    )
    assert units["defect"] == "m, rad, m/s, rad/s"
    for of in ("", "replay_", "discrete_"):  # of what the goal asks for
        assert (units[f"{of}terminal_position_error"], units[f"{of}terminal_velocity_error"]) == (
            "m",
            "rad/s",
        )


def test_each_row_measures_what_it_is_called():
    for row in TABLE:
        if "terminal" not in row.name:
            assert row.measure is getattr(module.measures, row.name)
        assert row.meaning != ""


def test_what_is_judged_and_what_is_shown_of_the_judge():
    assert [row.name for row in TABLE if row.question is Question.JUDGE] == [
        "answer_error",
        "energy_residual_relative",
    ]


EFFORT = Effort(
    rms=(1.0,), peak=(2.0,), rms_share=0.125, peak_share=0.25, plan_share=0.5, saturated=0.75
)


def test_feedback_is_measured_by_its_effort():
    def case(effort: Effort | None) -> Any:
        tracked = None if effort is None else SimpleNamespace(effort=effort)
        return SimpleNamespace(opened=SimpleNamespace(tracked=tracked))

    assert [row.measure(case(EFFORT)) for row in FEEDBACK] == [0.125, 0.5]
    for row in FEEDBACK:
        with pytest.raises(Unmeasured):
            row.measure(case(None))
    still = Effort(
        rms=(1.0,), peak=(2.0,), rms_share=0.125, peak_share=0.25, plan_share=None, saturated=0.0
    )
    with pytest.raises(LeavesBounds):
        FEEDBACK[1].measure(case(still))


def test_each_metric_of_the_replay_has_a_twin_that_asks_the_one_with_feedback():
    originals = [row for row in TABLE if row.of_replay]
    assert FOLLOWED[len(originals) :] == FEEDBACK
    for twin, row in zip(FOLLOWED, originals, strict=False):
        named = {"name": f"tracked_{row.name}", "meaning": f"with feedback: {row.meaning}"}
        assert twin == replace(row, **named, of_replay=False, measure=twin.measure)
    one = MetricEntry(
        name="x",
        question=Question.MOTION,
        units=lambda scene: ("m",),
        meaning="",
        measure=lambda case: case,
        of_replay=True,
    )
    assert module._twin(one).measure(SimpleNamespace(tracked=7.0)) == 7.0


def metric_of(measured: Any, *, question: Question = Question.MOTION,
              default: tuple[float, str] | None = (0.5, "of the table"),
              limit: Limit | None = None, needs: tuple[str, ...] = (),
              missing: frozenset[str] = frozenset(), scheme: Any = None,
              units: Any = ("m",)) -> Metric:  # fmt: skip
    """What becomes of a measurement, or of what it raises."""

    def measure(case: Any) -> Any:
        if isinstance(measured, Exception):
            raise measured
        return measured

    entry = MetricEntry(
        name="x",
        question=question,
        units=lambda scene: units,
        meaning="far",
        measure=measure,
        default=default,
        needs=needs,
    )
    scene = SimpleNamespace(
        limit=lambda name: limit if name == "x" else None, nf=1, nc=1, frictions=()
    )
    return _metric(
        entry,
        SimpleNamespace(
            scene=scene,
            trajectory=SimpleNamespace(missing=missing, scheme=scheme),
            touches_nothing=False,
        ),
    )


def said(metric: Metric) -> tuple[Any, ...]:
    return (metric.value, metric.error, metric.limit, metric.reason, metric.ok, metric.default)


SCENES_OWN = Limit(metric="x", value=2.0, reason="of the scene")
WAIVED = Limit(metric="x", value=None, reason="waived")


@pytest.mark.parametrize(
    ("measured", "options", "expected"),
    [
        (0.5, {}, (0.5, 0.0, 0.5, "of the table", True, True)),
        (0.51, {}, (0.51, 0.0, 0.5, "of the table", False, True)),
        ((0.4, 0.011), {}, (0.4, 0.011, 0.5, "of the table", None, True)),
        ((0.48, 0.011), {"question": Question.JUDGE},
         (0.48, 0.011, 0.5, "of the table", True, True)),  # as good as its error, not a tenth of it
        ((0.49, 0.011), {"question": Question.JUDGE},
         (0.49, 0.011, 0.5, "of the table", None, True)),
        ((0.52, 0.011), {"question": Question.JUDGE},
         (0.52, 0.011, 0.5, "of the table", False, True)),
        (1.5, {"limit": SCENES_OWN}, (1.5, 0.0, 2.0, "of the scene", True, False)),
        (2.5, {"limit": SCENES_OWN, "default": None},
         (2.5, 0.0, 2.0, "of the scene", False, False)),
        (2.5, {"limit": WAIVED}, (2.5, 0.0, None, "waived", None, True)),
        (2.5, {"default": None}, (2.5, 0.0, None, "", None, True)),
        (2.5, {"question": Question.SHOWN, "limit": SCENES_OWN}, (2.5, 0.0, None, "", None, True)),
        (2.5, {"default": (math.inf, "none")}, (2.5, 0.0, None, "", None, True)),
        (math.inf, {}, (None, 0.0, 0.5, "the metric is too large to be a number.", False, True)),
        (LeavesBounds("far out"), {}, (None, 0.0, 0.5, "far out", False, True)),
        (LeavesBounds("far out"), {"limit": SCENES_OWN}, (None, 0.0, 2.0, "far out", False, False)),
        (LeavesBounds("far out"), {"limit": WAIVED}, (None, 0.0, None, "far out", None, True)),
        (LeavesBounds("far out"), {"default": None}, (None, 0.0, None, "far out", None, True)),
        (Unmeasured("unseen"), {}, (None, 0.0, None, "unseen", None, True)),
        (Contradicted("no"), {}, (None, 0.0, 0.5, "no", None, True)),
        (Contradicted("no"), {"limit": SCENES_OWN}, (None, 0.0, 2.0, "no", None, False)),
        (Contradicted("no"), {"limit": WAIVED}, (None, 0.0, None, "no", None, True)),
        (1.0, {"needs": ("q",), "missing": frozenset({"q"})},
         (None, 0.0, None, "the plan does not say its positions.", None, True)),
        (1.0, {"needs": ("v",), "missing": frozenset({"q"})},
         (1.0, 0.0, 0.5, "of the table", False, True)),
        (1.0, {"needs": ("scheme",)},
         (None, 0.0, None, "the plan declares no scheme.", None, True)),
    ],
)  # fmt: skip
def test_a_measurement_becomes_a_metric(
    measured: Any, options: dict[str, Any], expected: tuple[Any, ...]
):
    found = metric_of(measured, **options)
    assert said(found) == expected
    assert (found.name, found.unit, found.meaning) == ("x", "m", "far")


@pytest.mark.parametrize(
    ("need", "missing", "scheme", "words"),
    [
        ("v", {"v"}, None, "velocities"), ("lam", {"lam"}, None, "contact forces"),
        ("friction", {"friction"}, None, "friction forces"),
        ("no scheme", (), "s", "declares a scheme"),
        ("no scheme", (), None, ""), ("scheme", (), "s", ""),
    ],
)  # fmt: skip
def test_what_a_plan_does_not_say_is_not_asked(need: str, missing: Any, scheme: Any, words: str):
    found = metric_of(1.0, needs=(need,), missing=frozenset(missing), scheme=scheme)
    assert (found.value is None) is bool(words)
    assert words in found.reason


def test_groups_without_columns_are_never_missing():
    free = load_scene("three_cart")
    for name, need in (("friction", free.nf), ("lam", free.nc)):
        row = MetricEntry(
            name="x",
            question=Question.TASK,
            units=lambda scene: ("m",),
            meaning="",
            measure=lambda case: 1.0,
            needs=(name,),
        )
        case: Any = SimpleNamespace(
            scene=free,
            trajectory=SimpleNamespace(missing=frozenset({"friction", "lam"}), scheme=None),
            touches_nothing=False,
        )
        assert (_metric(row, case).value is None) is bool(need), (
            "without any there is nothing to say"
        )
    assert isinstance(free, Scene)


def test_the_component_that_decides_is_the_worst_against_its_own_limit():
    measured = Measured(
        values=(5.0, 3.0), error=(0.5, 0.25), scales=(10.0, 1.0), allowed=(1.0, 2.0)
    )
    units = ("m", "rad")
    assert _worst(measured, units, limited=False) == (3.0, 0.25, 1.0, 2.0, "rad")
    assert _worst(measured, units, limited=True) == (5.0, 0.5, 10.0, 1.0, "m")
    assert [_worst(2.0, units, False), _worst((2.0, 3.0), units, True)] == [
        (2.0, 0.0, 1.0, 0.0, None),
        (2.0, 3.0, 1.0, 0.0, None),
    ]
    assert said(metric_of(measured, default=(0.5, "r"))) == (
        3.0,
        0.25,
        0.5 * 1.0 + 2.0,
        "r",
        None,
        True,
    )
    assert said(metric_of(measured, limit=SCENES_OWN)) == (
        5.0,
        0.5,
        3.0,
        "of the scene",
        None,
        False,
    )
    assert (metric_of(measured, units=units).unit, metric_of(2.0, units=units).unit) == (
        "rad",
        "m, rad",
    )


def test_what_is_not_asked_is_told_once_for_each_reason():
    def row(name: str, question: Question, **changes: Any) -> tuple[MetricEntry, Metric]:
        given = {"value": None, "reason": "unseen."} | changes
        entry = MetricEntry(
            name=name,
            question=question,
            units=lambda scene: ("m",),
            meaning="",
            measure=lambda case: 0.0,
        )
        return entry, Metric(name=name, question=question, unit="m", meaning="", **given)

    rows = [
        row("a", Question.TASK), row("b", Question.GOAL, reason="dark."), row("c", Question.GOAL),
        row("d", Question.SHOWN), row("e", Question.JUDGE),
        row("f", Question.GOAL, value=1.0), row("g", Question.GOAL, limit=1.0),
        row("h", Question.GOAL, reason=""),
        row("i", Question.GOAL,
            reason="the plan declares a scheme, whose own equations are asked instead."),
    ]  # fmt: skip
    entries, metrics = [item for item, _ in rows], tuple(item for _, item in rows)
    scene: Any = SimpleNamespace(not_asked=("of the FMU",))
    assert _not_asked(scene, entries, metrics) == ("a, c: unseen.", "b: dark.", "of the FMU")
    assert _not_asked(load_scene("three_cart"), entries[:1], metrics[:1]) == ("a: unseen.",)


def test_a_replay_belongs_to_the_nodes_of_its_plan():
    scene, plan = SimpleNamespace(name="s"), SimpleNamespace(t=np.array([0.0, 1.0, 2.0]))

    def replay(**changes: Any) -> Any:
        return SimpleNamespace(
            **(
                {
                    "scene": "s",
                    "ok": True,
                    "knots": np.array([0, 2, 3]),
                    "t": np.array([0.0, 0.5, 1.0, 2.0]),
                }
                | changes
            )
        )

    _check_belongs(scene, plan, replay())
    _check_belongs(scene, plan, replay(ok=False, knots=np.array([0])))
    for changes, part in (
        ({"scene": "other"}, "scene other"),
        ({"knots": np.array([0, 1])}, "2 nodes"),
        ({"knots": np.array([0, 1, 3])}, "3 nodes"),
    ):
        with pytest.raises(TrajectoryError, match=part):
            _check_belongs(scene, plan, replay(**changes))


# From metrics to a score


def asking(**ok: bool | None) -> tuple[Metric, ...]:
    """Judged metrics of such names."""
    questions = {row.name: row.question for row in TABLE}
    return tuple(
        Metric(
            name=name,
            question=questions[name.removeprefix("tracked_")],
            value=1.0,
            unit="m",
            meaning="",
            limit=1.0,
            ok=value,
        )
        for name, value in ok.items()
    )


@pytest.mark.parametrize(
    "name",
    [
        "terminal_position_error", "terminal_velocity_error",
        "replay_terminal_position_error", "replay_terminal_velocity_error", "replay_cost",
    ],
)  # fmt: skip
def test_who_asks_for_an_end_or_a_cost_asks_for_something(name: str):
    scene, plan = SimpleNamespace(nc=1, nf=1), SimpleNamespace(has_states=True, missing=frozenset())
    assert _of_what_is_asked(scene, plan, Verdict.HOLDS, asking(**{name: True})) is Verdict.HOLDS
    shown = tuple(replace(metric, limit=None) for metric in asking(**{name: True}))
    assert _of_what_is_asked(scene, plan, Verdict.HOLDS, shown) is Verdict.CONSISTENT
    assert _of_what_is_asked(scene, plan, Verdict.HOLDS_WITH_FEEDBACK, ()) is Verdict.CONSISTENT
    for verdict in (Verdict.VIOLATES, Verdict.UNDECIDED):
        assert _of_what_is_asked(scene, plan, verdict, ()) is verdict


@pytest.mark.parametrize(
    ("has_states", "missing", "nc", "nf", "claims"),
    [
        (True, {"lam", "friction"}, 1, 1, True), (False, {"lam", "friction"}, 1, 1, False),
        (False, {"friction"}, 1, 1, True), (False, {"lam"}, 1, 1, True),
        (False, set(), 0, 0, False), (False, {"friction"}, 0, 1, False),
        (False, {"lam"}, 1, 0, False), (False, set(), 0, 1, True), (False, set(), 1, 0, True),
    ],
)  # fmt: skip
def test_who_claims_nothing_is_not_judged_where_nothing_is_asked(
    has_states: bool, missing: set[str], nc: int, nf: int, claims: bool
):
    scene, plan = (
        SimpleNamespace(nc=nc, nf=nf),
        SimpleNamespace(has_states=has_states, missing=frozenset(missing)),
    )
    assert _of_what_is_asked(scene, plan, Verdict.HOLDS, asking(replay_error=True)) is (
        Verdict.CONSISTENT if claims else Verdict.NOT_APPLICABLE
    )


def test_what_cannot_be_measured_leaves_a_question_open_for_scenes_and_failed_replays():
    scene = load_scene("wall_pendulum")
    fails = replace(
        TABLE[0], name="x", question=Question.MOTION,
        measure=lambda case: (_ for _ in ()).throw(Unmeasured("unseen.")), default=(0.5, "r"),
        needs=(),
    )  # fmt: skip
    trajectory, there = (
        SimpleNamespace(missing=frozenset(), scheme=None),
        SimpleNamespace(outcome=ReplayOutcome.OK, ok=True),
    )
    foreign = SimpleNamespace(limit=lambda name: None, coordinates=[], nf=0, nc=0)
    for subject, replayed, of_replay, is_open in (
        (scene, there, False, True), (scene, there, True, True), (foreign, there, True, False),
        (foreign, None, True, True), (foreign, None, False, False),
    ):  # fmt: skip
        metric = _metric(
            replace(fails, of_replay=of_replay, units=lambda scene: ("m",)),
            Evidence(subject, trajectory, replayed),
        )
        assert (metric.limit is not None, metric.reason, metric.value, metric.default) == (
            is_open,
            "unseen.",
            None,
            True,
        )


def test_an_answer_by_a_measure_that_nobody_knows_is_refused_with_its_file(tmp_path: Path):
    scene = load_scene("bouncing_mass")
    wrong = replace(scene, answers=(replace(scene.answers[0], measure="depht"),))
    with pytest.raises(
        SceneError,
        match=r"^scene bouncing_mass: .*'depht', .*closing time, contact time, restitution, depth\.$",
    ):
        score_module.check_limits(wrong)
    with pytest.raises(SceneError, match=rf"^scene file {tmp_path}: scene bouncing_mass: answer"):
        score_module.check_limits(wrong, tmp_path)
    score_module.check_limits(replace(scene, answers=(replace(scene.answers[0], measure=""),)))
