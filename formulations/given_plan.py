"""A plan read from a file, as the first or only leg of a pipeline.

    leg(Path("plan.csv"), scene="three_cart")
    Pipeline(name="published", title="..", legs=(leg(..),))                 # judge a plan
    Pipeline(name="strict", title="..", legs=(leg(..), Leg("strict_lcp")))  # start from a plan

A campaign stores the leg like any other. The digests of the files are part of its key, their paths
are not. Nothing is solved.
"""

from __future__ import annotations

import hashlib
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from formulations.method import Clock, Kind, Leg, Method, Options, Session, option
from formulations.solution import Outcome, Seconds, Solution
from models.errors import TrajectoryError

if TYPE_CHECKING:
    from models.scene import Scene
    from models.trajectory import Trajectory


@dataclass(frozen=True, kw_only=True)
class GivenOptions(Options):
    """The files, and what they are."""

    plan: str = option("", "path of the plan, CSV or NetCDF", place=True)
    plan_digest: str = option("", "SHA-256 of the plan's file")
    of: str = option("", "name of the scene that a NetCDF plan was written for; empty: this scene")
    time_step: str = option("", "FILE.py:FUNCTION of the plan's own time step", place=True)
    time_step_digest: str = option("", "SHA-256 of the file of that function")


def digest(path: Path) -> str:
    """Return the SHA-256 of a file. Raises TrajectoryError if it cannot be read."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise TrajectoryError(
            f"plan {path}: it cannot be read ({error.strerror or error}); check its path."
        ) from error


def leg(path: Path, of: str = "", time_step: str = "") -> Leg:
    """Return the leg that reads this plan. Raises TrajectoryError."""
    step_file = time_step.rpartition(":")[0]
    options = GivenOptions(
        plan=str(path.resolve()),
        plan_digest=digest(path),
        of=of,
        time_step=time_step,
        time_step_digest=digest(Path(step_file)) if step_file else "",
    )
    return Leg(method=GIVEN_PLAN.name, options=asdict(options))


def read_plan(path: Path, scene: Scene, of: str = "") -> Trajectory:
    """Read a plan of a scene from CSV, or from NetCDF if its name ends so.

    Raises TrajectoryError.
    """
    from models.trajectory import read_csv
    from models.trajectory_netcdf import read_netcdf

    return read_netcdf(path, scene, of) if path.suffix == ".nc" else read_csv(path, scene)


class _Reader(Session):
    """Reads the plan each time it is asked to solve."""

    def __init__(self, scene: Scene, options: GivenOptions) -> None:
        self._scene, self._options = scene, options

    def solve(
        self, *, eps: float | None, warm_start: Trajectory | None, time_limit: float
    ) -> Solution:
        """Return the plan, its times counted from its start. Raises TrajectoryError."""
        GIVEN_PLAN.check_stage(eps, time_limit)
        options = self._options
        if digest(Path(options.plan)) != options.plan_digest:
            raise TrajectoryError(
                f"plan {options.plan}: the file changed since the campaign began; run the campaign again."
            )
        plan = read_plan(Path(options.plan), self._scene, options.of)
        return Solution(
            method=GIVEN_PLAN.name,
            outcome=Outcome.GIVEN,
            trajectory=plan.from_zero(),
            seconds=Seconds(),
            options=asdict(options),
        )


class GivenPlan(Method[GivenOptions]):
    """See the module docstring. It is no method of the catalogue: it plans nothing."""

    name = "given_plan"
    title = "A plan from elsewhere"
    kind = Kind.GIVEN
    needs_eps = False
    options = GivenOptions

    def accepts(self, scene: Scene) -> str | None:
        """Return None: every scene can be judged."""
        return None

    def session(self, scene: Scene, options: GivenOptions, clock: Clock) -> Session:
        """Open the plan's file when it is asked for."""
        return _Reader(scene, options)


GIVEN_PLAN = GivenPlan()
