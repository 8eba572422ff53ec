"""A look that falls exactly on an event is no alarm: a damped contact whose force jumps at the touch, timed to the look."""

import pytest
import sympy as sp

from models.fmu import build_fmu
from models.scene import Coordinate, Parameter, Scene, Task
from models.scene.contacts import Contact, DampingLaw
from validate.fmu_check import Status, check_fmu

q, v = sp.symbols("q v", real=True)
m, k, c = sp.symbols("m k c", positive=True)
STEP = 0.01


def thrown(steps_to_wall: float) -> Scene:
    """A free mass at 1 m/s that touches a damped wall after so many steps."""
    return Scene(
        name="thrown",
        title="A mass is thrown at a damped wall",
        source="ours",
        coordinates=(Coordinate(symbol=q, velocity=v, unit="m"),),
        inputs=(),
        parameters=(
            Parameter(symbol=m, value=1.0, unit="kg"),
            Parameter(symbol=k, value=400.0, unit="N/m"),
            Parameter(symbol=c, value=5.0, unit="N s/m"),
        ),
        kinetic_energy=m * v**2 / 2,
        potential_energy=sp.Integer(0),
        forces=(sp.Integer(0),),
        contacts=(
            Contact(
                name="wall",
                bodies=("mass", "wall"),
                depth=1.0,
                depth_reason="nothing here goes as deep",
                penetration=q,
                stiffness=k,
                damping=c,
                damping_law=DampingLaw.KELVIN_VOIGT,
            ),
        ),
        task=Task(
            start=(-steps_to_wall * STEP, 1.0),
            goal=(None, None),
            running_cost=sp.Integer(0),
            step=STEP,
            steps=40,
        ),
    )


@pytest.mark.slow
@pytest.mark.parametrize("steps", [3.0, 3.0 + 1 / 3, 3.17])
def test_a_touch_at_a_look_is_no_alarm(steps: float):
    report = check_fmu(build_fmu(thrown(steps)), names=("event indicators announce events",))
    (row,) = [row for row in report.rows if row.name == "event indicators announce events"]
    assert row.status is Status.PASSED, row.sentence
    assert "state events" in row.sentence
