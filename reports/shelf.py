"""Parts of a report that cost much to make, kept beside the campaign under the digest of all that they are made of.

    shelf = Shelf(folder);  shelf.text("section", digest_of_the_record)  ->  the text, or None;  shelf.put(text, "section", digest_of_the_record)

A name also holds the digest of this room's files and of what they stand on, so nothing is found again after a change of them. Every file begins
with the digest of its own content: one that is cut short or damaged is as none. The folder DIR/.told may be removed at any time.
"""

from __future__ import annotations

import contextlib
import hashlib
import zlib
from collections.abc import Callable
from functools import cached_property
from pathlib import Path

from reports.kept import code_digest

PLACE = ".told"
_DIGEST_BYTES = 32


class Shelf:
    """What is kept of one campaign's folder; `used` are the names that were asked for or put."""

    def __init__(self, folder: Path) -> None:
        self.place = folder / PLACE
        self.used: set[str] = set()

    def text(self, *made_of: str) -> str | None:
        """What was put under these words, or None."""
        try:
            found = (self.place / self._name(made_of)).read_bytes()
            packed = found[_DIGEST_BYTES:]
            if hashlib.sha256(packed).digest() == found[:_DIGEST_BYTES]:
                return zlib.decompress(packed).decode("utf-8")
        except (OSError, ValueError, zlib.error):  # none, or damaged
            pass
        return None

    def put(self, text: str, *made_of: str) -> None:
        """Keep a text under these words; a folder that takes nothing more is no reason to fail."""
        packed = zlib.compress(text.encode("utf-8", errors="replace"), 1)
        with contextlib.suppress(OSError):
            self.place.mkdir(exist_ok=True)
            (self.place / self._name(made_of)).write_bytes(hashlib.sha256(packed).digest() + packed)

    def kept(self, make: Callable[[], str], *made_of: str) -> str:
        """What was put under these words, or what is made now and put there."""
        found = self.text(*made_of)
        if found is None:
            found = make()
            self.put(found, *made_of)
        return found

    def tidy(self) -> None:
        """Remove what nobody asked for since this shelf was opened: it is of records or of a program that are no more."""
        with contextlib.suppress(OSError):
            for path in self.place.iterdir():
                if path.name not in self.used:
                    path.unlink()

    def _name(self, made_of: tuple[str, ...]) -> str:
        whole = hashlib.sha256(self._code.encode())
        for word in made_of:
            whole.update(hashlib.sha256(word.encode("utf-8", "surrogatepass")).digest())
        name = whole.hexdigest()
        self.used.add(name)
        return name

    @cached_property
    def _code(self) -> str:
        return code_digest()
