"""Entry point of the installed commands; its unique name allows reporting a clash of names."""

from __future__ import annotations

import importlib
import sys

from touchstone_annexes import is_present


def main(module: str = "validate.__main__") -> int | None:
    """Run `main` of a module; return 2 if it is missing or another package has one of our names."""
    try:
        import touchstone  # noqa: F401 - raises the error of a clash
    except ImportError as clash:
        print(clash, file=sys.stderr)
        return 2
    if not is_present(module):
        print(f"error: this installation has no {module}; install it again.", file=sys.stderr)
        return 2
    return importlib.import_module(module).main()


def mpec() -> int | None:
    """Run `touchstone-mpec`, the MPEC solver with AMPL's interface."""
    return main("formulations.ampl.command")
