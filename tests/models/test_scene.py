"""A scene checks itself when it is created: each mistake is one sentence that names the scene and the field; parameters that are made of the step."""

import re
from dataclasses import replace
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
import pytest
import sympy as sp
from wording import unsaid

from models.catalog import load_scene, scene_names
from models.errors import SceneError, UnknownNameError
from models.scene import Contact, Coordinate, Input, Limit, Parameter, Scene, Shape, Task
from models.scene.checks import check_expressions, step_problem
from models.scene.contacts import Friction
from models.scene.parts import goal_limits
from models.scene.values import as_number, base_exponents

x, vx, u = sp.symbols("x vx u", real=True)
m, k, w = sp.symbols("m k w", positive=True)


def part(kind: Any, /, **fields: Any) -> Any:
    """A part of a scene of fields that its types need not allow."""
    return kind(**fields)


def wall(**changes: Any) -> Contact:
    fields: dict = {
        "name": "wall", "bodies": ("mass", "wall"), "penetration": x - 1, "stiffness": k,
        "depth": 0.2, "depth_reason": "a spring",
    }  # fmt: skip
    return Contact(**(fields | changes))


def small_scene(**changes: object) -> Scene:
    fields: dict = {
        "name": "small", "title": "a mass before a wall", "source": "this test",
        "coordinates": (Coordinate(symbol=x, velocity=vx, unit="m"),),
        "inputs": (Input(symbol=u, unit="N"),),
        "parameters": (Parameter(symbol=m, value=1.0, unit="kg"),
                       Parameter(symbol=k, value=10.0, unit="N/m")),
        "kinetic_energy": m * vx**2 / 2, "potential_energy": sp.Integer(0), "forces": (u,),
        "contacts": (wall(),),
        "task": Task(start=(0.0, 0.0), goal=(0.5, 0.0), running_cost=u**2, step=0.01, steps=10),
        "limits": goal_limits(position=0.01, velocity=0.01, reason="this test"),
    }  # fmt: skip
    return Scene(**(fields | changes))


@pytest.mark.parametrize(
    ("unit", "advice"),
    [
        ("Nm", "did you mean 'N m'?"),
        ("kg*m/s**2", "did you mean 'kg m/s^2'?"),
        ("rad/s2", "did you mean 'rad/s^2'?"),
        ("m\u00b2", "did you mean 'm^2'?"),
        ("N\u00b7s/m", "did you mean 'N s/m'?"),
        ("deg", "convert the numbers from deg to rad."),
        ("kN/mm", "convert the numbers from kN to N."),
        ("rpm", "convert the numbers from rpm to rad/s."),
        ("km/h", "convert the numbers from km to m."),
        ("Pa s", "Pa is N/m^2."),
        ("furlong", "(with ^n, spaces and /)."),
    ],
)
def test_unit_in_another_spelling_is_answered_with_ours(unit: str, advice: str):
    with pytest.raises(ValueError, match=rf"{re.escape(advice)}\Z"):
        base_exponents(unit)


def test_friction_takes_a_list_of_contacts_as_a_tuple():
    found = Friction(name="f", slip=sp.Symbol("v"), coefficient=0.3, contact=["a", "b"])  # type: ignore[arg-type]
    assert found.pressing == ("a", "b")
    assert found.contact == ("a", "b")


def test_contact_bodies_are_shapes_or_fixed():
    """A scene that draws nothing may name its bodies as it likes."""
    box = Shape(name="mass", kind="disc", x=x, y=sp.Integer(0), size=(1,))
    assert small_scene(shapes=(box,)).contacts[0].bodies == ("mass", "wall")
    assert small_scene(contacts=(wall(bodies=["here", "there"]),)).contacts[0].bodies == (
        "here",
        "there",
    )


@pytest.mark.parametrize("given", [sp.pi / 3, sp.sqrt(2), sp.Rational(1, 3), np.float32(0.5)])
def test_a_number_may_be_one_of_sympy_or_numpy(given: Any):
    assert as_number("goal", given) == float(given)


def test_text_for_a_number_is_answered_with_quotes():
    with pytest.raises(SceneError, match="goal: '1' is text; write a number, without quotes"):
        as_number("goal", "1")


