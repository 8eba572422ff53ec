"""A whole map at once, every number different: each stands in its place, and each mistake names its own."""

import math
import zipfile
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from foreign_fmu import COSIMULATION, DESCRIPTION, EXCHANGE
from wording import unsaid

from models.plan_table import PlanTable
from models.trajectory import Trajectory
from tests.validate.judge.replay.test_replay_map import refusal
from validate.fmi.description import read_package
from validate.judge.replay.map_schema import (
    Dimensions,
    MapError,
    Named,
    by_equal_names,
    hint,
    read_map,
)
from validate.judge.replay.mapping import wire
from validate.judge.replay.result import Difference
from validate.judge.replay.subject import Foreign

MORE = "".join(
    f'<ScalarVariable name="{name}" valueReference="{reference}" causality="{causality}"{initial}><Real {unit}{rest}/></ScalarVariable>\n'
    for name, reference, causality, initial, unit, rest in (
        ("arm", 50, "output", ' initial="approx"', 'unit="rad" ', 'start="0" nominal="4"'),
        ("arm.rate", 51, "output", "", 'unit="rad/s"', ""),
        ("torque", 52, "input", "", 'unit="N.m" ', 'start="0" max="8"'),
        ("idle", 53, "input", "", "", 'start="0"'),
        ("wall.push", 54, "output", "", 'unit="N"', ""),
        ("wall.gap", 55, "output", "", 'unit="m"', ""),
        ("internal_step", 56, "parameter", ' variability="fixed"', "", 'start="1"'),
        ("gain", 57, "parameter", ' variability="fixed"', "", 'start="1" min="-2" max="3"'),
    )
)
WHOLE = """
[plan]
time = "time"
[task]
duration = 3.0
[inputs]
F = { variable = "drive.force", scale = -0.001, offset = 0.5, unit = "N", lower = -100.0 }
M = { variable = "torque", scale = 2.0, offset = 1.0 }
[positions]
x = { variable = "body.pos", scale = 0.001, offset = 7.0, unit = "m" }
a = { variable = "arm", scale = -3.0, offset = 0.25, unit = "deg" }
[velocities]
a = { variable = "arm.rate", scale = 5.0, offset = -1.0, unit = "deg/s", column = "turning" }
x = { variable = "body.vel", scale = 0.002, offset = 9.0, unit = "m/s" }
[contacts.stop]
force = { variable = "stop.push", scale = 11.0, offset = 12.0 }
gap = { variable = "stop.gap", scale = 13.0, offset = 14.0 }
depth = 0.5
depth_reason = "its spring"
[contacts.wall]
force = { variable = "wall.push", scale = 15.0, offset = 16.0 }
gap = { variable = "wall.gap", scale = 17.0, offset = 18.0 }
column = "pressed"
[parameters]
gain = 2.5
[start]
"body.pos" = 300
"body.vel" = "turning"
"arm" = "a"
[goal]
x = 1.25
turning = 2.25
[limits]
replay_terminal_position_error = { value = 0.1, reason = "near" }
replay_terminal_velocity_error = 0.2
terminal_velocity_error = { value = 0.3, reason = "own" }
[accuracy]
position = 0.125
velocity = 0.25
gap = 0.5
"""
HEAD = "time,F,M,x,a,turning,v_x,lam_stop,pressed"
ROWS = f"{HEAD}\n0,1,2,3,4,5,6,7,8\n1,11,12,13,14,15,16,17,18\n3,,,23,24,25,26,,\n"


