"""All checks, in the order of the table."""

from __future__ import annotations

from validate.fmu_check import (
    agreement,
    archive,
    communication,
    derivatives,
    description,
    exchange,
    repetition,
    states,
    timing,
    values,
    within_step,
)
from validate.fmu_check.result import Check

# Of the file alone; the others need its description, and most of them run its code.
STATIC: tuple[Check, ...] = (archive.archive, description.valid)
# If this one fails for a type, those after it are not run.
FIRST = timing.lives
READING: tuple[Check, ...] = (description.consistent, archive.exports)
BEHAVIOUR: tuple[Check, ...] = (
    FIRST,
    values.readable,
    values.starts,
    values.obeyed,
    values.finite,
    values.get_order,
    timing.keeps_time,
    timing.stop_time,
    communication.event_mode,
    communication.early_return,
    within_step.intermediate_update,
    within_step.input_derivatives,
    repetition.repeats,
    repetition.resets,
    repetition.independent,
    repetition.leaks,
    states.restores,
    states.serialises,
    exchange.arrays,
    exchange.nominals,
    exchange.indicators,
    derivatives.directional,
    derivatives.adjoint,
    derivatives.dependencies,
    agreement.agree,
)
NAMES = tuple(item.name for item in (*STATIC, *READING, *BEHAVIOUR))
