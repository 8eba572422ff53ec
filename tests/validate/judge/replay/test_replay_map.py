"""What a map says of somebody's FMU: duration, bounds, depths, accuracy, hold.

And names that nobody expects. One sentence, or it works.
"""

import json
import math
import re
import time
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from edited_fmu import edited
from foreign_fmu import (
    COSIMULATION,
    DESCRIPTION,
    EXCHANGE,
    FULL_MAP,
    MASS,
    STIFFNESS,
    build_foreign,
    compile_cart,
    foreign_plan,
    write_plan,
)
from wording import unsaid

from models.catalog import load_scene
from models.errors import TouchstoneError
from models.fmu import build_fmu
from models.netcdf import read_columns
from models.plan_table import PlanTable
from models.trajectory import Hold, Trajectory, write_csv
from validate.fmi.description import read_package
from validate.judge.replay import Replay
from validate.judge.replay.map_schema import hint, read_map
from validate.judge.replay.mapping import wire
from validate.judge.replay.netcdf import write_replay
from validate.judge.replay.run import replay_foreign
from validate.judge.replay.subject import Foreign
from validate.processes.isolated import Limits

Wire = Callable[..., tuple[Foreign, Trajectory]]
# Free flight: no contact, and nothing of the goal or the limits of FULL_MAP.
BARE = FULL_MAP.partition("[contacts.stop]")[0]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("map")
    build_foreign(folder / "cart.fmu")
    build_foreign(folder / "only_cs.fmu", kinds=COSIMULATION)
    build_foreign(folder / "own_grid.fmu", kinds=COSIMULATION, defines=("OWN_GRID=1e-3",))
    build_foreign(folder / "whole_steps.fmu", kinds=COSIMULATION, defines=("WHOLE_STEPS",))
    write_plan(folder / "plan.csv")
    return folder


@pytest.fixture(scope="module")
def wired(folder: Path) -> Wire:
    def call(
        given: str | None, plan: str | None = None, fmu: str = "cart.fmu", hold: str | None = None
    ) -> tuple[Foreign, Trajectory]:
        if given is not None:
            (folder / "map.toml").write_text(given, encoding="utf-8")
        if plan is not None:
            (folder / "told.csv").write_text(plan, encoding="utf-8")
        path = folder / ("plan.csv" if plan is None else "told.csv")
        return wire(
            read_package(folder / fmu),
            PlanTable(path),
            None if given is None else read_map(folder / "map.toml"),
            hold,
            "map",
        )

    return call


def replayed(folder: Path, wired: tuple[Foreign, Trajectory], fmu: str = "cart.fmu") -> Replay:
    foreign, plan = wired
    result = replay_foreign(foreign, read_package(folder / fmu), plan, limits=Limits(seconds=100.0))
    assert result.ok, result.message
    return result


def refusal(call: Callable[[], object]) -> str:
    with pytest.raises(TouchstoneError) as caught:
        call()
    assert caught.value.exit_code == 2
    assert "\n" not in str(caught.value)
    return str(caught.value)


# What the verdict reads


def test_what_cannot_be_asked_says_how_to_make_it_askable(wired: Wire):
    told = "\n".join(wired(BARE, "t,F\n0,1\n1,\n")[0].model.not_asked)
    assert not unsaid(
        told, "duration_error: the map gives no [task] duration",
        "the map gives no [goal]",
        "max_penetration, ghost_impulse, missed_impulse: the map names no [contacts]",
    )  # fmt: skip
    assert not unsaid(
        "\n".join(wired(FULL_MAP)[0].model.not_asked), "max_penetration: contact stop has no depth"
    )


