"""Write DIR/report.html and its pages from records, or with `--single-file` one file.

python -m reports DIR
"""

from __future__ import annotations

import sys
from pathlib import Path

from reports.load import ReportError
from reports.render import write_report, write_single


def main(arguments: list[str]) -> int:
    """Return 0 if written, 2 if the folder is missing or cannot be written."""
    folders = [word for word in arguments if word != "--single-file"]
    if len(folders) != 1 or folders[0].startswith("-"):
        print(
            "usage: python -m reports [--single-file] DIR    (DIR holds campaign.json and runs/)",
            file=sys.stderr,
        )
        return 2
    write = write_single if "--single-file" in arguments else write_report
    try:
        print(write(Path(folders[0])))
    except ReportError as problem:
        print(problem, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
