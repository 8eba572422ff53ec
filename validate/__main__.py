"""`python -m validate`, and the installed command `touchstone`."""

from __future__ import annotations

import signal
import sys


def main() -> None:
    try:
        from validate.cli.group import run

        code = run(sys.argv[1:])
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # all is written and told, and the exit code stays what it is
    except KeyboardInterrupt:  # before there was anything that hears it
        code = 130
    sys.exit(code)


if __name__ == "__main__":
    main()
