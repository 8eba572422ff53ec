"""Import a scene file and its neighbour modules, and digest all user sources that it uses.

    with loading(path):  # `import parts` finds parts.py in the file's folder
        spec.loader.exec_module(module)
        loaded_sources()  # digest of the file and of the user modules imported so far

Neighbour modules are read from source and forgotten afterwards: files in two folders may each have
a `parts.py`.
"""

from __future__ import annotations

import ast
import importlib.machinery
import sys
import sysconfig
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from functools import lru_cache
from importlib.machinery import FileFinder, ModuleSpec, PathFinder
from pathlib import Path
from types import CodeType, ModuleType
from typing import TypeVar

from models.errors import SceneError, UnknownNameError

_Said = TypeVar("_Said")
_OURS = ("models", "formulations", "validate", "reports")
# Before Python 3.11.8 parallel parsers corrupt a shared depth counter (CPython issue 106905).
_PARSING = threading.Lock()


class Afresh(importlib.machinery.SourceFileLoader):
    """Load a file from source, because bytecode may be stale within a second of a change."""

    def get_code(self, fullname: str) -> CodeType:
        """Return the code of the current file."""
        path = self.get_filename(fullname)
        return self.source_to_code(self.get_data(path), path)


class _Beside:
    """Find modules in a folder and its packages.

    A folder without __init__ yields to an equally named module elsewhere.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.found: set[str] = set()

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        entries = (
            [str(self._folder)]
            if path is None
            else [entry for entry in path if Path(entry).is_relative_to(self._folder)]
        )
        for entry in entries:
            spec = FileFinder(entry, (Afresh, [".py"])).find_spec(name, target)
            if (
                spec is not None
                and spec.loader is None
                and (elsewhere := PathFinder.find_spec(name, path, target)) is not None
            ):
                return elsewhere
            if spec is not None:
                self.found.add(name)
                return spec
        return None


# The files in execution, each imported by the previous one.
_NOW: ContextVar[tuple[Path, ...]] = ContextVar("files", default=())


@contextmanager
def loading(path: Path) -> Iterator[None]:
    """Execute the file `path` inside this context. Raises SceneError for a circular load."""
    if path in _NOW.get():
        raise SceneError(
            f"it loads itself ({' -> '.join(file.name for file in (*_NOW.get(), path))}); a scene is made of what is there before it."
        )
    finder, before, token = (
        _Beside(path.parent),
        frozenset(sys.modules),
        _NOW.set((*_NOW.get(), path)),
    )
    sys.meta_path.insert(0, finder)
    try:
        yield
    finally:
        sys.meta_path.remove(finder)
        _NOW.reset(token)
        for name in finder.found - before:
            sys.modules.pop(name, None)


def loaded_sources() -> str:
    """Return the digest of the executed file and of all user modules, or "" outside `loading`."""
    if not _NOW.get():
        return ""
    sources = {"": _NOW.get()[-1].read_bytes()}
    for name, module in tuple(sys.modules.items()):
        # multiprocessing's second name of __main__.
        if name == "__mp_main__":
            continue
        origin = getattr(module, "__file__", None)
        if origin is None or name.partition(".")[0] in _OURS:
            continue
        path = Path(origin).resolve()
        if path.is_file() and not any(path.is_relative_to(folder) for folder in _installed()):
            sources[name] = path.read_bytes()
    import hashlib  # 3 ms of OpenSSL

    digests = (
        f"{name} {hashlib.sha256(content).hexdigest()}" for name, content in sorted(sources.items())
    )
    return hashlib.sha256("\n".join(digests).encode()).hexdigest()


@lru_cache(maxsize=1)
def _installed() -> tuple[Path, ...]:
    folders = {sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib")}
    folders |= {
        entry for entry in sys.path if Path(entry).name in {"site-packages", "dist-packages"}
    }
    return tuple(Path(folder).resolve() for folder in folders if folder)


def declared(path: Path, name: str, kind: type[_Said]) -> _Said:
    """Read `NAME = Kind(...)` with literal arguments from one of our files, without importing it.

    Raises UnknownNameError if there is none.
    """
    text = path.read_text(encoding="utf-8")
    begin = text.find(f"\n{name} = {kind.__name__}(")
    if begin >= 0:
        # Parsing the whole file took a sixth of `list`.
        with _PARSING:
            node = ast.parse(text[begin:]).body[0]
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Call):
            return kind(
                **{
                    word.arg: ast.literal_eval(word.value)
                    for word in node.value.keywords
                    if word.arg
                }
            )
    raise UnknownNameError(
        f"{path.name}: it must define {name} = {kind.__name__}(...) with literals."
    )
