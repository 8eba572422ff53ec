"""Real chains of real methods, three of which begin with the same stages, and one that shares nothing; none of them imports PyTorch, which takes longer than all they do.
And a plugin that stumbles where plans are tried in perturbed worlds.

python -m validate all --plugin real_chains:PLUGIN        # with this folder on PYTHONPATH
"""

from dataclasses import replace

from formulations.method import Leg, Pipeline
from formulations.pipelines import SOFTPLUS_EPS
from validate.tasks.plugins import DEFAULT

_BEGIN = Leg(method="softplus_dc", schedule=SOFTPLUS_EPS)
_ENDS = ("strict_lcp", "collocation", "mpcc")
PIPELINES = (
    *(
        Pipeline(name=f"begin+{name}", title="begins alike", legs=(_BEGIN, Leg(method=name)))
        for name in _ENDS
    ),
    Pipeline(name="alone", title="shares nothing", legs=(Leg(method="collocation"),)),
)
PLUGIN = replace(DEFAULT, pipelines_for=lambda scene: PIPELINES, checks=lambda scenes: ())


def _stumble(*_: object):
    raise ZeroDivisionError("a stumble")


STUMBLING = replace(DEFAULT, survey=_stumble)
