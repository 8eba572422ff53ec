"""`python -m validate`, and the installed command `touchstone`."""

from __future__ import annotations

import importlib
import signal
import sys


def main(module: str = "validate.cli.group", program: str = "python -m validate") -> None:
    """The command line of a program, whose `group` of commands is in a module."""
    try:
        from validate.cli.group import run

        code = run(sys.argv[1:], importlib.import_module(module).group, program)
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # all is written and told, and the exit code stays what it is
    except KeyboardInterrupt:  # before there was anything that hears it
        code = 130
    sys.exit(code)


if __name__ == "__main__":
    main()
