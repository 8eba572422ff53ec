"""Problems of contact with exact answers: scene, start, duration, four steps, and the true end.

    problem = problems()[0]
    problem.name, problem.phenomenon, problem.scene, problem.plan, problem.parts
    problem.end(), problem.energy(), problem.asks

Scenes are the bank's, modified, and a ramp and a belt. Answers are closed forms, or the event-exact
integration of validate.truth.exact_motion; both are right to 1e-9.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import sympy as sp
from scipy.interpolate import CubicHermiteSpline
from scipy.special import lambertw

from models.catalog import load_scene
from models.scene import Contact, Coordinate, Friction, Parameter, Scene, Task
from models.scene.contacts import DampingLaw
from models.scenes import bouncing_mass as drop
from models.scenes import two_body_collision as pair
from models.scenes.two_discs import BLUR, RADIUS
from models.trajectory import Trajectory, uniform_grid
from validate.truth.exact_motion import Equations, Piece, true_motion

INTEGRATED = "our own event-exact integration (DOP853 at 1e-12)"
FOUR = (1, 2, 4, 8)
BOUNCES = 1000
HEIGHT = 0.05
STIFFNESSES = tuple(10.0**power for power in range(0, 9, 2))
RATIOS = (1e-4, 1e-2, 1e2, 1e4)
# Stiffness of the soft plane under sliding bodies [N/m].
_PLANE = 1e4


@dataclass(frozen=True, kw_only=True)
class Ask:
    """A number of a motion: measure(t, q, v) of nodes (nodes,) [s], (nodes, nq) [m, rad, per s]."""

    name: str
    exact: float
    scale: float
    measure: Callable[[np.ndarray, np.ndarray, np.ndarray], float]


@dataclass(frozen=True, kw_only=True, eq=False)
class TruthProblem:
    """One problem.

    - nodes: intervals whose ends are compared.
    - parts: engine steps in each, the coarsest first.
    - u (nu,): constant input [N].
    - exact (2 nq,): true end, NaN if not compared, None: integrated.
    - position, velocity: scales of errors [m, m/s].
    - energy_kept: the energy is constant.
    - source: of the answer.
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
    asks: tuple[Ask, ...] = ()

    @property
    def step(self) -> float:
        """Return the time between two nodes [s]."""
        return self.duration / self.nodes

    @property
    def plan(self) -> Trajectory:
        """Return the inputs on the nodes."""
        nothing = np.zeros((self.nodes + 1, 0))
        u = np.tile(np.array(self.u, dtype=float), (self.nodes, 1)).reshape(
            self.nodes, self.scene.nu
        )
        return Trajectory(
            t=uniform_grid(self.step, self.nodes), q=nothing, v=nothing, u=u, lam=nothing[1:]
        )

    def end(self) -> np.ndarray:
        """Return the true end (2 nq,) [m, m/s], NaN if not compared. Raises MotionError."""
        if self.exact is not None:
            return np.array(self.exact)
        pieces = [Piece(end=self.duration, u=np.array(self.u, dtype=float))]
        return true_motion(Equations(self.scene), pieces, np.array([self.duration]))[0]

    def errors(
        self, t: np.ndarray, q: np.ndarray, v: np.ndarray, end: np.ndarray
    ) -> dict[str, float]:
        """Return the errors of a motion, as shares of the problem's scales [-].

        t, q, v: (nodes,) [s], (nodes, nq) [m, m/s]; end: (2 nq,) of `end()`. Empty if only energy
        is compared. Raises ValueError if the shapes do not fit.
        """
        result = {}
        for kind, reached, true, scale in zip(
            ("position", "velocity"),
            (q, v),
            np.split(end, 2),
            (self.position, self.velocity),
            strict=True,
        ):
            if np.isfinite(true).any():
                result[f"{kind} at the end"] = float(np.nanmax(np.abs(reached[-1] - true))) / scale
        return result | {
            ask.name: abs(ask.measure(t, q, v) - ask.exact) / ask.scale for ask in self.asks
        }