@pytest.mark.parametrize("given", [sp.oo, sp.nan, sp.zoo, sp.I, x, sp.pi * x, True, None])
def test_what_is_no_number_is_refused(given: Any):
    with pytest.raises(SceneError, match=r"goal: .* is not a finite number"):
        as_number("goal", given)


def test_a_depth_follows_the_parameters():
    scene = small_scene(
        contacts=(wall(depth=w / 4),),
        parameters=(*small_scene().parameters, Parameter(symbol=w, value=1.0, unit="m")),
    )
    assert scene.depths == (0.25,)
    assert scene.with_parameters(w=2.0).depths == (0.5,)


_NEAR = ("terminal_position_error", "replay_terminal_position_error")


@pytest.mark.parametrize(("goal", "limits", "missing"), [
    ((0.5, None), (), _NEAR), ((0.5, None), _NEAR[:1], _NEAR[1:]), ((0.5, None), _NEAR, ()),
    ((0.5, 0.0), _NEAR, ("terminal_velocity_error", "replay_terminal_velocity_error")),
    ((None, None), (), ()), ((), (), ()), (None, (), ()),
])  # fmt: skip
def test_limits_that_a_goal_needs_are_named(
    goal: Any, limits: tuple[str, ...], missing: tuple[str, ...]
):
    task = Task(start=(0.0, 0.0), goal=goal, running_cost=u**2, step=0.01, steps=10)
    given = tuple(Limit(metric=metric, value=0.01, reason="this test") for metric in limits)
    if not missing:
        made = small_scene(task=task, limits=given)
        assert (made.limits, len(made.task.goal)) == (given, 2)
        return
    with pytest.raises(SceneError) as caught:
        small_scene(task=task, limits=given)
    assert f"no limit says how near is near enough: {', '.join(missing)}; add " in str(caught.value)


def test_limits_of_a_goal_are_of_the_plan_and_its_replay():
    found = {
        limit.metric: limit.value
        for limit in goal_limits(position=0.02, velocity=0.1, reason="this test")
    }
    assert found == {
        "terminal_position_error": 0.02, "replay_terminal_position_error": 0.02,
        "terminal_velocity_error": 0.1,
        "replay_terminal_velocity_error": 0.1,
    }  # fmt: skip
    assert goal_limits(reason="nothing is asked") == ()


def test_a_metric_has_one_limit():
    """Two that agree are one too many as well: nobody can tell which is meant."""
    one = Limit(metric="replay_error", value=1e-3, reason="a test")
    for other in (
        Limit(metric="replay_error", value=1.0, reason="a test"),
        Limit(metric="replay_error", value=None, reason="a test"),
        one,
    ):
        with pytest.raises(
            SceneError, match="there are 2 limits on replay_error; leave one of them"
        ):
            small_scene(limits=(*small_scene().limits, one, other))


def test_a_limit_is_waived_with_a_reason():
    waived = Limit(metric="defect", value=None, reason="its step is not ours")
    assert small_scene(limits=(*small_scene().limits, waived)).limit("defect") is waived
    assert small_scene().limit("defect") is None, "then the default holds"


def test_units_reduce_to_base_units():
    assert base_exponents("N s/m") == {"kg": 1, "s": -1}
    assert base_exponents("J") == {"kg": 1, "m": 2, "s": -2}
    assert base_exponents("m/s^2") == {"m": 1, "s": -2}
    assert base_exponents("1") == {}


def test_other_parameter_values():
    assert small_scene().with_parameters(k=300.0).parameter_values[k] == 300.0
    with pytest.raises(SceneError, match="no parameter 'kk'"):
        small_scene().with_parameters(kk=1.0)


def test_catalog_lists_all_scenes():
    assert "three_cart" in scene_names()
    with pytest.raises(UnknownNameError, match="did you mean three_cart"):
        load_scene("three_carts")


@pytest.mark.parametrize("assumption", ["positive", "integer", "nonnegative"])
def test_a_quantity_that_moves_may_have_any_value(assumption: str):
    """SymPy makes Abs(q) of a positive q to q, and sin(pi*q) of an integer q to 0: equations that are silently other ones."""
    narrow = sp.Symbol("x", **{assumption: True})
    for make in (
        lambda: part(Coordinate, symbol=narrow, velocity=vx, unit="m"),
        lambda: part(Coordinate, symbol=vx, velocity=narrow, unit="m"),
        lambda: part(Input, symbol=narrow, unit="N"),
    ):
        with pytest.raises(SceneError, match=f"takes x to be {assumption}"):
            make()


