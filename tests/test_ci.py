"""The scripts of CI."""

import subprocess
import sys
from pathlib import Path

SCRIPT = Path(__file__).parents[1] / ".ci" / "closing_line.py"


def test_closing_line_sums_counts_and_seconds(tmp_path: Path):
    first, second, third = (tmp_path / name for name in ("first", "second", "third"))
    first.write_text(
        "...\n== 3 failed, 10 passed, 1 skipped, 5 deselected in 62.30s (0:01:02) ==\n"
    )
    second.write_text("20 passed, 1 skipped, 2 errors in 1.50s\n")
    third.write_text("the process was killed\n")
    done = subprocess.run(
        [sys.executable, str(SCRIPT), str(first), str(second), str(third)],
        capture_output=True,
        text=True,
        check=True,
    )
    line = done.stdout.strip("= \n")
    assert line == "3 failed, 30 passed, 2 skipped, 3 error in 63.80s (0:01:04)"
