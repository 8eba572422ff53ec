"""Of the runs that end with exact contact: how many hold, and why the others do not; one below the other where they are few, scene by scene where many."""

from __future__ import annotations

from dataclasses import dataclass

from reports.records.record import HOLD, RunRecord, StageRecord
from reports.wording import VERDICTS, capital, count, error, listing, verdict

# An outcome that came back with what was asked for; a limit of iterations is the paper's own stopping rule for gradient descent.
_ANSWERED = frozenset({"solved", "iteration_limit"})
# So many sentences are read one after the other; of more, a reader wants to choose the scene first.
_FEW = 12
# Of what does not hold, in the words of a count.
_OTHERS = {
    "violates": ("violates", "violate"),
    "undecided": ("is undecided", "are undecided"),
    "no plan": ("ended without a plan", "ended without a plan"),
}


@dataclass(frozen=True)
class Sentence:
    """A sentence of the summary; `style` is the verdict's class it goes with."""

    style: str
    symbol: str
    text: str


@dataclass(frozen=True)
class JudgedScene:
    """One scene: how many of its runs hold, in words, and a sentence for those that do not."""

    name: str
    words: str
    sentences: list[Sentence]


@dataclass(frozen=True)
class _Runs:
    """Runs that end with exact contact, by what is counted: judged holds all that could hold, of which `bad` do not."""

    judged: list[RunRecord]
    bad: list[RunRecord]
    followed: list[RunRecord]
    refused: list[RunRecord]
    consistent: list[RunRecord]

    @property
    def held(self) -> int:
        return len(self.judged) - len(self.bad)

    @property
    def beside(self) -> str:
        """What is counted with nothing: ` (86 not applicable, 3 consistent)`."""
        parts = [f"{len(runs)} {word}" for runs, word in ((self.refused, "not applicable"), (self.consistent, "consistent")) if runs]
        return f" ({', '.join(parts)})" if parts else ""

    @property
    def with_feedback(self) -> str:
        return f", {len(self.followed)} of them with feedback" if self.followed else ""


def direct(runs: tuple[RunRecord, ...], *, whole: bool) -> list[Sentence]:
    """How many hold, and, if they are few, why the others do not; `whole` if no run of the campaign is missing."""
    found = _sorted(runs)
    if not (found.judged or found.consistent or found.refused):
        return []
    stored = "" if whole else "stored "
    if not found.judged:
        return [Sentence("plain", "•", f"No {stored}run that ends with exact contact could hold{found.beside}.")]
    followed = [_followed(found.followed, "{0.pipeline} on {0.scene.name}")] if 0 < len(found.followed) <= _FEW else []
    if not found.bad:
        text = (
            f"The one {stored}run that ends with exact contact holds"
            if len(found.judged) == 1
            else f"All {len(found.judged)} {stored}runs that end with exact contact hold"
        )
        return [Sentence("holds", "✓", f"{text}{found.with_feedback}{found.beside}."), *followed]
    text = f"{found.held} of {len(found.judged)} {stored}runs that end with exact contact hold{found.with_feedback}{found.beside}."
    if len(found.bad) <= _FEW:
        return [Sentence("plain", "•", text), *followed, *(_sentence(run, f"{run.pipeline} on {run.scene.name}") for run in found.bad)]
    amounts = [(sum(run.verdict == name for run in found.bad), words) for name, words in _OTHERS.items()]
    others = [f"{amount} {words[amount != 1]}" for amount, words in amounts if amount]
    return [Sentence("plain", "•", f"{text} Of the others {listing(others)}; scene by scene below."), *followed]


def scene_by_scene(runs: tuple[RunRecord, ...]) -> list[JudgedScene]:
    """The same for each scene where the runs that do not hold are many; empty where `direct` names them all."""
    if len(_sorted(runs).bad) <= _FEW:
        return []
    scenes = []
    for name in dict.fromkeys(run.scene.name for run in runs if run.must_hold):
        mine = _sorted(tuple(run for run in runs if run.scene.name == name))
        words = f"{mine.held} of {count(len(mine.judged), 'run')} {'holds' if len(mine.judged) == 1 else 'hold'}{mine.with_feedback}"
        if not mine.judged:
            words = "the scene asks for nothing" if mine.consistent else "no method applies"
        told = [_followed(mine.followed, "{0.pipeline}")] if mine.followed else []
        told += [_sentence(run, run.pipeline) for run in mine.bad]
        scenes.append(JudgedScene(name, words, told + _refusals(mine.refused)))
    return scenes


