"""Tail of Student's t distribution.

`scipy.special` has it too, but to load it takes as long as to load Pinocchio.
"""

from __future__ import annotations

from math import exp, inf, isnan, lgamma, log, log1p, nan

__all__ = ["student_tail"]

EPSILON = 2.0**-52

STEPS = 10_000
"""Most terms of the continued fraction; it takes about the root of the degrees."""

TINY = 1e-300


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
        return 0.5 * _incomplete_beta(a, 0.5, x, y)
    return 0.5 * (1.0 - _incomplete_beta(0.5, a, y, x))


def _incomplete_beta(a: float, b: float, x: float, y: float) -> float:
    """I_x(a, b) with y = 1 - x, for x below about a / (a + b).

    By the continued fraction of Abramowitz and Stegun 26.5.8, with Lentz's method.
    """
    if x == 0.0:
        return 0.0
    front = exp(
        lgamma(a + b)
        - lgamma(a)
        - lgamma(b)
        + a * (log(x) if x < 0.5 else log1p(-y))
        + b * (log(y) if y < 0.5 else log1p(-x))
    )
    c, d = 1.0, 1.0 / _nonzero(1.0 - (a + b) * x / (a + 1.0))
    fraction = d
    for m in range(1, STEPS):
        even = m * (b - m) * x / ((a + 2 * m - 1.0) * (a + 2 * m))
        odd = -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1.0))
        for factor in (even, odd):
            d = 1.0 / _nonzero(1.0 + factor * d)
            c = _nonzero(1.0 + factor / c)
            change = c * d
            fraction *= change
        if abs(change - 1.0) <= 4.0 * EPSILON:
            break
    return front * fraction / a


def _nonzero(value: float) -> float:
    return value if abs(value) > TINY else TINY
