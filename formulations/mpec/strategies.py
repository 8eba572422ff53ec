"""Strategies that make the pairs smooth, each controlled by a number eps > 0 that tends to 0.

    parameter = STRATEGIES["scholtes"].attach(lifted)  # once, before the shadow is compiled
    parameter.value = STRATEGIES["scholtes"].number(eps)

`MpecSettings` are our options of a solve; `read_settings` passes the rest to Ipopt.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from types import MappingProxyType
from typing import Any

import pyomo.environ as pyo

from formulations.ipopt import UnknownOptionError
from formulations.ipopt.options import checked_options, known_options
from formulations.mpec.lifted import Lifted
from models.errors import nearest


class Strategy(ABC):
    """A relaxation of all pairs.

    - first, last: default range of eps
    - warm_below: eps below which a step reuses the multipliers of the previous step
    - bounds_products: whether eps is an upper bound of v w
    - eps_is_weight: whether 1 / eps is the weight of a penalty
    """

    name: str
    first: float = 1.0
    last: float = 1e-9
    warm_below: float = 1e-4
    bounds_products: bool = False
    eps_is_weight: bool = False

    @abstractmethod
    def attach(self, lifted: Lifted) -> Any:
        """Write the relaxation into the shadow, replacing another, and return its mutable Param."""

    def number(self, eps: float) -> float:
        """Return the value of the Param at this eps."""
        return eps


class Scholtes(Strategy):
    """v w <= eps (Scholtes): Pyomo's `mpec.simple_nonlinear` with a mutable bound.

    It starts with a loose bound, near the optimum of the problem without complementarity.
    """

    name = "scholtes"
    first = 1e3
    bounds_products = True

    def attach(self, lifted: Lifted) -> Any:
        """Bound the products by `mpec_bound`."""
        lifted.relaxation()
        lifted.products(active=True)
        return lifted.shadow.mpec_bound


class Smoothing(Strategy):
    """v + w = sqrt(v^2 + w^2 + 2 eps) (Fischer-Burmeister, smoothed by Kanzow).

    It implies v w = eps and v, w > 0.
    """

    name = "smoothing"
    last = 1e-10

    def attach(self, lifted: Lifted) -> Any:
        """Replace the product of each pair by one equation."""
        block = lifted.relaxation()
        block.smoothing = pyo.Param(mutable=True, initialize=self.first)
        sides = [(pair.first, pair.second) for pair in lifted.pairs]

        def equation(block: Any, k: int) -> Any:
            v, w = sides[k]
            return v + w - pyo.sqrt(v**2 + w**2 + 2 * block.smoothing) == 0

        block.path_equation = pyo.Constraint(range(len(sides)), rule=equation)
        return block.smoothing


class L1Penalty(Strategy):
    """f + (1 / eps) sum v w; exact at a finite weight if the solution is strongly stationary."""

    name = "l1_penalty"
    last = 1e-8
    eps_is_weight = True

    def attach(self, lifted: Lifted) -> Any:
        """Replace the products by a weighted penalty in the objective."""
        block, objective = lifted.relaxation(), lifted.objective
        block.weight = pyo.Param(mutable=True, initialize=1.0)
        penalty = sum((block.weight * pair.first * pair.second for pair in lifted.pairs), start=0.0)
        if objective is None:
            block.penalised = pyo.Objective(expr=penalty)
        else:
            objective.deactivate()
            sign = 1.0 if objective.sense == pyo.minimize else -1.0
            block.penalised = pyo.Objective(
                expr=objective.expr + sign * penalty, sense=objective.sense
            )
        return block.weight

    def number(self, eps: float) -> float:
        """Return 1 / eps."""
        return 1.0 / eps


class Direct(Scholtes):
    """v w <= 0 in one step, as a plain NLP."""

    name = "direct"
    # Ipopt's own tolerance: with a bound of 0 its iterates would have no interior.
    first = last = 1e-8


STRATEGIES: dict[str, Strategy] = {
    item.name: item for item in (Scholtes(), Smoothing(), L1Penalty(), Direct())
}
STRATEGY_NAMES = tuple(STRATEGIES)
# Order of "auto". On 87 MacMPEC problems (solved, at the published optimum without `search`,
# iterations): smoothing 87, 81, 6573; scholtes 87, 82, 6997; direct 87, 82, 4478; l1_penalty 86,
# 77, 5424. On three_cart with 500 steps (cost, iterations): smoothing 490.600, 173; scholtes
# 490.624, 815. The elastic mode (85, 78, 10350) and smoothing by Chen, Harker, Kanzow and Smale
# (85, 78, 6432) were never best.
FALLBACKS = ("smoothing", "scholtes", "l1_penalty")
# Above LARGE pairs smoothing has a trial step only (`Path.points`), and l1_penalty is next. The
# trial takes 16 to 40 iterations on a membrane of 1024 pairs and on three_cart, the cases in which
# smoothing is fastest. On MacMPEC's packings of 961 pairs the trial fails after 240 to 500
# iterations, four times (24 CPU s). `l1_penalty` decides these after 80 to 220 iterations (6 to 15
# CPU s). `scholtes` takes 7 CPU s or fails after 44 iterations.
LARGE = 300
_OF_LARGE = ("smoothing", "l1_penalty", "scholtes")


@dataclass(frozen=True, kw_only=True)
class MpecSettings:
    """Settings of a solve.

    - strategy: "auto" tries FALLBACKS in order and keeps the best certified answer
    - starts: number of starts: the model's values, then random points around them, by seed
    - work: Ipopt iterations after the first success, as a multiple of those before; 0: stop there.
      None: 1 a start with at most `search` pairs, 3 with up to LARGE, limited to some 8 CPU s.
      Above LARGE pairs None is 1 a further start
    - eps_start, eps_end: range of eps (None: the strategy's own)
    - complementarity_tolerance: largest min(v, w) of a pair that is complementary without polish
    - polish: decide every pair and solve the branch exactly
    - certificate: recompute residuals and stationarity from the model
    - max_biactive: largest number of undecided pairs for which all combinations are tried
    - search: largest number of pairs for which neighbouring branches are tried
    - step_iterations: iterations of Ipopt for one eps
    - ipopt: options for Ipopt
    """

    strategy: str = "auto"
    eps_start: float | None = None
    eps_end: float | None = None
    starts: int = 1
    work: float | None = None
    complementarity_tolerance: float = 1e-6
    polish: bool = True
    certificate: bool = True
    max_biactive: int = 6
    search: int = 12
    step_iterations: int = 500
    ipopt: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))

    def order(self, pairs: int) -> tuple[str, ...]:
        """Return the names of the strategies for a problem with this many pairs, in order."""
        if self.strategy != "auto":
            return (self.strategy,)
        # Without pairs all strategies are the same.
        return FALLBACKS[: None if pairs else 1] if pairs <= LARGE else _OF_LARGE


_OWN = {item.name: item for item in fields(MpecSettings) if item.name != "ipopt"}


def read_settings(options: Mapping[str, Any]) -> MpecSettings:
    """Split options into those of MpecSettings and those of Ipopt.

    Raise UnknownOptionError with advice for a wrong option.
    """
    own = {name: value for name, value in options.items() if name in _OWN}
    ipopt = {
        name: value for name, value in options.items() if name not in _OWN and name != "solver"
    }
    for name in ipopt:
        if name not in known_options():
            near = nearest(name, [*_OWN, *known_options()])
            if near in _OWN:
                raise UnknownOptionError(f"there is no option '{name}': did you mean {near}?")
            if near is None:
                raise UnknownOptionError(
                    f"there is no option '{name}', neither Ipopt's nor one of mpec_ipopt: {', '.join(_OWN)}"
                )
    checked_options(ipopt)
    return MpecSettings(
        **{name: _checked(name, value) for name, value in own.items()},
        ipopt=MappingProxyType(ipopt),
    )


def _checked(name: str, value: Any) -> Any:
    if name == "strategy":
        if value not in ("auto", *STRATEGY_NAMES):
            raise UnknownOptionError(
                f"the option 'strategy' is one of auto, {', '.join(STRATEGY_NAMES)}, not {value!r}"
            )
        return value
    if name in ("polish", "certificate"):
        words = {
            True: True,
            False: False,
            "yes": True,
            "no": False,
            "true": True,
            "false": False,
            "True": True,
            "False": False,
        }
        if not isinstance(value, (bool, str)) or value not in words:
            raise UnknownOptionError(f"the option '{name}' is True or False, not {value!r}")
        return words[value]
    if value is None and name in ("eps_start", "eps_end", "work"):
        return None
    return _number(name, value)


def _number(name: str, value: Any) -> float | int:
    whole, least = (
        name in ("max_biactive", "search", "step_iterations", "starts"),
        int(name == "starts"),
    )
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    fits = (
        number >= least and number.is_integer()
        if whole
        else 0.0 < number < math.inf or (number == 0.0 and name == "work")
    )
    if isinstance(value, bool) or not fits:
        kind = (
            f"a whole number of at least {least}"
            if whole
            else "a number of at least 0"
            if name == "work"
            else "a positive number"
        )
        raise UnknownOptionError(f"the option '{name}' is {kind}, not {value!r}")
    return int(number) if whole else number