@pytest.fixture
def whole(tmp_path: Path) -> Callable[..., tuple[Foreign, Trajectory]]:
    """The cart with more variables, wired, or an FMU that is described otherwise.

    Nothing of it runs.
    """
    text = DESCRIPTION.format(kinds=EXCHANGE + COSIMULATION).replace(
        "  </ModelVariables>", MORE + "  </ModelVariables>"
    )

    def call(
        given: str = WHOLE, plan: str = ROWS, described: str = text
    ) -> tuple[Foreign, Trajectory]:
        with zipfile.ZipFile(tmp_path / "whole.fmu", "w") as archive:
            archive.writestr("modelDescription.xml", described)
            for platform in ("linux64", "x86_64-linux"):
                archive.writestr(f"binaries/{platform}/cart.so", b"")
        (tmp_path / "map.toml").write_text(given, encoding="utf-8")
        (tmp_path / "plan.csv").write_text(plan, encoding="utf-8")
        return wire(
            read_package(tmp_path / "whole.fmu"),
            PlanTable(tmp_path / "plan.csv"),
            read_map(tmp_path / "map.toml"),
            None,
            "map",
        )

    return call


def test_each_number_of_a_map_stands_in_its_place(whole):
    foreign, plan = whole()
    variables = foreign.variables
    assert (variables.q, variables.v, variables.lam, variables.gap, variables.u) == (
        (10, 50),
        (11, 51),
        (30, 54),
        (31, 55),
        (20, 52),
    )
    assert foreign.scale.tolist() == [0.001, -3.0, 0.002, 5.0, 11.0, 15.0, 13.0, 17.0]
    assert foreign.offset.tolist() == [7.0, 0.25, 9.0, -1.0, 12.0, 16.0, 14.0, 18.0]
    assert (foreign.input_scale.tolist(), foreign.input_offset.tolist()) == (
        [-0.001, 2.0],
        [0.5, 1.0],
    )
    assert (variables.parameters, variables.internal_step) == (((57, 2.5),), 56)
    # Of [start]: a number, and the first row of a column; the arm's angle from its own column,
    # (4 - 0.25)/-3.
    assert dict(zip(variables.start, foreign.start, strict=True)) == {
        10: 300.0,
        11: 5.0,
        50: pytest.approx(-1.25),
    }
    model = foreign.model
    assert [(item.name, item.velocity_name, item.unit, item.velocity_unit,
             item.nominal) for item in model.coordinates] == [
        ("x", "v_x", "m", "m/s", 0.001), ("a", "turning", "deg", "deg/s", 12.0),
    ]  # fmt: skip
    # drive.force is in -1 .. 1: 500 - 1000 * (-1, 1) in the plan's unit; the torque at most (8 -
    # 1)/2.
    assert [(item.name, item.unit, item.lower, item.upper) for item in model.inputs] == [
        ("F", "N", -100.0, 1500.0),
        ("M", "1", -math.inf, 3.5),
    ]
    assert [(item.name, item.force_name, item.gap_name, item.depth) for item in model.contacts] == [
        ("stop", "lam_stop", "gap_stop", 0.5), ("wall", "pressed", "gap_wall", None),
    ]  # fmt: skip
    assert (model.name, model.task.goal, model.task.horizon, model.task.step) == (
        "whole",
        (1.25, None, None, 2.25),
        3.0,
        3.0 / 500,
    )
    assert [(item.metric, item.value, item.reason) for item in model.limits] == [
        ("replay_terminal_position_error", 0.1, "near"),
        ("replay_terminal_velocity_error", 0.2, "set in the map"),
        ("terminal_velocity_error", 0.3, "own"),
    ]  # fmt: skip
    assert dict(model.lacks) == {}
    assert model.accuracy == Difference(
        position=0.125, state=pytest.approx(math.sqrt(2.0) * math.hypot(0.125, 0.25)), gap=0.5
    )
    assert model.notes == (
        "Inputs of the FMU that the plan does not drive keep their start values: idle.",
    )
    assert [
        sentence.partition(":")[0] + sentence.partition(":")[2][:30]
        for sentence in model.not_asked[:-1]
    ] == [
        "bound_violation input M has no lower bound, n",
        "max_penetration contact wall has no depth in ",
    ]
    assert (plan.t.tolist(), plan.u.tolist(), plan.missing) == (
        [0.0, 1.0, 3.0],
        [[1.0, 2.0], [11.0, 12.0]],
        set(),
    )
    assert plan.q.tolist() == [[3.0, 4.0], [13.0, 14.0], [23.0, 24.0]]
    assert plan.v.tolist() == [[6.0, 5.0], [16.0, 15.0], [26.0, 25.0]]
    assert plan.lam.tolist() == [[7.0, 8.0], [17.0, 18.0]]


