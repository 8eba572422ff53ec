"""`python -m validate`, and the installed command `touchstone`."""

from __future__ import annotations

import sys


def main() -> None:
    from validate.cli.group import run

    sys.exit(run(sys.argv[1:]))


if __name__ == "__main__":
    main()
