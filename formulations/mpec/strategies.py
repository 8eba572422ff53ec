"""Strategies: the ways to make the pairs of a shadow smooth, each steered by one number eps > 0 that goes to 0.

steered = STRATEGIES["scholtes"].attach(lifted)        # once, before the shadow is compiled
steered.value = STRATEGIES["scholtes"].number(eps)

`MpecSettings` are the options of a solve: `mpec_ipopt` reads its own by name, everything else goes
to Ipopt (and is refused there if Ipopt does not have it).
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
    """A way to make all pairs smooth.

    name: as chosen by option; first, last: where eps starts and ends unless the caller says
        otherwise; warm_below: from which eps on a step starts from
    the multipliers of the step before; bounds_products: whether eps is an upper bound of v w;
        eps_is_weight: whether 1 / eps is the weight of a penalty
    """

    name: str
    first: float = 1.0
    last: float = 1e-9
    warm_below: float = 1e-4
    bounds_products: bool = False
    eps_is_weight: bool = False

    @abstractmethod
    def attach(self, lifted: Lifted) -> Any:
        """Write the relaxation into the shadow, in place of another.

        Returns the mutable Param that steers it.
        """

    def number(self, eps: float) -> float:
        """What the Param is at this eps."""
        return eps


class Scholtes(Strategy):
    """v w <= eps (Scholtes): Pyomo's own `mpec.simple_nonlinear`, whose mutable bound goes to 0.

    It starts where pairs hardly bind, and so from what the rest of the problem would like best.
    """

    name = "scholtes"
    first = 1e3
    bounds_products = True

    def attach(self, lifted: Lifted) -> Any:
        """Products at most `mpec_bound`."""
        lifted.relaxation()
        lifted.products(active=True)
        return lifted.shadow.mpec_bound


class Smoothing(Strategy):
    """v + w = sqrt(v^2 + w^2 + 2 eps) (Fischer-Burmeister, smoothed by Kanzow): in place of the complementarity, with v w = eps and v, w > 0 on the path."""

    name = "smoothing"
    last = 1e-10

    def attach(self, lifted: Lifted) -> Any:
        """One equation a pair instead of its product."""
        block = lifted.relaxation()
        block.smoothing = pyo.Param(mutable=True, initialize=self.first)
        sides = [(pair.first, pair.second) for pair in lifted.pairs]

        def equation(block: Any, k: int) -> Any:
            v, w = sides[k]
            return v + w - pyo.sqrt(v**2 + w**2 + 2 * block.smoothing) == 0

        block.path_equation = pyo.Constraint(range(len(sides)), rule=equation)
        return block.smoothing


class L1Penalty(Strategy):
    """f + (1 / eps) sum v w: the products in the objective.

    Exact: a finite weight is enough where the solution is strongly stationary.
    """

    name = "l1_penalty"
    last = 1e-8
    eps_is_weight = True

    def attach(self, lifted: Lifted) -> Any:
        """No products; a weighted penalty in the objective."""
        block, given = lifted.relaxation(), lifted.objective
        block.weight = pyo.Param(mutable=True, initialize=1.0)
        penalty = sum((block.weight * pair.first * pair.second for pair in lifted.pairs), start=0.0)
        if given is None:
            block.penalised = pyo.Objective(expr=penalty)
        else:
            given.deactivate()
            sign = 1.0 if given.sense == pyo.minimize else -1.0
            block.penalised = pyo.Objective(expr=given.expr + sign * penalty, sense=given.sense)
        return block.weight

    def number(self, eps: float) -> float:
        """The weight is 1 / eps."""
        return 1.0 / eps


class Direct(Scholtes):
    """v w <= 0 at once: what an NLP solver makes of the problem as it stands."""

    name = "direct"
    first = last = (
        1e-8  # Ipopt's own tolerance: a bound of 0 would leave its iterates no interior at all
    )


STRATEGIES: dict[str, Strategy] = {
    item.name: item for item in (Scholtes(), Smoothing(), L1Penalty(), Direct())
}
STRATEGY_NAMES = tuple(STRATEGIES)
# The order of "auto". Measured on 87 MacMPEC problems (solved, at the published optimum without
# `search`, iterations) and on three_cart with 500 steps (cost, iterations; scholtes from eps 1):
# smoothing 87, 81, 6573 and 490.600, 173; scholtes 87, 82, 6997 and 490.624, 815; direct 87, 82,
# 4478; l1_penalty 86, 77, 5424. Two more never were the best of any: the elastic mode (85, 78,
# 10350), and the path of smoothing by the equation of Chen, Harker, Kanzow and Smale (85, 78,
# 6432).
FALLBACKS = ("smoothing", "scholtes", "l1_penalty")
# With more pairs than LARGE smoothing is only tried (`Path.points`), and l1_penalty is next.
# Smoothing's first step takes 16 to 40 iterations on a membrane of 1024 pairs and on three_cart,
# which nothing else solves as fast; on MacMPEC's packings of 961 pairs it finds nothing in 240 to
# 500, four times over (24 CPU s), where l1_penalty has decided the pairs after 80 to 220 (6 to 15
# CPU s). scholtes takes 7 CPU s on some of them and 44 in vain on others.
LARGE = 300
_OF_LARGE = ("smoothing", "l1_penalty", "scholtes")


@dataclass(frozen=True, kw_only=True)
class MpecSettings:
    """How an MPEC is solved.

    strategy: how pairs are made smooth; "auto" takes FALLBACKS in order and keeps the best
        certified answer
    starts: so many starts: the model's values, then random points around them, by seed; all
        strategies from each
    work: Ipopt's iterations for what comes after the first success, as a multiple of those up to
        there; 0: the first success is the answer;
    None: 1 a start with at most `search` pairs, 3 with up to LARGE, but some 8 CPU s a start
        (counted in iterations, not by a clock); then 1 a further start
    eps_start, eps_end: where the relaxation starts and ends (None: the strategy's own)
    complementarity_tolerance: largest min(v, w) of a pair that counts as complementary without
        polish
    polish: decide every pair and solve what remains exactly; certificate: recompute residuals and
        stationarity from the model
    max_biactive: up to how many undecided pairs every combination is tried
    search: with up to this many pairs, neighbouring branches are tried as well (each pair in turn
        decided otherwise), biactive or not
    step_iterations: iterations of Ipopt for one eps
    ipopt: options for Ipopt
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
        """Names of the strategies to try, in order, of a problem with so many pairs [-].

        Raises nothing.
        """
        if self.strategy != "auto":
            return (self.strategy,)
        return (
            FALLBACKS[: None if pairs else 1] if pairs <= LARGE else _OF_LARGE
        )  # without pairs all are the same


_OWN = {item.name: item for item in fields(MpecSettings) if item.name != "ipopt"}


def read_settings(options: Mapping[str, Any]) -> MpecSettings:
    """Split options into our own and Ipopt's, and check them.

    Raises
    ------
    UnknownOptionError
        for a name there is not, or a value that cannot be used, with what to write instead
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