def problems() -> tuple[TruthProblem, ...]:
    """Return all problems, by phenomenon."""
    return (
        *_rebounds(),
        _met("two-body collision", "masses 1 and 3", after=0.27, step=0.004, position=1.0),
        *map(mass_ratio, RATIOS), grazing(1e-4), squeeze(), _dying_bounces(), _stop(),
        *(ramp(mu, share) for mu in (0.2, 0.8) for share in (0.95, 1.05)), creep(0.5),
        _stick_slip(), _bounces(), *map(stiff, STIFFNESSES), _overlap(),
    )  # fmt: skip


def _started(name: str, start: tuple[float, ...] | None = None, **parameters: float) -> Scene:
    changed = replace(load_scene(name), answers=(), limits=()).with_parameters(**parameters)
    return changed if start is None else changed.with_task(start=start)


def deepest(t: np.ndarray, q: np.ndarray, v: np.ndarray) -> float:
    """Return the largest depth of coordinate 0 below 0 [m], by cubics between nodes.

    t: (nodes,) [s]; q, v: (nodes, nq) [m, m/s]. Raises ValueError if the shapes do not fit.
    """
    curve = CubicHermiteSpline(t, q[:, 0], v[:, 0])
    return -float(np.nanmin(curve(np.append(t, curve.derivative().roots(extrapolate=False)))))


def last_fall(t: np.ndarray, q: np.ndarray, v: np.ndarray) -> float:
    """Return the last time at which coordinate 0 falls below 0 [s], 0 if never.

    t: (nodes,) [s]; q, v: (nodes, nq) [m, m/s]. Raises ValueError if the shapes do not fit.
    """
    curve = CubicHermiteSpline(t, q[:, 0], v[:, 0])
    through = curve.roots(extrapolate=False)
    return float(through[curve(through, 1) < 0.0].max(initial=0.0))


def asymmetry(q: np.ndarray, v: np.ndarray) -> float:
    """Return the largest difference of q, v (nodes, nq) [m, m/s] from their mirror images.

    Positions are mirrored about the first middle. Raises nothing.
    """
    return max(
        float(np.abs(q + q[:, ::-1] - q[0, 0] - q[0, -1]).max()),
        float(np.abs(v + v[:, ::-1]).max()),
    )


def damped_floor(
    law: DampingLaw, damping: float, start: tuple[float, ...] | None = None, **parameters: float
) -> Scene:
    """Return the bouncing mass on a damped floor; damping in the law's unit."""
    scene, c = _started("bouncing_mass", start, **parameters), sp.Symbol("c", positive=True)
    damper = Parameter(
        symbol=c, value=damping, unit=law.unit, lower=0.0, description="damping of the floor"
    )
    return replace(
        scene,
        parameters=(*scene.parameters, damper),
        contacts=(replace(scene.contacts[0], damping=c, damping_law=law),),
    )


def restitution(z: float) -> float:
    """Return the restitution of a Kelvin-Voigt contact that opens at zero force, without gravity.

    z < 1/sqrt(2): damping ratio (T. Schwager and T. Poeschel, Granular Matter 9, 2007).
    """
    root = math.sqrt(1.0 - z**2)
    return math.exp(-z / root * (math.pi - math.atan(2.0 * z * root / (1.0 - 2.0 * z**2))))


def _rebounds() -> list[TruthProblem]:
    duration, speed, damping = 0.6, 3.0, 0.2
    common = {"phenomenon": "rebound", "duration": duration, "nodes": 300, "position": drop.DROP}
    flight, y = duration - drop.FALL_TIME - drop.CONTACT_TIME, 1.0 + damping * speed
    return [
        TruthProblem(
            **common, name="undamped", scene=_started("bouncing_mass"), velocity=drop.SPEED,
            energy_kept=True,
            source="closed form of the scene: free fall, swing about the static depth",
            exact=(drop.SPEED * flight - drop.GRAVITY * flight**2 / 2,
                   drop.SPEED - drop.GRAVITY * flight),
            asks=(Ask(name="depth", exact=drop.DEPTH, scale=drop.DEPTH, measure=deepest),),
        ),
        TruthProblem(
            **common, name="Kelvin-Voigt damping",
            scene=damped_floor(DampingLaw.KELVIN_VOIGT, 10.0), velocity=drop.SPEED,
            source=INTEGRATED,
        ),
        TruthProblem(
            **common, name="Hunt-Crossley damping",
            scene=damped_floor(DampingLaw.HUNT_CROSSLEY, damping, (0.6, -speed), g=0.0),
            velocity=speed,
            source="closed form: Lambert's W (as in damped_collision), no gravity",
            exact=(math.nan, (1.0 + float(lambertw(-y * math.exp(-y), 0).real)) / damping),
        ),
    ]  # fmt: skip


