"""The stages of the suite, each with the peers that people would use instead, and the targets of their ratios."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from statistics import median
from typing import Any

from benchmarks.measure import Size

OURS = "touchstone"
_STAGES = "benchmarks.suite.stages"
_PEERS = "benchmarks.suite.peers"
_REMEDIES = {"casadi": "pip install -e '.[bench]'", "pydrake": "pip install -e '.[bench-drake]'"}
# The size that targets are set for.
TARGET_SIZE = Size(3, 500)


@dataclass(frozen=True, kw_only=True)
class Case:
    """One way (`by`) through one stage.

    function: `module:name`, called in the child as name(size, folder) -> Work; its preparation is
    not measured. once: its work cannot be repeated in one process, or need not be; needs: a module
    that must be importable.
    """

    stage: str
    by: str = OURS
    function: str
    once: bool = False
    needs: str = ""

    @property
    def names(self) -> tuple[str, ...]:
        """The names that `-k` matches."""
        return (self.stage, self.by)

    def missing(self) -> str:
        """Empty, or the sentence why this case cannot be measured here."""
        from importlib.util import find_spec

        if not self.needs or find_spec(self.needs) is not None:
            return ""
        return f"{self.stage} by {self.by} is not measured: the module {self.needs} is not installed ({_REMEDIES[self.needs]})."


@dataclass(frozen=True, kw_only=True)
class Row:
    """One way through one stage at one size: CPU seconds of each round, or why there are none."""

    stage: str
    by: str
    n: int
    steps: int
    cpu_s: tuple[float, ...]
    outcome: str = ""
    iterations: int = 0
    value: float | None = None
    failed: str = ""


@dataclass(frozen=True)
class Ratio:
    """CPU time of the stages `over`, added up, by that of `under`: (stage, by)."""

    what: str
    target: float
    over: tuple[tuple[str, str], ...]
    under: tuple[str, str]

    def of(self, rows: Iterable[Row], size: Size) -> float | None:
        """The median over the rounds, whose ways stood beside each other; None without all of them."""
        known = {
            (row.stage, row.by): row.cpu_s
            for row in rows
            if (row.n, row.steps) == (size.n, size.steps)
        }
        ways = [known.get(way, ()) for way in (*self.over, self.under)]
        ratios = [sum(above) / below for *above, below in zip(*ways, strict=False)]
        return median(ratios) if ratios else None


def _ours(stage: str, **more: Any) -> Case:
    return Case(stage=stage, function=f"{_STAGES}:{stage}", **more)


def _peer(stage: str, by: str, function: str, **more: Any) -> Case:
    return Case(stage=stage, by=by, function=f"{_PEERS}.{function}", **more)


CASES: tuple[Case, ...] = (
    _ours("scene_compile", once=True),
    _ours("pyomo_build"),
    _ours("translate"),
    _ours("evaluate"),
    _ours("linear_algebra", once=True),
    Case(stage="linear_algebra", by="mumps", function=f"{_STAGES}:with_mumps", once=True),
    _ours("softplus_chain", once=True),
    _peer("softplus_chain", "casadi", "casadi_chain:chain", once=True, needs="casadi"),
    _peer("softplus_chain", "drake_snopt", "drake_snopt:chain", once=True, needs="pydrake"),
    _ours("cold_step", once=True),
    _peer("cold_step", "casadi", "casadi_chain:cold_step", once=True, needs="casadi"),
    _ours("eps_step", once=True),
    _ours("gd_iteration"),
    _peer("gd_iteration", "pytorch_loop", "torch_loop:iteration"),
    _ours("fmu_build", once=True),
    _ours("cs_replay"),
    _peer("cs_replay", "fmpy", "fmpy_replay:simulate"),
    _ours("whole_replay"),
)
_CHAIN = ("softplus_chain", OURS)
RATIOS = (
    Ratio("softplus chain against CasADi and Ipopt by hand", 0.8, (_CHAIN,),
          ("softplus_chain", "casadi")),
    Ratio("softplus chain against Drake and SNOPT", 1 / 20, (_CHAIN,),
          ("softplus_chain", "drake_snopt")),
    Ratio("Pyomo build and translation as a share of the softplus chain", 0.5,
          (("pyomo_build", OURS), ("translate", OURS)), _CHAIN),
    Ratio("a step of eps against building and solving cold", 1 / 5, (("eps_step", OURS),),
          ("cold_step", OURS)),
    Ratio("iteration of gradient descent against the paper's PyTorch loop", 1 / 150,
          (("gd_iteration", OURS),), ("gd_iteration", "pytorch_loop")),
    Ratio("one Co-Simulation against FMPy's simulate_fmu", 1 / 3, (("cs_replay", OURS),),
          ("cs_replay", "fmpy")),
)  # fmt: skip
