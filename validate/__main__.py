"""`python -m validate`, and the installed command `touchstone`."""

from __future__ import annotations

import atexit
import gc
import importlib
import os
import signal
import sys
from pathlib import Path

# New objects after which Python looks for cycles among them, instead of 700.
_OBJECTS = 200_000


def main(module: str = "validate.cli.group") -> None:
    """The command line of a program, whose `group` of commands is in a module."""
    # Importing SymPy makes 10^5 objects that stay; looking for cycles among them again and again
    # takes a quarter of its time (0.13 s of 0.53).
    gc.set_threshold(_OBJECTS)
    codes: list[int] = []
    atexit.register(_leave, codes)
    try:
        import touchstone  # says what else is called like one of our packages
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
        )  # all is written and told, and the exit code stays what it is
    except KeyboardInterrupt:  # before there was anything that hears it
        code = 130
    codes.append(code)
    sys.exit(code)


def _typed(module: str) -> str:
    """The program as it was called: `python3 -m validate`, or `touchstone`."""
    name = Path(sys.argv[0]).name
    return name if name != "__main__.py" else f"{sys.orig_argv[0]} -m {module.partition('.')[0]}"


def _refused(sentence: str, code: int = 2) -> int:
    print(sentence, file=sys.stderr)
    return code


def _leave(codes: list[int]) -> None:
    """End at once, after all other exit handlers (they run in reverse order).

    Taking SymPy apart object by object takes a tenth of a second, of 0.9 for a replay. An exception
    that was not caught, or output that cannot be written, ends as Python ends.
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