def test_what_a_map_leaves_out_is_left_out_of_all(whole):
    """One velocity, one gap and one force missing: the others are not read either.

    Without a duration the task's step is the plan's shortest.
    """
    without = WHOLE.replace("[task]\nduration = 3.0\n", "")
    for line in (
        'x = { variable = "body.vel"',
        'force = { variable = "wall.push"',
        'gap = { variable = "stop.gap"',
        "replay_terminal_velocity_error",
        '"body.vel" = "turning"',
        "internal_step",
    ):
        without = "\n".join(row for row in without.splitlines() if not row.startswith(line))
    plan = (
        ROWS.replace(",v_x,lam_stop,pressed", "")
        .replace(",6,7,8", "")
        .replace(",16,17,18", "")
        .replace(",26,,", "")
    )
    foreign, trajectory = whole(without.replace("turning = 2.25", ""), plan)
    variables, model = foreign.variables, foreign.model
    assert (variables.q, variables.v, variables.lam, variables.gap) == ((10, 50), (), (), ())
    assert foreign.scale.tolist() == [0.001, -3.0]
    assert set(model.lacks) == {"v", "gap", "lam"}
    assert (model.task.horizon, model.task.step) == (None, 0.006)
    assert (model.coordinates[0].velocity_name, model.coordinates[0].velocity_unit) == (
        "v_x",
        "1/s",
    )
    assert (trajectory.missing, trajectory.v.tolist(), trajectory.lam.tolist()) == (
        {"v", "lam"},
        [[0.0, 0.0]] * 3,
        [[0.0, 0.0]] * 2,
    )
    told = "\n".join(model.not_asked)
    assert not unsaid(
        told, "duration_error: the map gives no", "contact stop has no gap in the map",
        "ghost_impulse, missed_impulse: not every contact",
    )  # fmt: skip
    assert "no [goal]" not in told
    assert "replay_error: the map names" not in told


