"""A scene file of one's own with one mistake: one sentence that names the file and the field, and exit code 2."""

from pathlib import Path

import pytest
from wording import unsaid

from models.catalog import load_scene
from models.errors import SceneError
from validate.cli.group import run

SOUND = '''"""A mass before a wall, rubbing along it."""
import sympy as sp
from models.scene.contacts import Friction
from models.scene import Contact, Coordinate, Input, Limit, Parameter, Scene, Shape, Task
from models.scene.parts import goal_limits
x, vx, y, vy, u = sp.symbols("x vx y vy u", real=True)
m, k, mu = sp.symbols("m k mu", positive=True)
SCENE = Scene(
    name="own",
    title="a mass before a wall",
    source="this test",
    coordinates=(Coordinate(symbol=x, velocity=vx, unit="m"), Coordinate(symbol=y, velocity=vy, unit="m")),
    inputs=(Input(symbol=u, unit="N", lower=-1.0, upper=1.0),),
    parameters=(
        Parameter(symbol=m, value=1.0, unit="kg"), Parameter(symbol=k, value=10.0, unit="N/m"), Parameter(symbol=mu, value=0.5, unit="1")
    ),
    kinetic_energy=m * (vx**2 + vy**2) / 2,
    potential_energy=sp.Integer(0),
    forces=(u, sp.Integer(0)),
    contacts=(Contact(name="wall", bodies=("mass", "wall"), penetration=x - 1, stiffness=k, depth=0.2, depth_reason="a spring"),),
    frictions=(Friction(name="wall", slip=vy, coefficient=mu, contact="wall"),),
    task=Task(start=(0.0, 0.0, 0.0, 0.0), goal=(0.5, None, 0.0, None), running_cost=u**2, step=0.01, steps=10),
    limits=(Limit(metric="defect", value=1e-6, reason="tolerance"), *goal_limits(position=0.01, velocity=0.02, reason="near")),
    shapes=(Shape(name="mass", kind="disc", x=x, y=y, size=(0.1,)),),
)
'''
ENERGY = "kinetic_energy=m * (vx**2 + vy**2) / 2"
CONTACT = 'contacts=(Contact(name="wall", bodies=("mass", "wall"), penetration=x - 1, stiffness=k, depth=0.2, depth_reason="a spring"),)'
GOAL = "goal=(0.5, None, 0.0, None)"
# what is wrong: (the text of the sound file, what stands there instead, words of the sentence)
MISTAKES = {
    "a definition by itself": (
        "m, k, mu = sp",
        "from own import m\nm, k, mu = sp",
        ["ImportError", "line 7", "circular import"],
    ),
    "an energy of the scene itself": (
        "potential_energy=sp.Integer(0)",
        "potential_energy=SCENE.kinetic_energy",
        ["SCENE", "not defined"],
    ),
    "a word that nobody defined": (
        "forces=(u,",
        "forces=(u - drag * vx,",
        ["NameError", "'drag' is not defined", "drag = sp.Symbol('drag', real=True)"],
    ),
    "a name that models.scene does not have": (
        "import Contact, Coord",
        "import Contacts, Coord",
        ["models.scene has no Contacts; did you mean Contact?"],
    ),
    "parts from a module that is not there": (
        "from models.scene import Contact",
        "from models.scenery import Contact",
        ["No module named", "imported from models.scene"],
    ),
    "a function of NumPy": (
        "potential_energy=sp.Integer(0)",
        "potential_energy=__import__('numpy').cos(x)",
        ["use SymPy's function", "not NumPy's"],
    ),
    "a function of math": (
        "potential_energy=sp.Integer(0)",
        "potential_energy=__import__('math').exp(x)",
        ["use SymPy's function", "not that of math"],
    ),
    "an if on a symbol": (
        "potential_energy=sp.Integer(0)",
        "potential_energy=0 if x > 1 else m",
        ["cannot ask for a symbol's value"],
    ),
    "an argument that goal_limits does not have": (
        "goal_limits(position=0.01",
        "goal_limits(positions=0.01",
        ["goal_limits: there is no argument 'positions'; did you mean position?"],
    ),
    "goal limits without a reason": (
        ', reason="near")',
        ")",
        ["goal_limits: missing", "'reason'", "it takes position, velocity, reason"],
    ),
    "a number in quotes": ("value=10.0", 'value="10.0"', ["'10.0' is text; write a number"]),
    "bounds of a position": (
        'Coordinate(symbol=y, velocity=vy, unit="m")',
        'Coordinate(symbol=y, velocity=vy, unit="m", upper=2.0)',
        ["coordinate y", "no field 'upper'; a position has no bounds: write a Contact"],
    ),
    "a gap for a penetration": (
        "penetration=x - 1, stiffness",
        "gap=1 - x, stiffness",
        ["contact wall", "penetration=-gap"],
    ),
    "a horizon for steps": ("steps=10", "horizon=0.1", ["steps * step seconds"]),
    "a name for a parameter": (
        "Parameter(symbol=k, ",
        'Parameter(name="k", symbol=k, ',
        ["parameter k", "its name is that of its symbol"],
    ),
    "one part without its comma": (
        'inputs=(Input(symbol=u, unit="N", lower=-1.0, upper=1.0),)',
        'inputs=(Input(symbol=u, unit="N", lower=-1.0, upper=1.0))',
        ["inputs must be a tuple, not Input; write inputs=(Input(..),), with a comma"],
    ),
    "one force without its comma": (
        "forces=(u, sp.Integer(0))",
        "forces=(u)",
        ["forces must be a tuple, not Symbol; write forces=(u,)"],
    ),
    "none for no shapes": (
        'shapes=(Shape(name="mass", kind="disc", x=x, y=y, size=(0.1,)),)',
        "shapes=None",
        ["shapes=() for none"],
    ),
    "a symbol that is like a declared one": (
        "forces=(u, sp.Integer(0))",
        'forces=(u, sp.Symbol("muu", positive=True) * 1)',
        ["uses muu", "did you mean mu, or is a Parameter missing?"],
    ),
    "a symbol that nobody declared": (
        "forces=(u, sp.Integer(0))",
        'forces=(u, sp.Symbol("wind", real=True))',
        ["uses wind", "declare it as a Parameter."],
    ),
    "a friction pressed by a number": (
        'coefficient=mu, contact="wall"',
        "coefficient=mu, contact=2",
        ["friction wall", "a name, or a tuple of names", "2 is not an identifier"],
    ),
    "a friction pressed by a list that holds no name": (
        'coefficient=mu, contact="wall"',
        'coefficient=mu, contact=["wall", None]',
        ["friction wall", "None is not an identifier"],
    ),
    "a mass of another sign": (
        'symbol=m, value=1.0, unit="kg"',
        'symbol=m, value=-0.25, unit="kg"',
        ["at x, is -0.25", "check the masses"],
    ),
    "two contacts of one name": (
        "contacts=(",
        'contacts=(Contact(name="wall", bodies=("mass", "wall"), penetration=-x - 1, stiffness=k, depth=0.2, depth_reason="a spring"), ',
        ["2 contacts are named 'wall'", "a name of its own"],
    ),
    "two frictions of one name": (
        "frictions=(",
        'frictions=(Friction(name="wall", slip=vy, coefficient=mu, contact="wall"), ',
        ["2 frictions are named 'wall'", "a name of its own"],
    ),
    "an asymmetric mass matrix": (
        ENERGY,
        "kinetic_energy=sp.Matrix([[vx, vy]]) * sp.Matrix([[m, 1], [0, m]]) * sp.Matrix([vx, vy])",
        ["kinetic_energy", "not MutableDenseMatrix"],
    ),
    "a mass matrix that is not definite": (
        ENERGY,
        f"{ENERGY} + 3 * vx * vy",
        ["mass matrix", "not positive definite", "at y"],
    ),
    "an energy linear in a velocity": (
        ENERGY,
        f"{ENERGY} + vx",
        ["kinetic_energy contains vx", "not quadratic"],
    ),
    "a symbol that Python does not know": (
        "forces=(u,",
        "forces=(u - c * vx,",
        ["line 19", "'c' is not defined"],
    ),
    "a symbol that the scene does not know": (
        "forces=(u,",
        "forces=(u - sp.Symbol('c') * vx,",
        ["forces[x] uses c", "neither a parameter"],
    ),
    "a stiffness of an unknown symbol": (
        "stiffness=k",
        "stiffness=sp.Symbol('kk')",
        ["contact wall: stiffness uses kk"],
    ),
    "a gap without a slope at the start": (
        "x - 1,",
        "1 - sp.sqrt(x**2 + y**2),",
        ["contact wall", "not differentiable at the start"],
    ),
    "a damping of an unknown symbol": (
        "stiffness=k,",
        "stiffness=k, damping=sp.Symbol('c'),",
        ["contact wall: damping uses c", "neither a parameter nor"],
    ),
    "a damping in text": (
        "stiffness=k,",
        "stiffness=k, damping='soft',",
        ["contact wall: damping", "SymPy expression or a number, not str"],
    ),
    "a gap of a velocity": ("x - 1,", "x + vx - 1,", ["contact wall: penetration uses vx"]),
    "friction of a contact that is not there": (
        CONTACT,
        "contacts=()",
        ["friction wall", "no contact 'wall'", "it has no contacts"],
    ),
    "friction that nothing presses": (
        'coefficient=mu, contact="wall"',
        "coefficient=mu",
        ["friction wall", "there is neither"],
    ),
    "a slip of positions": ("slip=vy", "slip=y", ["friction wall", "not linear in the velocities"]),
    "a slip squared": ("slip=vy", "slip=vy**2", ["friction wall", "not linear in the velocities"]),
    "a negative coefficient of friction": (
        "symbol=mu, value=0.5",
        "symbol=mu, value=-0.5",
        ["friction wall", "coefficient"],
    ),
    "a mass of zero": (
        "symbol=m, value=1.0",
        "symbol=m, value=0.0",
        ["not positive definite", "at x"],
    ),
    "a mass in words": ("symbol=m, value=1.0", "symbol=m, value='1 kg'", ["parameter m", "'1 kg'"]),
    "no horizon": ("steps=10", "steps=0", ["task: steps", "at least 1"]),
    "a time step backwards": ("step=0.01", "step=-0.01", ["task: step", "positive"]),
    "a goal by name": (GOAL, "goal='upright'", ["task: goal", "'upright'"]),
    "a goal of too few numbers": (GOAL, "goal=(0.5, 0.0)", ["task.goal has 2", "4 are needed"]),
    "a goal of NaN": (GOAL, "goal=(float('nan'), None, 0.0, None)", ["task: goal[0]", "nan"]),
    "a free start": ("start=(0.0, 0.0,", "start=(0.0, None,", ["task: start[1]", "None"]),
    "bounds the wrong way round": (
        "lower=-1.0, upper=1.0",
        "lower=1.0, upper=-1.0",
        ["input u", "[1, -1]", "empty"],
    ),
    "a value outside its range": (
        "symbol=m, value=1.0",
        "symbol=m, value=1.0, lower=2.0",
        ["parameter m", "outside its range"],
    ),
    "a unit that is none": ('unit="kg"', 'unit="kilo"', ["parameter m", "'kilo'"]),
    "a field that is none": (
        'title="a',
        'titel="", title="a',
        ["scene own: there is no field 'titel'; did you mean title?"],
    ),
    "a field that is missing": ('    source="this test",\n', "", ["scene own: source is missing."]),
    "no contacts": (
        f"{CONTACT},\n",
        "",
        ["scene own: contacts is missing; contacts=() if there are none."],
    ),
    "no goal": (
        f"{GOAL}, ",
        "",
        ["task: goal is missing; goal=() if any end will do."],
    ),
    "a field without its name": (
        "Task(start=",
        "Task(",
        ["Task: (0.0, 0.0, 0.0, 0.0) has no name; write Task(start=..)."],
    ),
    "a limit of the goal misspelt": (
        '*goal_limits(position=0.01, velocity=0.02, reason="near")',
        'Limit(metric="terminal_position_eror", value=1.0, reason="near")',
        ["limit on 'terminal_position_eror': did you mean 'terminal_position_error'?"],
    ),
    "a field twice": ('title="a', 'source="", title="a', ["SyntaxError", "source"]),
    "an error of syntax": ("forces=(u,", "forces=(u,,", ["SyntaxError", "line 19"]),
    "an error of indentation": (
        "SCENE = Scene(",
        "  SCENE = Scene(",
        ["IndentationError", "line 8"],
    ),
    "a module that is not there": (
        "import sympy as sp",
        "import sympy as sp\nimport no_such_module",
        ["no_such_module", "line 3"],
    ),
    "a name that a module has not": (
        "import Friction",
        "import Frictions",
        ["Frictions", "line 3"],
    ),
    "a scene of another name": (
        "SCENE = Scene(",
        "SCENES = Scene(",
        ["must define SCENE", "there is none"],
    ),
    "a function instead of a scene": (
        "SCENE = Scene(",
        "def SCENE():\n  return Scene(",
        ["must define SCENE", "found function"],
    ),
    "a function that returns something else": (
        "SCENE = Scene(",
        "SCENE = (lambda: 3)()\nOTHER = Scene(",
        ["found int"],
    ),
    "another name than the file's": ('name="own"', 'name="other"', ["'other'", "'own'"]),
    "a title that is a number": ('title="a mass before a wall"', "title=3", ["title", "3"]),
    "a title of nothing": ('title="a mass before a wall"', 'title=" "', ["title", "words"]),
    "a source of nothing": ('source="this test"', "source=None", ["source", "None"]),
    "quick in words": (
        'name="own",',
        'name="own", quick="no",',
        ["quick", "True or False", "'no'"],
    ),
    "quick as a number": ('name="own",', 'name="own", quick=1,', ["quick", "True or False"]),
    "a limit without a reason": (
        'reason="tolerance"',
        "reason=None",
        ["limit on defect: reason", "None"],
    ),
    "a limit on a number": ('metric="defect"', "metric=3", ["limit: metric", "3"]),
    "a limit waived without a reason": (
        'value=1e-6, reason="tolerance"',
        'value=None, reason=""',
        ["limit on defect: reason", "words"],
    ),
    "a contact without bodies and depth": (
        'bodies=("mass", "wall"), penetration=x - 1, stiffness=k, depth=0.2, depth_reason="a spring"',
        "penetration=x - 1, stiffness=k",
        [
            "contact wall: bodies, depth, depth_reason must be given",
            'bodies=("cart", "wall"), depth=0.1, depth_reason="the length of the spring".',
        ],
    ),
    "a contact without a depth": ("depth=0.2, ", "", ["contact wall: depth must be given"]),
    "a depth without a reason": (
        ', depth_reason="a spring"',
        "",
        ["contact wall: depth_reason must be given"],
    ),
    "a contact of no bodies": (
        'bodies=("mass", "wall"), ',
        "",
        ["contact wall: bodies must be given"],
    ),
    "a contact of an unknown body": (
        '("mass", "wall")',
        '("mess", "wall")',
        ["contact wall: bodies names 'mess'", "no shape of the scene (mass)"],
    ),
    "a contact of one body": (
        'bodies=("mass", "wall")',
        'bodies=("mass", "mass")',
        ["contact wall: bodies must be the names of two different bodies"],
    ),
    "a depth below zero": (
        "depth=0.2",
        "depth=-k",
        ["contact wall: depth is -10 m, but must be positive"],
    ),
    "a depth of an unknown symbol": (
        "depth=0.2",
        "depth=sp.Symbol('s')",
        ["contact wall: depth uses s", "neither a parameter"],
    ),
    "a depth of a coordinate": ("depth=0.2", "depth=x", ["contact wall: depth uses x"]),
    "a cost of an unknown": (
        "running_cost=u**2",
        "running_cost=u**2 + sp.Symbol('w')",
        ["running_cost uses w"],
    ),
    "a cost that is a condition": (
        "running_cost=u**2",
        "running_cost=u > 1",
        ["running_cost", "StrictGreaterThan"],
    ),
    "a cost without end at the start": (
        "running_cost=u**2",
        "running_cost=sp.log(x)",
        ["task.running_cost", "at the start", "finite"],
    ),
    "a force without end at the start": (
        "forces=(u,",
        "forces=(u + 1 / x,",
        ["forces[x]", "zoo at the start"],
    ),
    "a force that is no number at the start": (
        "forces=(u,",
        "forces=(u / x,",
        ["forces[x]", "nan at the start"],
    ),
    "a force that is not real at the start": (
        "forces=(u,",
        "forces=(sp.sqrt(x - 1),",
        ["forces[x]", "real"],
    ),
    "a potential of a velocity": (
        "potential_energy=sp.Integer(0)",
        "potential_energy=vx",
        ["potential_energy uses vx"],
    ),
    "a symbol of two assumptions": (
        "forces=(u,",
        "forces=(sp.Symbol('u'),",
        ["forces[x]", "other assumptions"],
    ),
    "one symbol for two coordinates": (
        "symbol=y, velocity=vy",
        "symbol=x, velocity=vx",
        ["'x'", "2 times"],
    ),
    "a contact with a blank in its name": (
        'name="wall", bodies',
        'name="the wall", bodies',
        ["'the wall'", "identifier"],
    ),
    "a contact without a size": (
        "stiffness=k,",
        "stiffness=k, nominal=0.0,",
        ["contact wall: nominal", "positive"],
    ),
    "a damping that drives": (
        "stiffness=k,",
        "stiffness=k, damping=-1.0,",
        ["contact wall: the damping", "negative"],
    ),
    "a damping law in words": (
        "stiffness=k,",
        "stiffness=k, damping_law='kelvin',",
        ["contact wall: damping_law", "'kelvin'"],
    ),
    "a shape that nobody draws": ('kind="disc"', "kind=['disc']", ["shape mass", "box"]),
    "a file that ends the program": (
        "import sympy as sp",
        "import sympy as sp, sys\nsys.exit(0)",
        ["SystemExit", "line 3"],
    ),
    "a function that calls itself": (
        "SCENE =",
        "def f(n):\n  return f(n + 1)\nf(0)\nSCENE =",
        ["RecursionError"],
    ),
    "a force of a function that is not smooth C": (
        "forces=(u,",
        "forces=(u * sp.gamma(x + 2),",
        ["forces[x] contains gamma(x + 2)", "write it with", "sqrt"],
    ),
    "a start of too few numbers": (
        "start=(0.0, 0.0, 0.0, 0.0)",
        "start=(0.0,)",
        ["task.start", "1 numbers", "4 are needed"],
    ),
    "forces too many": (
        "forces=(u, sp.Integer(0))",
        "forces=(u, u, u)",
        ["forces", "3 entries", "2 coordinates"],
    ),
    "forces in text": (
        "forces=(u,",
        "forces=('u',",
        ["forces[0]", "SymPy expression or a number", "str"],
    ),
    "no force": ("forces=(u,", "forces=(None,", ["forces[0]", "NoneType"]),
    "an imaginary force": (
        "forces=(u,",
        "forces=(sp.Mul(sp.I, u),",
        ["forces[0]", "not a finite real"],
    ),
    "forces that are no tuple": (
        "forces=(u, sp.Integer(0))",
        "forces=u",
        ["forces must be a tuple"],
    ),
    "an energy in text": (ENERGY, "kinetic_energy='m*vx**2/2'", ["kinetic_energy", "str"]),
    "a potential of NaN": (
        "potential_energy=sp.Integer(0)",
        "potential_energy=float('nan')",
        ["potential_energy", "nan"],
    ),
    "a parameter that is a symbol": (
        'Parameter(symbol=m, value=1.0, unit="kg")',
        "m",
        ["parameters[0] must be a Parameter", "Symbol"],
    ),
    "contacts that are no tuple": (
        'depth_reason="a spring"),)',
        'depth_reason="a spring"))',
        ["contacts must be a tuple"],
    ),
    "a task that is none": ("task=Task(", "task={} and Task(", ["task must be a Task", "dict"]),
    "a stiffness below zero": (
        "symbol=k, value=10.0",
        "symbol=k, value=-1.0",
        ["wall", "stiffness"],
    ),
    "a gap with a corner": ("x - 1,", "sp.Max(x, 0) - 1,", ["wall", "Max", "a contact of its own"]),
    "a gap of no coordinate": ("x - 1,", "sp.Integer(1) * m,", ["wall", "no coordinate"]),
    "no coordinates": (
        "coordinates=(Coordinate",
        "coordinates=() and (Coordinate",
        ["no coordinates"],
    ),
    "a name of two words": ('name="own"', 'name="two words"', ["two words", "identifier"]),
    **{
        f"a unit of {unit!r}": ('unit="kg"', f"unit={unit!r}", ["parameter m", "unit"])
        for unit in ("", None, "N/", "m^x")
    },
    "a bound in text": ("lower=-1.0", "lower='-1'", ["input u", "lower", "'-1'"]),
    "a bound of NaN": ("upper=1.0", "upper=float('nan')", ["input u", "upper", "nan"]),
    "a range in text": (
        "symbol=m, value=1.0",
        "symbol=m, value=1.0, lower='0'",
        ["parameter m", "lower"],
    ),
    "no start": ("start=(0.0, 0.0, 0.0, 0.0)", "start=None", ["task: start", "None"]),
    "a start in text": ("start=(0.0, 0.0, 0.0, 0.0)", "start='0000'", ["task: start", "'0000'"]),
    "a time step of NaN": ("step=0.01", "step=float('nan')", ["task: step", "nan"]),
    "half a step": ("steps=10", "steps=2.5", ["task: steps", "2.5"]),
    "a cost in text": ("running_cost=u**2", "running_cost='u**2'", ["running_cost", "str"]),
    "a limit below 0": ("value=1e-6", "value=-1.0", ["limit on defect", "below 0"]),
    "a limit in text": ("value=1e-6", "value='1'", ["limit on defect", "'1'"]),
    "bodies in text": (
        'bodies=("mass", "wall")',
        'bodies="mass"',
        ["contact wall: bodies … two different bodies, not 'mass'"],
    ),
    "a body that is a number": (
        'bodies=("mass", "wall")',
        'bodies=("mass", 3)',
        ["contact wall: bodies", "3"],
    ),
    "a depth of NaN": ("depth=0.2", "depth=float('nan')", ["contact wall: depth", "nan"]),
    "a disc of two radii": ("size=(0.1,)", "size=(1, 2)", ["shape mass", "disc", "1 lengths"]),
    "a place in text": ('kind="disc", x=x', 'kind="disc", x="x"', ["shape mass: x", "str"]),
    "friction that is pressed twice": (
        'coefficient=mu, contact="wall"',
        'coefficient=mu, contact="wall", normal_force=m',
        ["friction wall: … must be given once", "there are both"],
    ),
    "a slip of no velocity": (
        "slip=vy",
        "slip=sp.Integer(0)",
        ["friction wall", "the slip depends on no velocity"],
    ),
    "a slip of an input": ("slip=vy", "slip=vy - u", ["friction wall", "slip uses u"]),
    "a normal force that pulls": (
        'coefficient=mu, contact="wall"',
        "coefficient=mu, normal_force=-20",
        ["friction wall", "the normal_force is -20"],
    ),
    "friction without a size": (
        "slip=vy,",
        "slip=vy, nominal=0.0,",
        ["friction wall", "nominal (a typical slip speed … must be positive"],
    ),
    "friction with a blank in its name": (
        'name="wall", slip',
        'name="the wall", slip',
        ["'the wall'", "is not an identifier"],
    ),
    "an error of two lines": (
        "SCENE = Scene(",
        "raise ValueError('one\\ntwo')\nSCENE = Scene(",
        ["ValueError", "line 8"],
    ),
}


