"""Contact laws: closed forms, no overflow, refusal where they have no meaning.

damping, and when a contact releases.
"""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import sympy as sp

from models.catalog import load_scene
from models.codegen.emit import for_scene
from models.codegen.kernel import kernel_sources, load_kernel
from models.contact_law import (
    ContactLaw,
    RelaxationError,
    contact_force,
    sharpness,
    worst_case_violation,
)
from models.dynamics import derive
from models.errors import SceneError
from models.fmu.description import find_standard
from models.fmu.package import fmu_texts
from models.scene import Scene
from models.scene.contacts import DampingLaw
from models.scenes import damped_collision

t, w, s, a = sp.symbols("t w s a", positive=True)


def swing() -> sp.Expr:
    """phi(t) of phi'' + 2 z w phi' + w^2 phi = 0 from phi = 0 at the speed s, z = cos a."""
    return s / (w * sp.sin(a)) * sp.exp(-sp.cos(a) * w * t) * sp.sin(w * sp.sin(a) * t)


@pytest.mark.slow
def test_the_restitutions_of_kelvin_voigt_are_derived():
    phi = swing()
    assert sp.simplify(phi.diff(t, 2) + 2 * sp.cos(a) * w * phi.diff(t) + w**2 * phi) == 0
    assert phi.subs(t, 0) == 0
    assert sp.simplify(phi.diff(t).subs(t, 0)) == s
    # without adhesion: the force mu (2 z w phi' + w^2 phi) = -mu phi'' is gone at w t sin a = 2 a
    released = 2 * a / (w * sp.sin(a))
    assert sp.simplify(sp.expand_trig(phi.diff(t, 2).subs(t, released))) == 0
    assert (
        sp.simplify(sp.expand_trig(-phi.diff(t).subs(t, released)) / s - sp.exp(-2 * a / sp.tan(a)))
        == 0
    )
    # from there it flies at that speed: phi / speed until phi = 0
    flight = sp.simplify(sp.expand_trig(phi.subs(t, released)) / (s * sp.exp(-2 * a / sp.tan(a))))
    assert sp.simplify(flight - 2 * sp.cos(a) / w) == 0
    # a contact that may pull is released at phi = 0
    assert (
        sp.simplify(-phi.diff(t).subs(t, sp.pi / (w * sp.sin(a))) / s - sp.exp(-sp.pi / sp.tan(a)))
        == 0
    )
    # the deepest point
    deepest = a / (w * sp.sin(a))
    assert sp.simplify(sp.expand_trig(phi.diff(t).subs(t, deepest))) == 0
    assert sp.simplify(phi.subs(t, deepest) - s / w * sp.exp(-a / sp.tan(a))) == 0


def test_the_restitution_of_hunt_crossley_is_derived():
    v, d = sp.symbols("v d", positive=True)
    # m v dv/dphi = -k phi (1 + d v): v/(1 + d v) dv = -(k/m) phi dphi, whose left side integrates
    # to F
    primitive = (d * v - sp.log(1 + d * v)) / d**2
    assert sp.simplify(primitive.diff(v) - v / (1 + d * v)) == 0
    # phi = 0 before and after: F(v_in) = F(-v_out), that is y - ln y = x - ln x with y = 1 + d
    # v_in, x = 1 - d v_out
    y = sp.Float(1.78)
    x = -sp.LambertW(-y * sp.exp(-y))
    assert float((y - sp.log(y)) - (x - sp.log(x))) == pytest.approx(0.0, abs=1e-14)
    assert 0 < float(x) < 1 < float(y)


def test_the_scene_has_the_derived_numbers():
    module = damped_collision
    values = {w: module.RATE, s: module.CLOSING_SPEED, a: module.ANGLE}
    released = module.CONTACT_TIME - 2 * sp.cos(module.ANGLE) / module.RATE
    assert float(-swing().diff(t).subs(t, released).subs(values)) == pytest.approx(
        module.RESTITUTION * module.CLOSING_SPEED, rel=1e-12
    )
    deepest = module.ANGLE / (module.RATE * sp.sin(module.ANGLE))
    assert float(swing().subs(t, deepest).subs(values)) == pytest.approx(
        module.COMPRESSION, rel=1e-12
    )
    before = module.MASS_1 * module.START[2] + module.MASS_2 * module.START[3]
    after = module.MASS_1 * module.V1_BETWEEN + module.MASS_2 * module.V2_AFTER
    assert after == pytest.approx(before, abs=1e-14)


