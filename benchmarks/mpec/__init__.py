"""Strict complementarity beside other solvers: `peers` starts a process for each solve, `judge` recomputes what came of it. See docs/mpec_peers.md."""