def test_limit_is_waived_with_a_reason_alone(wired: Wire):
    given = FULL_MAP + 'max_penetration = { waived = true, reason = "a spring without an end" }\n'
    limit = wired(given)[0].model.limit("max_penetration")
    assert (limit.value, limit.reason) == (None, "a spring without an end")
    for wrong, words in (
        (
            "{ waived = true }",
            "limits.max_penetration: a limit is waived for a reason; add reason = '..'",
        ),
        (
            "{ waived = true, value = 1.0, reason = 'x' }",
            "limits.max_penetration: it needs one of the two",
        ),
        ("{ reason = 'x' }", "limits.max_penetration: it needs one of the two"),
    ):
        assert not unsaid(
            refusal(lambda wrong=wrong: wired(f"{FULL_MAP}max_penetration = {wrong}\n")), words
        )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (FULL_MAP + "\n[task]\nduration = 0\n", "task.duration: it is 0 … above 0"),
        (FULL_MAP + "\n[task]\nduration = 'long'\n", "task.duration: it is … but must be a number"),
        (FULL_MAP + "\n[task]\nstep = 0.1\n",
         "task.step: … no such key; the steps are the plan's own"),
        (FULL_MAP + "\n[accuracy]\nposition = -1e-3\n",
         "accuracy.position: it is -0.001 … above 0"),
        (FULL_MAP + "\n[accuracy]\ngap = 0.0\n", "accuracy.gap: it is 0 … above 0"),
        (FULL_MAP + "\n[accuracy]\nposition = true\n",
         "accuracy.position: it is … but must be a number"),
        (FULL_MAP + "\n[plan]\nscheme = 'rk4'\n", "plan.scheme: … take the line out"),
        (FULL_MAP.replace("force =", "depth = -1\nforce ="),
         "contacts.stop.depth: it is -1 … above 0"),
        (FULL_MAP.replace("force =", "depth_reason = 'x'\nforce ="),
         "contacts.stop: it gives a depth_reason, but no depth"),
        (FULL_MAP.replace("replay_terminal_position_error", "max_penetration"),
         "goal.x: no limit … add replay_terminal_position_error = {"),
        (FULL_MAP.replace("[goal]", "[goal]\nv_x = 0.0"),
         "goal.v_x: no limit … add replay_terminal_velocity_error = {"),
        (FULL_MAP.replace('"body.pos"', '"body.mass"'),
         "positions.x: 'body.mass' is in 'kg' … position, in m"),
        (FULL_MAP.replace('0.001, unit = "m" }\n[vel', '0.001, unit = "kg" }\n[vel'),
         "positions.x: it is in 'kg' … position, in m"),
        (FULL_MAP.replace('0.001, unit = "m" }\n[vel', '0.001, unit = "m/s" }\n[vel'),
         "positions.x: it is in 'm/s' … position, in m"),
        (FULL_MAP.replace('"body.vel", scale = 0.001, unit = "m/s"', '"body.mass", scale = 2.0'),
         "velocities.x: 'body.mass' is in 'kg' … velocity, in m/s or 1/s"),
        (FULL_MAP.replace('"stop.push"', '{ variable = "body.mass", scale = 9.81 }'),
         "contacts.stop.force: 'body.mass' is in 'kg' … force, in N or N m"),
        (FULL_MAP.replace('unit = "m/s"', 'unit = "m"'),
         "velocities.x: … 'm', but positions.x in 'm'; … in 'm/s'"),
        (FULL_MAP.replace('"stop.gap", scale = 0.001, unit = "m"', '"stop.gap"'),
         "contacts.stop.gap: 'stop.gap' is in 'mm' … in 'm'; give a scale"),
        (FULL_MAP.replace('"stop.gap", scale = 0.001, unit = "m"',
                          '"stop.gap", scale = 0.001, unit = "kg"'),
                          "contacts.stop.gap: it is in 'kg' … in 'm'"),
        (FULL_MAP.replace('"stop.push"', '{ variable = "stop.push", scale = 0.001, unit = "kN" }'),
         "contacts.stop.force: it is in 'kN' … in 'N' behind its scale, as in the plan"),
    ],
)  # fmt: skip
def test_mistake_in_the_map_is_one_sentence(wired: Wire, text: str, words: str):
    assert not unsaid(refusal(lambda: wired(text)), words)


FROM_A_COLUMN = BARE + "[start]\n'body.mass' = 'begin'\n"


@pytest.mark.parametrize(
    ("given", "plan", "words"),
    [
        (FULL_MAP, "t,x,F,lam_stop [N]\n0,1,1,0\n1,1,1,0\n", ""),
        (FULL_MAP, "t,x,F,lam_stop [kN]\n0,1,1,0\n1,1,1,0\n", "'lam_stop' is in 'kN', but 'N'"),
        (FROM_A_COLUMN, "t,F,begin [kg]\n0,1,2\n1,1,2\n", ""),
        (FROM_A_COLUMN, "t,F,begin [g]\n0,1,2\n1,1,2\n", "'begin' is in 'g', but 'kg'"),
    ],
)  # fmt: skip
def test_planned_forces_and_starts_from_a_column_have_no_scale(
    wired: Wire, given: str, plan: str, words: str
):
    if words:
        assert not unsaid(refusal(lambda: wired(given, plan)), words, "is expected; convert it")
    else:
        wired(given, plan)


