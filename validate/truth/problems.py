"""Phenomena of contact with exact answers, as problems for any engine: a scene, a start, a duration, four steps, and what is true at the end.

    problem = problems()[0]
    problem.name, problem.phenomenon, problem.scene, problem.plan, problem.parts      # what an engine is asked
    problem.end(), problem.energy(), problem.asks                                     # what is right

Scenes are those of the bank, with other parameters, another start or a damped floor; the ramp and the belt are written here. An answer is a closed form
(of the scene's file, or here) or, where there is none, the motion by our own event-exact integration: DOP853 at 1e-12, afresh at every change of a contact
or a friction (models.fmu.reference). Either is right to 1e-9.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import sympy as sp
from scipy.special import lambertw

from models.catalog import load_scene
from models.fmu.reference import Equations, Piece, true_motion
from models.scene import Contact, Coordinate, Friction, Parameter, Scene, Task
from models.scene.contacts import DampingLaw
from models.scenes import bouncing_mass as drop
from models.scenes import two_body_collision as pair
from models.scenes.two_discs import BLUR, RADIUS
from models.trajectory import Trajectory, uniform_grid

INTEGRATED = "our own event-exact integration (DOP853 at 1e-12)"
FOUR = (1, 2, 4, 8)
BOUNCES, HEIGHT = 1000, 0.05
STIFFNESSES = tuple(10.0**power for power in range(0, 9, 2))
RATIOS = (1e-4, 1e-2, 1e2, 1e4)


@dataclass(frozen=True, kw_only=True)
class Ask:
    """A number of a motion beside its end: measure(t, q, v) of nodes (nodes,) [s], (nodes, nq) [m, rad, m/s, rad/s]; exact and scale in `unit`."""

    name: str
    unit: str
    exact: float
    scale: float
    measure: Callable[[np.ndarray, np.ndarray, np.ndarray], float]


@dataclass(frozen=True, kw_only=True, eq=False)
class TruthProblem:
    """See the module docstring.

    nodes: intervals at whose ends the motion is looked at; parts: steps of an engine in each, the coarsest first; u (nu,): constant input [N]. exact (2 nq,):
    the true end, NaN where it is not asked, None: integrated. position, velocity: what errors of the end are a share of [m, m/s]. energy_kept: that the
    energy at the end is that of the start. source: where the answer is from.
    """

    phenomenon: str
    name: str
    scene: Scene
    duration: float
    nodes: int
    source: str
    position: float
    velocity: float
    exact: tuple[float, ...] | None = None
    parts: tuple[int, ...] = FOUR
    u: tuple[float, ...] = ()
    energy_kept: bool = False
    asks: tuple[Ask, ...] = field(default=())

    @property
    def plan(self) -> Trajectory:
        """Its inputs on its nodes."""
        nothing = np.zeros((self.nodes + 1, 0))
        u = np.tile(np.array(self.u, dtype=float), (self.nodes, 1)).reshape(self.nodes, self.scene.nu)
        return Trajectory(t=uniform_grid(self.duration / self.nodes, self.nodes), q=nothing, v=nothing, u=u, lam=nothing[1:])

    def end(self) -> np.ndarray:
        """The true end, (2 nq,) positions, then velocities [m, m/s]; NaN where it is not asked. Raises MotionError where it cannot be integrated."""
        if self.exact is not None:
            return np.array(self.exact)
        pieces = [Piece(end=self.duration, u=np.array(self.u, dtype=float))]
        return true_motion(Equations(self.scene), pieces, np.array([self.duration]))[0][0]

    def errors(self, t: np.ndarray, q: np.ndarray, v: np.ndarray, end: np.ndarray) -> dict[str, float]:
        """How wrong a motion is, by what is asked.

        Parameters
        ----------
        t, q, v
            (nodes,) [s], (nodes, nq) [m, m/s].
        end
            (2 nq,) of `end()` [m, m/s].

        Returns
        -------
        dict[str, float]
            Shares of the problem's scales [-]; empty where only the energy is asked.

        Raises
        ------
        ValueError
            If the shapes do not fit.
        """
        nq = self.scene.nq
        found = {}
        for kind, reached, true, scale in (("position", q[-1], end[:nq], self.position), ("velocity", v[-1], end[nq:], self.velocity)):
            asked = np.isfinite(true)
            if asked.any():
                found[f"{kind} at the end"] = float(np.abs(reached - true)[asked].max()) / scale
        return found | {ask.name: abs(ask.measure(t, q, v) - ask.exact) / ask.scale for ask in self.asks}


def problems() -> tuple[TruthProblem, ...]:
    """All problems, by phenomenon."""
    return (
        *_rebounds(), _collision(), *_mass_ratios(), _grazing(), _squeeze(), _dying_bounces(), _stop(), *_ramps(), _creep(), _stick_slip(),
        _bounces(), *_stiffnesses(), _overlap(),
    )  # fmt: skip


def _started(scene: Scene, start: tuple[float, ...], **parameters: float) -> Scene:
    """Another start and other parameters; answers and limits of the scene's own are not those of this any more."""
    changed = replace(scene, answers=(), limits=()).with_parameters(**parameters)
    return changed.with_task(start=start)


