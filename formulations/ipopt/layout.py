"""What of a Pyomo model belongs where in the compiled problem."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

# A side of all constraints: the numbers by row, and (row, expression) of the bounds that are expressions of data.
Deferred = tuple[np.ndarray, tuple[tuple[int, Any], ...]]


@dataclass(frozen=True, kw_only=True, eq=False)
class Layout:
    """What of the Pyomo model belongs where. All constraints are listed, those without a variable too.

    variables: by column; data: Params, fixed variables and data expressions by data number; named: (named expression, content when
    compiled); lower, upper: numbers and the bounds that are expressions of data.
    """

    model: Any
    constraints: tuple[Any, ...]
    expressions: tuple[Any, ...]
    objective: Any | None
    sense: int
    lower: Deferred
    upper: Deferred
    variables: tuple[Any, ...]
    data: tuple[Any, ...]
    named: tuple[tuple[Any, Any], ...]
