"""Lets presentation MathML from a record through, and nothing else: known elements, harmless attributes, text escaped again."""

from __future__ import annotations

from xml.etree import ElementTree

from markupsafe import Markup, escape

from reports.wording import clean

_NAMESPACE = "{http://www.w3.org/1998/Math/MathML}"
# fmt: off
_ELEMENTS = frozenset(
    {
        "math", "mrow", "mi", "mn", "mo", "mtext", "mspace", "ms", "mfrac", "msqrt", "mroot", "mstyle", "merror", "mpadded",
        "mphantom", "mfenced", "menclose", "msub", "msup", "msubsup", "munder", "mover", "munderover", "mmultiscripts", "mtable",
        "mtr", "mtd", "mlabeledtr",
    }
)
_ATTRIBUTES = frozenset(
    {
        "display", "mathvariant", "stretchy", "fence", "separator", "lspace", "rspace", "linethickness", "accent", "accentunder",
        "form", "open", "close", "separators", "columnalign", "rowalign", "columnspacing", "rowspacing", "width", "height", "depth",
        "largeop", "movablelimits", "displaystyle", "scriptlevel", "notation",
    }
)
# fmt: on
# Deeper than any equation, shallower than what would exhaust the stack.
_DEEPEST, _LONGEST = 60, 200_000
# A hyphen is no minus sign, and the double-struck d of derivatives is in few fonts.
_SIGNS = {"-": "−", "ⅆ": "d", "&dd;": "d"}


def safe_mathml(text: str) -> Markup | None:
    """The equation as markup, or None if it is not MathML that this page can trust (show it as text then)."""
    if len(text) > _LONGEST or "<!" in text or "<?" in text:
        return None
    try:
        root = ElementTree.fromstring(clean(text))
    except (ElementTree.ParseError, ValueError, RecursionError):
        return None
    if _name(root) != "math":
        return None
    inside = _markup(root, 0)
    return None if inside is None else Markup(inside)


def _name(element: ElementTree.Element) -> str:
    return element.tag.removeprefix(_NAMESPACE) if isinstance(element.tag, str) else ""


def _markup(element: ElementTree.Element, depth: int) -> str | None:
    name = _name(element)
    if name not in _ELEMENTS or depth > _DEEPEST:
        return None
    attributes = "".join(f' {key}="{escape(value)}"' for key, value in element.attrib.items() if key in _ATTRIBUTES)
    parts = [f"<{name}{attributes}>", str(escape(_SIGNS.get(element.text or "", element.text or "")))]
    for child in element:
        inside = _markup(child, depth + 1)
        if inside is None:
            return None
        parts += [inside, str(escape(child.tail or ""))]
    return "".join([*parts, f"</{name}>"])