def deepest(place: int) -> Callable[[np.ndarray, np.ndarray, np.ndarray], float]:
    """Measures the largest depth of a coordinate below 0 [m], between nodes by the cubic through positions and velocities, of t (nodes,) [s], q, v (nodes, nq) [m, m/s]. Raises nothing."""

    def measure(t: np.ndarray, q: np.ndarray, v: np.ndarray) -> float:
        """Of t (nodes,) [s], q, v (nodes, nq) [m, m/s]: [m]. Raises nothing."""
        turns = np.flatnonzero((v[:-1, place] < 0.0) & (v[1:, place] >= 0.0))
        lowest = q[:, place].min()
        for i in turns:
            h = t[i + 1] - t[i]
            rise, (a, b) = (q[i + 1, place] - q[i, place]) / h, v[i : i + 2, place]
            s = np.roots([3 * (a + b - 2 * rise), 2 * (3 * rise - 2 * a - b), a])
            s = s[np.isreal(s)].real
            s = s[(s >= 0.0) & (s <= 1.0)]
            cubic = q[i, place] + h * (a * s + (3 * rise - 2 * a - b) * s**2 + (a + b - 2 * rise) * s**3)
            lowest = min(lowest, cubic.min(initial=np.inf))
        return -float(lowest)

    return measure


def _floor(law: DampingLaw, damping: float) -> Scene:
    """The bouncing mass on a damped floor."""
    scene, c = load_scene("bouncing_mass"), sp.Symbol("c", positive=True)
    damper = Parameter(symbol=c, value=damping, unit=law.unit, lower=0.0, description="damping of the floor")
    floor = replace(scene.contacts[0], damping=c, damping_law=law)
    return replace(scene, parameters=(*scene.parameters, damper), contacts=(floor,), answers=(), limits=())


def _rebounds() -> list[TruthProblem]:
    duration, nodes, phenomenon = 0.6, 300, "rebound"
    flight = duration - drop.FALL_TIME - drop.CONTACT_TIME
    elastic = TruthProblem(
        phenomenon=phenomenon, name="undamped", scene=load_scene("bouncing_mass"), duration=duration, nodes=nodes, position=drop.DROP, velocity=drop.SPEED,
        source="closed form of the scene: free fall, swing about the static depth", energy_kept=True,
        exact=(drop.SPEED * flight - drop.GRAVITY * flight**2 / 2, drop.SPEED - drop.GRAVITY * flight),
        asks=(Ask(name="depth", unit="m", exact=drop.DEPTH, scale=drop.DEPTH, measure=deepest(0)),),
    )  # fmt: skip
    linear = TruthProblem(
        phenomenon=phenomenon, name="Kelvin-Voigt damping", scene=_floor(DampingLaw.KELVIN_VOIGT, 10.0), duration=duration, nodes=nodes,
        position=drop.DROP, velocity=drop.SPEED, source=INTEGRATED,
    )  # fmt: skip
    speed, damping = 3.0, 0.2
    y = 1.0 + damping * speed
    after = (1.0 + float(lambertw(-y * math.exp(-y), 0).real)) / damping
    growing = TruthProblem(
        phenomenon=phenomenon, name="Hunt-Crossley damping", scene=_started(_floor(DampingLaw.HUNT_CROSSLEY, damping), (0.6, -speed), g=0.0),
        duration=duration, nodes=nodes, position=drop.DROP, velocity=speed, source="closed form: Lambert's W (as in damped_collision), no gravity",
        exact=(math.nan, after),
    )  # fmt: skip
    return [elastic, linear, growing]


