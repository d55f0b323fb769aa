"""Student's t against scipy's."""

from __future__ import annotations

import math

import pytest

from calib_pin.estimation.statistics.distributions import student_tail


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
