"""The text and binary forms of a `.nl` file, with the same interface.

`code` and `values` read, `at_end` tests for the end, `place` is the position for messages.
"""

from __future__ import annotations

import struct
from pathlib import Path
from types import MappingProxyType
from typing import Any

from models.errors import TouchstoneError


class NlError(TouchstoneError):
    """A `.nl` file that is damaged, or that smooth Pyomo expressions cannot represent."""


class TextSource:
    """A text file: a code is the first character of a line.

    Its values follow there or on the next.
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
        """Return whether only empty lines remain."""
        while self._next < len(self._lines) and not self._lines[self._next].strip():
            self._next += 1
        return self._next >= len(self._lines)

    @property
    def place(self) -> str:
        """Return the current line, for messages."""
        return f"line {self._next}"

    def _line(self) -> str:
        if self._next >= len(self._lines):
            raise NlError(
                f"{self._file} ends after line {self._next}, where more should follow: the file is cut off. Write it again."
            )
        self._next += 1
        return self._lines[self._next - 1].partition("#")[0]

    def code(self) -> str:
        """Return the first character of the next line. Raises NlError at the end of the file."""
        line = self._line().lstrip()
        self._rest = line[1:]
        return line[:1]

    def values(self, form: str) -> list[Any]:
        """Return values: i integers, o operators, d numbers, s names; an empty form ends the line.

        Raises NlError for other values, with the position.
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
    """A binary file of either byte order."""

    number = MappingProxyType({"n": "d", "s": "h", "l": "i"})

    def __init__(self, file: Path, data: bytes, begin: int, order: str, operator: str) -> None:
        self._file, self._data, self._next = file, data, begin
        self._kinds = {
            kind: struct.Struct(order + letter)
            for kind, letter in {"i": "i", "h": "h", "d": "d", "o": operator}.items()
        }

    def at_end(self) -> bool:
        """Return whether no byte remains."""
        return self._next >= len(self._data)

    @property
    def place(self) -> str:
        """Return the next byte, for messages."""
        return f"byte {self._next}"

    def _take(self, count: int) -> bytes:
        if not 0 <= count <= len(self._data) - self._next:
            raise NlError(
                f"{self._file} ends at byte {len(self._data)}, in the middle of a value that begins at byte {self._next}: the file is cut off, or its "
                "byte order differs from its sixth line. Write it again."
            )
        self._next += count
        return self._data[self._next - count : self._next]

    def code(self) -> str:
        """Return the next byte as a character. Raises NlError at the end of the file."""
        return self._take(1).decode("latin-1")

    def values(self, form: str) -> list[Any]:
        """Return values as `TextSource` does; h is a short integer, a name starts with its length.

        Raises NlError at the end of the file.
        """
        values: list[Any] = []
        for kind in form:
            if kind == "s":
                values.append(self._take(self.values("i")[0]).decode("latin-1"))
            else:
                values += self._kinds[kind].unpack(self._take(self._kinds[kind].size))
        return values