@pytest.mark.parametrize(
    "line", ['force = { variable = "wall.push"', 'gap = { variable = "wall.gap"']
)
def test_one_force_or_one_gap_that_is_missing_leaves_impulses_out(whole, line: str):
    given = "\n".join(row for row in WHOLE.splitlines() if not row.startswith(line))
    plan = "\n".join(",".join(row.split(",")[:-2]) for row in ROWS.splitlines()) + "\n"
    foreign, _ = whole(given, plan)
    assert any(
        sentence.startswith("ghost_impulse, missed_impulse: not every contact")
        for sentence in foreign.model.not_asked
    )
    assert set(foreign.model.lacks) == {"lam" if "force" in line else "gap"}
    assert len(foreign.variables.outputs) == 6


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (WHOLE.replace('"torque"', '"torqe"'), "inputs.M: … no variable 'torqe' (near it: torque)"),
        (WHOLE.replace('"torque"', '"label"'), "inputs.M: 'label' is of type String … number"),
        (WHOLE.replace('"torque"', '"arm"'), "inputs.M: 'arm' is no input of the FMU"),
        (WHOLE.replace('"torque"', '"drive.force"'), "inputs.M: 'drive.force' is inputs.F already"),
        (WHOLE.replace("[velocities]\na =", "[velocities]\nb ="), "velocities.b: … no position"),
        (WHOLE.replace("gain = 2.5", "gain = 3.5"), "parameters.gain: 3.5 … at most 3"),
        (WHOLE.replace("gain = 2.5", "gain = -2.5"), "parameters.gain: -2.5 … at least -2"),
        (
            WHOLE.replace("gain = 2.5", '"arm.rate" = 2.5'),
            "parameters.arm.rate: … no parameter of the FMU, but output",
        ),
        (
            WHOLE.replace('"body.vel" = "turning"', '"wall.gap" = 1'),
            "start.wall.gap: … no start value",
        ),
        (
            WHOLE.replace('"body.vel" = "turning"', '"body.vel" = "turnin"'),
            "start.body.vel: … the column 'turnin' is missing … (near it: turning)",
        ),
        (WHOLE.replace("turning = 2.25", "v_a = 2.25"), "goal.v_a: … no position or velocity"),
        (
            WHOLE.replace("turning = 2.25", "zzzz = 2.25"),
            "of that name; there are x, a, turning, v_x",
        ),
        (WHOLE.replace("scale = 2.0, offset = 1.0", "scale = 0.0"), "inputs.M: scale is 0"),
        (
            WHOLE.replace("lower = -100.0", "lower = -501.0"),
            "inputs.F.lower: -501 … own bound, which is -500",
        ),
        (
            WHOLE.replace("lower = -100.0", "upper = 1501.0"),
            "inputs.F.upper: 1501 … own bound, which is 1500",
        ),
        (
            WHOLE.replace(
                'force = { variable = "wall.push", scale = 15.0, offset = 16.0 }\ngap = { variable = "wall.gap", scale = 17.0, offset = 18.0 }\n',
                "",
            ),
            "contacts.wall: … neither force nor gap",
        ),
        (
            WHOLE.replace("gain = 2.5", "gain = 2.5\nbody = 1"),
            "parameters.body: the FMU has no variable 'body'",
        ),
        (WHOLE.replace('time = "time"', 'time = "time"\nhold = "spline"'), "plan.hold"),
        (
            WHOLE.replace("depth = 0.5", "dept = 0.5"),
            "contacts.stop.dept: … no such key; did you mean depth?",
        ),
        (
            WHOLE.replace('unit = "N"', 'units = "N"'),
            "inputs.F.units: … no such key; did you mean unit?",
        ),
        (
            WHOLE.replace("[parameters]", "[parameter]"),
            "parameter: … no such key; did you mean parameters?",
        ),
        (
            WHOLE.replace("duration = 3.0", "xyz = 3.0"),
            "task.xyz: … no such key; there is duration",
        ),
        (
            WHOLE.replace(
                'force = { variable = "stop.push",',
                'force = { variable = "stop.push", lower = 1.0,',
            ),
            "contacts.stop.force.lower: … no such key; … variable, scale, offset, unit",
        ),
        (
            WHOLE.replace('column = "turning"', 'colum = "turning"'),
            "velocities.a.colum: … no such key; did you mean column?",
        ),
        (
            WHOLE.replace('value = 0.1, reason = "near"', 'value = 0.1, reasn = "near"'),
            "limits.replay_terminal_position_error.reasn: … no such key; did you mean reason?",
        ),
    ],
)
def test_each_mistake_in_a_whole_map_names_its_place(whole, text: str, words: str):
    assert not unsaid(refusal(lambda: whole(text)), words)


