"""`python -m reports DIR` rebuilds DIR/report.html from its records, on a machine with no solver."""

from __future__ import annotations

import sys
from pathlib import Path

from reports.load import ReportError
from reports.render import write_report


def main(arguments: list[str]) -> int:
    """0 written; 2 no such folder, or it cannot be written."""
    if len(arguments) != 1 or arguments[0].startswith("-"):
        print("usage: python -m reports DIR    (DIR holds campaign.json and runs/)", file=sys.stderr)
        return 2
    try:
        print(write_report(Path(arguments[0])))
    except ReportError as problem:
        print(problem, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
