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
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

OPENS, CLOSES = "\x01", "\x02"
_TOKEN = re.compile(f"{OPENS}(\\d+){CLOSES}")
_FIGURE = re.compile(r"<figure .*?</figure>", re.DOTALL)
_LINE = re.compile(r'(?<= d=")M-?[\d.]+,-?[\d.]+(?:L-?[\d.]+,-?[\d.]+)*(?=")')
_ANCHOR = re.compile(' id="([^"]+)"')
_ANCHOR_OR_TOKEN = re.compile(f' id="([^"]+)"|{_TOKEN.pattern}')


# What makes a text of these words, or finds the one it made of them before.
Kept = Callable[..., str]


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


def _anew(make: Callable[[], str], *_: str) -> str:
    return make()


class Parcels:
    """The parts of one page, by number."""

    def __init__(self) -> None:
        self._parts: list[tuple[str, str]] = []
        self._anchors: dict[int, tuple[str, ...]] = {}

    def keep(self, block: str, text: str) -> Token:
        """Takes a part, which may hold other parts, and gives the token that stands for it."""
        self._parts.append((block, text))
        return Token(f"{OPENS}{len(self._parts) - 1}{CLOSES}")

    @property
    def parts(self) -> tuple[tuple[str, str], ...]:
        """(block, text) of each part, by number."""
        return tuple(self._parts)

    def inline(self, text: str) -> str:
        """The text with each part in its place."""
        return _TOKEN.sub(lambda found: self.inline(self._parts[int(found[1])][1]), text)

    def folded(self, texts: Sequence[str], kept: Kept = _anew) -> tuple[list[str], list[Block]]:
        """The texts with a place for each part, and the blocks that hold the parts; kept: what packs a block, or finds it packed."""
        contents: dict[str, list[str]] = {}
        whole = [self._placed(text, contents) for text in texts]
        packed = [kept(lambda parts=parts: _packed(parts), "block", *parts) for parts in contents.values()]
        return whole, [Block(f"b{place}", text) for place, text in enumerate(packed)]

    def _placed(self, text: str, contents: dict[str, list[str]]) -> str:
        return _TOKEN.sub(lambda found: self._place(int(found[1]), contents), text)

    def _place(self, number: int, contents: dict[str, list[str]]) -> str:
        name, text = self._parts[number]
        # The place also says which anchors its part holds, those of parts inside it too: links lead there before it is unfolded.
        anchors = " ".join(dict.fromkeys(self._held(number)))
        parts = contents.setdefault(name, [])
        parts.append("")
        place = len(parts) - 1
        parts[place] = self._placed(text, contents)
        block = list(contents).index(name)
        return f'<div class="parcel" data-block="b{block}" data-part="{place}" data-holds="{anchors}"></div>'

    def _held(self, number: int) -> tuple[str, ...]:
        """The anchors in a part, in order, with those of the parts inside it."""
        if number not in self._anchors:
            found: list[str] = []
            text = self._parts[number][1]
            # Most parts hold no other: what begins with one fixed text is found far sooner than what begins with either of two.
            pairs = _ANCHOR_OR_TOKEN.findall(text) if OPENS in text else [(anchor, "") for anchor in _ANCHOR.findall(text)]
            for anchor, inner in pairs:
                found += self._held(int(inner)) if inner else (anchor,)
            self._anchors[number] = tuple(found)
        return self._anchors[number]


def _figure(text: str, content: _Contents) -> str:
    drawn = _LINE.sub(lambda found: f"#{content.lines.setdefault(found[0], len(content.lines))}", text)
    return f'<i data-figure="{content.figures.setdefault(drawn, len(content.figures))}"></i>'


def _packed(parts: Sequence[str]) -> str:
    """Length of the JSON (4 bytes, little-endian), the JSON, the lines; deflated."""
    content = _Contents()
    content.parts = [_FIGURE.sub(lambda found: _figure(found[0], content), part) for part in parts]
    words = json.dumps({"parts": content.parts, "figures": list(content.figures)}, ensure_ascii=False, separators=(",", ":")).encode()
    raw = len(words).to_bytes(4, "little") + words + line_bytes(content.lines)
    return base64.b64encode(zlib.compress(raw, 9)).decode()


def line_bytes(lines: Iterable[str]) -> bytes:
    """Paths "Mx,yLx,y.." as numbers of seven bits a byte: how many lines, how many points each, all x, all y as differences in fifths of a pixel."""
    lines = list(lines)
    counts = np.array([line.count(",") for line in lines], np.int64)
    text = ",".join(line[1:].replace("L", ",") for line in lines)
    places = np.rint(5 * np.array(list(map(float, text.split(","))) if lines else [])).astype(np.int64).reshape(-1, 2)
    # The first point of a line is told from nought, every other from the one before it.
    changes = np.diff(places, axis=0, prepend=0)
    begins = (np.cumsum(counts) - counts)[counts > 0]
    changes[begins] = places[begins]
    across, down = np.where(changes >= 0, 2 * changes, -2 * changes - 1).T  # 0, -1, 1, -2, 2 .. as 0, 1, 2, 3, 4 ..: small ones stay small
    return b"".join(_sevens(values) for values in (np.array([len(lines)]), counts, across, down))


def _sevens(values: NDArray[np.int64]) -> bytes:
    """Each number in bytes of seven bits, the lowest first; the eighth bit says that another follows."""
    steps = np.arange(0, max(int(values.max(initial=0)).bit_length(), 1), 7)
    rest = values[:, None] >> steps
    more = (rest >> 7) > 0
    return (rest & 127 | more * 128).astype(np.uint8)[(rest > 0) | (steps == 0)].tobytes()
