"""What a report weighs and how soon it can be used: CPU seconds to write it, bytes, and seconds until a headless Chromium answers.

    python benchmarks/bench_report.py runs/all [--browser chromium] [--axe axe.min.js]

Interactive: from the start of the navigation until the load event is over and the page has answered clicks on the matrix's head with a picture;
the median of five. Beside it stands what the page's main thread did meanwhile, in CPU seconds, and its tasks of more than 50 ms: where a busy
machine makes the clock useless, the CPU seconds still tell. With `--axe` also the violations of WCAG 2 A and AA that axe-core finds, light and
dark, at desk and phone width. Exit code 1 where a target is missed.
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
from reports.render import render, write_report

_TRIES = 5
# Targets: seconds until it is interactive, and size of the file [MB].
_PATIENCE, _SIZE = 2.0, 6.0
_READY = """(async () => {
  const tasks = [];
  new PerformanceObserver((list) => tasks.push(...list.getEntries())).observe({ type: "longtask", buffered: true });
  await new Promise((done) => document.readyState === "complete" ? done() : addEventListener("load", done));
  const head = document.querySelector("#matrix-table thead button");
  if (head) { head.click(); head.click(); head.click(); }
  await new Promise((done) => requestAnimationFrame(() => setTimeout(done)));
  const end = performance.now();
  await new Promise((done) => setTimeout(done, 100));
  const [visit] = performance.getEntriesByType("navigation");
  return {
    interactive: end / 1000, parsed: visit.domInteractive / 1000, loaded: visit.loadEventEnd / 1000,
    tasks: tasks.filter((task) => task.startTime < end).map((task) => [task.startTime / 1000, task.duration / 1000]),
  };
})()"""
# What the main thread's CPU seconds go to, as Chromium counts them.
_METRICS = {"TaskDuration": "in all", "ScriptDuration": "script", "LayoutDuration": "layout", "RecalcStyleDuration": "style"}


def _browser() -> ModuleType:
    place = Path(__file__).parent.parent / "tests" / "reports" / "browser.py"
    spec = importlib.util.spec_from_file_location("report_browser", place)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["report_browser"] = module
    spec.loader.exec_module(module)
    return module


def main() -> int:
    """0: every target is met; 1: not."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--browser", type=shutil.which, default=shutil.which("chromium") or shutil.which("google-chrome"))
    parser.add_argument("--axe", type=Path)
    parser.add_argument("--kept", action="store_true", help="look at the report that is there, without writing it")
    wanted = parser.parse_args()
    target = wanted.folder / "report.html"
    if not wanted.kept:
        began = time.process_time()
        stored = load(wanted.folder)
        read = time.process_time() - began
        began = time.process_time()
        render(wanted.folder)
        made = time.process_time() - began
        write_report(wanted.folder)
        began = time.process_time()
        target = write_report(wanted.folder)
        again = time.process_time() - began
        print(
            f"{len(stored.runs)} runs; CPU s: {read:.1f} reading them, {made:.1f} making the page of them, {again:.1f} the same again from what is kept"
        )
    size = target.stat().st_size / 1e6
    print(f"{size:.2f} MB (target {_SIZE:g})")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile, _browser().Browser(wanted.browser, Path(profile)) as browser:
        visits = []
        for _ in range(_TRIES):
            page = browser.open(target, metered=True)
            found = page.evaluate(_READY)
            found["cpu"] = {item["name"]: item["value"] for item in page.call("Performance.getMetrics")["metrics"]}
            visits.append((found["interactive"], len(page.requests) - 1, len(page.messages), found))
            page.call("Page.close")
        visits.sort(key=lambda visit: visit[0])
        median, _, _, told = visits[_TRIES // 2]
        asked, said = sum(visit[1] for visit in visits), sum(visit[2] for visit in visits)
        print(f"interactive after {', '.join(f'{visit[0]:.2f}' for visit in visits)} s, median {median:.2f} (target {_PATIENCE:g})")
        print(f"  of the median: parsed after {told['parsed']:.2f} s, loaded after {told['loaded']:.2f} s")
        spent = [f"{words} {told['cpu'].get(name, 0.0):.2f}" for name, words in _METRICS.items()]
        print(f"  CPU s of the main thread: {', '.join(spent)}")
        print(f"  tasks over 50 ms: {', '.join(f'{length:.2f} s at {start:.2f} s' for start, length in told['tasks']) or 'none'}")
        print(f"{asked} requests, {said} console messages")
        violations = 0
        for width, dark in ((1400, False), (1400, True), (375, False), (375, True)) if wanted.axe else ():
            page = browser.open(target, width=width, dark=dark)
            page.evaluate(wanted.axe.read_text(encoding="utf-8") + ";0")
            found = page.evaluate(
                "axe.run(document, {runOnly: ['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa', 'wcag22aa']}).then((r) => r.violations.map("
                "(v) => [v.id, v.nodes.length, v.nodes[0].html.slice(0, 160), v.nodes[0].failureSummary.slice(0, 200)]))"
            )
            violations += len(found)
            print(f"axe, {width} px, {'dark' if dark else 'light'}: {len(found)} violations")
            for one in found:
                print("  " + json.dumps(one, ensure_ascii=False))
    return int(median > _PATIENCE or size > _SIZE or asked + said + violations > 0)


if __name__ == "__main__":
    sys.exit(main())
