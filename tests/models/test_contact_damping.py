"""Contacts with damping: the closed forms derived, what a scene accepts, and that a scene without damping has nothing of it in its models."""

from dataclasses import replace
from pathlib import Path

import pytest
import sympy as sp
from wording import saying

from models.catalog import load_scene
from models.codegen.emit import for_scene
from models.codegen.kernel import kernel_sources
from models.dynamics import derive
from models.errors import SceneError
from models.fmu.description import find_standard
from models.fmu.package import fmu_texts
from models.scene import Scene
from models.scene.checks import check_expressions
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
    assert sp.simplify(sp.expand_trig(-phi.diff(t).subs(t, released)) / s - sp.exp(-2 * a / sp.tan(a))) == 0
    # from there it flies at that speed: phi / speed until phi = 0
    flight = sp.simplify(sp.expand_trig(phi.subs(t, released)) / (s * sp.exp(-2 * a / sp.tan(a))))
    assert sp.simplify(flight - 2 * sp.cos(a) / w) == 0
    # a contact that may pull is released at phi = 0
    assert sp.simplify(-phi.diff(t).subs(t, sp.pi / (w * sp.sin(a))) / s - sp.exp(-sp.pi / sp.tan(a))) == 0
    # the deepest point
    deepest = a / (w * sp.sin(a))
    assert sp.simplify(sp.expand_trig(phi.diff(t).subs(t, deepest))) == 0
    assert sp.simplify(phi.subs(t, deepest) - s / w * sp.exp(-a / sp.tan(a))) == 0


def test_the_restitution_of_hunt_crossley_is_derived():
    v, d = sp.symbols("v d", positive=True)
    # m v dv/dphi = -k phi (1 + d v): v/(1 + d v) dv = -(k/m) phi dphi, whose left side integrates to F
    primitive = (d * v - sp.log(1 + d * v)) / d**2
    assert sp.simplify(primitive.diff(v) - v / (1 + d * v)) == 0
    # phi = 0 before and after: F(v_in) = F(-v_out), that is y - ln y = x - ln x with y = 1 + d v_in, x = 1 - d v_out
    y = sp.Float(1.78)
    x = -sp.LambertW(-y * sp.exp(-y))
    assert float((y - sp.log(y)) - (x - sp.log(x))) == pytest.approx(0.0, abs=1e-14)
    assert 0 < float(x) < 1 < float(y)


def test_the_scene_has_the_derived_numbers():
    module = damped_collision
    values = {w: module.RATE, s: module.CLOSING_SPEED, a: module.ANGLE}
    released = module.CONTACT_TIME - 2 * sp.cos(module.ANGLE) / module.RATE
    assert float(-swing().diff(t).subs(t, released).subs(values)) == pytest.approx(module.RESTITUTION * module.CLOSING_SPEED, rel=1e-12)
    deepest = module.ANGLE / (module.RATE * sp.sin(module.ANGLE))
    assert float(swing().subs(t, deepest).subs(values)) == pytest.approx(module.COMPRESSION, rel=1e-12)
    before = module.MASS_1 * module.START[2] + module.MASS_2 * module.START[3]
    after = module.MASS_1 * module.V1_BETWEEN + module.MASS_2 * module.V2_AFTER
    assert after == pytest.approx(before, abs=1e-14)


def contact(**changes: object) -> Scene:
    base = load_scene("bouncing_mass")
    return replace(base, contacts=(replace(base.contacts[0], **changes),))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"damping": -1, "damping_law": DampingLaw.HUNT_CROSSLEY}, "the damping is -1 … s/m, but must not be negative"),
        ({"damping": sp.Symbol("c")}, "contact floor: damping uses c … neither a parameter nor"),
        ({"damping": "soft"}, "contact floor: damping … SymPy expression or a number, not str"),
    ],
)
def test_a_wrong_damping_is_one_sentence(changes: dict, words: str):
    with pytest.raises(SceneError, match=saying(words)):
        check_expressions(contact(**changes))


def texts(scene: Scene) -> dict[str, str]:
    found = {f"{version}/{name}": text for version in ("2.0", "3.0") for name, text in fmu_texts(scene, find_standard(version)).items()}
    return found | {f"kernel/{name}": text for name, text in kernel_sources(scene).items()}


@pytest.mark.parametrize("name", ["three_cart", "bouncing_mass", "transport"])
def test_undamped_scene_has_no_damping_code(name: str):
    scene = load_scene(name)
    written = texts(scene)
    for place, text in written.items():
        own = text.replace("(inputs, damping)", "")
        for word in ("damped", "damping", "pressing", "_rate_vjp") if "sources" in place or "kernel" in place else ("pressing",):
            assert word not in own.lower().replace("hardly damped", "").replace("scene_slip_rate_vjp", ""), (place, word)
    assert not derive(scene).structure.contact_damping
    # a coefficient of 0 is no damping: the same bytes
    zero = replace(scene, contacts=tuple(replace(item, damping=sp.S.Zero, damping_law=DampingLaw.HUNT_CROSSLEY) for item in scene.contacts))
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
        replace(base, parameters=(*base.parameters, replace(base.parameters[0], symbol=sp.Symbol("pressing_pair", positive=True))))
