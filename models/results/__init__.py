"""Vocabulary of results: what judge, solvers and campaigns fill, and reports draw."""
