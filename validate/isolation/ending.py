"""How an isolated run can end: a closed list."""

from __future__ import annotations

from enum import Enum


class Ending(Enum):
    """The value is the sentence's beginning; `Isolated.sentence` says the rest."""

    OK = "it came to its end"
    ERROR = "it refused"  # a TouchstoneError of the function: a sentence for the user
    MACHINE = "this machine cannot"  # a MachineError of the function
    EXCEPTION = "it ended with an exception of Python"
    FATAL = "the FMU reported a fatal status"
    NOT_A_NUMBER = "the FMU gave a value that is not a finite number"
    TIME_LIMIT = "it was ended at its time limit"
    MEMORY_LIMIT = "it was ended at its memory limit"
    SIGNAL = "it crashed"
    ABORT = "it aborted"
    NO_RESULT = "its process ended without a result"


class ModelFault(Exception):  # noqa: N818 - a finding about the model, not an error of ours
    """Raised by an isolated function to end with a finding about the model (FATAL, NOT_A_NUMBER) and its sentence."""

    def __init__(self, ending: Ending, sentence: str) -> None:
        super().__init__(sentence)
        self.ending = ending
