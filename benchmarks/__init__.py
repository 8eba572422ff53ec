"""What is measured about touchstone and what it is tried on, from a checkout of the sources: `python -m benchmarks --help`, docs/benchmarks.md.

A benchmark leaves its figures in DIR/NAME.json (`records`), and `page` tells all of them on one page. Nothing that is shipped knows this folder.
"""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
