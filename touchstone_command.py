"""The installed commands `touchstone` and `touchstone-mpec` begin here, under a name that no other package has, so that a clash of names is told in a sentence."""

from __future__ import annotations

import importlib
import sys


def main(module: str = "validate.__main__") -> int | None:
    """Run the command whose `main` is in a module.

    Exit code 2 where another package is called like one of ours.
    """
    try:
        import touchstone  # noqa: F401 - says what is called so
    except ImportError as clash:
        print(clash, file=sys.stderr)
        return 2
    return importlib.import_module(module).main()


def mpec() -> int | None:
    """`touchstone-mpec`: the MPEC solver as AMPL calls its solvers."""
    return main("formulations.ampl.command")
