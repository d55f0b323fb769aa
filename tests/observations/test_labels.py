"""Codes of names and configurations, counted or sorted."""

from __future__ import annotations

import numpy as np
import pytest

from calib_pin.observations.labels import SPARSE, firsts, numbered


@pytest.mark.parametrize("largest", [1, 30, 50 * SPARSE, 10**12])
def test_codes_are_numbered_as_sorting_numbers_them(largest: int) -> None:
    codes = np.random.default_rng(0).integers(0, largest, 50)
    distinct, number = numbered(codes)
    expected = np.unique(codes, return_index=True, return_inverse=True)
    np.testing.assert_array_equal(distinct, expected[0])
    np.testing.assert_array_equal(number, expected[2])
    np.testing.assert_array_equal(firsts(codes), np.sort(expected[1]))


def test_no_codes_have_no_numbers() -> None:
    none = np.zeros(0, np.int64)
    assert [len(found) for found in (*numbered(none), firsts(none))] == [0, 0, 0]
