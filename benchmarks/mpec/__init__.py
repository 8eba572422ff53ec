"""Strict complementarity beside other solvers: `peers` starts a process for each solve, `judge` recomputes what came of it. See docs/mpec_peers.md.

`macmpec`, `generator` and `enumeration` are the problems, found and random, and what all branches
of a random one have; the tests take theirs from here.
"""
