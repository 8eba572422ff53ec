"""The paper's Table I beside ours: which of its rows belongs to which stage of which pipeline.

    paper_row("three_cart", "softplus_dc+strict", 0)   # {"cost": 197.86, "stability": 0.0, "physics": 2445.98, "time": 11.64}

The numbers stand once, in `reports.paper`. The rows of a warm starter stand once in the paper and belong to both pipelines that begin
with it. A pipeline of ours has no row there, even where it chains the same methods.
"""

from __future__ import annotations

from collections.abc import Mapping

from formulations.pipeline import PAPER, PIPELINES, stage_plan
from reports.paper import SCENE, TABLE_1, PaperRow


def table_rows(pipeline: str) -> tuple[PaperRow, ...]:
    """The paper's rows of a pipeline, one a stage; empty for a pipeline the paper does not have."""
    known = next((known for known in PIPELINES if known.name == pipeline and known.source.startswith(PAPER)), None)
    if known is None:
        return ()
    by_chain = {(row.methods, row.eps): row for row in TABLE_1}
    rows, chain = [], ()
    for leg, eps, _ in stage_plan(known):
        chain = chain if chain[-1:] == (leg.method,) else (*chain, leg.method)
        rows.append(by_chain[chain, eps])
    return tuple(rows)


def paper_row(scene: str, pipeline: str, stage: int) -> Mapping[str, float]:
    """The paper's numbers for stage `stage` (from 0) of a pipeline by column name; empty where the paper has none."""
    rows = table_rows(pipeline) if scene == SCENE else ()
    return rows[stage].numbers if stage < len(rows) else {}