def solved_scenes(runs: tuple[RunRecord, ...]) -> list[Sentence]:
    """On how many of the scenes that ask for something a run holds: by its inputs alone, or with feedback."""
    asked: dict[str, list[str]] = {}
    for run in runs:
        if run.verdict not in ("not applicable", "consistent") and run.outcome != "refused":
            asked.setdefault(run.scene.name, []).append(run.verdict)
    if len(asked) < 2:
        return []
    solved = [name for name, words in asked.items() if any(word in HOLD for word in words)]
    followed = [name for name in solved if "holds" not in asked[name]]
    text = f"{len(solved)} of {len(asked)} scenes are solved: a plan of them holds, with feedback or without"
    text += f"; with feedback alone {listing(followed)}." if followed else "."
    return [Sentence("holds" if len(solved) == len(asked) else "plain", "✓" if len(solved) == len(asked) else "•", text)]


def failure(run: RunRecord) -> str:
    """Why a run did not end as asked; empty if it did."""
    if run.outcome in _ANSWERED and run.stages:
        return ""
    advice = run.stages[-1].advice if run.stages and run.stages[-1].outcome == run.outcome else ""
    return " ".join(dict.fromkeys(capital(part) for part in (advice, run.message) if part)) or "The record gives no reason."


def _sorted(runs: tuple[RunRecord, ...]) -> _Runs:
    exact = [run for run in runs if run.must_hold]
    refused = [run for run in exact if run.outcome == "refused" or run.verdict == "not applicable"]
    consistent = [run for run in exact if run.verdict == "consistent"]
    judged = [run for run in exact if run.outcome != "refused" and run.verdict not in ("not applicable", "consistent")]
    return _Runs(
        judged,
        [run for run in judged if run.verdict not in HOLD],
        [run for run in judged if run.verdict == "holds with feedback"],
        refused,
        consistent,
    )


def _followed(runs: list[RunRecord], name: str) -> Sentence:
    sign = VERDICTS["holds with feedback"]
    named = listing([name.format(run) for run in runs])
    return Sentence(sign.style, sign.symbol, f"{named} {'holds' if len(runs) == 1 else 'hold'} with feedback, not for the inputs alone.")


def _sentence(run: RunRecord, name: str) -> Sentence:
    # A plan is judged whatever its method says of it: the limit that it breaks comes before how the method ended.
    why = _why(run.stages[-1]) if run.stages else ""
    judged = f"{why.rstrip('.')}. " if why and run.verdict != "no plan" else ""
    ended = failure(run)
    reason = (judged + ("" if ended.rstrip(".") == judged.strip().rstrip(".") else ended)).strip() or why or "The record gives no reason."
    sign = verdict(run.verdict)
    return Sentence(sign.style, sign.symbol, f"{name}: {run.verdict}. {capital(reason)}")


def _refusals(refused: list[RunRecord]) -> list[Sentence]:
    """One sentence for all that are refused for one reason: each method says "name: reason"."""
    reasons: dict[str, list[str]] = {}
    for run in refused:
        head, colon, reason = run.message.partition(": ")
        reasons.setdefault(reason if colon and " " not in head else run.message, []).append(run.pipeline)
    sign = VERDICTS["not applicable"]
    return [
        Sentence(
            sign.style,
            sign.symbol,
            f"{listing(names)} {'does' if len(names) == 1 else 'do'} not apply: {reason or 'the record gives no reason.'}",
        )
        for reason, names in reasons.items()
    ]


def _why(stage: StageRecord) -> str:
    if stage.why:
        return stage.why
    beyond = [
        f"{metric.name} is {error(metric.value)} {metric.unit} (limit {error(metric.limit)})"
        for metric in stage.metrics
        if metric.ok is False
    ]
    return f"{listing(beyond)}." if beyond else ""