# One number of each kind that a map does not take, and what it does.
_KINDS = """<fmiModelDescription fmiVersion="3.0" modelName="kinds" instantiationToken="{kinds}"><CoSimulation modelIdentifier="cart"/><ModelVariables>
<Float64 name="x" valueReference="1" causality="output"/><Float64 name="F" valueReference="2" causality="input" start="0"/>
<Int32 name="gear" valueReference="3" causality="input" start="1"/><Boolean name="brake" valueReference="4" causality="input" start="false"/>
<Float64 name="u" valueReference="5" causality="input" start="0 0"><Dimension start="2"/></Float64>
<Int32 name="teeth" valueReference="6" causality="parameter" variability="fixed" start="12"/><Clock name="tick" valueReference="7" causality="input" intervalVariability="triggered"/>
</ModelVariables><ModelStructure><Output valueReference="1"/></ModelStructure></fmiModelDescription>"""
_KINDS_MAP = '[inputs]\nF = { variable = "F" }\n[positions]\nx = { variable = "x" }\n'


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (_KINDS_MAP.replace('"F"', '"gear"'), "inputs.F: 'gear' is of type Int32, but"),
        (_KINDS_MAP.replace('"F"', '"brake"'), "inputs.F: 'brake' is of type Boolean, but"),
        (_KINDS_MAP.replace('"F"', '"u"'), "inputs.F: 'u' is an array of Float64, but"),
        (_KINDS_MAP.replace('"F"', '"u[1]"'), "inputs.F: 'u[1]' is an entry of the array 'u', but"),
        (
            f"{_KINDS_MAP}[parameters]\nteeth = 11\n",
            "parameters.teeth: 'teeth' is of type Int32, but",
        ),
        (f"{_KINDS_MAP}[start]\nbrake = 1\n", "start.brake: 'brake' is of type Boolean, but"),
    ],
)
def test_a_variable_of_another_kind_is_refused_with_what_a_map_takes_and_what_to_do(
    whole, text: str, words: str
):
    told = refusal(lambda: whole(text, "t,F,x\n0,1,0\n1,,0\n", _KINDS))
    assert not unsaid(
        told,
        words,
        "a map takes variables of one floating-point number (Real, Float64); leave it out (inputs and parameters keep their start values), or wrap the FMU",
    )


def test_inputs_of_other_kinds_are_named_that_keep_their_start_values(whole):
    foreign, _ = whole(_KINDS_MAP, "t,F,x\n0,1,0\n1,,0\n", _KINDS)
    assert foreign.model.notes == (
        "Inputs of the FMU that the plan does not drive keep their start values: gear, brake, u.",
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (WHOLE.replace("lower = -100.0", "lower = -500.000001"),
         "inputs.F.lower: -500 lies beyond"),
        (WHOLE.replace("lower = -100.0", "lower = 2.0, upper = 2.0"),
         "inputs.F: lower is 2 … below upper, 2"),
        (WHOLE.replace("lower = -100.0", "upper = -500.0"),
         "inputs.F: … lower bound is -500 … upper bound -500"),
        (WHOLE.replace("replay_terminal_velocity_error = 0.2",
                       "replay_terminal_velocity_error = -0.2"),
                       "limits.replay_terminal_velocity_error.value: … but must be at least 0"),
        (WHOLE.replace("replay_terminal_velocity_error = 0.2",
                       "replay_terminal_velocity_error = true"),
                       "limits.replay_terminal_velocity_error: "),
        (WHOLE.replace("gain = 2.5", "gain = nan"),
         "parameters.gain: it is nan, but must be a finite number"),
        (WHOLE.replace('"torque"', '""'), "inputs.M.variable: … but must be a name"),
        (WHOLE.replace("x = 1.25", 'x = "1.25"'), "goal.x: it is … but must be a number"),
    ],
)  # fmt: skip
def test_numbers_that_are_just_beyond_what_they_may_be(whole, text: str, words: str):
    assert not unsaid(refusal(lambda: whole(text)), words)


def test_a_bound_on_one_side_is_on_the_other_where_the_scale_is_negative(whole):
    """The torque is at most 8, and has no least."""
    foreign, _ = whole(WHOLE.replace("scale = 2.0, offset = 1.0", "scale = -2.0, offset = 1.0"))
    assert (foreign.model.inputs[1].lower, foreign.model.inputs[1].upper) == (-3.5, math.inf)


def test_a_limit_of_nothing_and_a_limit_by_its_number_are_limits(whole):
    foreign, _ = whole(
        WHOLE.replace("replay_terminal_velocity_error = 0.2",
                      "replay_terminal_velocity_error = 0").replace("scale = 2.0, offset = 1.0",
                      "scale = 2"),
    )  # fmt: skip
    limit = foreign.model.limit("replay_terminal_velocity_error")
    assert (limit.value, foreign.input_scale.tolist()) == (0.0, [-0.001, 2.0])


