"""Print one closing line of pytest for several logs: counts and seconds summed."""

import re
import sys
from collections import Counter
from pathlib import Path

CLOSING = re.compile(r"^=* ?((?:\d+ [a-z]+,? ?)+) in ([\d.]+)s", re.MULTILINE)
SHOWN = ("failed", "passed", "skipped", "xfailed", "xpassed", "warning", "error")


def main(logs: list[str]) -> str:
    """Return the summed line. A log without a closing line counts as an error."""
    counts, seconds = Counter[str](), 0.0
    for log in logs:
        found = CLOSING.findall(Path(log).read_text(encoding="utf-8", errors="replace"))
        if not found:
            counts["error"] += 1
            continue
        words, duration = found[-1]
        seconds += float(duration)
        for number, word in re.findall(r"(\d+) ([a-z]+)", words):
            counts[word.removesuffix("s") if word in ("errors", "warnings") else word] += int(
                number
            )
    shown = ", ".join(f"{counts[word]} {word}" for word in SHOWN if counts[word])
    minutes, rest = divmod(round(seconds), 60)
    line = f" {shown} in {seconds:.2f}s ({minutes // 60}:{minutes % 60:02}:{rest:02}) "
    return f"{line:=^80}"


if __name__ == "__main__":
    print(main(sys.argv[1:]))
