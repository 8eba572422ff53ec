"""Runs that were split into parts, shown as one: the cheapest plan, all starts, the seconds of all of them together."""

from __future__ import annotations

from collections.abc import Iterable

from reports.records.record import RunRecord, SecondsRecord, StageRecord, StartRecord

# Costs that differ by less, relative to the cheapest, are one optimum: solves agree to 1e-12, windows shifted by a step differ by 1e-5.
SAME_OPTIMUM = 1e-7
# A plan that holds goes before a cheaper one that does not, and one that holds by its inputs alone before one that needs feedback.
_RANKS = {"holds": 0, "consistent": 0, "holds with feedback": 1}


def collected(runs: Iterable[RunRecord]) -> tuple[RunRecord, ...]:
    """The runs in order; parts of one pipeline on one scene become one run, at the place of the first of them."""
    return tuple(_together(list(group)) if group[0].parts > 1 else group[0] for group in grouped(runs))


def grouped(runs: Iterable[RunRecord]) -> tuple[tuple[RunRecord, ...], ...]:
    """The parts of each run, in order."""
    groups: dict[tuple[str, str], list[RunRecord]] = {}
    for run in runs:
        groups.setdefault((run.scene.name, run.pipeline if run.parts > 1 else run.key), []).append(run)
    return tuple(map(tuple, groups.values()))


def optima(starts: Iterable[StartRecord]) -> list[tuple[float, list[StartRecord]]]:
    """(cost, starts that reached it), from the cheapest."""
    found: list[tuple[float, list[StartRecord]]] = []
    for start in sorted((start for start in starts if start.cost is not None), key=lambda start: start.cost or 0.0):
        price = start.cost or 0.0
        if found and abs(price - found[-1][0]) <= SAME_OPTIMUM * abs(price):
            found[-1][1].append(start)
        else:
            found.append((price, [start]))
    return found


def _together(parts: list[RunRecord]) -> RunRecord:
    crashed = next((part for part in parts if part.outcome == "crashed"), None)
    best = min(parts, key=lambda part: (_RANKS.get(part.verdict, len(_RANKS)), _cost(part)))
    starts = tuple(sorted((start for part in parts for stage in part.stages for start in stage.starts), key=lambda start: start.number))
    message = " ".join(part for part in (_spread(starts), _lacking(parts), best.message if crashed is None else crashed.message) if part)
    stages = best.stages
    if stages:
        last = stages[-1].model_copy(
            update={"starts": starts, "seconds": _seconds(parts), "iterations": _iterations(parts), "message": message}
        )
        stages = (*stages[:-1], last)
    return best.model_copy(
        update={
            "stages": stages,
            "outcome": best.outcome if crashed is None else "crashed",
            "message": message,
            "wall_seconds": sum(part.wall_seconds for part in parts),
            "cpu_seconds": sum(part.cpu_seconds for part in parts),
            "profile": {
                phase: sum(part.profile.get(phase, 0.0) for part in parts)
                for phase in dict.fromkeys(phase for part in parts for phase in part.profile)
            },
        }
    )


def _cost(run: RunRecord) -> float:
    cost = run.stages[-1].cost if run.stages else None
    return float("inf") if cost is None else cost


def _spread(starts: tuple[StartRecord, ...]) -> str:
    found = optima(starts)
    if not found:
        return f"None of {len(starts)} starts was solved." if starts else ""
    solved = sum(len(same) for _, same in found)
    ways = (
        f"{len(found)} distinct optima, from {found[0][0]:.6g} to {found[-1][0]:.6g}"
        if len(found) > 1
        else "all of them at the same optimum"
    )
    return f"{solved} of {len(starts)} starts were solved, {ways}; {len(found[0][1])} reached the cheapest."


def _lacking(parts: list[RunRecord]) -> str:
    whole = parts[0].parts
    return "" if len(parts) == whole else f"Only {len(parts)} of the {whole} parts of this run are stored; the others are not counted."


def _last(parts: list[RunRecord]) -> list[StageRecord]:
    return [part.stages[-1] for part in parts if part.stages]


def _seconds(parts: list[RunRecord]) -> SecondsRecord:
    names = SecondsRecord.model_fields
    return SecondsRecord(**{name: sum(getattr(stage.seconds, name) for stage in _last(parts)) for name in names})


def _iterations(parts: list[RunRecord]) -> int:
    return sum(stage.iterations for stage in _last(parts))
