"""A plugin that stumbles where plans are tried in perturbed worlds."""

from dataclasses import replace

from validate.tasks.plugins import DEFAULT


def _stumble(*_: object):
    raise ZeroDivisionError("a stumble")


PLUGIN = replace(DEFAULT, survey=_stumble)