def texts(scene: Scene) -> dict[str, str]:
    found = {
        f"{version}/{name}": text
        for version in ("2.0", "3.0")
        for name, text in fmu_texts(scene, find_standard(version)).items()
    }
    return found | {f"kernel/{name}": text for name, text in kernel_sources(scene).items()}


@pytest.mark.parametrize("name", ["three_cart", "bouncing_mass", "transport"])
def test_undamped_scene_has_no_damping_code(name: str):
    scene = load_scene(name)
    written = texts(scene)
    for place, text in written.items():
        own = text.replace("(inputs, damping)", "")
        for word in (
            ("damped", "damping", "pressing", "_rate_vjp")
            if "sources" in place or "kernel" in place
            else ("pressing",)
        ):
            assert word not in own.lower().replace("hardly damped", "").replace(
                "scene_slip_rate_vjp", ""
            ), (place, word)
    assert not derive(scene).structure.contact_damping
    # a coefficient of 0 is no damping: the same bytes
    zero = replace(
        scene,
        contacts=tuple(
            replace(item, damping=sp.S.Zero, damping_law=DampingLaw.HUNT_CROSSLEY)
            for item in scene.contacts
        ),
    )
    assert texts(zero) == written


def test_a_scene_with_damping_has_all_of_the_sources():
    scene = load_scene("damped_collision")
    for text in ("a\n#ifdef DAMPING\nb\n#if X\nc\n#endif\n#else\nd\n#endif\ne\n", "DAMPED(a;)\n"):
        assert for_scene(scene, text) == text


def test_for_scene_removes_exactly_the_damping_sections():
    scene = load_scene("three_cart")
    text = "a\n\n#ifdef DAMPING\nb\n#if X\nc\n#else\nc2\n#endif\n#else\nd\n#endif\n    DAMPED(e;)\n\nf\n#ifndef DAMPING\ng\n#endif\n#if X\nh\n#endif\n"
    assert for_scene(scene, text) == "a\n\nd\n\nf\ng\n#if X\nh\n#endif\n"


def test_every_hand_written_source_closes_its_sections():
    folder = Path(__file__).parents[2] / "models"
    for path in [*(folder / "fmu" / "shell").iterdir(), folder / "codegen" / "rollout.c"]:
        kept = for_scene(load_scene("three_cart"), path.read_text(encoding="utf-8"))
        assert "DAMP" not in kept or path.name == "damping_modes.h", path.name
        assert kept.count("#if") == kept.count("#endif"), path.name


def test_contacts_of_one_name_with_the_name_of_a_push():
    base = load_scene("damped_collision")
    with pytest.raises(SceneError, match="the name 'pressing_pair' is used 2 times"):
        replace(
            base,
            parameters=(
                *base.parameters,
                replace(base.parameters[0], symbol=sp.Symbol("pressing_pair", positive=True)),
            ),
        )


K = 30.0


def test_relu_is_the_true_law():
    assert contact_force(np.array([-1.0, 0.0, 0.5]), K).tolist() == [0.0, 0.0, 15.0]


@pytest.mark.parametrize("eps", [0.999, 0.1, 1e-3, 1e-16, 1e-300])
def test_softplus_is_finite_above_relu_and_right_far_away(eps: float):
    phi = np.array([-1e3, -1.0, 0.0, 1.0, 1e3])
    lam = contact_force(phi, K, ContactLaw.SOFTPLUS, eps)
    assert np.isfinite(lam).all()
    assert (lam >= contact_force(phi, K) * (1 - 1e-15)).all()  # k/b times b*phi rounds
    assert lam[2] == pytest.approx(K * math.log(2) / sharpness(eps), rel=1e-15)
    assert lam[4] == pytest.approx(
        K * (1e3 + math.log1p(math.exp(-1e3 * sharpness(eps))) / sharpness(eps)), rel=1e-15
    )


@pytest.mark.parametrize(
    "eps", [0.0, 1.0, -1e-3, 2.0, float("nan"), float("inf"), "1e-3", True, None]
)
def test_meaningless_eps_is_refused(eps: object):
    with pytest.raises(RelaxationError, match="0 < eps < 1"):
        sharpness(eps)  # pyright: ignore[reportArgumentType] - the mistake under test


