"""What the suite measures: our stages, each with what people would use instead.

A Case is one way (`by`) through one stage.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from benchmarks.measure import Size

OURS = "touchstone"
YARDSTICK = "yardstick"
_BENCH = "pip install -e '.[bench]'"
_CASADI = {"casadi": _BENCH}
_DRAKE = {"pydrake": "pip install drake"}
_STAGES = "benchmarks.suite.stages"
_PEERS = "benchmarks.suite.peers"


@dataclass(frozen=True, kw_only=True)
class Case:
    """One row of the suite.

    function: `module:name`, called in the child as name(size, folder) -> Work: what it does before
        it returns is not measured.
    once: its work cannot be repeated in one process, or need not be; needs: modules that must be
        importable, with the words of how to get them;
    largest: the largest n T it is asked for; sized: False for what
        knows no size; slow: it takes minutes, and is measured once, if asked for; of_campaign: it
        needs a stored campaign.
    """

    stage: str
    title: str
    function: str
    by: str = OURS
    once: bool = False
    needs: Mapping[str, str] = field(default_factory=dict, hash=False)
    largest: int | None = None
    sized: bool = True
    slow: bool = False
    of_campaign: bool = False
    clock: Literal["CPU", "wall"] = "CPU"

    @property
    def names(self) -> tuple[str, ...]:
        """What `-k` looks at."""
        return (self.stage, self.by)

    def missing(self) -> str:
        """Empty, or the sentence why this case cannot be measured here."""
        from importlib.util import find_spec

        for module, remedy in self.needs.items():
            if find_spec(module) is None:
                return f"{self.stage} by {self.by} is not measured: the module {module} is not installed ({remedy})."
        return ""

    def fits(self, size: Size) -> bool:
        """Whether it is to be measured at this size."""
        return self.largest is None or size.n * size.steps <= self.largest


def _ours(stage: str, title: str, function: str, **more: object) -> Case:
    return Case(stage=stage, title=title, function=f"{_STAGES}:{function}", **more)  # type: ignore[arg-type] - of a type that was checked or made so above


def _peer(stage: str, title: str, by: str, function: str, **more: object) -> Case:
    return Case(stage=stage, title=title, by=by, function=function, **more)  # type: ignore[arg-type] - as above


CASES: tuple[Case, ...] = (
    _ours(YARDSTICK, "A fixed piece of work: how fast the machine is", "yardstick"),
    _ours(
        "scene_compile", "Scene to compiled time step, nothing cached", "scene_compile", once=True
    ),
    _ours("pyomo_build", "Scene to Pyomo model", "pyomo_build"),
    _ours("translate", "Pyomo model to Ipopt's functions", "translate"),
    _ours("evaluate", "Functions and derivatives of one iteration", "evaluate"),
    _ours("linear_algebra", "The rest of an iteration of Ipopt", "linear_algebra", once=True),
    _peer(
        "linear_algebra",
        "The same with the MUMPS of the wheel",
        "mumps",
        f"{_STAGES}:with_mumps",
        once=True,
    ),
    _ours(
        "softplus_chain",
        "Softplus collocation at three eps, from Scene to plans",
        "softplus_chain",
        once=True,
    ),
    _peer(
        "softplus_chain",
        "The same by hand",
        "casadi",
        f"{_PEERS}.casadi_chain:chain",
        once=True,
        needs=_CASADI,
    ),
    _peer(
        "softplus_chain",
        "The same with SNOPT",
        "drake_snopt",
        f"{_PEERS}.drake_snopt:chain",
        once=True,
        needs=_DRAKE,
        largest=2000,
    ),
    _ours("cold_step", "The last eps, from Scene to plan, cold", "cold_step", once=True),
    _peer(
        "cold_step",
        "The same by hand",
        "casadi",
        f"{_PEERS}.casadi_chain:cold_step",
        once=True,
        needs=_CASADI,
    ),
    _ours("eps_step", "The last eps from the one before, session open", "eps_step", once=True),
    _ours("gd_iteration", "One iteration of gradient descent through contact", "gd_iteration"),
    _ours("gd_kernel", "Its compiled part: rollout and adjoint", "gd_kernel"),
    _peer(
        "gd_iteration",
        "The paper's loop in PyTorch",
        "pytorch_loop",
        f"{_PEERS}.torch_loop:iteration",
        largest=60_000,
    ),
    _peer(
        "gd_iteration",
        "An adjoint of this scene by hand in C",
        "hand_written_c",
        f"{_PEERS}.c_adjoint:iteration",
    ),
    _ours("fmu_build", "Scene to FMU 2.0, nothing cached", "fmu_build", once=True),
    _ours("cs_replay", "One Co-Simulation of a plan", "cs_replay"),
    _ours("cs_calls", "Its calls, with one internal step each", "cs_calls"),
    _peer("cs_replay", "FMPy's simulate_fmu", "fmpy", f"{_PEERS}.fmpy_replay:simulate"),
    _ours("replay", "The whole replay with its error estimate", "whole_replay"),
    _ours("list", "python -m validate list", "list_command", sized=False),
    _ours(
        "report",
        "python -m validate report",
        "report_command",
        sized=False,
        once=True,
        of_campaign=True,
    ),
    _ours(
        "all_quick",
        "python -m validate all --quick -j 2",
        "quick_campaign",
        sized=False,
        once=True,
        slow=True,
        clock="wall",
    ),
    _ours(
        "all_again",
        "The same, everything stored",
        "stored_campaign",
        sized=False,
        once=True,
        slow=True,
        clock="wall",
    ),
)

FULL_SIZES = (Size(3, 500), Size(3, 2000), Size(3, 5000), Size(10, 500))
QUICK_SIZES = (Size(3, 50),)
