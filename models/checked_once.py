"""Checks that take long and say the same of an equal scene every time: what passed is noted in the cache folder, and passes again at once.

    with remembering(path.read_bytes()):    # while a scene's file is loaded
        checked_once(scene, check)          # raises what `check` raises

A note is named by, and holds, the digest of the scene's whole text, of its file (which may define functions of its own), of our sources that check
it, and of the versions of SymPy and Python. Where none can be kept or read, everything is checked. Only files are remembered: of scenes made by the thousand, each with other numbers, notes would be litter.
"""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import lru_cache
from pathlib import Path

import sympy as sp

from models.errors import MachineError
from models.scene import Scene
from models.scene_text import scene_text

_MODELS = Path(__file__).parent
# Digest of the file that is loaded; empty while there is none.
_FILE: ContextVar[str] = ContextVar("file", default="")


@contextmanager
def remembering(file: bytes) -> Iterator[None]:
    """Inside, what passes is noted, as of a file of this content."""
    before = _FILE.set(hashlib.sha256(file).hexdigest())
    try:
        yield
    finally:
        _FILE.reset(before)


def checked_once(scene: Scene, check: Callable[[Scene], None]) -> None:
    """Check a scene, unless an equal one is known to have passed. Raises what `check` raises."""
    if not _FILE.get():
        check(scene)
        return
    from models.codegen.cache import cached

    text = "\n".join([check.__qualname__, sp.__version__, platform.python_version(), _sources(), _FILE.get(), scene_text(scene)])
    digest = hashlib.sha256(text.encode()).hexdigest()

    def note(path: Path) -> None:
        check(scene)
        path.write_text(digest, encoding="ascii")

    try:
        known = cached(text, ".checked", note).read_bytes() == digest.encode()
    except (MachineError, OSError):  # no cache folder, or one that takes nothing
        known = False
    if not known:
        check(scene)


@lru_cache(maxsize=1)
def _sources() -> str:
    """Digest of the code that checks, and of all it is made of."""
    return hashlib.sha256(b"\0".join(path.read_bytes() for path in sorted(_MODELS.glob("*.py")))).hexdigest()
