"""How finely the numbers of a plan are printed: half a unit of their last digit, which a plan may be off by without being wrong.

half_unit(np.round(motion, 4), most=1.0)     # 5e-05: four decimals
half_unit(motion, most=1.0)                  # 0.0: all the digits of float64

Decimals are looked for over all numbers of a group (the positions, the forces, ..); where there are more than six, significant digits: small numbers that
are printed with a few of those have many decimals.
"""

from __future__ import annotations

import numpy as np

# More digits than these are as good as all.
_DIGITS = 12
# A unit of so many decimals at most is taken for one that was chosen.
_FEW = 1e-6
# Rounding of numbers that were read from text or came of a product.
_ROUNDING = 1e-13
# Numbers that would be printed coarser than this share of what counts as large are taken as they stand: 2.5 is 2.5, not something near it.
_MOST = 5e-4


def half_unit(values: np.ndarray, most: float) -> float:
    """Half a unit of the last printed digit of some numbers.

    Parameters
    ----------
    values : (n,) or (rows, columns) numbers of one kind [any unit].
    most : what counts as large here, in the same unit.

    Returns
    -------
    0 where all digits are given, or so few that they are the number: half a unit would be more than 5e-4 of `most`.
    """
    sizes = np.abs(values[values != 0.0])
    if not sizes.size:
        return 0.0
    unit = _decimals(sizes)
    half = (unit if unit >= _FEW else max(unit, _significant(sizes))) / 2.0
    return half if half <= _MOST * most else 0.0


def _decimals(sizes: np.ndarray) -> float:
    for digits in range(_DIGITS + 1):
        if (np.abs(sizes - np.round(sizes, digits)) <= _ROUNDING * np.maximum(sizes, 1.0)).all():
            return 10.0**-digits
    return 0.0


def _significant(sizes: np.ndarray) -> float:
    exponents = np.floor(np.log10(sizes))
    for digits in range(1, _DIGITS + 1):
        scaled = sizes * 10.0 ** (digits - 1 - exponents)
        if (np.abs(scaled - np.round(scaled)) <= _ROUNDING * scaled).all():
            return float(10.0 ** (exponents.max() + 1 - digits))
    return 0.0
