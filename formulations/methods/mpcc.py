"""The exact contact problem by its contact windows: softplus homotopy, modes read off, what is left solved exactly, windows searched.

Where the end is free and has a cost, a plan that touches nothing is a local optimum from which no slope leads to a contact (two_discs_wall: nothing
done costs 0.61, a throw off the wall 0.39). There throws by constant inputs are tried, and the cheapest are solved with their contact modes.
"""

from __future__ import annotations

from formulations.contact_modes.method import MpccOptions, why_not
from formulations.method import Kind, Method, Session
from models.scene import Scene


class Mpcc(Method[MpccOptions]):
    name = "mpcc"
    title = "Exact contact by its windows"
    kind = Kind.DIRECT
    needs_eps = False
    exact = True
    options = MpccOptions

    def accepts(self, scene: Scene) -> str | None:
        return why_not(scene)

    def session(self, scene: Scene, options: MpccOptions, opening: tuple[float, float]) -> Session:
        from formulations.contact_modes.session import MpccSession  # imports Pyomo and Ipopt: 1 s that planning a campaign does without

        return MpccSession(self, scene, options, opening)


METHOD = Mpcc()
