"""Equations of a scene as MathML: any parser reads them, and a reader reads the equation that is meant."""

from xml.etree import ElementTree

import numpy as np
import pytest
import sympy as sp

from models.catalog import load_scene
from models.dynamics import derive
from reports.pages.scene import safe_mathml
from validate.tasks import scene_record as module
from validate.tasks.scene_record import equations, presentation, scene_record


def test_equations_are_mathml_the_report_accepts():
    for equation in scene_record(load_scene("three_cart")).equations:
        assert safe_mathml(equation.mathml) is not None
        assert ElementTree.fromstring(equation.mathml).tag.endswith("math")


def test_mathml_is_a_block_whose_signs_any_parser_reads():
    x, lam = sp.symbols("x lambda")
    text = presentation(sp.Lt(x, lam))
    assert "&lt;" in text
    assert safe_mathml(text) is not None
    root = ElementTree.fromstring(text)
    assert root.get("display") == "block"
    assert [item.text for item in root.iter() if item.text] == ["x", "<", "λ"]


def read_as_a_reader_does(element: ElementTree.Element) -> str:
    """An equation as Python: what stands beside each other in a row is one line, and only parentheses that are shown bind."""
    tag, parts = element.tag.rpartition("}")[2], [read_as_a_reader_does(child) for child in element]
    text = (element.text or "").strip()
    if tag == "mi":
        return text if text in ("sin", "cos", "sinh", "cosh", "log", "sign") else f"S[{text!r}]"
    if tag.startswith("msu") and "t+1" in element[-1].itertext():  # of the next step: no power
        return "S[" + repr("_".join("".join(child.itertext()) for child in element)) + "]"
    if tag in ("msub", "msubsup"):
        name = "S[" + repr("_".join("".join(child.itertext()) for child in list(element)[:2])) + "]"
        return name if tag == "msub" else f"{name}**({parts[2]})"
    made = {"msup": "{0}**({1})", "mfrac": "(({0})/({1}))", "msqrt": "sqrt({0})"}.get(tag)
    if made is not None:
        return made.format(*parts)
    return {"\u2062": "*", "\u00b7": "*"}.get(text, text) if tag in ("mo", "mn") else "".join(parts)


@pytest.mark.parametrize(
    "name", ["hopper", "hopper_planar", "two_finger_lift", "damped_collision", "three_cart"]
)
def test_an_equation_that_is_read_as_it_is_shown_is_the_equation(
    name: str, monkeypatch: pytest.MonkeyPatch
):
    shown: list[tuple[sp.Basic, str]] = []
    monkeypatch.setattr(
        module,
        "presentation",
        lambda expression: shown.append((expression, presentation(expression))) or "",
    )
    equations(derive(load_scene(name)))
    compared, rng = 0, np.random.default_rng(1)
    words = {
        "sin": np.sin,
        "cos": np.cos,
        "sinh": np.sinh,
        "cosh": np.cosh,
        "log": np.log,
        "sign": np.sign,
        "sqrt": np.sqrt,
        "max": max,
    }
    for equation, text in shown:
        if not isinstance(equation, sp.Eq) or equation.has(sp.Derivative, sp.Sum, sp.Abs):
            continue
        values = {
            symbol: rng.uniform(0.5, 1.5) for symbol in sorted(equation.free_symbols, key=str)
        }
        names = {
            read_as_a_reader_does(ElementTree.fromstring(presentation(symbol))): value
            for symbol, value in values.items()
        }
        assert len(names) == len(values), "two symbols look alike"
        read = read_as_a_reader_does(ElementTree.fromstring(text)).split("=")
        for side, said in zip(equation.args, read, strict=True):
            found = eval(said, {**words, "S": {name[3:-2]: value for name, value in names.items()}})
            assert found == pytest.approx(float(side.subs(values)), rel=1e-9), (equation, said)
        compared += 1
    assert compared >= 5
