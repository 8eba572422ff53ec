"""What holds, what does not and why, in sentences computed from the records."""

from __future__ import annotations

from reports.judged import end_of
from reports.pages.judged_runs import Sentence, direct, failure, scene_by_scene, solved_scenes
from reports.pages.section import Report, Section
from reports.records.check_record import ExaminationRecord
from reports.records.load import Unreadable
from reports.records.record import HOLD, RunRecord
from reports.rows import Row
from reports.rule import failures, findings
from reports.rule_text import RESULTS, RULE
from reports.wording import VERDICTS, capital, cost, count, error, listing, seconds

# So many runs that ended otherwise than asked are told one below the other; more are folded, and those refused only with their scene.
_FEW = 12


def build(report: Report) -> Section:
    """The section; it says so where nothing is stored."""
    stored = report.stored
    runs = stored.runs
    whole = not (stored.missing or stored.unreadable)
    ended = [(run, report.link(run), sentence) for run in runs if (sentence := failure(run))]
    if len(ended) > _FEW:
        ended = [(run, link, sentence) for run, link, sentence in ended if run.outcome != "refused"]
    return Section(
        "summary",
        "Summary",
        "summary.html",
        {
            "sentences": [
                *_rule(runs, stored.examinations, whole=whole),
                *_time_steps(report),
                *direct(runs, whole=whole),
                *solved_scenes(runs),
                *_examined(stored.examinations),
                *_indirect(report.rows),
                *_cheapest(report.rows),
                *_found(runs),
                *_times(runs),
                *_stored(report),
            ],
            "rule": RULE,
            "results": RESULTS,
            "counts": _counts(runs),
            "judged": scene_by_scene(runs),
            "failures": ended,
            "few": len(ended) <= _FEW,
            "campaign": stored.campaign,
            "unreadable": _by_sentence(stored.unreadable),
            "missing": stored.missing,
            "provenance": stored.campaign.provenance if stored.campaign else (runs[0].provenance if runs else None),
        },
    )


def _by_sentence(unreadable: tuple[Unreadable, ...]) -> list[tuple[str, list[str]]]:
    """(why, the files of which it is true)."""
    found: dict[str, list[str]] = {}
    for item in unreadable:
        found.setdefault(item.sentence, []).append(item.path)
    return list(found.items())


def _counts(runs: tuple[RunRecord, ...]) -> dict[str, int]:
    """Of each verdict; of what is asked of nobody only where there is any."""
    amounts = {name: sum(run.verdict == name for run in runs) for name in VERDICTS}
    return {name: amount for name, amount in amounts.items() if amount or name not in ("not applicable", "consistent")}


def _rule(runs: tuple[RunRecord, ...], examinations: tuple[ExaminationRecord, ...], *, whole: bool) -> list[Sentence]:
    """Whether the campaign fails, by its rule, and why."""
    failed = [Sentence("violates", "✗", f"The campaign fails: {sentence.rstrip('.')}.") for sentence in failures(runs, examinations)]
    if failed or not (runs or examinations):
        return failed
    return [Sentence("holds", "✓", f"All required checks passed{'' if whole else ', as far as they are stored'}.")]


def _found(runs: tuple[RunRecord, ...]) -> list[Sentence]:
    """What the replay found of plans that is no failure."""
    return [Sentence("undecided", "!", f"Found by the replay: {sentence.rstrip('.')}.") for sentence in findings(runs)]


def _examined(examinations: tuple[ExaminationRecord, ...]) -> list[Sentence]:
    """Of each kind of examination, how many passed."""
    said = []
    for kind in dict.fromkeys(record.kind for record in examinations):
        passed = [record.passed for record in examinations if record.kind == kind]
        style, symbol = ("holds", "✓") if all(passed) else ("violates", "✗")
        said.append(Sentence(style, symbol, f"{kind}: {sum(passed)} of {count(len(passed), 'check')} passed."))
    return said


def _time_steps(report: Report) -> list[Sentence]:
    """Scenes whose time step is unstable in contact, said before anything ran."""
    campaign = report.stored.campaign
    return [Sentence("undecided", "!", capital(item.warning)) for item in campaign.time_steps if item.warning] if campaign else []


