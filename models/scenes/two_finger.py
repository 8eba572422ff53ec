"""Two fingers carry a disc sideways and set it to rest: seven positions, four torques, and a mass matrix that depends on the position.

The disc (0.5 kg) lies on a smooth table, seen from above, between the tips of two 2-link fingers.
It has no drive of its own: only the tips can move it, 0.05 m to the right, and they have to catch
it again. The fingers start 5 mm off on both sides, so that no force acts at first and both contacts
have to be found.

Source: dimensions, masses, stiffness, damping and the time step are those of our scene bank, after
    the planar grippers of contact-implicit
planning; the equations are Lagrange's, see `_fingers`. Chosen here: bases 0.14 m beside the row of
    tip, disc and tip, so that the elbows are
bent; 2 N m at each joint, ten times what the push takes once the tips are there; no friction, which
    this task can do without
(`two_finger_lift` has it).

To hold: the task asks for rest at the end, with the disc at its goal. The running cost counts the
distance of the disc from its goal, 5 a metre, against the torques squared: enough that the disc
arrives after half of the 0.5 s and stays for the other half. The distance is counted as it is, not
squared: its square would let the last millimetres take as long as they like. Tips of 100 N/m are
very soft: the push and the catch of the plan that strict complementarity finds are 3.4 and 4.6 N,
and sink in by as many centimetres, of the 6 at which the centres would meet.
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
