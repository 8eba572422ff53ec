"""A parameter that is made of the task's step is refused with its line; a step that is made of parameters, or of the duration, is not."""

from pathlib import Path
from time import perf_counter

import pytest
from wording import unsaid

from models.catalog import load_scene
from models.errors import SceneError
from models.scene.step_dependence import step_problem

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
    assert "value=" in text.splitlines()[line - 1] or "with_parameters" in text.splitlines()[line - 1]
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
    path.write_text(text.replace("q1, q2 =", "STEP = 0.01\nq1, q2 =", 1).replace("step=0.01", "step=STEP"))
    assert load_scene(str(path)).task.step == 0.01
    path.write_text(path.read_text().replace("value=0.8", "value=80 * STEP"))
    line = path.read_text().splitlines().index(next(line for line in path.read_text().splitlines() if "80 * STEP" in line)) + 1
    with pytest.raises(SceneError) as caught:
        load_scene(str(path))
    assert not unsaid(caught.value, f"{path}, line {line}: scene own: … parameter m2, 80 * STEP")


def test_a_long_file_is_read_at_once():
    text = "\n".join(["A0 = 1.0", *(f"A{number} = A{number - 1} * 2.0" for number in range(1, 2000)), "STEP = A1999", "Task(step=STEP)"])
    began = perf_counter()
    assert step_problem(f"{text}\nParameter(symbol=m, value=A1999)") is not None
    assert step_problem(f"{text}\nParameter(symbol=m, value=A1998)") is None
    assert perf_counter() - began < 5.0
