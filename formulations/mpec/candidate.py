"""What one strategy hands on to be judged."""

from __future__ import annotations

from dataclasses import dataclass

from formulations.mpec.branching import Branch
from formulations.mpec.homotopy import Point, Step
from formulations.mpec.lifted import Lifted
from formulations.mpec.strategy import Strategy
from formulations.mpec.workspace import Workspace
from formulations.solution import Outcome


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """What one strategy found: a branch, or only a point of its relaxation, or neither; and whether it met a branch without a lower bound."""

    strategy: Strategy
    lifted: Lifted
    work: Workspace
    branch: Branch | None
    point: Point | None
    outcome: Outcome
    message: str
    steps: tuple[Step, ...]
    unbounded: bool = False
