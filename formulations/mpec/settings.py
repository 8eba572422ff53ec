"""Options of `mpec_ipopt`: its own by name, everything else goes to Ipopt (and is refused there if Ipopt does not have it)."""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from types import MappingProxyType
from typing import Any

from formulations.ipopt.errors import UnknownOptionError
from formulations.ipopt.options import checked_options, known_options
from formulations.mpec.strategies import STRATEGIES

STRATEGY_NAMES = tuple(STRATEGIES)
# The order of "auto". Measured on 87 MacMPEC problems (solved, at the published optimum without `search`, iterations) and on three_cart with
# 500 steps (cost, iterations): smoothing 87, 81, 6573 and 490.600, 173; scholtes 87, 82, 6997 and 490.624, 815; direct 87, 82, 4478; chks
# 85, 78, 6432; l1_penalty 86, 77, 5424; elastic 85, 78, 10350.
FALLBACKS = ("smoothing", "scholtes", "l1_penalty")


@dataclass(frozen=True, kw_only=True)
class MpecSettings:
    """How an MPEC is solved.

    strategy: how pairs are made smooth; "auto" takes FALLBACKS in order until one succeeds (with at most `search` pairs, until two do)
    eps_start, eps_end: where the relaxation starts and ends (None: the strategy's own)
    complementarity_tolerance: largest min(v, w) of a pair that counts as complementary without polish
    polish: decide every pair and solve what remains exactly; certificate: recompute residuals and stationarity from the model
    max_biactive: up to how many undecided pairs every combination is tried
    search: with up to this many pairs, neighbouring branches are tried as well (each pair in turn decided otherwise), biactive or not
    step_iterations: iterations of Ipopt for one eps
    ipopt: options for Ipopt
    """

    strategy: str = "auto"
    eps_start: float | None = None
    eps_end: float | None = None
    complementarity_tolerance: float = 1e-6
    polish: bool = True
    certificate: bool = True
    max_biactive: int = 6
    search: int = 12
    step_iterations: int = 500
    ipopt: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def strategies(self) -> tuple[str, ...]:
        """Names of the strategies to try, in order."""
        return FALLBACKS if self.strategy == "auto" else (self.strategy,)


_OWN = {item.name: item for item in fields(MpecSettings) if item.name != "ipopt"}


def read_settings(options: Mapping[str, Any]) -> MpecSettings:
    """Split options into our own and Ipopt's, and check them.

    Raises
    ------
    UnknownOptionError
        for a name there is not, or a value that cannot be used, with what to write instead
    """
    own = {name: value for name, value in options.items() if name in _OWN}
    ipopt = {name: value for name, value in options.items() if name not in _OWN and name != "solver"}
    for name in ipopt:
        if name not in known_options():
            close = difflib.get_close_matches(name, [*_OWN, *known_options()], n=1)
            if close and close[0] in _OWN:
                raise UnknownOptionError(f"there is no option '{name}': did you mean '{close[0]}'?")
            if not close:
                raise UnknownOptionError(f"there is no option '{name}', neither Ipopt's nor one of mpec_ipopt: {', '.join(_OWN)}")
    checked_options(ipopt)
    return MpecSettings(**{name: _checked(name, value) for name, value in own.items()}, ipopt=MappingProxyType(ipopt))


def _checked(name: str, value: Any) -> Any:
    if name == "strategy":
        if value not in ("auto", *STRATEGY_NAMES):
            raise UnknownOptionError(f"the option 'strategy' is one of auto, {', '.join(STRATEGY_NAMES)}, not {value!r}")
        return value
    if name in ("polish", "certificate"):
        words = {True: True, False: False, "yes": True, "no": False, "true": True, "false": False, "True": True, "False": False}
        if not isinstance(value, (bool, str)) or value not in words:
            raise UnknownOptionError(f"the option '{name}' is True or False, not {value!r}")
        return words[value]
    if value is None and name in ("eps_start", "eps_end"):
        return None
    return _number(name, value)


def _number(name: str, value: Any) -> float | int:
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise UnknownOptionError(f"the option '{name}' is a number, not {value!r}") from None
    if name in ("max_biactive", "search", "step_iterations"):
        if isinstance(value, bool) or number < 0 or not number.is_integer():
            raise UnknownOptionError(f"the option '{name}' is a whole number of at least 0, not {value!r}")
        return int(number)
    if isinstance(value, bool) or not 0.0 < number < math.inf:
        raise UnknownOptionError(f"the option '{name}' is a positive number, not {value!r}")
    return number
