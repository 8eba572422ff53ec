"""Two fingers carry a disc sideways: seven positions, four torques, and a variable mass matrix.

The disc (0.5 kg) lies on a smooth table between the tips of two 2-link fingers, which must move it
by 0.05 m and catch it. The fingers start 5 mm off, so both contacts must be found. Source:
dimensions, masses, stiffness, damping and step are from our scene bank, after planar
    grippers of
contact-implicit planning. Chosen: bases 0.14 m from the row (bent elbows), 2 N m per joint (ten
times the need), no friction. The running cost is 5 per metre of distance, plus squared torques: the
disc arrives after half of
    the
0.5 s. A squared distance would leave the last millimetres slow. Tips of 100 N/m are very soft: push
and catch of the strict plan are 3.4 and 4.6 N, as many centimetres deep, of 6 between the centres.
"""

import sympy as sp

from models.scene import Scene, Task
from models.scene.parts import limits
from models.scenes import _fingers as fingers

WAY = 0.05
HEIGHT = 0.14
GAP = 0.005
MASS = 0.5
PULL = 5.0

SCENE = Scene(
    name="two_finger",
    title="Two fingers carry a disc and set it to rest",
    source="Lagrange's equations of four bars and a disc; dimensions of planar grippers in contact-implicit planning (see the file)",
    unstable="a disc pinched between two round tips without friction slips out sideways: the pinch F drives it off with 2 F/(R + w/2) a metre, a rate of sqrt(2 F/(m (R + w/2))) = 8/s for each newton under the root",
    coordinates=fingers.coordinates(),
    inputs=fingers.inputs(2.0),
    parameters=fingers.parameters(MASS),
    kinetic_energy=fingers.kinetic_energy(),
    potential_energy=sp.Integer(0),
    forces=fingers.forces(),
    contacts=fingers.tip_contacts(0.01),
    task=Task(
        start=(*fingers.pinch(GAP, HEIGHT), 0.0, HEIGHT, 0.0, *[0.0] * 7),
        goal=(None, None, None, None, WAY, HEIGHT, None, *[0.0] * 7),
        running_cost=fingers.running_cost(WAY, HEIGHT, PULL),
        step=0.001,
        steps=500,
    ),
    limits=limits(
        terminal_position_error=(0.005, "a tenth of the way that the disc is to be moved"),
        terminal_velocity_error=(
            0.01,
            "at 0.01 m/s the disc glides on by m_d/c_d * 0.01 = 5 mm, the limit of its position; a link that turns at 0.01 rad/s moves its tip by less",
        ),
        replay_terminal_position_error=(0.005, "a tenth of the way that the disc is to be moved"),
        replay_terminal_velocity_error=(
            0.01,
            "as of the plan: at 0.01 m/s the disc glides on by 5 mm, the limit of its position",
        ),
        replay_error=(
            0.05,
            "a link of 0.1 m that is 0.05 rad off has its end 5 mm off, the limit of the disc at the goal",
        ),
    ),
    answers=(fingers.stretched_answer(),),
    quick=False,
    length=fingers.LENGTH,
    shapes=fingers.shapes(),
)
