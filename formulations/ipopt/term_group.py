"""All terms of one shape in one model: index arrays settled once, data re-read at each refresh, derivatives evaluated together."""

from __future__ import annotations

import numpy as np

from formulations.ipopt.shapes import Shape
from formulations.ipopt.terms import Bucket


class TermGroup:
    """N instances of a shape. Arrays over instances are the last axis.

    rows, weights: (N,) the row of the model each term belongs to, and the number it is multiplied by there
    columns: (slots, N) the variable in each slot
    """

    def __init__(self, shape: Shape, bucket: Bucket) -> None:
        self.shape = shape
        self.rows = np.array(bucket.rows, dtype=np.intp)
        self.weights = np.array(bucket.weights, dtype=float)
        count = len(self.rows)
        self.columns = np.array(bucket.slots, dtype=np.intp).reshape(count, -1).T.copy()
        self._numbers = np.array(bucket.numbers, dtype=float).reshape(count, -1).T
        self._params = np.array(bucket.params, dtype=np.intp).reshape(count, -1).T
        self._curved = self.columns[list(shape.curved)]
        self._prepared = np.empty((shape.prepared, count))
        self._hoisted: list[np.ndarray] = []

    # -- structure --------------------------------------------------------------------------------------------------------------

    @property
    def affine_entries(self) -> tuple[np.ndarray, np.ndarray]:
        """(rows, columns) of the affine part, slot after slot; values in `affine_values` after a refresh."""
        slots = list(self.shape.linear)
        return np.tile(self.rows, len(slots)), self.columns[slots].ravel()

    @property
    def slope_entries(self) -> tuple[np.ndarray, np.ndarray]:
        """(rows, columns) of the nonlinear part's gradient entries."""
        slots = list(self.shape.slope_slots)
        return np.tile(self.rows, len(slots)), self._curved[slots].ravel()

    @property
    def curvature_entries(self) -> tuple[np.ndarray, np.ndarray]:
        """(larger column, smaller column) of each Hessian entry."""
        first, second = (self._curved[slots].ravel() for slots in self.shape.hessian_pairs)
        return np.maximum(first, second), np.minimum(first, second)

    # -- values -----------------------------------------------------------------------------------------------------------------

    def refresh(self, data: np.ndarray) -> None:
        """Compute everything that depends on data alone; data: (number of data,)."""
        rows = [*self._numbers, *data[self._params]]
        self.shape.prepare(rows, self._prepared)
        self._hoisted = list(self._prepared[1 + len(self.shape.linear) :])

    @property
    def constants(self) -> np.ndarray:
        """(N,) weighted constant parts."""
        return self.weights * self._prepared[0]

    @property
    def affine_values(self) -> np.ndarray:
        return (self.weights * self._prepared[1 : 1 + len(self.shape.linear)]).ravel()

    @property
    def is_curved(self) -> bool:
        return self.shape.value is not None

    def values(self, x: np.ndarray) -> np.ndarray:
        """(N,) weighted values of the nonlinear parts at x (n,)."""
        out = np.empty((1, len(self.rows)))
        self.shape.value(x[self._curved], self._hoisted, out)  # pyright: ignore[reportOptionalCall] - asked only where is_curved
        return self.weights * out[0]

    def slopes(self, x: np.ndarray) -> np.ndarray:
        """Weighted gradient entries, in the order of `slope_entries`."""
        out = np.empty((len(self.shape.slope_slots), len(self.rows)))
        if self.shape.slope is not None:
            self.shape.slope(x[self._curved], self._hoisted, out)
        return (self.weights * out).ravel()

    def curvatures(self, x: np.ndarray, multipliers: np.ndarray) -> np.ndarray:
        """Hessian entries times weight times the multiplier of each term's row, in the order of `curvature_entries`."""
        out = np.empty((self.shape.hessian_pairs.shape[1], len(self.rows)))
        if self.shape.hessian is not None:
            self.shape.hessian(x[self._curved], self._hoisted, out)
        return (self.weights * multipliers[self.rows] * out).ravel()