def test_a_bound_may_be_the_fmus_own_but_for_rounding(whole):
    foreign, _ = whole(WHOLE.replace("lower = -100.0", "lower = -500.0000004, upper = 1500.000001"))
    assert (foreign.model.inputs[0].lower, foreign.model.inputs[0].upper) == (
        -500.0000004,
        1500.000001,
    )


@pytest.mark.parametrize(
    ("plan", "words"),
    [
        (ROWS.replace(",M,", ",m,"), "the column 'M' is missing"),
        (ROWS.replace("pressed", "presed"), "'presed' … (near it: pressed)"),
        (ROWS.replace("time,", "time [ms],"), "the column 't' is in 'ms'"),
        (ROWS.replace("F,", "F [kN],"), "inputs.F: … 'F' is in 'kN' … 'N'"),
    ],
)  # fmt: skip
def test_each_mistake_in_the_columns_of_a_plan_is_named(whole, plan: str, words: str):
    assert not unsaid(refusal(lambda: whole(WHOLE, plan)), words)


def test_a_missing_input_is_not_answered_with_another_input(whole):
    plain = '[inputs]\nM = "torque"\nF = "drive.force"\n'
    said = refusal(lambda: whole(plain, "t,F\n0,1\n1,1\n"))
    assert said.endswith("the column 'M' is missing; it has t, F.")


def test_a_unit_of_the_plan_against_that_of_the_fmu_needs_a_scale(whole):
    plain = '[inputs]\nF = "drive.force"\n[positions]\nx = "body.pos"\n'
    assert not unsaid(
        refusal(lambda: whole(plain, "t,F,x [m]\n0,1,0\n1,1,0\n")),
        "in 'm', but 'body.pos' is in 'mm'; give a scale",
    )
    for given in (
        '{ variable = "body.pos", scale = 0.001 }',
        '{ variable = "body.pos", offset = 1.0 }',
    ):
        foreign, _ = whole(
            plain.replace('"body.pos"', given), f"t,F,x [m]\n0,1,{'offset' in given:d}\n1,1,0\n"
        )
        assert foreign.model.coordinates[0].unit == "m"
    foreign, _ = whole(plain, "t,F,x\n0,1,0\n1,1,0\n")
    assert (foreign.model.coordinates[0].unit, foreign.model.inputs[0].unit) == ("mm", "kN"), (
        "without a scale it is the FMU's own"
    )


# Without a map


def variables(*items: tuple[str, str, str] | tuple[str, str, str, Any]) -> Any:
    """The FMU's variables: (name, causality, unit), and of what a rate is the derivative."""
    found = [
        SimpleNamespace(
            name=name, causality=causality, unit=unit, type="Real", valueReference=place,
            derivative=SimpleNamespace(name=of[0]) if of else None,
        )
        for place, (name, causality, unit, *of) in enumerate(items)
    ]  # fmt: skip
    return Named(SimpleNamespace(description=SimpleNamespace(modelVariables=found)))  # type: ignore[arg-type]


def equal(named: Any, columns: str, *units: Any) -> Any:
    dimensions = Dimensions(SimpleNamespace(unitDefinitions=units))
    table: Any = SimpleNamespace(names=columns.split(","), where="plan p")
    return by_equal_names(named, table, dimensions)


FMU = (("u", "input", "N"), ("x", "output", "m"), ("y", "output", "m"),
       ("vx", "output", "m/s", "x"), ("w", "output", "rad/s"), ("lam_a", "output", "N"),
       ("lam_b", "output", "N"), ("gap_b", "output", "m"))  # fmt: skip


def test_columns_are_what_the_variables_of_their_names_are():
    found = equal(variables(*FMU), "t,u,y,x,w,vx,lam_a,lam_b")
    assert (
        {name: item.variable for name, item in found.inputs.items()},
        list(found.positions),
    ) == ({"u": "u"}, ["y", "x"])
    assert {name: (item.variable, item.column) for name, item in found.velocities.items()} == {
        "y": ("w", "w"),
        "x": ("vx", "vx"),
    }
    assert {
        name: (item.force.variable, item.gap.variable if item.gap else None)
        for name, item in found.contacts.items()
    } == {
        "a": ("lam_a", None),
        "b": ("lam_b", "gap_b"),
    }