def _met(
    phenomenon: str, name: str, start: tuple[float, float, float, float] = pair.START, *,
    after: float, step: float, position: float,
    m1: float = pair.MASS_1, m2: float = pair.MASS_2, k: float = pair.STIFFNESS,
) -> TruthProblem:  # fmt: skip
    """Two bodies on a line that meet once, or overlap at rest, until `after` [s] past parting."""
    (q1, q2, v1, v2), w = start, contact_rate(m1, m2, k)
    gap, opening, mass = q2 - q1 - 2 * pair.RADIUS, v2 - v1, m1 + m2
    parted, parting = (
        (math.pi / w - gap / opening, -opening) if gap > 0.0 else (math.pi / 2 / w, -gap * w)
    )
    nodes = math.ceil((parted + after) / step)
    mean, apart = (m1 * v1 + m2 * v2) / mass, (nodes * step - parted) * parting + 2 * pair.RADIUS
    centre, masses = (m1 * q1 + m2 * q2) / mass + mean * nodes * step, np.array([m1, m2])
    size = max(m1 * abs(v1) + m2 * abs(v2), m1 * m2 / mass * parting)

    def momentum(t: np.ndarray, q: np.ndarray, v: np.ndarray) -> float:
        """Return the momentum [kg m/s] that differs most from the initial one.

        t: (nodes,) [s]; q, v: (nodes, 2) [m, m/s]. Raises nothing.
        """
        return float((v @ masses)[np.abs(v @ masses - mass * mean).argmax()])

    return TruthProblem(
        phenomenon=phenomenon, name=name,
        scene=_started("two_body_collision", start, m1=m1, m2=m2, k=k), duration=nodes * step,
        nodes=nodes,
        source="closed form: the centre of mass moves on, the distance swings half a period",
        position=position, velocity=parting, energy_kept=True,
        exact=(centre - m2 / mass * apart, centre + m1 / mass * apart, mean - m2 / mass * parting,
               mean + m1 / mass * parting),
        asks=(Ask(name="momentum", exact=mass * mean, scale=size, measure=momentum),),
    )  # fmt: skip


def contact_rate(m1: float, m2: float, k: float) -> float:
    """Return the frequency [rad/s] of two bodies [kg] on a spring [N/m].

    Raises ZeroDivisionError without mass.
    """
    return math.sqrt(k * (m1 + m2) / (m1 * m2))


def mass_ratio(ratio: float) -> TruthProblem:
    """Bodies of 1 kg and `ratio` [kg] meet; the coarsest step is a fifth of a radian of contact."""
    w, start = contact_rate(1.0, ratio, pair.STIFFNESS), (0.0, 2 * pair.RADIUS + 0.03, 2.0, -1.0)
    return _met(
        "mass ratio",
        f"1 to {ratio:g}",
        start,
        after=0.01,
        step=0.2 / w,
        position=pair.CLOSING_SPEED / w,
        m1=1.0,
        m2=ratio,
    )


def stiff(k: float) -> TruthProblem:
    """Bodies meet at 1 cm/s on a spring of k [N/m], at the same steps for every k."""
    gap, speed = 0.005, 0.01
    start = (0.0, 2 * pair.RADIUS + gap, speed / 2, -speed / 2)
    return _met(
        "stiffness at fixed step",
        f"k = {k:g} N/m, h = 4 to 0.5 ms",
        start,
        after=0.2,
        step=0.004,
        position=gap,
        k=k,
    )


def _overlap() -> TruthProblem:
    start = (0.0, 2 * pair.RADIUS - 0.05, 0.0, 0.0)
    return _met(
        "penetration at the start",
        "two bodies 5 cm into each other",
        start,
        after=0.17,
        step=0.002,
        position=0.1,
    )


