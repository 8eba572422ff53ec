"""Rows of the paper's Table I, to show rows that we lack; records have the same numbers.

H.J. Terry Suh, Yanwei Wang, "Comparing Effectiveness of Relaxation Methods for Warm Starting
Trajectory Optimization through Soft Contact", Table I. Cost = sum of u^2, stability = |x_T - x_f|,
physics = (10); seconds of that stage alone.
"""

from __future__ import annotations

from dataclasses import dataclass

SCENE = "three_cart"


@dataclass(frozen=True)
class PaperRow:
    """One row: the chain of methods, with eps of the last (None for a direct method)."""

    methods: tuple[str, ...]
    eps: float | None
    cost: float
    stability: float
    physics: float
    time: float

    @property
    def numbers(self) -> dict[str, float]:
        """Return the paper's numbers by their names in a record."""
        return {
            "cost": self.cost,
            "stability": self.stability,
            "physics": self.physics,
            "time": self.time,
        }


TABLE_1 = (
    PaperRow(("strict_lcp",), None, 40779.28, 0.00, 0.00, 31.56),
    PaperRow(("relu_gd",), None, 542.56, 0.04, 0.16, 49.59),
    PaperRow(("relaxed_lcp",), 1e-2, 484.21, 0.00, 2.99, 1407.90),
    PaperRow(("relaxed_lcp",), 1e-3, 561.00, 0.00, 0.34, 580.77),
    PaperRow(("relaxed_lcp",), 1e-4, 469.94, 0.00, 0.03, 430.16),
    PaperRow(("relaxed_lcp", "strict_lcp"), None, 46415.20, 0.00, 0.00, 20.73),
    PaperRow(("relaxed_lcp", "relu_gd"), None, 492.06, 0.00, 0.20, 0.27),
    PaperRow(("softplus_dc",), 1e-3, 197.86, 0.00, 2445.98, 11.64),
    PaperRow(("softplus_dc",), 1e-5, 261.23, 0.00, 625.11, 9.78),
    PaperRow(("softplus_dc",), 1e-7, 339.53, 0.00, 239.50, 12.40),
    PaperRow(("softplus_dc", "strict_lcp"), None, 16619.35, 0.00, 0.00, 100.07),
    PaperRow(("softplus_dc", "relu_gd"), None, 360.31, 0.00, 0.20, 1.43),
    PaperRow(("softplus_gd",), 1e-3, 149.18, 0.41, 0.01, 4.07),
    PaperRow(("softplus_gd",), 1e-5, 166.45, 0.27, 0.11, 3.77),
    PaperRow(("softplus_gd",), 1e-7, 215.14, 0.20, 0.12, 2.94),
    PaperRow(("softplus_gd", "strict_lcp"), None, 3748.30, 0.00, 0.00, 151.54),
    PaperRow(("softplus_gd", "relu_gd"), None, 309.42, 0.05, 0.21, 2.38),
)
# Figures of the paper with trajectories at decreasing eps.
TIGHTENING_FIGURES = {"softplus_dc": "Fig. 4", "softplus_gd": "Fig. 5", "relaxed_lcp": "Fig. 6"}
