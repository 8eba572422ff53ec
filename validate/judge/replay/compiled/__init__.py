"""The loops of a replay in C, over the addresses of any FMU's functions: one call of Python a step of the plan, or a run, instead of one a call of FMI.

integration.c drives CVODE over Model Exchange (validate.judge.replay.reference), stepping.c steps Co-Simulation (validate.judge.replay.everyday). The
tests hold them against the same loops in Python, call by call and bit for bit.
"""
