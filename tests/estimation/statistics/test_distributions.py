"""Quantiles and tails of chi-square, F and Student's t against those of scipy."""

from __future__ import annotations

import math
from itertools import product

import pytest
from scipy.special import chdtrc, chdtri, fdtrc
from scipy.stats import t as student

from calib_pin.estimation.statistics.distributions import (
    chi_square_quantile,
    chi_square_tail,
    f_tail,
    student_tail,
)


def test_quantiles_are_those_of_scipy() -> None:
    # Of a million degrees of freedom the logarithm of the density is a difference of
    # numbers near 1e7, whose rounding is 2e-9; the quantile is sqrt(2 / dof) as far.
    for dof in (1, 2, 3, 7.3, 100, 2970.5, 3_000_000):
        for tail in (0.975, 0.5, 0.025, 1e-4, 1e-8):
            expected = pytest.approx(chdtri(dof, tail), rel=1e-10)
            assert chi_square_quantile(dof, tail) == expected, (dof, tail)


def test_tails_are_those_of_scipy() -> None:
    for dof in (0.5, 1, 2, 7.3, 100, 2970.5):
        for ratio in (0.0, 0.01, 0.5, 1.0, 1.2, 3.0):
            expected = pytest.approx(chdtrc(dof, ratio * dof), rel=1e-10, abs=1e-15)
            assert chi_square_tail(ratio * dof, dof) == expected, (dof, ratio)


def test_tails_of_f_are_those_of_scipy() -> None:
    # The logarithms of gamma functions near 1e6 leave 1e-10 of what they multiply.
    for above, below in product((1, 2.5, 30, 2970), (1, 4, 33.3, 500, 100_000)):
        for x in (0.0, 1e-6, 0.3, 1.0, 1.5, 4.0, 100.0):
            expected = pytest.approx(fdtrc(above, below, x), rel=1e-8, abs=1e-15)
            assert f_tail(x, above, below) == expected, (x, above, below)


def test_tails_of_student_are_those_of_scipy() -> None:
    for dof in (1, 2, 3, 10, 300, 1_000_000):
        for t in (0.0, 1e-6, 0.1, 0.7, 1.5, 3.0, 8.0, 30.0):
            expected = float(student.sf(t, dof))
            # lgamma of a million half degrees keeps nine digits of its difference.
            assert student_tail(t, dof) == pytest.approx(expected, rel=1e-7, abs=1e-300)
            assert student_tail(-t, dof) == pytest.approx(1.0 - expected, rel=1e-7)


def test_ends() -> None:
    assert student_tail(math.inf, 3) == 0.0
    assert student_tail(-math.inf, 3) == 1.0
    assert math.isnan(student_tail(math.nan, 3))
