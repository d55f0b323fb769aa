"""Quantiles of chi-square against those of scipy."""

from __future__ import annotations

import pytest
from scipy.special import chdtri

from calib_pin.chi_square import chi_square_quantile


@pytest.mark.parametrize("tail", [0.975, 0.5, 0.025, 1e-4, 1e-8])
@pytest.mark.parametrize("dof", [1, 2, 3, 6, 7, 100, 2970, 100_000, 3_000_000])
def test_quantiles_are_those_of_scipy(dof: int, tail: float) -> None:
    # Of a million degrees of freedom the logarithm of the density is a difference of
    # numbers near 1e7, whose rounding is 2e-9; the quantile is sqrt(2 / dof) as far.
    assert chi_square_quantile(dof, tail) == pytest.approx(chdtri(dof, tail), rel=1e-11)
