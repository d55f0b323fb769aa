"""Cells of configurations and quantities."""

from __future__ import annotations

import numpy as np
import pytest

from calib_pin.estimation.robust.studentized import DENSE, _numbered


@pytest.mark.parametrize("spread", [1, DENSE, 100 * DENSE])
def test_cells_are_numbered_alike_by_a_table_and_by_sorting(spread: int) -> None:
    rng = np.random.default_rng(0)
    values = rng.integers(0, 500 * spread, 500)
    found, expected = _numbered(values), np.unique(values, return_inverse=True)
    for own, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(own, other)
    empty, places = _numbered(values[:0])
    assert len(empty) == len(places) == 0
