"""Tail of Student's t distribution.

`scipy.special` has it too, but to load it takes as long as to load Pinocchio.
"""

from __future__ import annotations

from math import inf, isnan, nan

from calib_pin.estimation.statistics.chi_square import incomplete_beta


def student_tail(t: float, dof: int) -> float:
    """Probability that Student's t exceeds a value.

    `P(T > t) = I_x(dof / 2, 1 / 2) / 2` for t > 0, with `x = dof / (dof + t^2)` and the
    regularized incomplete beta function (Abramowitz and Stegun 26.7.1).

    Args:
        t: The value.
        dof: Degrees of freedom, 1 or more.

    Example:
        >>> round(student_tail(2.0, 10), 6)
        0.036694
    """
    if isnan(t):
        return nan
    if t < 0.0:
        return 1.0 - student_tail(-t, dof)
    if t == inf:
        return 0.0
    a, square = 0.5 * dof, t * t
    x, y = dof / (dof + square), square / (dof + square)
    if x < (a + 1.0) / (a + 2.5):
        return 0.5 * incomplete_beta(a, 0.5, x, y)
    return 0.5 * (1.0 - incomplete_beta(0.5, a, y, x))
