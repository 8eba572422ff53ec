"""What a report weighs and how soon it can be used: CPU seconds to write it, bytes, and seconds until a headless Chromium answers.

    python benchmarks/bench_report.py runs/all [--browser chromium] [--axe axe.min.js]

Interactive: from the start of the navigation until the load event is over and the page answers a click on the matrix's head. With `--axe` also
the violations of WCAG 2 A and AA that axe-core finds, light and dark, at desk and phone width.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import shutil
import sys
import tempfile
import time
from pathlib import Path
from types import ModuleType

from reports.load import load
from reports.render import write_report

_TRIES = 3
_READY = """(async () => {
  await new Promise((done) => document.readyState === "complete" ? done() : addEventListener("load", done));
  const head = document.querySelector("#matrix-table thead button");
  if (head) { head.click(); head.click(); head.click(); }
  await new Promise((done) => requestAnimationFrame(() => setTimeout(done)));
  return performance.now();
})()"""


def _browser() -> ModuleType:
    place = Path(__file__).parent.parent / "tests" / "reports" / "browser.py"
    spec = importlib.util.spec_from_file_location("report_browser", place)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["report_browser"] = module
    spec.loader.exec_module(module)
    return module


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--browser", default=shutil.which("chromium") or shutil.which("google-chrome"))
    parser.add_argument("--axe", type=Path)
    parser.add_argument("--kept", action="store_true", help="look at the report that is there, without writing it")
    wanted = parser.parse_args()
    target = wanted.folder / "report.html"
    if not wanted.kept:
        began = time.process_time()
        stored = load(wanted.folder)
        read = time.process_time() - began
        began = time.process_time()
        target = write_report(wanted.folder)
        print(f"{len(stored.runs)} runs; reading them takes {read:.1f} CPU s, reading and writing {time.process_time() - began:.1f}")
    print(f"{target.stat().st_size / 1e6:.2f} MB")
    with tempfile.TemporaryDirectory() as profile, _browser().Browser(wanted.browser, Path(profile)) as browser:
        seconds = []
        for _ in range(_TRIES):
            page = browser.open(target)
            seconds.append(page.evaluate(_READY) / 1000)
        print(f"interactive after {', '.join(f'{value:.2f}' for value in seconds)} s")
        print(f"{len(page.requests) - 1} requests, {len(page.messages)} console messages")
        for width, dark in ((1400, False), (1400, True), (375, False), (375, True)) if wanted.axe else ():
            page = browser.open(target, width=width, dark=dark)
            page.evaluate(wanted.axe.read_text(encoding="utf-8") + ";0")
            found = page.evaluate(
                "axe.run(document, {runOnly: ['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa', 'wcag22aa']}).then((r) => r.violations.map("
                "(v) => [v.id, v.nodes.length, v.nodes[0].html.slice(0, 160), v.nodes[0].failureSummary.slice(0, 200)]))"
            )
            print(f"axe, {width} px, {'dark' if dark else 'light'}: {len(found)} violations")
            for one in found:
                print("  " + json.dumps(one, ensure_ascii=False))


if __name__ == "__main__":
    main()
