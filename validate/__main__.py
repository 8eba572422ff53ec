"""`python -m validate`, and the installed command `touchstone`."""

from __future__ import annotations

import atexit
import gc
import importlib
import os
import signal
import sys
from pathlib import Path

# New objects between two searches for reference cycles (Python's default: 700).
_OBJECTS = 200_000


def main(module: str = "validate.cli.group") -> None:
    """Run the command line of a program. module: contains the program's `group` of commands."""
    # Importing SymPy creates 10^5 permanent objects. Repeated searches for cycles among them take a
    # quarter of its time (0.13 s of 0.53 s).
    gc.set_threshold(_OBJECTS)
    codes: list[int] = []
    atexit.register(_leave, codes)
    try:
        import touchstone  # raises if another module shadows one of our packages
    except ImportError as clash:
        sys.exit(_refused(str(clash)))
    try:
        try:
            from validate.cli.group import run

            group = importlib.import_module(module).group
        except ModuleNotFoundError as error:
            if (why := touchstone.not_installed(error)) is None:
                raise
            sys.exit(_refused(f"error: {why}", 3))
        code = run(sys.argv[1:], group, _typed(module))
        signal.signal(
            signal.SIGINT, signal.SIG_IGN
        )  # all output is written; the exit code does not change
    except KeyboardInterrupt:  # before an interrupt handler was installed
        code = 130
    codes.append(code)
    sys.exit(code)


def _typed(module: str) -> str:
    """Return the program as it was called: `python3 -m validate`, or `touchstone`."""
    name = Path(sys.argv[0]).name
    return name if name != "__main__.py" else f"{sys.orig_argv[0]} -m {module.partition('.')[0]}"


def _refused(sentence: str, code: int = 2) -> int:
    print(sentence, file=sys.stderr)
    return code


def _leave(codes: list[int]) -> None:
    """End the process at once, after all other exit handlers (they run in reverse order).

    Freeing SymPy's objects takes 0.1 s, of 0.9 s for a replay. An uncaught exception or output that
    cannot be written ends as in Python.
    """
    if not codes:
        return
    try:
        sys.stdout.flush()
        sys.stderr.flush()
    except (OSError, ValueError):
        return
    os._exit(codes[0])


if __name__ == "__main__":
    main()
