"""The numbers of the paper's Table I, row by row, to stand beside ours.

    paper_row("three_cart", "softplus_dc+strict", 0)   # {"cost": 197.86, "stability": 0.0, "physics": 2445.98, "time": 11.64}

cost = sum of u^2 [N^2], stability = distance of the last state from the goal, physics = (10) of the paper [N^2], time [s] of
the stage alone on the authors' machine. Source: Suh and Wang, Table I. The rows of a warm starter stand once in the paper and belong to
both pipelines that begin with it.
"""

from __future__ import annotations

from collections.abc import Mapping

PAPER_SCENE = "three_cart"
_COLUMNS = ("cost", "stability", "physics", "time")

# warm starter -> the rows of its stages
_STARTERS = {
    "relaxed": ((484.21, 0.00, 2.99, 1407.90), (561.00, 0.00, 0.34, 580.77), (469.94, 0.00, 0.03, 430.16)),
    "softplus_dc": ((197.86, 0.00, 2445.98, 11.64), (261.23, 0.00, 625.11, 9.78), (339.53, 0.00, 239.50, 12.40)),
    "softplus_gd": ((149.18, 0.41, 0.01, 4.07), (166.45, 0.27, 0.11, 3.77), (215.14, 0.20, 0.12, 2.94)),
}

# pipeline -> its last row
_FINISHERS = {
    "strict": (40779.28, 0.00, 0.00, 31.56),
    "relu_gd": (542.56, 0.04, 0.16, 49.59),
    "relaxed+strict": (46415.20, 0.00, 0.00, 20.73),
    "relaxed+relu_gd": (492.06, 0.00, 0.20, 0.27),
    "softplus_dc+strict": (16619.35, 0.00, 0.00, 100.07),
    "softplus_dc+relu_gd": (360.31, 0.00, 0.20, 1.43),
    "softplus_gd+strict": (3748.30, 0.00, 0.00, 151.54),
    "softplus_gd+relu_gd": (309.42, 0.05, 0.21, 2.38),
}


def table_rows(pipeline: str) -> tuple[tuple[float, ...], ...]:
    """The paper's rows of a pipeline, one a stage; empty for a pipeline the paper does not have."""
    if pipeline not in _FINISHERS:
        return ()
    starter = pipeline.split("+")[0] if "+" in pipeline else ""
    return (*_STARTERS.get(starter, ()), _FINISHERS[pipeline])


def paper_row(scene: str, pipeline: str, stage: int) -> Mapping[str, float]:
    """The paper's numbers for stage `stage` (from 0) of a pipeline by column name; empty where the paper has none."""
    rows = table_rows(pipeline) if scene == PAPER_SCENE else ()
    return dict(zip(_COLUMNS, rows[stage], strict=True)) if stage < len(rows) else {}
