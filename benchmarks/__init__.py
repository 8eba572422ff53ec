"""What is measured about touchstone and what it is tried on, from a checkout of the sources: `python -m benchmarks --help`, docs/benchmarks.md.

A benchmark stores its figures in DIR/NAME.json (`records`). Nothing that is shipped knows this
folder.
"""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).resolve().parents[1]


def module_at(path: str) -> ModuleType:
    """The module in a file, such as `tests/reports/browser.py`. Raises ImportError."""
    place = ROOT / path
    spec = importlib.util.spec_from_file_location(f"checkout_{place.stem}", place)
    if spec is None or spec.loader is None:
        raise ImportError(str(place))
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def find_modules_in(folder: str) -> None:
    """Let modules of a folder be imported by their names, in children too."""
    sys.path.insert(0, str(ROOT / folder))
