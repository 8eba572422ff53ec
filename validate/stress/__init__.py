"""Stress cases: hard situations for contact solvers, one per file in `cases`."""
