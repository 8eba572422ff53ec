"""Rounding of printed numbers, by hand."""

import numpy as np
import pytest

from validate.judge.printed import columns_rounding, rounding


def test_rounding_four_decimals_half_a_unit_each():
    assert rounding(np.array([0.1234, 0.5, -1.2345]), 1.0) == pytest.approx([5e-5] * 3)


def test_rounding_significant_digits_scale_with_each_number():
    found = rounding(np.array([1.234e-6, 1.234, 123.4]), 1e9)
    assert found == pytest.approx([5e-10, 5e-4, 5e-2])


def test_rounding_all_digits_next_to_nothing():
    assert rounding(np.sin(np.arange(5.0)), 1.0).max() < 1e-15


def test_rounding_float32_half_its_spacing():
    values = np.sin(np.arange(1.0, 5.0)).astype(np.float32).astype(float)
    assert rounding(values, 1.0) == pytest.approx(
        [0.5 * float(np.spacing(np.float32(abs(value)))) for value in values]
    )


def test_rounding_few_digits_at_most_a_share_of_the_nominal():
    assert rounding(np.array([0.3, 1.0]), 0.1).tolist() == [5e-5] * 2


def test_columns_rounding_each_column_by_itself():
    found = columns_rounding(np.array([[0.123, 1.0 / 3.0], [0.5, 2.0 / 3.0]]), np.ones(2))
    assert found.shape == (2, 2)
    assert found[:, 0].tolist() == [5e-4] * 2
    assert found[:, 1].max() < 1e-15
    assert columns_rounding(np.zeros((3, 0)), 1.0).shape == (3, 0)
