"""`python -m reports DIR` rebuilds DIR/report.html from its records, on a machine with no solver; with `--split` pages in DIR/report."""

from __future__ import annotations

import sys
from pathlib import Path

from reports.records.load import ReportError
from reports.render import write_report
from reports.split import write_pages


def main(arguments: list[str]) -> int:
    """0 written; 2 no such folder, or it cannot be written."""
    folders = [word for word in arguments if word != "--split"]
    if len(folders) != 1 or folders[0].startswith("-"):
        print("usage: python -m reports [--split] DIR    (DIR holds campaign.json and runs/)", file=sys.stderr)
        return 2
    write = write_pages if "--split" in arguments else write_report
    try:
        print(write(Path(folders[0])))
    except ReportError as problem:
        print(problem, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
