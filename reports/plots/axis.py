"""Axes: values to pixels, and the ticks a reader can use.

axis = Axis.fitted("time", "s", [0.0, 5.0]);  axis.ticks() -> [(0.0, "0"), (1.0, "1"), ...]
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from reports.wording import number, power, unit

# Steps of a linear axis that a reader can add up in the head.
_NICE = (1.0, 2.0, 2.5, 5.0, 10.0)
# Values beyond this (and its inverse, on a logarithmic axis) are drawn at the edge: room for margins before a float overflows.
_LARGEST = 1e200


@dataclass(frozen=True)
class Axis:
    """`exponent`: labels are divided by 10**exponent, and the axis says so."""

    quantity: str
    unit: str
    low: float
    high: float
    log: bool = False
    exponent: int = 0

    @staticmethod
    def fitted(
        quantity: str,
        unit: str,
        values: Iterable[float] | NDArray[np.float64],
        *,
        log: bool = False,
        margin: float = 0.05,
        zero: bool = False,
    ) -> Axis:
        """An axis that holds all values.

        Parameters
        ----------
        quantity, unit : what it shows, in which unit
        values : (n,), in that unit; what is not finite counts for nothing
        log : whether it is logarithmic
        margin : room at both ends, as a share of the range [-]
        zero : a linear axis then begins (or ends) at zero

        Returns
        -------
        axis : Axis
        """
        smallest = 1 / _LARGEST if log else -_LARGEST
        if isinstance(values, np.ndarray) and len(values) and smallest <= values.min() and values.max() <= _LARGEST:
            values = (float(values.min()), float(values.max()))
        usable = [value for value in values if smallest <= value <= _LARGEST]
        if log:
            low, high = (min(usable), max(usable)) if usable else (1e-3, 1.0)
            room = max(0.12, margin * (math.log10(high) - math.log10(low)))
            return Axis(quantity, unit, low * 10**-room, high * 10**room, True)
        if zero:
            usable.append(0.0)
        low, high = (min(usable), max(usable)) if usable else (0.0, 1.0)
        if zero and low == high == 0:
            high = 1.0
        if high - low <= max(1e-12 * max(abs(low), abs(high)), 1 / _LARGEST):
            # A constant: show it in the middle of a range of its own size.
            half = abs(high) / 2 if abs(high) > 1 / _LARGEST else 0.5
            low, high = low - half, high + half
        room = margin * (high - low)
        largest = max(abs(low), abs(high))
        exponent = math.floor(math.log10(largest)) if largest < 1e-2 or largest >= 1e5 else 0
        return Axis(
            quantity, unit, low - (0.0 if zero and low == 0 else room), high + (0.0 if zero and high == 0 else room), False, exponent
        )

    @property
    def title(self) -> str:
        """The quantity with its unit, and the power of ten that its labels are divided by."""
        words = unit(self.unit)
        if self.exponent:
            words = f"{power(self.exponent)} {words}".strip()
        return f"{self.quantity} [{words}]" if words else self.quantity

    def fraction(self, value: float) -> float:
        """Where the value lies, 0 at the low end and 1 at the high end; values outside are moved to just outside."""
        if self.log:
            begin = math.log10(self.low)
            position = (math.log10(max(value, 1 / _LARGEST)) - begin) / (math.log10(self.high) - begin)
        else:
            position = (value - self.low) / (self.high - self.low)
        return min(max(position, -0.5), 1.5)

    def pixels(self, values: Sequence[float] | NDArray[np.float64], start: float, end: float) -> NDArray[np.float64]:
        """Pixels of many values, the same as by `fraction`.

        Parameters
        ----------
        values : (n,), in the unit of the axis
        start, end : [pixel] of its low and its high end

        Returns
        -------
        pixels : (n,) [pixel]
        """
        array = np.asarray(values, np.float64)
        if self.log:
            begin = math.log10(self.low)
            position = (np.log10(np.maximum(array, 1 / _LARGEST)) - begin) / (math.log10(self.high) - begin)
        else:
            with np.errstate(over="ignore"):  # what is too far off to be told is at the edge
                position = (array - self.low) / (self.high - self.low)
        return start + np.clip(position, -0.5, 1.5) * (end - start)

    def ticks(self, most: int = 6) -> list[tuple[float, str]]:
        """At most about so many (value, label)."""
        return self._decades(most) if self.log else self._linear(most)

    def _decades(self, most: int) -> list[tuple[float, str]]:
        first, last = math.ceil(math.log10(self.low) - 1e-9), math.floor(math.log10(self.high) + 1e-9)
        if last - first >= 2:
            stride = max(1, math.ceil((last - first + 1) / most))
            plain = first >= -3 and last <= 3
            exponents = range(first, last + 1, stride)
            return [
                (10.0**exponent, number(10.0**exponent, 1) if plain or 0 <= exponent <= 1 else power(exponent)) for exponent in exponents
            ]
        values = [mantissa * 10.0**exponent for exponent in range(first - 1, last + 2) for mantissa in (1, 2, 3, 5)]
        inside = [value for value in values if self.low <= value <= self.high]
        if len(inside) < 2:
            # Less than between two of these: as good as linear.
            return self._linear(most)
        return [(value, number(value, 2)) for value in (inside if 2 <= len(inside) <= most else inside[:: max(1, len(inside) // most)])]

    def _linear(self, most: int) -> list[tuple[float, str]]:
        raw = (self.high - self.low) / most
        magnitude = 10.0 ** math.floor(math.log10(raw))
        step = next(nice * magnitude for nice in _NICE if nice * magnitude >= raw * 0.999)
        first, last = math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9)
        scale = 10.0**self.exponent
        # So many digits that two neighbours differ, and four where fewer do.
        digits = max(4, math.ceil(math.log10(max(abs(first), abs(last), 1))) + 1)
        return [(place * step, number(place * step / scale, digits)) for place in range(first, last + 1)]