def grazing(depth: float) -> TruthProblem:
    """A disc passes another at 1 m/s, this deep [m] (negative: beside it) at the middle node."""
    ahead, height = 0.05, math.sqrt((2 * RADIUS - depth) ** 2 - BLUR**2)
    # Scale: the impulse of 0.1 mm, some 5 mm/s.
    return TruthProblem(
        phenomenon="grazing contact", name=f"discs pass at a depth of {1e3 * depth:g} mm",
        duration=2 * ahead, nodes=50, source=INTEGRATED, u=(0.0, 0.0),
        scene=_started("two_discs", (-ahead, height, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)),
        position=5e-3 * ahead, velocity=5e-3, energy_kept=True,
    )  # fmt: skip


def squeeze() -> TruthProblem:
    """Two carts press a third from both sides for 2 s."""
    even = Ask(name="asymmetry", exact=0.0, scale=0.1, measure=lambda t, q, v: asymmetry(q, v))
    return TruthProblem(
        phenomenon="symmetric squeeze", name="two carts press a third",
        scene=load_scene("three_cart"), duration=2.0, nodes=200, source=INTEGRATED,
        u=(6.0, -6.0), position=0.1, velocity=0.5, asks=(even,),
    )  # fmt: skip


def _dying_bounces() -> TruthProblem:
    # A contact lasts 0.1 s; a twentieth of that resolves each one.
    scene = damped_floor(
        DampingLaw.KELVIN_VOIGT, 2.0 * 0.2 * math.sqrt(drop.STIFFNESS * drop.MASS)
    ).with_task(step=0.005)
    duration, nodes = 2.5, 5000
    t = uniform_grid(duration / nodes, nodes)
    states = true_motion(Equations(scene), [Piece(end=duration, u=np.zeros(0))], t)
    q, v = states[:, :1], states[:, 1:]
    third = int(np.flatnonzero((q[:-1] > 0.0) & (q[1:] <= 0.0))[1]) + 400
    return TruthProblem(
        phenomenon="dying bounces", name="damping ratio 0.2, until it rests", scene=scene,
        duration=duration, nodes=nodes, source=INTEGRATED,
        exact=tuple(states[-1]), position=0.1, velocity=0.5,
        asks=(
            Ask(name="time of rest", exact=last_fall(t, q, v), scale=1.0, measure=last_fall),
            Ask(name="height after two bounces", exact=float(q[third, 0]), scale=0.1,
                measure=lambda t, q, v: float(q[third, 0])),
        ),
    )  # fmt: skip


def ground(
    angle: float, mu: float, *, belt: float = 0.0, spring: float = 0.0, speed: float = 0.0
) -> Scene:
    """Return a block on a soft plane with friction, tilted by `angle` [rad], or on a belt.

    belt: its mass [kg], on a spring [N/m]. s: place along the plane, n: height above it. The block
    starts at its static depth, with this speed along the plane [m/s], as the belt.
    """
    s, n, b, v_s, v_n, v_b = sp.symbols("s n b v_s v_n v_b", real=True)
    m, g, tilt, k, mu_, m_b, k_s = sp.symbols("m g tilt k mu m_b k_s", positive=True)
    on_belt, g_n = belt > 0.0, drop.GRAVITY * math.cos(angle)
    values = [
        (m, 1.0, "kg"),
        (g, drop.GRAVITY, "m/s^2"),
        (tilt, angle, "rad"),
        (k, _PLANE, "N/m"),
        (mu_, mu, "1"),
    ]
    moving = [
        (s, v_s, "place of the block along the plane", 0.0, speed),
        (n, v_n, "its height above the plane", -g_n / _PLANE, 0.0),
    ]
    if on_belt:
        values += [(m_b, belt, "kg"), (k_s, spring, "N/m")]
        moving += [(b, v_b, "place of the belt", 0.0, speed)]
    start = (*(item[3] for item in moving), *(item[4] for item in moving))
    return Scene(
        name="belt" if on_belt else "ramp",
        title="A block on a moving belt" if on_belt else "A block on a ramp",
        source="Newton's second law",
        coordinates=tuple(
            Coordinate(symbol=q, velocity=v, unit="m", description=words)
            for q, v, words, _, _ in moving
        ),
        inputs=(),
        parameters=tuple(
            Parameter(symbol=item, value=value, unit=unit, lower=0.0, description=item.name)
            for item, value, unit in values
        ),
        kinetic_energy=m * (v_s**2 + v_n**2) / 2 + (m_b * v_b**2 / 2 if on_belt else 0),
        potential_energy=m * g * (n * sp.cos(tilt) - s * sp.sin(tilt))
        + (k_s * s**2 / 2 if on_belt else 0),
        forces=(sp.Integer(0),) * len(moving),
        contacts=(
            Contact(
                name="plane",
                bodies=("block", "plane"),
                penetration=-n,
                stiffness=k,
                depth=0.1,
                depth_reason="the height of the block",
                nominal=1e-3,
            ),
        ),
        frictions=(
            Friction(
                name="plane", slip=v_s - v_b if on_belt else v_s, coefficient=mu_, contact="plane"
            ),
        ),
        task=Task(
            start=start,
            goal=(None,) * (2 * len(moving)),
            running_cost=sp.Integer(0),
            step=0.01,
            steps=100,
        ),
    )


