"""SimulatorsRecord: what other simulators say of a campaign's plans, as `validate report --engine` writes it into the folder (docs/engines.md)."""

from __future__ import annotations

from collections.abc import Mapping

from reports.records.record import Finite, Model

SIMULATORS = "simulators.json"


class EngineLevelRecord(Model):
    """step [s] or tolerance; the verdict there; distance [-]: the largest from our replay, in the nominal sizes of the coordinates, None where it diverged."""

    step: Finite
    verdict: str
    distance: Finite | None


class EngineRecord(Model):
    """An engine's verdict on a plan, or what came of asking; agrees: with ours at all its levels, None where it has none; kind, sentence: why not, as measured."""

    engine: str
    verdict: str
    agrees: bool | None
    kind: str
    sentence: str
    why: str = ""
    levels: tuple[EngineLevelRecord, ...] = ()


class SimulatorsRecord(Model):
    """engines: by name, what each is and how it makes contact; plans: by the key of the run, a row an engine."""

    engines: Mapping[str, str] = {}
    plans: Mapping[str, tuple[EngineRecord, ...]] = {}

    def with_rows(self, run: str, rows: tuple[EngineRecord, ...]) -> SimulatorsRecord:
        """The record with these rows of a run's plan; engines that were asked earlier keep theirs."""
        kept = {row.engine: row for row in (*self.plans.get(run, ()), *rows)}
        return self.model_copy(update={"plans": {**self.plans, run: tuple(kept.values())}})
