"""Modules that a scene's file imports from beside it, and the digest of a file with all it imported that anybody may change.

    # `import parts` finds parts.py beside the file, whatever the folder one works in
    with loading(path):
        spec.loader.exec_module(module)
        # digest of the file and of the modules of somebody's own that are imported by now
        loaded_sources()

Modules from beside it are read as they are, never from kept bytecode, and forgotten afterwards: two
files in two folders may each have a `parts.py`.
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
# before Python 3.11.8 two threads that parse spoil each other's count of depth (CPython issue
# 106905)
_PARSING = threading.Lock()


class Afresh(importlib.machinery.SourceFileLoader):
    """Reads the file itself, never kept bytecode: that of a file written twice within a second, to the same length, is taken for its own."""

    def get_code(self, fullname: str) -> CodeType:
        """The code of the file as it is now."""
        path = self.get_filename(fullname)
        return self.source_to_code(self.get_data(path), path)


class _Beside:
    """Finds modules in a folder, and what lies in packages there.

    A folder that only bears a name yields to a module of that name elsewhere.
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


# The files that are executed now, each on behalf of the one before it.
_NOW: ContextVar[tuple[Path, ...]] = ContextVar("files", default=())


@contextmanager
def loading(path: Path) -> Iterator[None]:
    """Inside, the file `path` is executed as Python; see the module docstring.

    Raises SceneError where it is executed already.
    """
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
    """Digest of the file that is executed now and of all modules that belong neither to Python nor to an installed package; empty where there is none."""
    if not _NOW.get():
        return ""
    sources = {"": _NOW.get()[-1].read_bytes()}
    for name, module in tuple(sys.modules.items()):
        if (
            name == "__mp_main__"
        ):  # the second name of __main__, since somebody imported multiprocessing
            continue
        origin = getattr(module, "__file__", None)
        if origin is None or name.partition(".")[0] in _OURS:
            continue
        path = Path(origin).resolve()
        if path.is_file() and not any(path.is_relative_to(folder) for folder in _installed()):
            sources[name] = path.read_bytes()
    import hashlib  # 3 ms of OpenSSL, which who only asks what is declared does without

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
    """What a file of ours says of itself, without importing it: NAME = Kind(...), whose arguments are literals. Raises UnknownNameError where it says nothing."""
    text = path.read_text(encoding="utf-8")
    begin = text.find(f"\n{name} = {kind.__name__}(")
    if begin >= 0:
        # All of a file is not parsed: that took a sixth of `list`.
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
