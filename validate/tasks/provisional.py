"""The record of a cell that has everything but its certificates, in case it ends while they are made.

set_aside(folder, record, awaiting)          # by the cell, before each certificate
record = recovered(folder, key, lost)        # by its parent, where the cell left no record; None if none was set aside
lacks_certificate(record)                    # whether a stored record is such a one
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from validate.store.disk import write_durably

if TYPE_CHECKING:
    from reports.records.check_record import ExaminationRecord
    from reports.records.record import RunRecord, StageRecord
    from validate.execution.worker import Lost

_PROVISIONAL = "provisional.json"
_MISSING = "The certificate is missing"


def set_aside(folder: Path, record: RunRecord, awaiting: Sequence[int]) -> None:
    """Keep what is known. awaiting: indices of the stages whose certificate is still to come. Raises MachineError where the disk refuses."""
    text = json.dumps({"awaiting": list(awaiting), "record": record.model_dump(mode="json")})
    write_durably(folder / _PROVISIONAL, text)


def recovered(folder: Path, key: str, lost: Lost) -> RunRecord | None:
    """The record that was set aside, with a sentence why certificates are missing. A cell that ran out of time has the outcome of its last
    stage, one that crashed has crashed, its plans, replays and scores kept."""
    from reports.records.record import RunRecord
    from validate.tasks.records import LOG_LINES

    try:
        content = json.loads((folder / _PROVISIONAL).read_bytes())
        record, awaiting = RunRecord.model_validate(content["record"]), frozenset(content["awaiting"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError):  # none, or not ours; pydantic's and JSON's are ValueErrors
        return None
    if record.key != key:
        return None
    late = lost.outcome == "time_limit"
    known = sum(record.profile.values())
    wall = max(lost.wall, known)  # the clock of the parent, and that of the child
    certificate = record.profile.get("certificate", 0.0) + wall - known
    why = f"{_MISSING}{' because time ran out: the cell' if late else ':'} {lost.message}"
    return record.model_copy(
        update={
            "stages": tuple(_without(stage, why) if stage.index in awaiting else stage for stage in record.stages),
            "outcome": record.outcome if late else lost.outcome,
            "message": _joined(record.message, why),
            "wall_seconds": wall,
            "cpu_seconds": lost.cpu,
            "profile": {**record.profile, "certificate": certificate},
            "log_tail": "\n".join(lost.log.splitlines()[-LOG_LINES:]),
        }
    )


def lacks_certificate(record: RunRecord | ExaminationRecord) -> bool:
    """Whether the cell ended while a certificate was made: its outcome does not tell where its time ran out."""
    # records of older versions say it in their message only
    return any(stage.certificate_missing or _MISSING in stage.message for stage in getattr(record, "stages", ()))


def _without(stage: StageRecord, why: str) -> StageRecord:
    return stage.model_copy(update={"message": _joined(stage.message, why), "certificate_missing": True})


def _joined(message: str, why: str) -> str:
    return f"{message} {why}".strip()
