"""`ablate`: switch off one rule of a planner at a time, and print which verdicts and costs get worse.

    python -m benchmarks ablate --rule "mpcc: detours"

A rule that makes no verdict worse and no cost higher by 1 % on any case is a candidate to leave.
"""
