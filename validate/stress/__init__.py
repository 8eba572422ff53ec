"""Stress cases: situations in which contact solvers go wrong, each measured through the product's own paths. ONE FILE = ONE CASE in `cases`."""