def test_plain_numbers_are_expressions_and_numbers_of_other_libraries_are_floats():
    task = part(
        Task,
        start=np.array([0, 0]),
        goal=(sp.Rational(1, 2), np.float32(0)),
        running_cost=0,
        step=np.float32(0.5),
        steps=1,
    )
    scene = small_scene(potential_energy=0, forces=[0.0], contacts=[wall(stiffness=30)], task=task)
    assert scene.potential_energy is sp.S.Zero
    assert scene.forces[0] is sp.S.Zero, "a force that is not there is left out of every model"
    assert scene.contacts[0].stiffness == sp.Integer(30)
    assert (task.start, task.goal, task.step) == ((0.0, 0.0), (0.5, 0.0), 0.5)
    assert all(type(value) is float for value in (*task.start, *task.goal, task.step))


def test_expressions_stay_exact():
    third = sp.Rational(1, 3)
    scene = small_scene(
        potential_energy=third, contacts=(wall(penetration=x - third, stiffness=third),)
    )
    assert (scene.potential_energy, scene.contacts[0].stiffness) == (third, third)


@pytest.mark.parametrize(
    "force",
    [sp.gamma(x + 2), sp.sin(sp.LambertW(x + 2)), sp.Function("f")(vx), sp.erf(x), sp.sec(x),
     sp.sinc(x), sp.SingularityFunction(x, 1, 2), sp.Sum(x**k, (k, 0, 3)),
     sp.Integral(sp.cos(k**5 + x), (k, 0, 1))],
    ids=str,
)  # fmt: skip
def test_function_outside_the_list_is_named_with_its_field(force: sp.Expr):
    with pytest.raises(
        SceneError, match=r"small: forces\[x\] contains .*, which a scene cannot use; write it with"
    ):
        check_expressions(small_scene(forces=(force,)))
    with pytest.raises(SceneError, match=r"task.final_cost contains .*, which a scene cannot use"):
        check_expressions(small_scene(task=replace(small_scene().task, final_cost=force)))


@pytest.mark.parametrize(
    "number", [sp.Float("2e-400"), sp.Integer(10) ** 400], ids=["tiny", "huge"]
)
def test_number_that_no_double_holds_is_named(number: sp.Expr):
    with pytest.raises(SceneError, match=r"potential_energy contains \d.*, which no double holds"):
        check_expressions(small_scene(potential_energy=k * number * x**2))


NOT_SMOOTH = {
    "Abs": (sp.Abs(x), "sqrt(x^2 + r^2) for Abs(x)"),
    "Max": (sp.Max(x, 1), "(x + y + sqrt((x - y)^2 + r^2))/2 for Max(x, y)"),
    "Min": (sp.Min(x, 1), "(x + y - sqrt((x - y)^2 + r^2))/2 for Min(x, y)"),
    "sign": (sp.sign(x), "tanh(x/r) for sign(x)"),
    "Heaviside": (sp.Heaviside(x), "tanh(x/r)"),
    "Piecewise": (sp.Piecewise((x, x > 0), (0, True)), "tanh(x/r)"),
    "floor": (sp.floor(x), "x for floor(x)"),
    "ceiling": (sp.ceiling(x), "x for ceiling(x)"),
    "Mod": (sp.Mod(x, 2), "a sine of the same period"),
}  # fmt: skip


@pytest.mark.parametrize("name", NOT_SMOOTH)
def test_a_corner_is_said_once(name: str):
    """Wherever plans need derivatives, and how it is rounded off.

    A depth is a number, and may be a smallest one.
    """
    bent, advice = NOT_SMOOTH[name]
    task, rubbing = small_scene().task, Friction(name="f", slip=vx, coefficient=1, contact="wall")
    for field, changes in {
        "kinetic_energy": {"kinetic_energy": m * vx**2 * (9 + bent)},
        "potential_energy": {"potential_energy": k * bent**3},
        "forces[x]": {"forces": (u - k * bent,)},
        "friction f: slip": {"frictions": (replace(rubbing, slip=vx * (2 + bent)),)},
        "friction f: normal_force": {
            "frictions": (replace(rubbing, contact=None, normal_force=k * bent),)
        },
        "task.running_cost": {"task": replace(task, running_cost=u**2 + bent)},
        "task.final_cost": {"task": replace(task, final_cost=bent)},
    }.items():
        with pytest.raises(SceneError) as caught:
            check_expressions(small_scene(**changes))
        text = str(caught.value)
        assert text.startswith(f"scene small: {field} contains {name}("), text
        assert not unsaid(text, "not differentiable … round it off: ")
        assert not unsaid(text, advice)


