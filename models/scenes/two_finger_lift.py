"""Two fingers lift a disc off a table by friction: the paper's cup.

The fingers of `two_finger` hang from above; the tips start 5 mm off. They must close, press (at
least m g/(2 mu) per side to hold the disc), lift by 0.05 m and hold. Pushes are horizontal, so the
lift needs friction. Source: as `two_finger`. Chosen: mu = 1 (rubber); a disc of 0.1 kg, held with 5
mm of penetration (0.5 kg: 25 mm, half the radius); a table of 500 N/m with 2 mm, in balance; h =
0.002 s: h w = 0.14 on the table. The distance costs 20 per metre: 1 per step on the table against
0.05 for the holding torques, so lifting at once pays.
"""

import sympy as sp

from models.scene import Answer, Contact, Parameter, Scene, Shape, Task
from models.scene.parts import limits
from models.scenes import _fingers as fingers

g, mu, k_t, y_t = sp.symbols("g mu k_t y_t", positive=True)
WAY = 0.05
HEIGHT = -0.14
GAP = 0.005
MASS = 0.1
GRAVITY = 9.81
MU = 1.0
TABLE = 500.0
PULL = 20.0
SUNK = MASS * GRAVITY / TABLE

SCENE = Scene(
    name="two_finger_lift",
    title="Two fingers lift a disc off a table by friction",
    source="Lagrange's equations of four bars and a disc; dimensions of planar grippers in contact-implicit planning (see the file)",
    unstable="a disc held between two round tips turns them over: what squeezes them drives an error of the height on, and the tips roll on the disc",
    coordinates=fingers.coordinates(),
    inputs=fingers.inputs(2.0),
    parameters=(
        *fingers.parameters(MASS),
        Parameter(symbol=g, value=GRAVITY, unit="m/s^2", lower=0.0, description="gravity"),
        Parameter(
            symbol=mu,
            value=MU,
            unit="1",
            lower=0.0,
            description="coefficient of friction between tip and disc",
        ),
        Parameter(
            symbol=k_t, value=TABLE, unit="N/m", lower=1e-6, description="stiffness of the table"
        ),
        Parameter(
            symbol=y_t,
            value=fingers.RADIUS - SUNK - HEIGHT,
            unit="m",
            description="depth of the table below the bases",
        ),
    ),
    kinetic_energy=fingers.kinetic_energy(),
    potential_energy=g
    * (fingers.m_d * fingers.y + fingers.m_l * sum(centre[1] for centre, _ in fingers.bars())),
    forces=fingers.forces(),
    contacts=(
        *fingers.tip_contacts(0.01),
        Contact(
            name="table",
            bodies=("disc", "table"),
            penetration=fingers.R - fingers.y - y_t,
            stiffness=k_t,
            depth=fingers.R,
            depth_reason="the radius of the disc: there its centre is in the top of the table, and beyond it the nearer way out is below",
            nominal=0.002,
            description="disc on the table",
        ),
    ),
    frictions=fingers.tip_frictions(mu, 0.1),
    task=Task(
        start=(*fingers.pinch(GAP, HEIGHT), 0.0, HEIGHT, 0.0, *[0.0] * 7),
        goal=(None, None, None, None, 0.0, HEIGHT + WAY, None, *[0.0] * 7),
        running_cost=fingers.running_cost(0.0, HEIGHT + WAY, PULL),
        step=0.002,
        steps=200,
    ),
    limits=limits(
        **dict.fromkeys(
            ("ghost_impulse", "missed_impulse"),
            (
                0.02,
                "a twentieth of the impulse m g T by which the disc is held up: what a step of 2 ms may misplace at the ten touches of a plan",
            ),
        ),
        terminal_position_error=(0.005, "a tenth of the way that the disc is to be lifted"),
        terminal_velocity_error=(0.01, "the speed that falling freely gives in 1 ms, half a step"),
        replay_terminal_position_error=(0.005, "a tenth of the way that the disc is to be lifted"),
        replay_terminal_velocity_error=(
            0.02,
            "the speed that falling freely gives in one step of 2 ms",
        ),
        replay_error=(
            0.05,
            "a link of 0.1 m that is 0.05 rad off has its end 5 mm off, the limit of the disc at the goal",
        ),
    ),
    answers=(
        fingers.stretched_answer(),
        Answer(
            quantity="least squeeze of each tip that holds the disc in the air [N]",
            value=MASS * GRAVITY / (2 * MU),
            tolerance=1e-9,
            source="2 mu N >= m g: balance of the disc under two level pushes and their friction",
        ),
    ),
    quick=False,
    length=fingers.LENGTH,
    shapes=(
        *fingers.shapes(),
        Shape(name="table", kind="wall", x=sp.Integer(0), y=-y_t, size=(0.4,)),
    ),
)
