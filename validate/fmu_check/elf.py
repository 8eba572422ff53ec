"""What a shared library of Linux exports and needs, read from the file without loading it.

Layout: System V Application Binary Interface, chapters 4 and 5 (sections, symbol table, dynamic section).
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass

_HEADER = 52  # bytes of the shorter header, that of 32 bits
_CLASSES = {1: 32, 2: 64}
_MACHINES = {3: "x86", 62: "x86_64", 183: "aarch64"}
_DYNAMIC_SECTION, _SYMBOL_SECTION = 6, 11
_NEEDED, _UNDEFINED = 1, 0
_FUNCTION_KINDS = (2, 10)  # STT_FUNC, STT_GNU_IFUNC


class NotElf(ValueError):  # noqa: N818 - says what the file is not
    """The bytes are no ELF file that can be read."""


@dataclass(frozen=True)
class Library:
    """exported: names of functions; needed: other libraries; glibc: the newest version of the GNU C library it asks for ("" if none)."""

    bits: int
    machine: str
    exported: frozenset[str]
    needed: tuple[str, ...]
    glibc: str


def read_library(data: bytes) -> Library:
    """Raises NotElf."""
    if data[:4] != b"\x7fELF" or len(data) < _HEADER:
        raise NotElf("it does not begin like an ELF file")
    bits = _CLASSES.get(data[4], 0)
    order = {1: "<", 2: ">"}.get(data[5], "")
    if not bits or not order:
        raise NotElf("its class or byte order is unknown")
    try:
        return _read(data, bits, order)
    except (struct.error, IndexError, ValueError, OverflowError) as error:
        raise NotElf(f"its tables cannot be read ({error})") from error


def _read(data: bytes, bits: int, order: str) -> Library:
    wide = bits == 64
    (machine,) = struct.unpack_from(f"{order}H", data, 18)
    (table,) = struct.unpack_from(f"{order}{'Q' if wide else 'I'}", data, 40 if wide else 32)
    size, count, _ = struct.unpack_from(f"{order}HHH", data, 58 if wide else 46)
    header = f"{order}IIQQQQIIQQ" if wide else f"{order}IIIIIIIIII"
    sections = [struct.unpack_from(header, data, table + number * size) for number in range(count)]
    if sum(section[5] for section in sections if section[1] in (_DYNAMIC_SECTION, _SYMBOL_SECTION)) > len(data):
        raise NotElf("its tables are larger than the file")
    exported: set[str] = set()
    needed: list[str] = []
    texts = b""
    for _, kind, _, _, offset, length, link, _, _, entry in sections:
        if kind not in (_DYNAMIC_SECTION, _SYMBOL_SECTION):
            continue
        strings = data[sections[link][4] : sections[link][4] + sections[link][5]]
        texts = strings
        for at in range(offset, offset + length, entry):
            if kind == _SYMBOL_SECTION:
                name, info, section = _symbol(data, at, order, wide)
                if section != _UNDEFINED and info & 0xF in _FUNCTION_KINDS and info >> 4:
                    exported.add(_text(strings, name))
            else:
                tag, value = struct.unpack_from(f"{order}{'QQ' if wide else 'II'}", data, at)
                if tag == _NEEDED:
                    needed.append(_text(strings, value))
    versions = [tuple(map(int, item.split(b"."))) for item in re.findall(rb"\0GLIBC_([0-9.]+)(?=\0)", texts)]
    glibc = ".".join(map(str, max(versions))) if versions else ""
    return Library(bits, _MACHINES.get(machine, f"machine {machine}"), frozenset(exported), tuple(needed), glibc)


def _symbol(data: bytes, at: int, order: str, wide: bool) -> tuple[int, int, int]:
    """(name, info, section index) of a row of the symbol table."""
    if wide:
        name, info, _, section = struct.unpack_from(f"{order}IBBH", data, at)
    else:
        name, _, _, info, _, section = struct.unpack_from(f"{order}IIIBBH", data, at)
    return name, info, section


def _text(strings: bytes, at: int) -> str:
    return strings[at : strings.index(b"\0", at)].decode("utf-8")
