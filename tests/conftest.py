"""Hypothesis tries the same examples in every run and keeps none: what passes here passes again. New ones: `pytest --hypothesis-profile=default`."""

from __future__ import annotations

from hypothesis import settings

settings.register_profile("repeatable", derandomize=True, database=None, deadline=None)
settings.load_profile("repeatable")