def _collided(scene: Scene, duration: float) -> tuple[float, float, float, float]:
    """The true end of two bodies on a line that meet once by a linear spring, or overlap at the start: the mean moves on, the distance swings half a period."""
    values = {parameter.name: parameter.value for parameter in scene.parameters}
    m1, m2, k, r = (values[name] for name in ("m1", "m2", "k", "r"))
    q1, q2, v1, v2 = (value for value in scene.task.start if value is not None)
    w = math.sqrt(k * (m1 + m2) / (m1 * m2))
    gap, opening = q2 - q1 - 2 * r, v2 - v1
    if gap > 0.0:
        gap, opening = (duration + gap / opening - math.pi / w) * -opening, -opening
    else:  # at rest
        gap, opening = (duration - math.pi / 2 / w) * -gap * w, -gap * w
    centre, mean = (m1 * q1 + m2 * q2 + (m1 * v1 + m2 * v2) * duration) / (m1 + m2), (m1 * v1 + m2 * v2) / (m1 + m2)
    share1, share2 = m2 / (m1 + m2), m1 / (m1 + m2)
    distance = gap + 2 * r
    return centre - share1 * distance, centre + share2 * distance, mean - share1 * opening, mean + share2 * opening


_SWING = "closed form: the centre of mass moves on, the distance swings half a period"


def _collision() -> TruthProblem:
    scene = load_scene("two_body_collision")
    masses, start = np.array([pair.MASS_1, pair.MASS_2]), np.array(pair.START[2:])
    momentum = Ask(
        name="momentum", unit="kg m/s", exact=float(masses @ start), scale=float(masses @ np.abs(start)), measure=lambda t, q, v: float(v[-1] @ masses)
    )  # fmt: skip
    return TruthProblem(
        phenomenon="two-body collision", name="masses 1 and 3", scene=scene, duration=0.6, nodes=150, source=_SWING, exact=_collided(scene, 0.6),
        position=1.0, velocity=pair.CLOSING_SPEED, energy_kept=True, asks=(momentum,),
    )  # fmt: skip


def _mass_ratios() -> list[TruthProblem]:
    found = []
    for ratio in RATIOS:
        base = load_scene("two_body_collision")
        scene = _started(base, (0.0, 2 * pair.RADIUS + 0.03, 2.0, -1.0), m1=1.0, m2=ratio)
        w = math.sqrt(pair.STIFFNESS * (1.0 + ratio) / ratio)
        duration = 0.02 + math.pi / w
        # A fifth of a radian of the contact is the coarsest step.
        found.append(
            TruthProblem(
                phenomenon="mass ratio",
                name=f"1 to {ratio:g}",
                scene=scene,
                duration=duration,
                nodes=math.ceil(duration * w / 0.2),
                source=_SWING,
                exact=_collided(scene, duration),
                position=pair.CLOSING_SPEED / w,
                velocity=pair.CLOSING_SPEED,
                energy_kept=True,
            )
        )
    return found


def _grazing() -> TruthProblem:
    depth, ahead = 1e-4, 0.05
    height = math.sqrt((2 * RADIUS - depth) ** 2 - BLUR**2)
    scene = _started(load_scene("two_discs"), (-ahead, height, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0))
    # What one disc gives the other: some 5 mm/s.
    return TruthProblem(
        phenomenon="grazing contact", name="discs pass at a depth of 0.1 mm", scene=scene, duration=2 * ahead, nodes=50, source=INTEGRATED, u=(0.0, 0.0),
        position=5e-3 * ahead, velocity=5e-3, energy_kept=True,
    )  # fmt: skip


def _squeeze() -> TruthProblem:
    scene = load_scene("three_cart")
    middle = Ask(
        name="middle cart moved", unit="m", exact=scene.task.start[1], scale=0.1, measure=lambda t, q, v: float(q[np.abs(q[:, 1] - q[0, 1]).argmax(), 1])
    )  # fmt: skip
    return TruthProblem(
        phenomenon="symmetric squeeze", name="two carts press a third", scene=scene, duration=2.0, nodes=200, source=INTEGRATED, u=(6.0, -6.0),
        position=0.1, velocity=0.5, asks=(middle,),
    )  # fmt: skip


def last_lift(t: np.ndarray, q: np.ndarray, v: np.ndarray) -> float:
    """The last time at which coordinate 0 falls below 0: from then on it rests; t (nodes,) [s], q, v (nodes, nq) [m, m/s]. 0 where it never does. Raises nothing."""
    falls = np.flatnonzero((q[:-1, 0] > 0.0) & (q[1:, 0] <= 0.0))
    if not len(falls):
        return 0.0
    i = falls[-1]
    return float(t[i] + (t[i + 1] - t[i]) * q[i, 0] / (q[i, 0] - q[i + 1, 0]))