def test_a_velocity_is_known_by_the_definition_of_its_unit():
    """knot: 1 m/s but for a factor; m/s is called so, but defined as a length here."""
    named = variables(("x", "output", "inch"), ("y", "output", "m/s"), ("a", "output", "turn"),
                      ("vx", "output", "knot"), ("wa", "output", "rpm"))  # fmt: skip
    defined = [unit_of("inch", m=1), unit_of("m/s", m=1), unit_of("turn", rad=1)]
    defined += [unit_of("knot", m=1, s=-1), unit_of("rpm", rad=1, s=-1)]
    found = equal(named, "t,x,y,vx", *defined)
    assert list(found.positions) == ["x", "y", "vx"]  # two positions, one velocity: no pairs
    found = equal(named, "t,x,a,vx,wa", *defined)
    assert (list(found.positions), list(found.velocities)) == (["x", "a"], ["x", "a"])


def test_rates_without_as_many_positions_are_positions():
    found = equal(variables(*FMU), "t,u,y,x,w")
    assert (list(found.positions), found.velocities) == (["y", "x", "w"], {})
    assert list(equal(variables(*FMU), "t,w").positions) == ["w"]


@pytest.mark.parametrize("rate", ["v_x", "der(x)"])
def test_a_rate_belongs_to_the_position_that_its_name_says(rate: str):
    named = variables(
        ("x", "output", "m"),
        ("y", "output", "m"),
        (rate, "output", "m/s"),
        ("other", "output", "m/s"),
    )
    assert {
        name: item.variable for name, item in equal(named, f"t,x,y,other,{rate}").velocities.items()
    } == {"x": rate, "y": "other"}
    both = variables(
        ("x", "output", "m"),
        ("y", "output", "m"),
        ("v_x", "output", "m/s"),
        ("der(x)", "output", "m/s"),
    )
    assert {
        name: item.variable for name, item in equal(both, "t,x,y,v_x,der(x)").velocities.items()
    } == {"x": "v_x", "y": "der(x)"}


def test_names_that_nothing_shares_are_said():
    with pytest.raises(MapError, match=r"plan p: .*no variable 'z'; name the right one in a map"):
        equal(variables(*FMU), "t,z")
    with pytest.raises(MapError, match=r"no variable 'lam_c' \(near it: lam_b, lam_a\)"):
        equal(variables(*FMU), "t,lam_c")
    with pytest.raises(MapError, match="share no names"):
        equal(variables(*FMU), "t,lam_a")


def test_a_hint_among_many_names_is_that_among_few():
    """Above two thousand names the likely ones are chosen by their parts of three letters first."""
    many = [f"zz{index}" for index in range(2500)]
    assert (
        hint("body.poss", [*many, "body.pos", "body.position"])
        == hint("body.poss", ["body.pos", "body.position"])
        == " (near it: body.pos, body.position)"
    )
    assert hint("qqqqqq", many) == hint("qqqqqq", []) == ""
    assert hint("BODY.POS", [*many, "body.pos"]) == "", "letters of another size are other letters"


@pytest.mark.parametrize(
    ("position", "velocity", "may"),
    [("m", "m/s", True), ("m", "m", False), ("rad", "rad/s", True), ("1", "m/s", True),
     ("m", "1", True), ("m/s", "m/s2", True), ("m s", "m", True), ("m", "kg m/s", False),
     ("furlong", "m/s", True), ("m", "furlong", True)],
)  # fmt: skip
def test_a_velocity_is_in_its_positions_unit_per_second(position: str, velocity: str, may: bool):
    dimensions = Dimensions(SimpleNamespace(unitDefinitions=[]))
    assert dimensions.may_be_rate(position, velocity) is may


def unit_of(name: str, **given: float) -> Any:
    powers = dict.fromkeys(("kg", "m", "s", "A", "K", "mol", "cd", "rad"), 0)
    base = {**powers, "factor": 1.0, "offset": 0.0, **given}
    return SimpleNamespace(name=name, baseUnit=SimpleNamespace(**base))


