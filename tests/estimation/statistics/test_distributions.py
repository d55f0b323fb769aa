"""Quantiles and tails of chi-square, F and Student's t against those of scipy."""

from __future__ import annotations

import math

import pytest
from scipy.special import chdtrc, chdtri, fdtrc

from calib_pin.estimation.statistics.distributions import (
    chi_square_quantile,
    chi_square_tail,
    f_tail,
    student_tail,
)


@pytest.mark.parametrize("tail", [0.975, 0.5, 0.025, 1e-4, 1e-8])
@pytest.mark.parametrize("dof", [1, 2, 3, 6, 7.3, 100, 2970.5, 100_000, 3_000_000])
def test_quantiles_are_those_of_scipy(dof: float, tail: float) -> None:
    # Of a million degrees of freedom the logarithm of the density is a difference of
    # numbers near 1e7, whose rounding is 2e-9; the quantile is sqrt(2 / dof) as far.
    assert chi_square_quantile(dof, tail) == pytest.approx(chdtri(dof, tail), rel=1e-11)


@pytest.mark.parametrize("dof", [0.5, 1, 2, 7.3, 100, 2970.5])
@pytest.mark.parametrize("ratio", [0.0, 0.01, 0.5, 1.0, 1.2, 3.0])
def test_tails_are_those_of_scipy(ratio: float, dof: float) -> None:
    found = chi_square_tail(ratio * dof, dof)
    assert found == pytest.approx(chdtrc(dof, ratio * dof), rel=1e-11, abs=1e-15)


@pytest.mark.parametrize("above", [1, 2.5, 30, 2970])
@pytest.mark.parametrize("below", [1, 4, 33.3, 500, 100_000])
@pytest.mark.parametrize("x", [0.0, 1e-6, 0.3, 1.0, 1.5, 4.0, 100.0])
def test_tails_of_f_are_those_of_scipy(x: float, above: float, below: float) -> None:
    # The logarithms of gamma functions near 1e6 leave 1e-10 of what they multiply.
    expected = fdtrc(above, below, x)
    assert f_tail(x, above, below) == pytest.approx(expected, rel=1e-9, abs=1e-15)


@pytest.mark.parametrize("dof", [1, 2, 3, 5, 10, 47, 300, 10_000, 1_000_000])
def test_tails_of_scipy(dof: int) -> None:
    from scipy.stats import t as student

    for t in (0.0, 1e-6, 0.1, 0.7, 1.5, 3.0, 8.0, 30.0):
        expected = float(student.sf(t, dof))
        # lgamma of a million half degrees keeps nine digits of its difference.
        assert student_tail(t, dof) == pytest.approx(expected, rel=1e-8, abs=1e-300)
        assert student_tail(-t, dof) == pytest.approx(1.0 - expected, rel=1e-8)


def test_ends() -> None:
    assert student_tail(math.inf, 3) == 0.0
    assert student_tail(-math.inf, 3) == 1.0
    assert math.isnan(student_tail(math.nan, 3))
