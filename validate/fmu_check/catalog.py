"""All checks, in the order of the table."""

from __future__ import annotations

from validate.fmu_check import archive, communication, derivatives, exchange, states, values
from validate.fmu_check.result import Check

# Of the file alone; the others need its description, and most of them run its code.
STATIC: tuple[Check, ...] = (archive.archive, archive.valid)
# If this one fails for a type, those after it are not run.
FIRST = communication.lives
READING: tuple[Check, ...] = (archive.consistent, archive.exports)
BEHAVIOUR: tuple[Check, ...] = (
    FIRST,
    values.readable,
    values.starts,
    values.obeyed,
    values.finite,
    values.get_order,
    communication.keeps_time,
    communication.stop_time,
    communication.event_mode,
    communication.early_return,
    communication.intermediate_update,
    communication.input_derivatives,
    states.repeats,
    states.resets,
    states.independent,
    states.leaks,
    states.restores,
    states.serialises,
    exchange.arrays,
    exchange.nominals,
    exchange.indicators,
    derivatives.directional,
    derivatives.adjoint,
    derivatives.dependencies,
    exchange.agree,
)
NAMES = tuple(item.name for item in (*STATIC, *READING, *BEHAVIOUR))
