"""Phenomena of contact with exact answers: what the truth suite (validate.tasks.truth) puts to every engine."""
