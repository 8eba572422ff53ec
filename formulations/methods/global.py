"""The global optimum, proved: one binary variable a contact and step, for linear scenes with few enough of them."""
# ruff: noqa: N999 - a method's file is named like the method; nobody writes `import global`

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from formulations.method import Kind, Method, Options, Session, option

if TYPE_CHECKING:
    from models.scene import Scene

# Contact decisions beyond which nothing is begun: 38 of three carts (20 steps) are proved in seconds, 98 (50 steps) leave most of the gap open.
_MOST = 60


@dataclass(frozen=True, kw_only=True)
class GlobalOptions(Options):
    seconds: float = option(200.0, "time after which the best bound is reported", unit="s", lower=1e-3, upper=1e7)


class Global(Method[GlobalOptions]):
    name = "global"
    title = "Global optimum by branch and bound"
    kind = Kind.DIRECT
    needs_eps = False
    options = GlobalOptions

    def accepts(self, scene: Scene) -> str | None:
        if not scene.inputs:
            return f"scene {scene.name} has no inputs, so there is nothing to plan."
        decisions = scene.nc * (scene.task.steps - 1)
        if decisions > _MOST:
            return (
                f"scene {scene.name} has {decisions} contact decisions ({scene.nc} a step), and a proof is tried up to {_MOST}; "
                "`python -m benchmarks proof` in a checkout says what is reached beyond."
            )
        from formulations.proof.prove import missing_solver, why_no_proof

        return why_no_proof(scene) or missing_solver()

    def session(self, scene: Scene, options: GlobalOptions, opening: tuple[float, float]) -> Session:
        from formulations.proof.session import ProofSession

        return ProofSession(self, scene, options.seconds, opening)


METHOD = Global()