def _dying_bounces() -> TruthProblem:
    # A contact lasts 0.1 s: at a twentieth of that our own integration sees each.
    scene = _floor(DampingLaw.KELVIN_VOIGT, 2.0 * 0.2 * math.sqrt(drop.STIFFNESS * drop.MASS)).with_task(step=0.005)
    duration, nodes = 2.5, 5000
    t = uniform_grid(duration / nodes, nodes)
    states, _ = true_motion(Equations(scene), [Piece(end=duration, u=np.zeros(0))], t)
    # Between nodes half a millisecond apart a parabola is 1e-6 m off its chord, which at the last falls is 1e-5 s; both sides measure with it.
    rest = Ask(name="time of rest", unit="s", exact=last_lift(t, states[:, :1], states[:, 1:]), scale=1.0, measure=last_lift)
    third = int(np.flatnonzero((states[:-1, 0] > 0.0) & (states[1:, 0] <= 0.0))[1]) + 400
    height = Ask(
        name="height after two bounces", unit="m", exact=float(states[third, 0]), scale=0.1, measure=lambda t, q, v: float(q[third, 0])
    )  # fmt: skip
    return TruthProblem(
        phenomenon="dying bounces", name="damping ratio 0.2, until it rests", scene=scene, duration=duration, nodes=nodes, source=INTEGRATED,
        exact=tuple(states[-1]), position=0.1, velocity=0.5, asks=(rest, height),
    )  # fmt: skip


def ground(angle: float, mu: float, *, belt: float = 0.0, spring: float = 0.0, start: tuple[float, ...] | None = None) -> Scene:
    """A block on a soft, rubbing plane that is tilted by `angle` [rad]; with a belt of that mass [kg] under it instead, and a spring [N/m] to the ground.

    s is the place along the plane, n that above it; at the start it lies as deep as it weighs.
    """
    s, n, b = sp.symbols("s n b", real=True)
    v_s, v_n, v_b = sp.symbols("v_s v_n v_b", real=True)
    m, g, tilt, k, mu_, m_b, k_s = sp.symbols("m g tilt k mu m_b k_s", positive=True)
    stiffness, gravity = 1e4, drop.GRAVITY
    on_belt = belt > 0.0
    values = ((m, 1.0, "kg"), (g, gravity, "m/s^2"), (tilt, angle, "rad"), (k, stiffness, "N/m"), (mu_, mu, "1"))
    values += ((m_b, belt, "kg"), (k_s, spring, "N/m")) if on_belt else ()
    sag = gravity * math.cos(angle) / stiffness
    begun = start or (0.0, -sag, 0.0, 0.0)
    moving = [(s, v_s, "place of the block along the plane"), (n, v_n, "its height above the plane")]
    moving += [(b, v_b, "place of the belt")] if on_belt else []
    return Scene(
        name="belt" if on_belt else "ramp",
        title="A block on a moving belt" if on_belt else "A block on a ramp",
        source="Newton's second law",
        coordinates=tuple(Coordinate(symbol=q, velocity=v, unit="m", description=words) for q, v, words in moving),
        inputs=(),
        parameters=tuple(Parameter(symbol=symbol, value=value, unit=unit, description=str(symbol)) for symbol, value, unit in values),
        kinetic_energy=m * (v_s**2 + v_n**2) / 2 + (m_b * v_b**2 / 2 if on_belt else 0),
        potential_energy=m * g * (n * sp.cos(tilt) - s * sp.sin(tilt)) + (k_s * s**2 / 2 if on_belt else 0),
        forces=(sp.Integer(0),) * len(moving),
        contacts=(
            Contact(name="plane", bodies=("block", "plane"), penetration=-n, stiffness=k, depth=0.1, depth_reason="the height of the block", nominal=1e-3),
        ),
        frictions=(Friction(name="plane", slip=v_s - v_b if on_belt else v_s, coefficient=mu_, contact="plane"),),
        task=Task(start=begun, goal=(None,) * (2 * len(moving)), running_cost=sp.Integer(0), step=0.01, steps=100),
    )  # fmt: skip


