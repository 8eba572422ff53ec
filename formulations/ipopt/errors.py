"""What the bridge refuses, each as one sentence in the caller's terms that names the component."""

from __future__ import annotations


class ModelRefusedError(ValueError):
    """The model holds something that a smooth solver cannot treat, or that would be silently dropped."""


class MissingValueError(ValueError):
    """A Param or a fixed variable that the model needs has no value, or not a finite one."""


class StructureChangedError(RuntimeError):
    """The model's structure is no longer the one that was compiled: compile it again."""


class UnknownOptionError(ValueError):
    """An option that is not on the list, or a value that cannot be used for it."""
