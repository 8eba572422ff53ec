"""The loops of a replay in C, over the addresses of any FMU's functions: one call of Python a step of the plan, or a run, instead of one a call of FMI.

They make the calls that the Python loops of `validate.judge.replay.reference` and `validate.judge.replay.everyday` make, in their order, and give their numbers
bit for bit. Where there is no C compiler, where the FMU lacks a function, or where CVODE cannot be reached by its addresses, the Python loops run.
"""
