"""Speed, side by side: each stage beside what people would use instead, and the figures that were set as targets."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from types import SimpleNamespace

from benchmarks.pages.chart import Point, chart
from benchmarks.records import AnyRecord, SuiteFigure, SuiteRecord, SuiteRow, middle, spread
from reports.pages.section import Section
from reports.plots import Plot
from reports.wording import Sign, count, error, listing, number, seconds, spaced, times

OURS = "touchstone"
MET = Sign("met", "✓", "holds", "the median is at most the target")
MISSED = Sign("missed", "✗", "violates", "the median is above the target")
UNJUDGED = Sign(
    "not judged", "○", "noplan", "not measured, or not at the size that the target is set for"
)
# The stages that a chain of collocation is made of; the last two come once an iteration.
_ONCE = ("pyomo_build", "translate")
_EACH = ("evaluate", "linear_algebra")
_OF_CHAIN = ("chain_against_casadi", "chain_against_drake", "pyomo_share")


def build(records: Sequence[AnyRecord]) -> Section | None:
    """The section, or None where no suite ran."""
    views = [_view(record) for record in records if isinstance(record, SuiteRecord)]
    return (
        Section("suite", "Speed, side by side", "suite.html", {"views": views}) if views else None
    )


def _view(record: SuiteRecord) -> SimpleNamespace:
    """One file of the suite.

    A line is a row of the table of stages, with its time by ours, of a peer.
    """
    figures = [_shown(figure, record) for figure in record.figures]
    ours = {
        (row.stage, row.n, row.steps): middle(row.cpu_s) for row in record.rows if row.by == OURS
    }
    lines = [
        SimpleNamespace(
            row=row, seconds=middle(row.cpu_s), spread=spread(row.cpu_s),
            memory=middle(row.memory_mib),
            factor=_factor(row, ours.get((row.stage, row.n, row.steps))),
        )
        for row in record.rows
    ]  # fmt: skip
    return SimpleNamespace(
        record=record,
        figures=figures,
        lines=lines,
        plot=_plot(record.rows),
        sentence=_sentence(record),
        busy=_busy(record),
    )


def _shown(figure: SuiteFigure, record: SuiteRecord) -> SimpleNamespace:
    """A figure: measured, range and target in words.

    profile: of a missed one, what its time was spent on.
    """
    sign = UNJUDGED if figure.met is None else MET if figure.met else MISSED
    low, high = (min(figure.samples), max(figure.samples)) if figure.samples else (None, None)
    size = (
        f"n\u00a0=\u00a0{figure.n}" + (f", T\u00a0=\u00a0{figure.steps}" if figure.steps else "")
        if figure.n
        else ""
    )
    span = f"{number(low, 3)} – {number(high, 3)}" if number(low, 3) != number(high, 3) else ""
    profile = _profile(figure, record.rows) if figure.met is False else ""
    return SimpleNamespace(
        figure=figure, size=size, measured=number(figure.measured, 3), span=span,
        target=f"{number(figure.target, 3)} {figure.unit}".strip(),
        sign=sign, profile=profile,
    )  # fmt: skip


def _profile(figure: SuiteFigure, rows: Iterable[SuiteRow]) -> str:
    """Where our time went, from the stages that were measured beside it."""
    here = {
        row.stage: row
        for row in rows
        if row.by == OURS and (row.n, row.steps) == (figure.n, figure.steps)
    }
    if figure.name == "gd_against_pytorch":
        return _profile_of_two(
            here,
            "gd_iteration",
            "gd_kernel",
            "compiled rollout and adjoint",
            "loss, history, stopping rule and step, in PyTorch",
        )
    if figure.name == "replay_against_fmpy":
        return _profile_of_two(
            here,
            "cs_replay",
            "cs_calls",
            "the calls, with one internal step each",
            "the other internal steps, in the FMU's own C",
        )
    if figure.name == "eps_step":
        return _profile_of_step(here)
    chain = here.get("softplus_chain") if figure.name in _OF_CHAIN else None
    whole = None if chain is None else middle(chain.cpu_s)
    if chain is None or whole is None:
        return ""
    told = []
    for stage in (*_ONCE, *_EACH):
        spent = middle(here[stage].cpu_s) if stage in here else None
        if spent is not None and stage in _EACH:
            told.append(
                f"{spaced(stage)} {chain.iterations} × {error(spent)} s = {seconds(chain.iterations * spent)} s"
            )
        elif spent is not None:
            told.append(f"{spaced(stage)} {seconds(spent)} s")
    return f"Of its {seconds(whole)} CPU s: {listing(told)}." if told else ""


def _profile_of_two(here: dict[str, SuiteRow], stage: str, part: str, words: str, rest: str) -> str:
    """A stage and a part of it that was measured by itself."""
    whole, known = (middle(here[name].cpu_s) if name in here else None for name in (stage, part))
    if whole is None or known is None:
        return ""
    return f"Of its {error(1e6 * whole)} µs: {words} {error(1e6 * known)} µs; the rest is {rest}."


def _profile_of_step(here: dict[str, SuiteRow]) -> str:
    """What the warm start saved, and what of the cold way is not iterations."""
    step, cold = here.get("eps_step"), here.get("cold_step")
    spent, whole = (None if row is None else middle(row.cpu_s) for row in (step, cold))
    if step is None or cold is None or spent is None or whole is None:
        return ""
    once = [middle(here[stage].cpu_s) for stage in _ONCE if stage in here]
    built = sum(seconds_of for seconds_of in once if seconds_of is not None)
    told = f"; building and translating are {seconds(built)} s of that" if built else ""
    return (
        f"{count(step.iterations, 'iteration')} from the plan before in {seconds(spent)} s, "
        f"against {cold.iterations} from a cold start in {seconds(whole)} s{told}."
    )


def _factor(row: SuiteRow, ours: float | None) -> str:
    theirs = middle(row.cpu_s)
    return "" if row.by == OURS or not ours or not theirs else f"{times(theirs / ours)} ours"


def _plot(rows: Iterable[SuiteRow]) -> Plot | None:
    """CPU time of our stages over n T, where there are several sizes."""
    series: dict[str, list[Point]] = {}
    for row in rows:
        y = middle(row.cpu_s)
        if row.by == OURS and row.n and row.stage != "yardstick" and y:
            tip = f"{spaced(row.stage)}, n = {row.n}, T = {row.steps}: {error(y)} s"
            series.setdefault(spaced(row.stage), []).append((float(row.n * row.steps), y, tip))
    if len({x for points in series.values() for x, _, _ in points}) < 2:
        return None
    plot = chart(
        "CPU time of our stages over n T",
        ("bodies times steps, n T", ""),
        ("CPU time", "s"),
        series,
        height=440,
    )
    if plot is not None:
        plot.words = "Medians; points on a line of slope one grow linearly."
    return plot


def _sentence(record: SuiteRecord) -> str:
    judged = [figure for figure in record.figures if figure.met is not None]
    if not judged:
        return "No figure was measured at a size that its target is set for."
    missed: dict[str, list[SuiteFigure]] = {}
    for figure in judged:
        if not figure.met:
            missed.setdefault(figure.what, []).append(figure)
    told = [
        f"{what} ({listing([number(figure.measured, 3) + (f' at T = {figure.steps}' if figure.steps else '') for figure in found])}; "
        f"target {number(found[0].target, 3)})"
        for what, found in missed.items()
    ]
    kept = sum(figure.met is True for figure in judged)
    met = f"{kept} of {count(len(judged), 'figure')} that could be judged {'is' if kept == 1 else 'are'} met."
    return f"{met} Missed: {'; '.join(told)}." if told else met


def _busy(record: SuiteRecord) -> str:
    if record.load is None or max(record.load) <= record.provenance.cores:
        return ""
    return (
        f"The machine was busy with other work: its load was {number(record.load[0], 3)} before and {number(record.load[1], 3)} after, "
        f"on {count(record.provenance.cores, 'core')}. Seconds are of the processor, but caches are shared: trust the ratios more than the seconds."
    )