@pytest.mark.parametrize(
    ("unit", "what", "contradicts"),
    [
        ("inch", "position", False), ("inch", "gap", False), ("inch", "velocity", True),
        ("inch", "force", True), ("pound", "position", True), ("volt", "position", False),
        ("turn", "position", False), ("m", "position", False), ("kg", "position", True),
        ("furlong", "position", False), ("", "position", False), (None, "gap", False),
        ("knot", "velocity", False), ("hertz", "velocity", False), ("moment", "force", False),
        ("bare", "position", False), ("warm", "gap", False),
    ],
)  # fmt: skip
def test_a_unit_contradicts_a_quantity_where_no_scale_leads_to_it(
    unit: str | None, what: str, contradicts: bool
):
    defined = [
        unit_of("inch", m=1), unit_of("pound", kg=1), unit_of("volt", kg=1, m=2, s=-3, A=-1),
        unit_of("turn"), unit_of("knot", m=1, s=-1), unit_of("hertz", s=-1),
        unit_of("moment", kg=1, m=2, s=-2), SimpleNamespace(name="bare", baseUnit=None),
        unit_of("warm", K=1),
    ]  # fmt: skip
    of_fmu = Dimensions(SimpleNamespace(unitDefinitions=defined))
    assert of_fmu.contradicts(unit, what, True) is contradicts
    own = {"m": what in ("velocity", "force"), "kg": True}
    assert [of_fmu.contradicts(name, what) for name in own] == list(own.values())


# Units of an FMU whose names say one thing, or nothing, and whose definitions say what they are.
_UNITS = [
    unit_of("N", kg=1, m=1, s=-2, factor=1000.0), unit_of("newton", kg=1, m=1, s=-2),
    unit_of("m.s-1", m=1, s=-1), unit_of("mm/s", m=1, s=-1, factor=1e-3), unit_of("mm", m=1, factor=1e-3),
    unit_of("degree", rad=1, factor=0.0174532925199433), unit_of("degree/s", rad=1, s=-1, factor=0.01745329252),
    unit_of("radian", rad=1), unit_of("degC", K=1, offset=273.15), unit_of("kelvin", K=1),
]  # fmt: skip


def test_units_are_the_same_by_their_definitions():
    units = Dimensions(SimpleNamespace(unitDefinitions=_UNITS))
    assert units.is_same("m/s", "m.s-1")
    assert units.is_same("rad", "radian")
    assert not units.is_same("rad", "degree")
    assert not units.is_same("m/s", "mm/s")
    assert units.is_same("furlong", "furlong"), "that nobody defines"
    assert not units.is_same("furlong", "chain")
    assert not units.is_same("N", "N"), "the FMU's are kilonewtons"
    assert units.is_in("newton", ("N", "N m"))
    assert not units.is_in("N", ("N", "N m"))
    assert units.is_force("newton")
    assert not units.is_force("degree")
    assert units.is_force("Nm"), "by its name"


@pytest.mark.parametrize(
    ("position", "velocity", "may"),
    [
        ("mm", "mm/s", True), ("m", "mm/s", False), ("mm", "m.s-1", False), ("m", "m.s-1", True),
        ("degree", "degree/s", True), ("rad", "degree/s", False), ("degC", "furlong", True),
    ],
)  # fmt: skip
def test_velocity_is_per_second_of_its_position_by_definition(
    position: str, velocity: str, may: bool
):
    units = Dimensions(SimpleNamespace(unitDefinitions=_UNITS))
    assert units.may_be_rate(position, velocity) is may


def test_very_many_short_names_do_not_crowd_out_the_long_one_that_is_meant():
    """Two shared parts in twelve letters say more than one in three: what counts is the length of both names."""
    assert hint("abcdefghijkl", [*["abc"] * 2500, "abcxefgxijxl"]) == " (near it: abcxefgxijxl)"