@pytest.mark.parametrize(
    ("defined", "words"),
    [
        ('m="1" factor="0.001"', ""),
        ('rad="1" factor="0.0175"', ""),  # an angle, with an arm for its scale
        ('kg="1" m="2" s="-3" A="-1"', ""),  # volts of a sensor: only its maker knows
        ('kg="1"', "positions.x: 'body.pos' is in 'mm' … position, in m."),
    ],
)
def test_a_unit_is_what_the_fmu_defines_it_to_be(
    folder: Path, wired: Wire, defined: str, words: str
):
    units = f'<UnitDefinitions><Unit name="mm"><BaseUnit {defined}/></Unit></UnitDefinitions>\n  <ModelVariables>'
    renamed(folder / "unit.fmu", {}, units=units)
    given = BARE.replace(', unit = "m" }', " }")
    if words:
        assert not unsaid(refusal(lambda: wired(given, fmu="unit.fmu")), words)
    else:
        assert wired(given, "t,F\n0,1\n1,\n", "unit.fmu")[0].model.nq == 1


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (('unit="N"', 'unit="newton"'), ""),
        (('unit="N"', 'unit="kilo"'), "contacts.stop.force: 'stop.push' is in 'kilo' … in 'N'; give a scale"),
    ],
)  # fmt: skip
def test_contact_unit_is_what_the_fmu_defines(
    folder: Path, wired: Wire, edit: tuple[str, str], words: str
):
    newton = '<Unit name="{0}"><BaseUnit kg="1" m="1" s="-2" factor="{1}"/></Unit>'
    units = f"<UnitDefinitions>{newton.format('newton', 1)}{newton.format('kilo', 1000)}</UnitDefinitions><ModelVariables>"
    edited(
        folder / "cart.fmu",
        folder / "newton.fmu",
        lambda text: text.replace(*edit).replace("<ModelVariables>", units),
    )
    if words:
        assert not unsaid(refusal(lambda: wired(FULL_MAP, fmu="newton.fmu")), words)
    else:
        assert wired(FULL_MAP, fmu="newton.fmu")[0].model.nc == 1


@pytest.mark.parametrize("given", [BARE, None])
@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('unit="mm" start="0"', 'unit="mm" start="abc"',
         "its variable 'body.pos' has start='abc', which is no number; correct it"),
        ('unit="kg" start="2"', 'unit="kg" start=""',
         "'body.mass' has start='', which is no number"),
        ('min="-1"', 'min="1 kN"', "'drive.force' has min='1 kN'"),
        ('max="1"', 'max="-"', "'drive.force' has max='-'"),
        ('unit="mm/s" start', 'unit="mm/s" nominal="a" start', "'body.vel' has nominal='a'"),
    ],
)  # fmt: skip
def test_what_is_no_number_in_the_fmu_is_told_with_its_variable(
    folder: Path, wired: Wire, given: str | None, old: str, new: str, words: str
):
    edited(folder / "cart.fmu", folder / "numbers.fmu", lambda text: text.replace(old, new, 1))
    assert words in refusal(lambda: wired(given, fmu="numbers.fmu"))


@pytest.mark.parametrize("steps", [1, 3, 40, 600])
def test_how_deep_it_goes_does_not_depend_on_the_rows_of_a_plan(
    folder: Path, wired: Wire, steps: int
):
    """Of Co-Simulation alone too: the cart is in the stop for 0.14 s, by the closed form 0.1 m deep."""
    write_plan(folder / "rows.csv", plan=foreign_plan(steps, 0.4 / steps))
    foreign, plan = wired(
        FULL_MAP, (folder / "rows.csv").read_text(encoding="utf-8"), "only_cs.fmu"
    )
    result = replayed(folder, (foreign, plan), "only_cs.fmu")
    speed, sag = math.hypot(2.0, math.sqrt(2.0 * 4.0 / MASS * 0.2)), 4.0 / STIFFNESS
    assert -result.gap.min() == pytest.approx(
        sag + math.hypot(sag, speed * math.sqrt(MASS / STIFFNESS)), abs=2e-4
    )
    assert (result.t[result.knots] == plan.t).all()
    assert len(result.t) >= 501


