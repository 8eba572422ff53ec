"""What a large page keeps folded: parts of its text, compressed in blocks, which the page's script unfolds when they are opened or scrolled to.

    parcels = Parcels();  token = parcels.keep("three_cart", "<p>..</p>")
    parcels.inline(f"<main>{token}</main>")   the page with every part in its place: a small page, and each page of a split report
    parcels.folded([f"<main>{token}</main>"])  the page with empty places, and the blocks that fill them

Both tell the same: unfolding gives back the text, character by character. Figures that several parts share are kept once a block, and the
points of lines as differences of pixels, which take a fifth of their text. No part can be taken for another's place: tokens hold two control
characters that no text of a record may bring onto the page (`render` removes them).
"""

from __future__ import annotations

import base64
import json
import re
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from markupsafe import Markup

OPENS, CLOSES = "\x01", "\x02"
_TOKEN = re.compile(f"{OPENS}(\\d+){CLOSES}")
_FIGURE = re.compile(r"<figure .*?</figure>", re.DOTALL)
_LINE = re.compile(r'(?<= d=")M-?[\d.]+,-?[\d.]+(?:L-?[\d.]+,-?[\d.]+)*(?=")')
_ANCHOR = re.compile(r' id="([^"]+)"')


class Token(Markup):
    """Markup in which parts stand as tokens."""

    __slots__ = ()


@dataclass(frozen=True)
class Block:
    """`text`: base64 of the deflated parts of one name."""

    name: str
    text: str


@dataclass
class _Contents:
    """What one block holds; figures and lines are told by their numbers."""

    parts: list[str] = field(default_factory=list)
    figures: dict[str, int] = field(default_factory=dict)
    lines: dict[str, int] = field(default_factory=dict)


class Parcels:
    """The parts of one page, by number."""

    def __init__(self) -> None:
        self._parts: list[tuple[str, str]] = []

    def keep(self, block: str, text: str) -> Token:
        """Takes a part, which may hold other parts, and gives the token that stands for it."""
        self._parts.append((block, text))
        return Token(f"{OPENS}{len(self._parts) - 1}{CLOSES}")

    def inline(self, text: str) -> str:
        """The text with each part in its place."""
        return _TOKEN.sub(lambda found: self.inline(self._parts[int(found[1])][1]), text)

    def folded(self, texts: Sequence[str]) -> tuple[list[str], list[Block]]:
        """The texts with a place for each part, and the blocks that hold the parts."""
        contents: dict[str, _Contents] = {}
        whole = [self._placed(text, contents) for text in texts]
        return whole, [Block(f"b{place}", _packed(one)) for place, one in enumerate(contents.values())]

    def _placed(self, text: str, contents: dict[str, _Contents]) -> str:
        return _TOKEN.sub(lambda found: self._place(int(found[1]), contents), text)

    def _place(self, number: int, contents: dict[str, _Contents]) -> str:
        name, text = self._parts[number]
        # The place also says which anchors its part holds, those of parts inside it too: links lead there before it is unfolded.
        anchors = " ".join(dict.fromkeys(_ANCHOR.findall(self.inline(text))))
        content = contents.setdefault(name, _Contents())
        content.parts.append("")
        place = len(content.parts) - 1
        content.parts[place] = _FIGURE.sub(lambda found: _figure(found[0], content), self._placed(text, contents))
        block = list(contents).index(name)
        return f'<div class="parcel" data-block="b{block}" data-part="{place}" data-holds="{anchors}"></div>'


def _figure(text: str, content: _Contents) -> str:
    drawn = _LINE.sub(lambda found: f"#{content.lines.setdefault(found[0], len(content.lines))}", text)
    return f'<i data-figure="{content.figures.setdefault(drawn, len(content.figures))}"></i>'


def _packed(content: _Contents) -> str:
    """Length of the JSON (4 bytes, little-endian), the JSON, the lines; deflated."""
    words = json.dumps({"parts": content.parts, "figures": list(content.figures)}, ensure_ascii=False, separators=(",", ":")).encode()
    raw = len(words).to_bytes(4, "little") + words + line_bytes(content.lines)
    return base64.b64encode(zlib.compress(raw, 9)).decode()


def line_bytes(lines: Iterable[str]) -> bytes:
    """Paths "Mx,yLx,y.." as numbers of seven bits a byte: how many lines, how many points each, all x, all y as differences in fifths of a pixel."""
    counts, across, down = bytearray(), bytearray(), bytearray()
    amount = 0
    for line in lines:
        points = line[1:].split("L")
        amount += 1
        _append(counts, len(points))
        before_x = before_y = 0
        for point in points:
            x, y = (round(5 * float(part)) for part in point.split(","))
            _append(across, _unsigned(x - before_x))
            _append(down, _unsigned(y - before_y))
            before_x, before_y = x, y
    head = bytearray()
    _append(head, amount)
    return bytes(head + counts + across + down)


def _unsigned(value: int) -> int:
    """0, -1, 1, -2, 2 .. as 0, 1, 2, 3, 4 ..: small differences stay small numbers."""
    return 2 * value if value >= 0 else -2 * value - 1


def _append(target: bytearray, value: int) -> None:
    while value > 127:
        target.append(value & 127 | 128)
        value >>= 7
    target.append(value)
