"""What a report weighs and how soon it can be used: CPU seconds to write it, bytes, and seconds until a headless Chromium answers.

Interactive: from the start of the navigation until the load event is over and the page has drawn
    itself again after it was scrolled to its index;
the median of five. Beside it stands what the page's main thread did meanwhile, in CPU seconds, and
    its tasks of more than 50 ms: where a busy
machine makes the clock useless, the CPU seconds still tell. Exit code 1 where a target is missed.
"""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

import click

from benchmarks import module_at
from benchmarks.measure import timed
from benchmarks.options import campaign_argument
from reports.load import load
from reports.render import PAGES, render, write_report

_TRIES = 5
# Targets: seconds until it is interactive, and size of the file [MB].
_PATIENCE = 0.5
_SIZE = 0.6
_READY = """(async () => {
  const tasks = [];
  new PerformanceObserver((list) => tasks.push(...list.getEntries())).observe({ type: "longtask", buffered: true });
  await new Promise((done) => document.readyState === "complete" ? done() : addEventListener("load", done));
  const index = document.querySelector("#index");
  if (index) index.scrollIntoView();
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
_METRICS = {
    "TaskDuration": "in all",
    "ScriptDuration": "script",
    "LayoutDuration": "layout",
    "RecalcStyleDuration": "style",
}


def _program(context: click.Context, parameter: click.Parameter, name: str | None) -> str | None:
    """A program by its path, or by its name if the shell finds it."""
    if name is not None and shutil.which(name) is None:
        raise click.BadParameter(f"there is no program {name}.", context, parameter)
    return name


@click.command()
@campaign_argument
@click.option(
    "--browser", callback=_program,
    default=lambda: shutil.which("chromium") or shutil.which("google-chrome"), metavar="PROGRAM",
    help="Chromium, if it is elsewhere.",
)  # fmt: skip
@click.option("--kept", is_flag=True, help="Look at the report that is there, without writing it.")
def command(folder: Path, browser: str | None, kept: bool) -> int:
    """What the report of a campaign in FOLDER weighs, and seconds until a headless Chromium answers; exit code 1 where a target is missed."""
    if browser is None:
        raise click.UsageError("there is no Chromium on this machine; give one with --browser.")
    browser_of = module_at("tests/reports/browser.py").Browser
    target = folder / "report.html"
    if not kept:
        stored, read = timed(lambda: load(folder))
        _, made = timed(lambda: render(folder))
        shutil.rmtree(folder / PAGES, ignore_errors=True)
        target, whole = timed(lambda: write_report(folder, 1))
        _, again = timed(lambda: write_report(folder, 1))
        click.echo(
            f"{len(stored.runs)} runs; CPU s: {read:.1f} reading them, {made:.1f} with report.html, {whole:.1f} with all pages, {again:.1f} again"
        )
    size = target.stat().st_size / 1e6
    click.echo(f"{size:.2f} MB (target {_SIZE:g})")
    with (
        tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile,
        browser_of(browser, Path(profile)) as opened,
    ):
        visits = []
        for _ in range(_TRIES):
            page = opened.open(target, metered=True)
            found = page.evaluate(_READY)
            found["cpu"] = {
                item["name"]: item["value"]
                for item in page.call("Performance.getMetrics")["metrics"]
            }
            visits.append((found["interactive"], len(page.requests) - 1, len(page.messages), found))
            page.call("Page.close")
        visits.sort(key=lambda visit: visit[0])
        median, _, _, told = visits[_TRIES // 2]
        asked, said = sum(visit[1] for visit in visits), sum(visit[2] for visit in visits)
        click.echo(
            f"interactive after {', '.join(f'{visit[0]:.2f}' for visit in visits)} s, median {median:.2f} (target {_PATIENCE:g})"
        )
        click.echo(
            f"  of the median: parsed after {told['parsed']:.2f} s, loaded after {told['loaded']:.2f} s"
        )
        spent = [f"{words} {told['cpu'].get(name, 0.0):.2f}" for name, words in _METRICS.items()]
        click.echo(f"  CPU s of the main thread: {', '.join(spent)}")
        click.echo(
            f"  tasks over 50 ms: {', '.join(f'{length:.2f} s at {start:.2f} s' for start, length in told['tasks']) or 'none'}"
        )
        click.echo(f"{asked} requests, {said} console messages")
    return int(median > _PATIENCE or size > _SIZE or asked + said > 0)