def test_a_map_without_positions_is_looked_at_as_often(folder: Path, wired: Wire):
    foreign, plan = wired(
        FULL_MAP.split("[positions]")[0], "t,F\n0,1\n0.1,1\n0.2,\n", "only_cs.fmu"
    )
    result = replayed(folder, (foreign, plan), "only_cs.fmu")
    assert (plan.q.shape, result.q.shape[1], len(result.knots)) == ((3, 0), 0, 3)
    assert len(result.t) >= 501


# Hold and declarations


@pytest.mark.parametrize("fmu", ["cart.fmu", "only_cs.fmu"])
def test_ramp_that_ends_at_the_last_row_is_integrated_to_its_end(
    folder: Path, wired: Wire, fmu: str
):
    """m x'' = 10 - 40 t in free flight, from five rows: without the last one the end would be 0.002 m off."""
    rows = "".join(f"{t!r},{10 - 40 * t!r}\n" for t in (0.0, 0.05, 0.1, 0.15, 0.2))
    given = BARE + "[start]\n'body.pos' = 100\n"
    foreign, plan = wired(given, "# hold: linear\nt,F\n" + rows, fmu)
    assert (plan.hold, plan.steps, plan.missing) == (Hold.LINEAR, 4, {"q", "v"})
    assert plan.u_end == pytest.approx([2.0])
    result = replayed(folder, (foreign, plan), fmu)
    t = result.t[result.knots]
    assert result.q[result.knots, 0] == pytest.approx(
        0.1 + (5 * t**2 - 40 * t**3 / 6) / MASS, abs=1e-8 if fmu == "cart.fmu" else 1e-6
    )
    held = replayed(
        folder, wired(given, "# hold: linear\nt,F\n" + rows.rsplit(",", 1)[0] + ",\n", fmu), fmu
    )
    assert abs(held.q[-1, 0] - result.q[-1, 0]) > 1e-4, (
        "an empty last cell holds the last step constant"
    )


def test_hold_of_the_plan_must_not_be_contradicted(wired: Wire):
    plan = "# hold: linear\nt,F\n0,1\n1,2\n"
    asks = BARE + "[plan]\nhold = 'linear'\n"
    assert (
        wired(asks, plan)[1].hold
        is wired(BARE, plan)[1].hold
        is wired(BARE, plan, hold="linear")[1].hold
        is Hold.LINEAR
    )
    assert not unsaid(
        refusal(lambda: wired(asks.replace("linear", "zero"), plan)),
        "hold 'linear', but map (plan.hold)",
    )
    assert not unsaid(refusal(lambda: wired(asks, plan, hold="zero")), "hold 'linear', but --hold")
    assert wired(asks, plan.split("\n", 1)[1], hold="zero")[1].hold is Hold.ZERO_ORDER, (
        "--hold counts before the map"
    )


def test_scheme_of_a_plan_is_noted_and_not_asked_of_an_fmu(folder: Path, wired: Wire):
    foreign, plan = wired(BARE, "# scheme: semi_implicit_euler\n# hold: zero\nt,F\n0,1\n0.1,\n")
    assert plan.scheme is None
    assert (
        "The plan declares the scheme semi_implicit_euler"
        in replayed(folder, (foreign, plan)).message
    )
    assert "did you mean semi_implicit_euler?" in refusal(
        lambda: wired(BARE, "# scheme: semi_implicit_euller\nt,F\n0,1\n0.1,\n")
    )


def test_inputs_alone_hold_their_last_row_for_a_step_where_the_task_lasts_as_long(wired: Wire):
    plan = "t,F\n0,1\n0.1,2\n0.2,3\n"
    longer = wired(BARE + "[task]\nduration = 0.3\n", plan)[1]
    assert (longer.t[-1], longer.u[:, 0].tolist()) == (pytest.approx(0.3), [1.0, 2.0, 3.0])
    assert wired(BARE + "[task]\nduration = 0.2\n", plan)[1].steps == 2
    assert wired(BARE, plan)[1].steps == 2
    assert wired(BARE + "[task]\nduration = 5.0\n", plan)[1].steps == 2, (
        "a step more does not make it as long"
    )