def _stop() -> TruthProblem:
    mu, speed = 0.4, 2.0
    sag, distance = drop.GRAVITY / 1e4, speed**2 / (2 * mu * drop.GRAVITY)
    scene = ground(0.0, mu, start=(0.0, -sag, speed, 0.0))
    return TruthProblem(
        phenomenon="stopping distance", name="a block slides to rest, mu = 0.4", scene=scene, duration=0.8, nodes=80, position=distance, velocity=speed,
        source="closed form: v^2/(2 mu g)", exact=(distance, -sag, 0.0, 0.0),
    )  # fmt: skip


def _tilted(phenomenon: str, name: str, mu: float, share: float) -> TruthProblem:
    """A ramp that asks `share` of what friction can hold; errors are shares of the way without friction."""
    angle, duration = math.atan(share * mu), 1.0
    pull = drop.GRAVITY * math.sin(angle)
    rate = max(0.0, pull - mu * drop.GRAVITY * math.cos(angle))
    sag = drop.GRAVITY * math.cos(angle) / 1e4
    return TruthProblem(
        phenomenon=phenomenon, name=name, scene=ground(angle, mu), duration=duration, nodes=100, position=pull * duration**2 / 2, velocity=pull * duration,
        source="closed form: constant forces", exact=(rate * duration**2 / 2, -sag, rate * duration, 0.0),
    )  # fmt: skip


def _ramps() -> list[TruthProblem]:
    return [
        _tilted("ramp", f"mu = {mu:g}, tilted to {share:g} of its angle: it {'slides' if share > 1 else 'sticks'}", mu, share)
        for mu in (0.2, 0.8)
        for share in (0.95, 1.05)
    ]


def _creep() -> TruthProblem:
    return _tilted("creep under load", "mu = 0.5, half of what friction holds", 0.5, 0.5)


def _stick_slip() -> TruthProblem:
    speed, mu = 0.2, 0.3
    scene = ground(0.0, mu, belt=100.0, spring=100.0, start=(0.0, -drop.GRAVITY / 1e4, 0.0, speed, 0.0, speed))
    return TruthProblem(
        phenomenon="stick-slip", name="a block on a spring, on a belt of 100 kg", scene=scene, duration=2.0, nodes=200, source=INTEGRATED, position=0.03, velocity=speed
    )  # fmt: skip


def _bounces() -> TruthProblem:
    scene = _started(load_scene("bouncing_mass"), (HEIGHT, 0.0))
    speed = math.sqrt(2 * drop.GRAVITY * HEIGHT)
    contact = (2 * math.pi - 2 * math.atan2(speed / drop.RATE, drop.SAG)) / drop.RATE
    period = 2 * speed / drop.GRAVITY + contact
    return TruthProblem(
        phenomenon="energy over 1000 bounces", name="undamped", scene=scene, duration=BOUNCES * period, nodes=BOUNCES, source="closed form: none is lost",
        exact=(math.nan, math.nan), position=HEIGHT, velocity=speed, energy_kept=True, parts=tuple(150 * part for part in FOUR),
    )  # fmt: skip


def _stiffnesses() -> list[TruthProblem]:
    found, base, gap, speed = [], load_scene("two_body_collision"), 0.005, 0.01
    for stiffness in STIFFNESSES:
        scene = _started(base, (0.0, 2 * pair.RADIUS + gap, speed / 2, -speed / 2), k=stiffness)
        w = math.sqrt(stiffness / pair.REDUCED_MASS)
        duration = round((gap / speed + math.pi / w + 0.2) / 0.004) * 0.004
        found.append(
            TruthProblem(
                phenomenon="stiffness at fixed step",
                name=f"k = {stiffness:g} N/m, h = 4 to 0.5 ms",
                scene=scene,
                duration=duration,
                nodes=round(duration / 0.004),
                source=_SWING,
                exact=_collided(scene, duration),
                position=gap,
                velocity=speed,
                energy_kept=True,
            )
        )
    return found


def _overlap() -> TruthProblem:
    depth = 0.05
    scene = _started(load_scene("two_body_collision"), (0.0, 2 * pair.RADIUS - depth, 0.0, 0.0))
    w = math.sqrt(pair.STIFFNESS / pair.REDUCED_MASS)
    return TruthProblem(
        phenomenon="penetration at the start", name="two bodies 5 cm into each other", scene=scene, duration=0.2, nodes=100, source=_SWING,
        exact=_collided(scene, 0.2), position=0.1, velocity=depth * w, energy_kept=True,
    )  # fmt: skip
