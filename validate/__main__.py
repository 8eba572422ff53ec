"""`python -m validate`, and the installed command `touchstone`."""

from __future__ import annotations

import atexit
import importlib
import os
import signal
import sys


def main(module: str = "validate.cli.group", program: str = "python -m validate") -> None:
    """The command line of a program, whose `group` of commands is in a module."""
    codes: list[int] = []
    atexit.register(_leave, codes)
    try:
        import touchstone  # noqa: F401 - says what else is called like one of our packages
    except ImportError as clash:
        sys.exit(_refused(str(clash)))
    try:
        from validate.cli.group import run

        code = run(sys.argv[1:], importlib.import_module(module).group, program)
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # all is written and told, and the exit code stays what it is
    except KeyboardInterrupt:  # before there was anything that hears it
        code = 130
    codes.append(code)
    sys.exit(code)


def _refused(sentence: str) -> int:
    print(sentence, file=sys.stderr)
    return 2


def _leave(codes: list[int]) -> None:
    """End at once, after all other exit handlers (they run in reverse order): taking SymPy apart object by object takes a tenth
    of a second, of 0.9 for a replay. An exception that was not caught, or output that cannot be written, ends as Python ends."""
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