def test_group_of_columns_that_is_there_in_part_is_refused(wired: Wire):
    two = '\n[contacts.stop]\nforce = "stop.push"\n[contacts.other]\ngap = { variable = "stop.gap", scale = 0.001 }\n'
    assert "the column 'lam_other' is missing, but 'lam_stop' is present" in refusal(
        lambda: wired(BARE + two, "t,F,lam_stop\n0,1,0\n1,1,0\n")
    )
    assert "it has velocities, but no positions" in refusal(
        lambda: wired(BARE, "t,F,v_x\n0,1,0\n1,1,0\n")
    )


def test_empty_columns_are_as_none_but_of_inputs(wired: Wire):
    foreign, plan = wired(BARE, "t,x,v_x,F\n0,,,1\n0.1,,,1\n0.2,,,\n")
    assert (plan.missing, foreign.variables.start) == (
        {"q", "v"},
        wired(BARE, "t,F\n0,1\n0.1,1\n0.2,\n")[0].variables.start,
    )
    assert "the column 'F' is empty; it has t, x" in refusal(
        lambda: wired(BARE, "t,x,F\n0,1,\n0.1,1,\n")
    )


# Without Model Exchange


@pytest.mark.slow
def test_stated_accuracy_is_the_error_where_no_run_tells_one(folder: Path, wired: Wire):
    blind = replayed(folder, wired(FULL_MAP, fmu="own_grid.fmu"), "own_grid.fmu")
    assert (blind.error.estimate, blind.error.stated) == (None, None)
    assert not unsaid(blind.error.would_decide, "state how good … ([accuracy] position = ..)")
    given = FULL_MAP + "[accuracy]\nposition = 1e-4\nvelocity = 2e-3\ngap = 1e-4\n"
    stated = replayed(folder, wired(given, fmu="own_grid.fmu"), "own_grid.fmu")
    assert stated.error.estimate == stated.error.stated
    assert "its author states" in stated.message
    part = replayed(
        folder,
        wired(FULL_MAP + "[accuracy]\nposition = 1e-4\n", fmu="own_grid.fmu"),
        "own_grid.fmu",
    )
    assert (part.error.estimate.position, part.error.estimate.gap) == (1e-4, math.inf)
    assert not unsaid(part.error.would_decide, "state [accuracy] velocity and gap")
    told = json.dumps(part.error.as_json(), allow_nan=False)
    assert json.loads(told)["estimate"]["gap"] is None


@pytest.mark.slow
def test_larger_of_stated_and_measured_error_counts(folder: Path, wired: Wire):
    fmu = "whole_steps.fmu"
    measured = replayed(folder, wired(FULL_MAP, fmu=fmu), fmu).error
    small = replayed(folder, wired(FULL_MAP + "[accuracy]\nposition = 1e-12\n", fmu=fmu), fmu).error
    assert small.estimate == measured.step
    large = replayed(folder, wired(FULL_MAP + "[accuracy]\nposition = 0.5\n", fmu=fmu), fmu).error
    assert (large.estimate.position, large.estimate.gap) == (0.5, measured.estimate.gap)


def test_stated_accuracy_is_not_the_error_of_a_reference(folder: Path, wired: Wire):
    result = replayed(folder, wired(FULL_MAP + "[accuracy]\nposition = 0.5\n"))
    assert result.error.estimate.position < 1e-6
    assert "The stated accuracy is of Co-Simulation" in result.message
    assert result.error.would_decide == ""


@pytest.mark.slow
def test_what_divides_the_two_interfaces_is_the_error_unless_the_map_says_how_coarse_one_is(
    folder: Path, wired: Wire
):
    build_foreign(folder / "coarse.fmu", defines=("OWN_GRID=1e-3",))
    apart = replayed(folder, wired(FULL_MAP, fmu="coarse.fmu"), "coarse.fmu")
    assert apart.method == "reference"
    assert (
        apart.error.estimate.position
        == apart.error.everyday.position
        > 1e3 * apart.error.tolerance.position
    )
    assert not unsaid(
        apart.message, "Co-Simulation is … from Model Exchange … ([accuracy] position"
    )
    stated = replayed(
        folder,
        wired(
            FULL_MAP + "[accuracy]\nposition = 1e-2\nvelocity = 1.0\ngap = 1e-2\n", fmu="coarse.fmu"
        ),
        "coarse.fmu",
    )
    assert stated.error.estimate == stated.error.tolerance


