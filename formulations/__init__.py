"""Find plans: methods, pipelines that chain them, and the Pyomo models they use.

    model = build_model("three_cart", ContactFormulation.SOFTPLUS, eps=1e-3)
    pyomo.environ.SolverFactory("touchstone_ipopt").solve(model)  # "mpec_ipopt" for complementarity

Importing this package registers both solvers with both of Pyomo's factories, as soon as
`pyomo.environ` is imported. It imports neither Pyomo (0.5 s) nor PyTorch.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence
from functools import partial
from importlib.util import find_spec
from types import MappingProxyType, ModuleType
from typing import TYPE_CHECKING, Any

from touchstone_annexes import is_present

if TYPE_CHECKING:
    from importlib.machinery import ModuleSpec

    from formulations.transcription.build import build_block, build_model, load_plan, read_plan
    from formulations.transcription.contact import (
        ContactFormulation,
        ModelError,
        relax,
        set_relaxation,
    )
    from formulations.transcription.residuals import PlanResiduals

__all__ = [
    "ContactFormulation",
    "ModelError",
    "PlanResiduals",
    "build_block",
    "build_model",
    "load_plan",
    "read_plan",
    "relax",
    "set_relaxation",
]


def __getattr__(name: str) -> Any:
    if name in __all__:
        for home in ("build", "contact", "residuals"):
            found = getattr(
                importlib.import_module(f"formulations.transcription.{home}"), name, None
            )
            if found is not None:
                return found
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


# Name of a solver -> module, class, description; an annex may be missing.
_SOLVERS = MappingProxyType({
    "touchstone_ipopt": ("formulations.ipopt.pyomo_solver", "TouchstoneIpopt",
                         "Ipopt through cyipopt, without AMPL executables"),
    "mpec_ipopt": ("formulations.mpec.solve", "MpecIpopt",
                   "MPECs (pyomo.mpec) by relaxation, active-set polish and certificate, on Ipopt"),
})  # fmt: skip


class _AfterPyomo:
    """A meta path finder; the base class in `importlib.abc` would cost 10 ms."""

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if name != "pyomo.environ":
            return None
        sys.meta_path.remove(self)
        spec = find_spec(name)
        if spec is not None and spec.loader is not None:
            inner = spec.loader.exec_module

            def exec_module(module: ModuleType) -> None:
                inner(module)
                _register()

            spec.loader.exec_module = exec_module  # type: ignore[method-assign] - of this one module
        return spec


def _register() -> None:
    from pyomo.common.factory import Factory
    from pyomo.contrib.solver.common.factory import SolverFactory
    from pyomo.opt import SolverFactory as FirstFactory

    for name, (home, plugin, doc) in _SOLVERS.items():
        if not is_present(home):
            continue
        FirstFactory.register(name, doc)(partial(_plugin, home, plugin))
        # Factory.register would replace the plugin in the first factory by a wrapper.
        Factory.register(SolverFactory, name, doc)(partial(_plugin, home, plugin, "ContribSolver"))


def _plugin(home: str, name: str, outer: str = "", /, **settings: Any) -> Any:
    """Return a solver of the first interface, wrapped for the second if `outer` is given."""
    plugin = getattr(importlib.import_module(home), name)
    return (
        getattr(importlib.import_module("formulations.ipopt.pyomo_solver"), outer)(
            plugin, **settings
        )
        if outer
        else plugin(**settings)
    )


if "pyomo.environ" in sys.modules:
    _register()
else:
    sys.meta_path.insert(0, _AfterPyomo())  # type: ignore[arg-type] - as finders are
