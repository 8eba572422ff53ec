"""The two forms of a `.nl` file, read by the same three verbs: `code`, `values`, `at_end`.

`place` says where in the file that is.
"""

from __future__ import annotations

import struct
from pathlib import Path
from types import MappingProxyType
from typing import Any

from models.errors import TouchstoneError


class NlError(TouchstoneError):
    """A `.nl` file that cannot be read: damaged, or with what Pyomo's smooth expressions cannot say."""


class TextSource:
    """Lines of a text file: a code is a line's first character.

    Its values follow on that line, or are a line of their own.
    """

    number = MappingProxyType({"n": "d", "s": "i", "l": "i"})
    _read = MappingProxyType({"i": int, "o": int, "d": float, "s": str})
    _names = MappingProxyType(
        {"i": "a whole number", "o": "an operator's number", "d": "a number", "s": "a name"}
    )

    def __init__(self, file: Path, data: bytes, lines: int) -> None:
        self._file, self._next = file, lines
        self._lines = data.decode("latin-1").splitlines()
        self._rest: str | None = None

    def at_end(self) -> bool:
        """Whether nothing is left but empty lines."""
        while self._next < len(self._lines) and not self._lines[self._next].strip():
            self._next += 1
        return self._next >= len(self._lines)

    @property
    def place(self) -> str:
        """The line that was read last, for messages."""
        return f"line {self._next}"

    def _line(self) -> str:
        if self._next >= len(self._lines):
            raise NlError(
                f"{self._file} ends after line {self._next}, where more should follow: the file is cut off. Write it anew."
            )
        self._next += 1
        return self._lines[self._next - 1].partition("#")[0]

    def code(self) -> str:
        """The first character of the next line. Raises NlError at the end of the file."""
        line = self._line().lstrip()
        self._rest = line[1:]
        return line[:1]

    def values(self, form: str) -> list[Any]:
        """Numbers and names: i whole, o an operator's, d any, s a name; none: the line is done.

        Raises NlError for others, with the place.
        """
        line = self._line() if self._rest is None else self._rest
        self._rest = None
        words = line.split()
        try:
            return [
                self._read[kind](word) for kind, word in zip(form, words[: len(form)], strict=True)
            ]
        except ValueError:
            wanted = ", ".join(self._names[kind] for kind in form)
            raise NlError(
                f"{self._file}, {self.place}: {wanted} should stand here, not '{line.strip()}'. The file is damaged."
            ) from None


class BinarySource:
    """The same of a binary file, of either byte order."""

    number = MappingProxyType({"n": "d", "s": "h", "l": "i"})

    def __init__(self, file: Path, data: bytes, begin: int, order: str, operator: str) -> None:
        self._file, self._data, self._next = file, data, begin
        self._kinds = {
            kind: struct.Struct(order + letter)
            for kind, letter in {"i": "i", "h": "h", "d": "d", "o": operator}.items()
        }

    def at_end(self) -> bool:
        """Whether no byte is left."""
        return self._next >= len(self._data)

    @property
    def place(self) -> str:
        """The byte that is read next, for messages."""
        return f"byte {self._next}"

    def _take(self, count: int) -> bytes:
        if not 0 <= count <= len(self._data) - self._next:
            raise NlError(
                f"{self._file} ends at byte {len(self._data)}, in the middle of a value that begins at byte {self._next}: the file is cut off, or of "
                "another byte order than its sixth line says. Write it anew."
            )
        self._next += count
        return self._data[self._next - count : self._next]

    def code(self) -> str:
        """The next byte as a character. Raises NlError at the end of the file."""
        return self._take(1).decode("latin-1")

    def values(self, form: str) -> list[Any]:
        """The same numbers and names, h a short one; a name begins with its length.

        Raises NlError at the end of the file.
        """
        found: list[Any] = []
        for kind in form:
            if kind == "s":
                found.append(self._take(self.values("i")[0]).decode("latin-1"))
            else:
                found += self._kinds[kind].unpack(self._take(self._kinds[kind].size))
        return found