# Names


def renamed(
    path: Path, names: dict[str, str], more: str = "", units: str = "<ModelVariables>"
) -> Path:
    """The cart with other names of its variables, and with more variables and units."""
    text = DESCRIPTION.format(kinds=EXCHANGE + COSIMULATION).replace(
        "  </ModelVariables>", more + "  </ModelVariables>"
    )
    text = text.replace("<ModelVariables>", units)
    for old, new in names.items():
        written = new.replace("&", "&amp;").replace('"', "&quot;").replace("<", "&lt;")
        assert f'name="{old}"' in text
        text = text.replace(f'name="{old}"', f'name="{written}"')
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", text)
        archive.writestr("binaries/linux64/cart.so", compile_cart(path.parent))
    return path


STRANGE = [
    "kraft_längs",
    "θ1",
    "a b  c",
    'it\'s "so"',
    "körper.x[1].ẋ",
    "🚗",
    "a/b",
    "-1",
    "x,y;z",
    "<&>",
    "t",
    "gap_x",
]


def called(folder: Path, wired: Wire, name: str) -> tuple[Foreign, Trajectory]:
    """The cart, its variables, columns and contact called by this name, at rest."""
    renamed(
        folder / "named.fmu",
        {"body.pos": name, "drive.force": f"{name} in", "stop.gap": f"{name} gap"},
    )
    key = json.dumps(name, ensure_ascii=False)
    given = f"""
plan = {{ time = "the time" }}
[inputs]
{json.dumps(f"u {name}", ensure_ascii=False)} = {{ variable = {json.dumps(f"{name} in", ensure_ascii=False)}, scale = 0.001 }}
[positions]
{key} = {{ variable = {key}, scale = 0.001, unit = "m" }}
[start]
{key} = {key}
[contacts.{key}]
gap = {{ variable = {json.dumps(f"{name} gap", ensure_ascii=False)}, scale = 0.001 }}
"""
    header = ",".join(
        '"' + part.replace('"', '""') + '"' for part in ("the time", name, f"u {name}")
    )
    return wired(given, f"{header}\n0,0.1,1\n0.1,0.1,\n", "named.fmu")


@pytest.fixture(scope="module")
def moved(folder: Path, wired: Wire) -> Replay:
    """A replay, which tells variables by their numbers: that of any other name.

    A child takes a name with everything that is strange.
    """
    return replayed(folder, called(folder, wired, " ".join(STRANGE)), "named.fmu")


@pytest.mark.parametrize("name", STRANGE)
def test_any_name_of_variables_columns_and_contacts_works(
    folder: Path, wired: Wire, moved: Replay, name: str
):
    foreign, plan = called(folder, wired, name)
    assert foreign.model.coordinates[0].name == name
    write_replay(folder / "named.nc", moved, foreign.model, plan)
    columns, _ = read_columns(folder / "named.nc")
    assert name in columns or any(item.description.startswith(name) for item in columns.values())
    assert f"gap_{name}" in columns or any(
        f"gap_{name}" in item.description for item in columns.values()
    )


@pytest.mark.parametrize("name", ["kraft_längs", "θ1", "a b", "🚗", "q[1]", "q[1,2]", "t2"])
def test_any_name_works_without_a_map(folder: Path, wired: Wire, name: str):
    renamed(folder / "equal.fmu", {"body.pos": name})
    quoted = f'"{name}"'
    foreign, plan = wired(None, f"t,{quoted},drive.force\n0,0,0\n0.1,100,\n", "equal.fmu")
    assert [item.name for item in foreign.model.coordinates] == [name]
    assert plan.q[1, 0] == 100.0


