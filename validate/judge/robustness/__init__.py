"""Robustness of a plan: the share of perturbed worlds in which it arrives.

from validate.judge.robustness import robustness
robustness("three_cart", "plan.csv").alone.share
"""

from validate.judge.robustness.robustness import SAMPLES, Robustness, Survey, robustness, survey
from validate.judge.robustness.worlds import PerturbationKind

__all__ = ["SAMPLES", "PerturbationKind", "Robustness", "Survey", "robustness", "survey"]