def test_without_a_mistake_it_is_a_scene(tmp_path: Path):
    assert load_scene(written(tmp_path, SOUND)).nf == 1


@pytest.mark.parametrize("kind", MISTAKES)
def test_a_mistake_is_named_with_its_file_and_field(tmp_path: Path, kind: str):
    sound, instead, words = MISTAKES[kind]
    assert SOUND.count(sound) >= 1
    path = written(tmp_path, SOUND.replace(sound, instead, 1))
    with pytest.raises(SceneError) as caught:
        load_scene(path)
    text = str(caught.value)
    assert text.startswith(f"scene file {path}")
    assert not unsaid(text, *words)


# Not of the scene alone: which metrics there are, the score knows.
UNKNOWN_METRIC = ('metric="defect"', 'metric="defekt"')


def test_a_limit_on_an_unknown_figure_is_named_with_its_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    path = written(tmp_path, SOUND.replace(*UNKNOWN_METRIC, 1))
    assert run(["all", "--scene", path, "--out", str(tmp_path / "runs"), "--dry-run"]) == 2
    said = capsys.readouterr().err
    assert not unsaid(
        said,
        f"error: scene file {path}: scene own: there … 'defekt' … no metric; did you mean defect?",
    )
    assert said.count("\n") == 1, said


@pytest.mark.parametrize(
    "kind",
    [
        "quick in words",
        "an error of two lines",
        "an error of syntax",
        "a force of a function that is not smooth C",
        None,
    ],
)
def test_the_command_says_it_in_one_line_and_ends_with_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str | None
):
    """None: the file is missing."""
    path = (
        str(tmp_path / "own.py")
        if kind is None
        else written(tmp_path, SOUND.replace(*MISTAKES[kind][:2], 1))
    )
    assert run(["all", "--scene", path, "--out", str(tmp_path / "runs"), "--dry-run"]) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: ")
    assert said.count("\n") == 1, said
    assert path in said


def written(folder: Path, text: str) -> str:
    path = folder / "own.py"
    path.write_text(text, encoding="utf-8")
    return str(path)