def test_friction_forces_of_a_plan_are_told_and_nothing_is_asked_of_them(folder: Path, wired: Wire):
    """The CSV of a scene's plan beside the FMU of that scene, without a map.

    A map has no place for them either. What is no force is a position.
    """
    scene = load_scene("transport")
    q, v = (np.tile(part, (3, 1)) for part in np.split(np.array(scene.task.start), 2))
    write_csv(
        folder / "cargo.csv",
        Trajectory(t=np.arange(3.0), q=q, v=v, u=np.zeros((2, 1)), lam=np.ones((2, 3))),
        scene,
    )
    foreign, read = wire(
        read_package(build_fmu(scene)), PlanTable(folder / "cargo.csv"), None, None, "FMU"
    )
    assert [item.name for item in foreign.model.coordinates] == ["cargo", "cart"]
    assert read.lam.tolist() == [[1.0, 1.0]] * 2
    for model in (foreign.model, wired(BARE, "t,F,friction_belt\n0,1,0.5\n0.1,,\n")[0].model):
        assert not unsaid(model.notes[-1], "friction forces (friction_belt)")
    renamed(folder / "angle.fmu", {"body.pos": "friction_angle"})
    angle = wired(None, "t,friction_angle,drive.force\n0,0,0\n0.1,100,\n", "angle.fmu")[0].model
    assert [item.name for item in angle.coordinates] == ["friction_angle"]


def test_umlaut_may_be_written_as_one_sign_or_two(wired: Wire, folder: Path):
    composed, apart = "längs", "la\u0308ngs"
    renamed(folder / "apart.fmu", {"body.pos": apart})
    given = BARE.replace('"body.pos"', f'"{composed}"').replace("\nx =", f'\n"{apart}" =')
    assert wired(given, f"t,F,{composed}\n0,1,0\n1,1,0\n", "apart.fmu")[1].missing == {"v"}
    assert "two keys 'längs' look the same" in refusal(
        lambda: wired(f'[start]\n"{composed}" = 1\n"{apart}" = 2\n')
    )


def test_names_that_differ_in_case_alone_are_two(folder: Path, wired: Wire):
    more = '<ScalarVariable name="Body.Pos" valueReference="11"><Real/></ScalarVariable>\n'
    renamed(folder / "case.fmu", {}, more)
    given = BARE.replace(
        '"body.vel", scale = 0.001, unit = "m/s"', '"Body.Pos", scale = 0.001, unit = "m/s"'
    )
    assert wired(given, fmu="case.fmu", plan="t,F\n0,1\n1,\n")[0].variables.v == (11,)
    twice = '<ScalarVariable name="body.vel" valueReference="40"><Real/></ScalarVariable>\n'
    renamed(folder / "twice.fmu", {}, twice)
    assert "velocities.x: the FMU has two variables 'body.vel'" in refusal(
        lambda: wired(BARE, fmu="twice.fmu")
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (BARE.replace('"body.vel"', '"body.pos"'),
         "velocities.x: 'body.pos' is positions.x already"),
        (BARE.replace("[velocities]", 'y = "body.pos"\n[velocities]'),
         "positions.y: 'body.pos' is positions.x already"),
        (BARE.replace("\nx =", "\nF ="), "positions.F: … 'F' is that of inputs.F already; call"),
        (BARE.replace("\nF =", "\nt ="), "inputs.t: … 't' is that of the time (plan.time) already"),
        (BARE.replace('unit = "m/s"', 'unit = "m/s", column = "x"'),
         "velocities.x: … 'x' is that of positions.x already; give"),
        (FULL_MAP.replace("[start]", '[start]\n"drive.force" = 1'),
         "start.drive.force: 'drive.force' is inputs.F already"),
        (FULL_MAP.replace(
            "[start]", '[parameters]\n"body.mass" = 1\n[start]\n"body.mass" = 1'),
         "start.body.mass: 'body.mass' is parameters.body.mass already"),
        (BARE + '[contacts.stop]\nforce = "stop.push"\ncolumn = "F"\n',
         "contacts.stop: … 'F' is that of inputs.F already"),
        (BARE.replace("\nF =", "\nlam_stop =") + '[contacts.stop]\nforce = "stop.push"\n',
         "contacts.stop: … 'lam_stop' is that of inputs.lam_stop already"),
        (BARE + '[contacts.a]\nforce = "body.pos"\n',
         "contacts.a.force: 'body.pos' is positions.x already"),
        (BARE + '[contacts.a]\ngap = "body.vel"\n',
         "contacts.a.gap: 'body.vel' is velocities.x already"),
        (BARE + '[contacts.a]\nforce = "stop.push"\n[contacts.b]\ngap = "stop.push"\n',
         "contacts.b.gap: 'stop.push' is contacts.a.force already"),
        (BARE + '[contacts.a]\nforce = "stop.push"\n[contacts.b]\nforce = "stop.push"\n',
         "contacts.b.force: 'stop.push' is contacts.a.force already"),
    ],
)  # fmt: skip
def test_names_that_collide_are_one_sentence(wired: Wire, text: str, words: str):
    assert not unsaid(refusal(lambda: wired(text)), words)