def test_worst_case_violation_of_the_paper():
    """PAPER erratum 4: D = (k ln2 / ln eps)^2."""
    for eps, expected in ((1e-3, 9.0619), (1e-5, 3.2623), (1e-7, 1.6644), (1e-9, 1.0069)):
        assert worst_case_violation(K, eps) == pytest.approx(expected, abs=5e-5)


def test_eps_is_counted_in_the_length_of_the_scene():
    """The same eps on a scene a tenth as large reaches a tenth as far: forces and distances shrink alike, and so does what it violates at most."""
    phi = np.linspace(-0.3, 0.1, 9)
    large = contact_force(phi, 30.0, ContactLaw.SOFTPLUS, 1e-3)
    small = contact_force(phi / 10.0, 30.0, ContactLaw.SOFTPLUS, 1e-3, length=0.1)
    assert small == pytest.approx(large / 10.0, rel=1e-14)
    assert sharpness(1e-3, 0.1) == pytest.approx(10.0 * sharpness(1e-3), rel=1e-15)
    assert worst_case_violation(30.0, 1e-3, 0.1) == pytest.approx(
        worst_case_violation(30.0, 1e-3) / 100.0, rel=1e-14
    )


STEP = 5e-7  # s: of a contact of 0.07 s; the step is of first order, w h = 3e-5
TOLERANCE = 1e-4


def touching(ratio: float) -> tuple[Scene, float]:
    """The two discs at the touch, closing, with damping ratio z = ratio, and how long half a damped swing takes [s]."""
    scene = load_scene("damped_collision")
    values = {parameter.name: parameter.value for parameter in scene.parameters}
    mass = values["m1"] * values["m2"] / (values["m1"] + values["m2"])
    rate = math.sqrt(values["k"] / mass)
    scene = replace(scene, answers=(), limits=()).with_parameters(
        c=2.0 * ratio * math.sqrt(values["k"] * mass)
    )
    return scene.with_task(start=(1.0, 1.0 + 2.0 * values["r"], 2.1, -1.0), step=STEP), math.pi / (
        rate * math.sqrt(1.0 - ratio**2)
    )


def glued(scene: Scene) -> Scene:
    """The same spring and damper between the discs, as a force that also pulls; no contact."""
    pair = scene.contacts[0]
    moved = dict(
        zip(
            (item.symbol for item in scene.coordinates),
            (item.velocity for item in scene.coordinates),
            strict=True,
        )
    )
    rate = sum(sp.diff(pair.penetration, q) * v for q, v in moved.items())
    push = pair.stiffness * pair.penetration + pair.damping * rate
    return replace(
        scene,
        contacts=(),
        forces=tuple(
            force + sp.diff(-pair.penetration, q) * push
            for force, q in zip(scene.forces, moved, strict=True)
        ),
    )


def restitution(scene: Scene, seconds: float, radius: float) -> float:
    """Speed at which phi comes back to zero, over the closing speed."""
    steps = round(1.6 * seconds / STEP)
    found = load_kernel(scene).rollout(np.array(scene.task.start), np.zeros((steps, 0)), STEP)
    phi = 2.0 * radius - (found.q[:, 1] - found.q[:, 0])
    last = 10 + int(
        np.argmax(phi[10:] <= 0.0)
    )  # the first node after the contact; glued discs swing on
    assert 1000 < last < steps, "the contact is over within the motion"
    return float((found.v[last, 1] - found.v[last, 0]) / (found.v[0, 0] - found.v[0, 1]))


@pytest.mark.parametrize("z", [0.05, 0.2, 0.5])
def test_a_contact_that_may_pull_is_released_at_phi_0_and_loses_more(z: float):
    scene, seconds = touching(z)
    radius = next(parameter.value for parameter in scene.parameters if parameter.name == "r")
    pulling, ours = restitution(glued(scene), seconds, radius), restitution(scene, seconds, radius)
    angle = math.acos(z)
    assert pulling == pytest.approx(math.exp(-math.pi * z / math.sqrt(1.0 - z**2)), rel=TOLERANCE)
    assert ours == pytest.approx(math.exp(-2.0 * angle / math.tan(angle)), rel=TOLERANCE)
    assert pulling < ours - 0.01 * z
