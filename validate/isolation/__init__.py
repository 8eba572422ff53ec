"""Other people's code in a child process of its own: it may hang, crash, fork, fill the memory or print - we go on, and nothing is left.

    intake = examine(Path("model.fmu"))                                  # before anything is unpacked: IntakeError names what is wrong
    done = run_isolated("validate.replay.job:simulate", {"fmu": ...}, limits=Limits(seconds=60))
    done.ending, done.sentence, done.value, done.arrays

The function is named by `module:name` and takes and gives JSON and numpy arrays; nothing is pickled. Its answer is a file written last and whole: what
the child prints, and how it exits afterwards, cannot pass for an answer.
"""

from validate.isolation.ending import Ending, ModelFault
from validate.isolation.intake import Intake, IntakeError, IntakeLimits, Problem, examine, problems, unpack
from validate.isolation.run import Isolated, Limits, run_isolated

__all__ = [
    "Ending",
    "Intake",
    "IntakeError",
    "IntakeLimits",
    "Isolated",
    "Limits",
    "ModelFault",
    "Problem",
    "examine",
    "problems",
    "run_isolated",
    "unpack",
]
