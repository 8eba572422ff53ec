"""The rounding of printed numbers: a plan is not wrong by the digits that its file leaves out.

    rounding(np.array([0.1234, 0.5, 1.0]), most=1.0)    # 5e-05 for each: four decimals

Each column has its own decimals and significant digits. The shortest decimal that gives a double
back stands for its text, so that a file and the same numbers as an array are equal.
"""

from __future__ import annotations

from decimal import Decimal

import numpy as np

# Largest rounding, as a share of the nominal: numbers with fewer digits are meant as they are.
_MOST = 5e-4
# A column with so many decimals and digits is not rounded.
_ALL_DECIMALS = 13
_ALL_DIGITS = 15


def rounding(values: np.ndarray, most: float) -> np.ndarray:
    """Return by how much each number of a column may be rounded.

    Parameters
    ----------
    values
        One column (n,) [any unit].
    most
        Nominal of the column, in the same unit.

    Returns
    -------
    np.ndarray
        (n,): the larger of half a unit of the last decimal of the column and half a unit of its
        last significant digit, at least half the float32 spacing if every value is a float32, and
        at most 5e-4 of the nominal.

    Raises
    ------
    decimal.InvalidOperation
        For values that are not finite.
    """
    sizes = np.abs(values)
    decimals, digits = _decimals_and_digits(sizes)
    with np.errstate(divide="ignore"):
        exponents = np.floor(np.log10(sizes))
    found = 0.5 * np.maximum(10.0**-decimals, 10.0 ** (exponents + 1 - digits))
    with np.errstate(over="ignore"):
        single = sizes.astype(np.float32)
    if (single == sizes).all():
        found = np.maximum(found, 0.5 * np.spacing(single).astype(float))
    return np.minimum(found, _MOST * most)


def columns_rounding(values: np.ndarray, most: np.ndarray | float) -> np.ndarray:
    """Return `rounding` of each column of an array (rows, n) [any units]; most: (n,) nominals, or one.

    Raises decimal.InvalidOperation for values that are not finite.
    """
    nominals = np.broadcast_to(most, values.shape[1:])
    columns = [rounding(*pair) for pair in zip(values.T, nominals.tolist(), strict=True)]
    return np.array(columns).reshape(values.T.shape).T


def _decimals_and_digits(sizes: np.ndarray) -> tuple[int, int]:
    """Return the most decimals and the most significant digits of the values (n,)."""
    decimals, digits = 0, 0
    for value in sizes.tolist():
        shortest = Decimal(repr(value)).normalize().as_tuple()
        decimals = max(decimals, -int(shortest.exponent))
        digits = max(digits, len(shortest.digits))
        if decimals >= _ALL_DECIMALS and digits >= _ALL_DIGITS:
            break
    return decimals, digits
