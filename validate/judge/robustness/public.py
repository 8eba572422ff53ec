"""The function `robustness` of `import touchstone`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from models.errors import listed
from models.scene import Scene
from models.trajectory import Trajectory
from validate.judge.judgement import as_wired_fmu
from validate.judge.robustness.robustness import Robustness
from validate.judge.robustness.robustness import robustness as measured


def robustness(
    scene: Scene | str | Path,
    plan: Trajectory | Mapping[str, Any] | str | Path | Any,
    *,
    samples: int = 1000,
    seed: int = 0,
    kinds: Sequence[str] = ("parameters", "start", "gain", "noise", "delay"),
    anyway: bool = False,
    map: str | Path | None = None,
    hold: str | None = None,
) -> Robustness:
    """Try a plan in perturbed worlds (docs/robustness.md).

    Parameters
    ----------
    scene, plan, map, hold
        As for `judge`.
    samples
        Number of worlds, from 10 to 10^6; a quarter of them with feedback too.
    seed
        The same seed gives bitwise the same numbers.
    kinds
        Kinds of perturbations, or names of single ones.
    anyway
        Measure a plan that does not hold, too.

    Returns
    -------
    Robustness
        `alone` and `feedback` with their `share` and `checked`; `failures`, `weakest`.

    Raises
    ------
    SceneError, TrajectoryError, MachineError
        In one sentence.
    """
    wired = as_wired_fmu(scene, plan, map, hold)
    subject = scene if wired is None else wired
    return measured(
        subject, plan, samples=samples, seed=seed, kinds=listed(kinds), anyway=anyway, hold=hold
    )
