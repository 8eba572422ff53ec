"""Robustness of a plan: the share of perturbed worlds in which it arrives.

from validate.judge.robustness import robustness
robustness("three_cart", "plan.csv").alone.share
"""

from models.results.robustness import PerturbationKind, Survey
from validate.judge.robustness.robustness import SAMPLES, Robustness, robustness, survey

__all__ = ["SAMPLES", "PerturbationKind", "Robustness", "Survey", "robustness", "survey"]