def test_goal_of_a_position_is_not_that_of_a_velocity_that_nobody_named(folder: Path, wired: Wire):
    """The position v_x is not the velocity of x, which the map does not name."""
    given = '[inputs]\nF = "drive.force"\n[positions]\nx = "body.pos"\nv_x = "body.vel"\n[goal]\nv_x = 1\n[limits]\nreplay_terminal_position_error = 1\n'
    assert wired(given, "t,F,x,v_x\n0,0,0,0\n1,0,0,0\n")[0].model.task.goal == (
        None,
        1.0,
        None,
        None,
    )


def test_column_called_t_may_be_an_input_where_the_time_is_called_otherwise(wired: Wire):
    given = BARE.replace("\nF =", "\nt =") + "[plan]\ntime = 'time'\n"
    assert wired(given, "time,t\n0,4\n1,\n")[1].u.tolist() == [[4.0]]


def test_velocities_of_equal_names_belong_to_the_positions_they_are_derivatives_of(
    folder: Path, wired: Wire
):
    text = (
        '<ScalarVariable name="{0}" valueReference="{1}"><Real unit="{2}"{3}/></ScalarVariable>\n'
    )
    more = text.format("a", 31, "m", "") + text.format("b", 30, "rad", "")
    # The 11th and 10th variable of the cart: velocities in the other order than their positions.
    more += text.format("of_b", 12, "rad/s", ' derivative="11"') + text.format(
        "of_a", 13, "m/s", ' derivative="10"'
    )
    renamed(folder / "rates.fmu", {}, more)
    foreign, _ = wired(None, "t,a,b,of_b,of_a,drive.force\n0,0,0,0,0,0\n1,0,0,0,0,\n", "rates.fmu")
    assert [item.velocity_name for item in foreign.model.coordinates] == ["of_a", "of_b"]


@pytest.mark.slow
def test_hint_among_very_many_names_is_quick_and_right():
    """difflib alone takes 40 us a name of this length, 4 s of all.

    The bound is about five times what it takes.
    """
    known = [f"model.part[{index}].länge_{index % 7}" for index in range(100_000)] + [
        "body.pos",
        "body.vel",
    ]
    began = time.process_time()
    assert hint("body.poss", known) == " (near it: body.pos, body.vel)"
    assert re.fullmatch(
        r" \(near it: model\.part\[\d+\]\.länge_3, .*\)", hint("model.part[12345].lange_3", known)
    )
    assert time.process_time() - began < 3.0


def test_first_row_other_than_the_start_is_refused(folder: Path, wired: Wire):
    words = (
        "map: start: the plan begins with x = 0.1, but the FMU starts at 0; add 'body.pos' = 'x'"
    )
    assert words in refusal(lambda: wired(BARE, "t,x,F\n0,0.1,1\n1,1,1\n"))
    named = BARE + "[start]\n'body.pos' = 'x'\n"
    foreign, _ = wired(named, "t,x,F\n0,0.1,1\n1,1,1\n")
    assert foreign.start.tolist() == [100.0], "in the FMU's millimetres"


def test_first_row_rounded_from_the_start_is_no_mistake(wired: Wire):
    shifted = BARE.replace('scale = 0.001, unit = "m" }', "scale = 0.001, offset = 0.12345678 }")
    wired(shifted, "t,x,F\n0,0.1234568,1\n1,0.2000001,1\n")
    assert "the plan begins with x = 0.123457, but the FMU starts at 0.123457" in refusal(
        lambda: wired(shifted, "t,x,F\n0,0.1234569,1\n1,0.2000001,1\n")
    )