@pytest.mark.parametrize("field", ["stiffness", "damping"])
def test_a_corner_of_parameters_is_a_parameter(field: str):
    wall = replace(small_scene().contacts[0], **{field: sp.Max(k, 2 * m)})
    with pytest.raises(
        SceneError,
        match=rf"contact wall: {field} contains Max\(k, 2\*m\), .* make it a parameter of its value",
    ):
        check_expressions(small_scene(contacts=(wall,)))


def test_a_plan_must_fit_into_memory():
    """Five numbers a step: time, position, velocity, input, contact force."""
    scene = small_scene()
    each = 1 + 2 * scene.nq + scene.nu + scene.nl
    assert scene.with_task(steps=10**9 // each).task.steps == 10**9 // each
    with pytest.raises(SceneError, match=r"task.steps is 1000000000000: .* at most"):
        scene.with_task(steps=10**12)


SCENES = Path(__file__).parents[1] / "scenes"

REFUSED = {
    "a product": "STEP = 0.02\nParameter(symbol=m, value=STEP * 10.0, unit='kg')\nTask(step=STEP)",
    "of a tuple": "STEP, STEPS = 0.02, 10\nParameter(symbol=m, value=10.0 * STEP)\nTask(step=STEP, steps=STEPS)",
    "another name of it": "H = 0.02\nSTEP = H\nParameter(symbol=m, value=10.0 / H)\nTask(step=STEP)",
    "over names": "STEP = 0.02\nLAG = STEP / 2\nMASS = [LAG * 10.0]\nParameter(symbol=m, value=MASS[0])\nTask(step=STEP)",
    "by a function": "STEP = 0.02\ndef mass(d):\n    h = STEP\n    return h * d\nParameter(symbol=m, value=mass(10.0))\nTask(step=STEP)",
    "as an argument": "STEP = 0.02\nParameter(symbol=m, value=max(STEP, 1.0))\nTask(step=STEP)",
    "of a table": "STEP = 0.02\nTABLE = (('m', STEP * 10.0), ('k', 3.0))\nP = [Parameter(symbol=s, value=x) for s, x in TABLE]\nTask(step=STEP)",
    "in a factory": "def make(step, drag):\n    mass = step * drag\n    return Scene(parameters=(Parameter(symbol=m, value=mass),), task=Task(step=step))",
    "by an operator": "STEP = 0.02\nMASS = 10.0\nMASS *= STEP\nParameter(symbol=m, value=MASS)\nTask(step=STEP)",
    "of a module": "import grid\nParameter(symbol=m, value=grid.STEP * 10.0)\nTask(step=grid.STEP)",
    "unnamed": "T, N = 2.0, 100\nParameter(symbol=m, value=10.0 * (T / N))\nTask(step=T / N, steps=N)",
    "afterwards": "STEP = 0.02\nSCENE = load_scene('three_cart').with_parameters(m=STEP * 10.0).with_task(step=STEP)",
    "by a walrus": "STEP = 0.02\nprint(MASS := STEP * 10.0)\nParameter(symbol=m, value=MASS)\nTask(step=STEP)",
    "of a class": "class Grid:\n    h = 0.02\nParameter(symbol=m, value=Grid.h * 10.0)\nTask(step=Grid.h)",
}
ACCEPTED = {
    "numbers that happen to fit": "Parameter(symbol=m, value=0.02)\nParameter(symbol=c, value=2.0)\nTask(step=0.01)",
    "a step that follows the physics": "MASS, K = 1.0, 100.0\nSTEP = 0.1 * (MASS / K) ** 0.5\nParameter(symbol=m, value=MASS)\nTask(step=STEP)",
    "the duration": "T, N = 4.0, 200\nSTEP = T / N\nParameter(symbol=speed, value=1.0 / T)\nParameter(symbol=n, value=N)\nTask(step=STEP, steps=N)",
    "another thing of that name": "step = 0.02\ndef mean(n):\n    step = 1.0 / n\n    return step / 2\nParameter(symbol=m, value=mean(9))\nTask(step=step)",
    "another argument of that name": "def mean(step):\n    return step / 2\nstep = 0.02\nParameter(symbol=m, value=mean(9))\nTask(step=step)",
    "a comprehension's own name": "h = 0.02\nParameter(symbol=m, value=sum(h for h in (1.0, 2.0)))\nTask(step=h)",
    "answers and limits": "STEP = 0.02\nAnswer(value=STEP * 3)\nLimit(value=STEP)\nParameter(symbol=m, value=1.0)\nTask(step=STEP)",
    "a range": "STEP = 0.02\nParameter(symbol=m, value=1.0, lower=STEP)\nTask(step=STEP)",
    "no task": "STEP = 0.02\nParameter(symbol=m, value=STEP)",
    "nothing": "",
    "a sum of thousands": f"STEP = 0.02\nX = {' + '.join(['1.0'] * 5000)}\nParameter(symbol=m, value=X)\nTask(step=STEP)",
}


@pytest.mark.parametrize("kind", REFUSED)
def test_parameters_made_of_the_step_are_found(kind: str):
    text = REFUSED[kind]
    problem = step_problem(text)
    assert problem is not None
    line, words = problem
    assert (
        "value=" in text.splitlines()[line - 1] or "with_parameters" in text.splitlines()[line - 1]
    )
    assert f"the value of parameter {'s' if kind == 'of a table' else 'm'}, " in words
    assert "relaxation_time * damping" in words
    assert "\n" not in words


@pytest.mark.parametrize("kind", ACCEPTED)
def test_parameters_independent_of_the_step_are_accepted(kind: str):
    assert step_problem(ACCEPTED[kind]) is None


@pytest.mark.slow
def test_the_line_and_the_scene_are_named(tmp_path: Path):
    text = (SCENES / "two_link_arm.py").read_text().replace('"two_link_arm"', '"own"')
    path = tmp_path / "own.py"
    path.write_text(
        text.replace("q1, q2 =", "STEP = 0.01\nq1, q2 =", 1).replace("step=0.01", "step=STEP")
    )
    assert load_scene(str(path)).task.step == 0.01
    path.write_text(path.read_text().replace("value=0.8", "value=80 * STEP"))
    line = (
        path.read_text()
        .splitlines()
        .index(next(line for line in path.read_text().splitlines() if "80 * STEP" in line))
        + 1
    )
    with pytest.raises(SceneError) as caught:
        load_scene(str(path))
    assert not unsaid(caught.value, f"{path}, line {line}: scene own: … parameter m2, 80 * STEP")


def test_a_long_file_is_read_at_once():
    text = "\n".join(
        [
            "A0 = 1.0",
            *(f"A{number} = A{number - 1} * 2.0" for number in range(1, 2000)),
            "STEP = A1999",
            "Task(step=STEP)",
        ]
    )
    began = process_time()
    assert step_problem(f"{text}\nParameter(symbol=m, value=A1999)") is not None
    assert step_problem(f"{text}\nParameter(symbol=m, value=A1998)") is None
    assert process_time() - began < 5.0


@pytest.mark.parametrize(
    ("given", "advice"),
    [
        ("own", "did you mean own.py?"),
        ("plan.csv", "this is a plan, which stands before --scene"),
        ("robot.fmu", "this is an FMU, which --fmu takes"),
        ("robot.xml", "`fmu --mjcf` takes"),
    ],
)
def test_what_is_no_scene_file_is_answered_with_its_place(
    given: str, advice: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.py").touch()
    with pytest.raises(UnknownNameError) as caught:
        load_scene(given)
    assert not unsaid(caught.value, f"there is no scene {given!r}", advice)


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("t", "the time in a plan"),
        ("h", "the time step in the equations of a report"),
        ("short", "a word of C"),
        ("lambda", "a word of Python"),
    ],
)
def test_scene_reserved_name_has_its_reason(name: str, reason: str):
    push = sp.Symbol(name, real=True)
    with pytest.raises(SceneError, match=rf"'{name}' is reserved: it is {reason}; choose"):
        small_scene(inputs=(Input(symbol=push, unit="N"),), forces=(push,))
