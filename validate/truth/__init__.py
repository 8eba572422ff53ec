"""Phenomena of contact with exact answers: what the truth suite (validate.cli.truth) puts to every engine."""
