"""Quantiles of chi-square.

`scipy.special` has them too, but to load it takes as long as to load Pinocchio.
"""

from __future__ import annotations

from math import exp, inf, lgamma, log

__all__ = ["chi_square_quantile"]

EPSILON = 2.0**-52

STEPS = 60
"""Most steps; seven are usual. Rounding moves the last ones for millions of degrees."""


def chi_square_quantile(dof: int, tail: float) -> float:
    """What chi-square exceeds with a given probability.

    Args:
        dof: Degrees of freedom, 1 or more.
        tail: That probability, between 0 and 1.

    Example:
        >>> round(chi_square_quantile(3, 0.05), 6)
        7.814728
    """
    # Newton's method on the logarithm of the smaller tail, which is nearly straight;
    # where it leaves what is known to hold the quantile, bisection.
    x, low, high = float(dof), 0.0, inf
    for _ in range(STEPS):
        upper, lower, density = _tails(0.5 * dof, 0.5 * x)
        if upper > tail:
            low = x
        else:
            high = x
        if tail < 0.5:
            step = upper / density * log(upper / tail) if upper > 0.0 else -inf
        else:
            step = lower / density * log((1.0 - tail) / lower) if lower > 0.0 else inf
        new = x + 2.0 * step
        if not low < new < high:
            new = 2.0 * x if high == inf else 0.5 * (low + high)
        x, last = new, x
        if abs(x - last) <= 4.0 * EPSILON * x:
            break
    return x


def _tails(a: float, x: float) -> tuple[float, float, float]:
    """Regularized incomplete gamma functions Q(a, x) and P(a, x), and -dQ/dx.

    By the series where P is the smaller one, else by the continued fraction
    (Abramowitz and Stegun 6.5.29 and 6.5.31, the latter by Lentz's method).
    """
    density = exp(a * log(x) - x - lgamma(a)) / x
    if x < a + 1.0:
        term = total = 1.0 / a
        n = a
        while term > EPSILON * total:
            n += 1.0
            term *= x / n
            total += term
        lower = density * x * total
        return 1.0 - lower, lower, density
    b = x + 1.0 - a
    c, d = inf, 1.0 / b
    fraction, change = d, inf
    i = 0
    while abs(change - 1.0) > EPSILON:
        i += 1
        b += 2.0
        factor = i * (a - i)
        d = 1.0 / (factor * d + b)
        c = b + factor / c
        change = c * d
        fraction *= change
    upper = density * x * fraction
    return upper, 1.0 - upper, density