def _stop() -> TruthProblem:
    mu, speed = 0.4, 2.0
    distance = speed**2 / (2 * mu * drop.GRAVITY)
    return TruthProblem(
        phenomenon="stopping distance", name="a block slides to rest, mu = 0.4",
        scene=ground(0.0, mu, speed=speed), duration=0.8, nodes=80,
        position=distance, velocity=speed, source="closed form: v^2/(2 mu g)",
        exact=(distance, -drop.GRAVITY / _PLANE, 0.0, 0.0),
    )  # fmt: skip


def ramp(mu: float, share: float) -> TruthProblem:
    """A block on a ramp that needs `share` of the friction; errors in shares of the free motion."""
    angle, duration = math.atan(share * mu), 1.0
    down, on = drop.GRAVITY * math.sin(angle), drop.GRAVITY * math.cos(angle)
    rate, does = max(0.0, down - mu * on), "slides" if share > 1.0 else "sticks"
    return TruthProblem(
        phenomenon="ramp", name=f"mu = {mu:g}, tilted to {share:g} of its angle: it {does}",
        scene=ground(angle, mu), duration=duration, nodes=100,
        position=down * duration**2 / 2, velocity=down * duration,
        source="closed form: constant forces",
        exact=(rate * duration**2 / 2, -on / _PLANE, rate * duration, 0.0),
    )  # fmt: skip


def creep(mu: float) -> TruthProblem:
    """A block on a ramp at half of the largest friction."""
    return replace(
        ramp(mu, 0.5),
        phenomenon="creep under load",
        name=f"mu = {mu:g}, half of what friction holds",
    )


def _stick_slip() -> TruthProblem:
    speed = 0.2
    return TruthProblem(
        phenomenon="stick-slip", name="a block on a spring, on a belt of 100 kg",
        scene=ground(0.0, 0.3, belt=100.0, spring=100.0, speed=speed),
        duration=2.0, nodes=200, source=INTEGRATED, position=0.03, velocity=speed,
    )  # fmt: skip


def _bounces() -> TruthProblem:
    speed = math.sqrt(2 * drop.GRAVITY * HEIGHT)
    contact = (2 * math.pi - 2 * math.atan2(speed / drop.RATE, drop.SAG)) / drop.RATE

    def lost(t: np.ndarray, q: np.ndarray, v: np.ndarray) -> float:
        """Return the relative energy loss [-] at the pace of the first half, if half is lost.

        The whole loss alone would be equal at every step. t: (nodes,) [s]; q, v: (nodes, 1). Raises
        nothing.
        """
        share = abs(
            (
                v[:, 0] ** 2 / 2
                + drop.GRAVITY * q[:, 0]
                + drop.STIFFNESS / drop.MASS * np.minimum(q[:, 0], 0.0) ** 2 / 2
            )
            / (drop.GRAVITY * HEIGHT)
            - 1
        )
        gone = np.append(np.flatnonzero(share > 0.5), BOUNCES)[0]
        return float(share[gone] * BOUNCES / gone)

    return TruthProblem(
        phenomenon="energy over 1000 bounces", name="undamped",
        scene=_started("bouncing_mass", (HEIGHT, 0.0)), nodes=BOUNCES,
        duration=BOUNCES * (2 * speed / drop.GRAVITY + contact), source="closed form: none is lost",
        exact=(math.nan, math.nan), position=HEIGHT,
        velocity=speed, energy_kept=True, parts=tuple(50 * part for part in FOUR),
        asks=(Ask(name="energy lost by bounces", exact=0.0, scale=1.0, measure=lost),),
    )  # fmt: skip
