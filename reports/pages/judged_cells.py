"""Of the cells that must hold: how many do, and why the others do not; one below the other where they are few, scene by scene where they are many."""

from __future__ import annotations

from dataclasses import dataclass

from reports.record import RunRecord, StageRecord
from reports.wording import capital, count, error, listing, spaced

# An outcome that came back with what was asked for; a limit of iterations is the paper's own stopping rule for gradient descent.
_ANSWERED = frozenset({"solved", "iteration_limit"})
# So many sentences are read one after the other; of more, a reader wants to choose the scene first.
_FEW = 12
_SIGNS = {"violates": ("violates", "✗"), "no plan": ("noplan", "○")}


@dataclass(frozen=True)
class Sentence:
    """A sentence of the summary; `style` is the verdict's class it goes with."""

    style: str
    symbol: str
    text: str


@dataclass(frozen=True)
class JudgedScene:
    """One scene: how many of its cells hold, in words, and a sentence for those that do not."""

    name: str
    words: str
    sentences: list[Sentence]


def direct(runs: tuple[RunRecord, ...], *, whole: bool) -> list[Sentence]:
    """How many hold, and, if they are few, why the others do not; `whole` if no cell of the campaign is missing."""
    judged, bad = _judged(runs)
    if not judged:
        return []
    stored = "" if whole else "stored "
    if not bad and len(judged) == 1:
        return [Sentence("holds", "✓", f"The one {stored}cell that ends in a direct method holds.")]
    if not bad:
        return [Sentence("holds", "✓", f"All {len(judged)} {stored}cells that end in a direct method hold.")]
    text = f"{len(judged) - len(bad)} of {len(judged)} {stored}cells that end in a direct method hold."
    if len(bad) <= _FEW:
        return [Sentence("plain", "•", text), *(_sentence(run, f"{run.pipeline} on {run.scene.name}") for run in bad)]
    refused = sum(run.outcome == "refused" for run in bad)
    others = [
        f"{sum(_verdict(run) == name for run in bad)} {words}"
        for name, words in _OTHERS.items()
        if any(_verdict(run) == name for run in bad)
    ]
    if refused:
        others.append(f"{refused} {'is' if refused == 1 else 'are'} of methods that do not apply to the scene")
    return [Sentence("plain", "•", f"{text} Of the others {listing(others)}; scene by scene below.")]


_OTHERS = {"violates": "violate a limit", "not resolved": "cannot be told", "no plan": "ended without a plan"}


def scene_by_scene(runs: tuple[RunRecord, ...]) -> list[JudgedScene]:
    """The same for each scene where the cells that do not hold are many; empty where `direct` names them all."""
    judged, bad = _judged(runs)
    if len(bad) <= _FEW:
        return []
    scenes = []
    for name in dict.fromkeys(run.scene.name for run in judged):
        mine, failing = [run for run in judged if run.scene.name == name], [run for run in bad if run.scene.name == name]
        applying = [run for run in mine if run.outcome != "refused"]
        held = f"{len(mine) - len(failing)} of {count(len(applying), 'cell')} {'holds' if len(applying) == 1 else 'hold'}"
        words = held if applying else "no method applies"
        told = [_sentence(run, run.pipeline) for run in failing if run.outcome != "refused"]
        scenes.append(JudgedScene(name, words, told + _refusals([run for run in failing if run.outcome == "refused"])))
    return scenes


def failure(run: RunRecord) -> str:
    """Why a cell did not end as asked; empty if it did."""
    if run.outcome in _ANSWERED and run.stages:
        return ""
    advice = run.stages[-1].advice if run.stages and run.stages[-1].outcome == run.outcome else ""
    return " ".join(dict.fromkeys(capital(part) for part in (advice, run.message) if part)) or "The record gives no reason."


def _judged(runs: tuple[RunRecord, ...]) -> tuple[list[RunRecord], list[RunRecord]]:
    judged = [run for run in runs if run.must_hold]
    return judged, [run for run in judged if run.verdict != "holds"]


def _verdict(run: RunRecord) -> str:
    return "" if run.outcome == "refused" else run.verdict


def _sentence(run: RunRecord, name: str) -> Sentence:
    # A plan is judged whatever its method says of it: the limit that it breaks comes before how the method ended.
    why = _why(run.stages[-1]) if run.stages else ""
    judged = f"{why.rstrip('.')}. " if why and run.verdict != "no plan" else ""
    ended = failure(run)
    reason = (judged + ("" if ended.rstrip(".") == judged.strip().rstrip(".") else ended)).strip() or why or "The record gives no reason."
    return Sentence(*_SIGNS.get(run.verdict, ("unresolved", "?")), f"{name}: {run.verdict}. {capital(reason)}")


def _refusals(refused: list[RunRecord]) -> list[Sentence]:
    """One sentence for all that are refused for one reason: each method says "name: reason"."""
    reasons: dict[str, list[str]] = {}
    for run in refused:
        head, colon, reason = run.message.partition(": ")
        reasons.setdefault(reason if colon and " " not in head else run.message, []).append(run.pipeline)
    return [
        Sentence(
            "noplan", "○", f"{listing(names)} {'does' if len(names) == 1 else 'do'} not apply: {reason or 'the record gives no reason.'}"
        )
        for reason, names in reasons.items()
    ]


def _why(stage: StageRecord) -> str:
    if stage.why:
        return stage.why
    broken = [
        f"{spaced(figure.name)} is {error(figure.value)} {figure.unit} (limit {error(figure.limit)})"
        for figure in stage.metrics
        if figure.ok is False
    ]
    return f"{listing(broken)}." if broken else ""
