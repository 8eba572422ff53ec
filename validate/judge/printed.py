"""Rounding of printed numbers: digits left out of a file must not make a plan wrong.

    rounding(np.array([0.1234, 0.5, 1.0]), most=1.0)    # 5e-05 for each: four decimals

Decimals and digits are those of the shortest decimal that reproduces each double; a file and the
same array are therefore equal.
"""

from __future__ import annotations

from decimal import Decimal

import numpy as np

# Largest rounding, as a fraction of the nominal; shorter numbers are taken as exact.
_MOST = 5e-4
# Decimals of an unrounded column.
_ALL_DECIMALS = 13
# Digits of an unrounded column.
_ALL_DIGITS = 15


def rounding(values: np.ndarray, most: float) -> np.ndarray:
    """Return the largest rounding error of each number of a column.

    Parameters
    ----------
    values
        One column (n,) [any unit].
    most
        Nominal, in the same unit.

    Returns
    -------
    np.ndarray
        (n,): half a unit of the column's last decimal or last significant digit, the larger. At
        least half the float32 spacing if all values are float32, at most 5e-4 of the nominal.

    Raises
    ------
    decimal.InvalidOperation
        If a value is not finite.
    """
    sizes = np.abs(values)
    decimals, digits = _decimals_and_digits(sizes)
    with np.errstate(divide="ignore"):
        exponents = np.floor(np.log10(sizes))
    half_units = 0.5 * np.maximum(10.0**-decimals, 10.0 ** (exponents + 1 - digits))
    with np.errstate(over="ignore"):
        single = sizes.astype(np.float32)
    if (single == sizes).all():
        half_units = np.maximum(half_units, 0.5 * np.spacing(single).astype(float))
    return np.minimum(half_units, _MOST * most)


def columns_rounding(values: np.ndarray, most: np.ndarray | float) -> np.ndarray:
    """Return `rounding` of each column (rows, n) [any units]; most: (n,) nominals, or one.

    Raises decimal.InvalidOperation if a value is not finite.
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