def _indirect(rows: list[Row]) -> list[Sentence]:
    asked = [row for row in rows if row.stage.kind == "indirect" and row.stage.verdict != "not applicable"]
    relaxed = [row for row in asked if row.stage.verdict not in ("no plan", "not applicable")]
    if not asked:
        return []
    lost = f" {count(len(asked) - len(relaxed), 'other')} came back without a plan." if len(relaxed) < len(asked) else ""
    if not relaxed:
        return [Sentence("plain", "•", f"No relaxed stage came back with a plan, of {len(asked)}.")]
    violating = [row for row in relaxed if row.stage.verdict == "violates"]
    errors = [value for row in violating if (value := row.metric("replay_terminal_error")) is not None]
    reach = f", missing the goal by {error(min(errors))} to {error(max(errors))} after the replay" if errors else ""
    planned = f"{count(len(relaxed), 'relaxed stage')} with a plan"
    text = (
        f"{len(violating)} of {planned} {'violates' if len(violating) == 1 else 'violate'}, as relaxations are expected to{reach}; "
        "each is judged by all that it claims, its contact forces too."
    )
    if len(violating) == len(relaxed):
        return [Sentence("plain", "•", text + lost)]
    exempt = [f"{row.label} on {row.run.scene.name}" for row in relaxed if row.stage.verdict in HOLD]
    open_still = sum(row.stage.verdict == "undecided" for row in relaxed)
    named = listing(exempt) if len(exempt) <= _FEW else f"{len(exempt)} of them"
    holding = f" {named} {'holds' if len(exempt) == 1 else 'hold'}." if exempt else ""
    undecided = f" {open_still} {'is' if open_still == 1 else 'are'} undecided." if open_still else ""
    return [Sentence("plain", "•", text + holding + undecided + lost)]


def _cheapest(rows: list[Row]) -> list[Sentence]:
    """Never a cost without its terminal error; none where there is nothing to choose."""
    said = []
    for name in dict.fromkeys(row.run.scene.name for row in rows if row.run.scene.inputs):
        holding = [row for row in rows if row.run.scene.name == name and row.stage.verdict in HOLD and row.stage.cost is not None]
        if not holding:
            continue
        exact = [row for row in holding if (missed := row.metric("discrete_terminal_error")) is not None and missed <= 1e-4]
        best = min(holding, key=lambda row: row.stage.cost or 0.0)
        parts = [f"On {name} the cheapest plan that holds is by {best.named}: {_price(best)}."]
        if exact:
            strictest = min(exact, key=lambda row: row.stage.cost or 0.0)
            if strictest is not best:
                parts.append(f"The cheapest that also reaches the goal on its own grid is by {strictest.named}: {_price(strictest)}.")
        said.append(Sentence("plain", "•", " ".join(parts)))
    return said


def _price(row: Row) -> str:
    if all(goal is None for goal in row.run.scene.goal):
        return f"cost {cost(row.stage.cost)}; the scene leaves its end free"
    return f"cost {cost(row.stage.cost)}, terminal error after the replay: {end_of(row.stage, row.run.scene) or 'not measured'}"


def _times(runs: tuple[RunRecord, ...]) -> list[Sentence]:
    if not runs:
        return []
    wall, cpu = sum(run.wall_seconds for run in runs), sum(run.cpu_seconds for run in runs)
    return [
        Sentence(
            "plain",
            "•",
            f"All runs together took {seconds(cpu)} CPU seconds ({seconds(wall)} s wall, summed over the runs).",
        )
    ]


def _stored(report: Report) -> list[Sentence]:
    stored = report.stored
    said = []
    if stored.campaign is None:
        said.append(
            Sentence(
                "undecided",
                "!",
                "The campaign's own record is missing or unreadable: the page shows every run it finds, in the order of their names.",
            )
        )
    if not stored.runs and not stored.examinations:
        said.append(Sentence("noplan", "○", "No run is stored here yet; there is nothing to judge."))
    if stored.missing:
        said.append(
            Sentence(
                "noplan",
                "○",
                f"{count(len(stored.missing), 'run')} of the campaign {'has' if len(stored.missing) == 1 else 'have'} no stored record yet.",
            )
        )
    if stored.unreadable:
        said.append(
            Sentence(
                "undecided",
                "!",
                f"{count(len(stored.unreadable), 'file')} could not be read: {_first_reason(stored.unreadable)}; see below.",
            )
        )
    if stored.foreign:
        said.append(
            Sentence(
                "plain",
                "•",
                f"{count(stored.foreign, 'stored run')} in this folder {'belongs' if stored.foreign == 1 else 'belong'} to another campaign and {'is' if stored.foreign == 1 else 'are'} left out.",
            )
        )
    return said


def _first_reason(unreadable: tuple[Unreadable, ...]) -> str:
    """Why most of them could not."""
    (why, files), *others = sorted(_by_sentence(unreadable), key=lambda item: -len(item[1]))
    return (f"of {len(files)} of them " if others else "") + why.rstrip(".").replace("; ", ", ")
