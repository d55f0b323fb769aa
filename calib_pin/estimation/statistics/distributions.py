"""Quantiles and tails of chi-square, tails of Fisher's F and of Student's t.

`scipy.special` has them too, but to load it takes as long as to load Pinocchio.
"""

from __future__ import annotations

from math import exp, inf, isnan, lgamma, log, log1p, nan, sqrt

EPSILON = 2.0**-52

STEPS = 60
"""Most steps; seven are usual. Rounding moves the last ones for millions of degrees."""

TERMS = 10_000
"""Most terms of a continued fraction; it takes about the root of the degrees."""

NORMAL = 1.959964
"""Standard deviations within which 95 % of a normal distribution lie."""

TINY = 1e-300
"""In place of a zero denominator of a continued fraction (Lentz's method)."""


def chi_square_quantile(dof: float, tail: float) -> float:
    """The value that chi-square exceeds with a given probability.

    Args:
        dof: Degrees of freedom, positive, whole or not.
        tail: That probability, between 0 and 1.

    Examples:
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


def chi_square_tail(x: float, dof: float) -> float:
    """Probability of chi-square to exceed a value.

    Args:
        x: The value.
        dof: Degrees of freedom, positive, whole or not.

    Examples:
        >>> round(chi_square_tail(7.814728, 3), 6)
        0.05
    """
    return _tails(0.5 * dof, 0.5 * x)[0] if x > 0.0 else 1.0


def f_tail(x: float, above: float, below: float) -> float:
    """Probability of Fisher's F to exceed a value.

    Of one degree of freedom above it is the probability of Student's t to exceed the
    root of the value in size.

    Args:
        x: The value.
        above: Degrees of freedom of the numerator, positive, whole or not.
        below: Those of the denominator.

    Examples:
        >>> round(f_tail(4.964603, 1, 10), 6)
        0.05
    """
    if not x > 0.0:
        return 1.0
    part = above * x / (above * x + below)
    # The continued fraction converges fast below the mean only.
    if part * (above + below + 4.0) < above + 2.0:
        return 1.0 - incomplete_beta(0.5 * above, 0.5 * below, part, 1.0 - part)
    rest = below / (above * x + below)
    return incomplete_beta(0.5 * below, 0.5 * above, rest, part)


def incomplete_beta(a: float, b: float, x: float, y: float) -> float:
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
    for m in range(1, TERMS):
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


def student_tail(t: float, dof: int) -> float:
    """Probability that Student's t exceeds a value.

    `P(T > t) = I_x(dof / 2, 1 / 2) / 2` for t > 0, with `x = dof / (dof + t^2)` and the
    regularized incomplete beta function (Abramowitz and Stegun 26.7.1).

    Args:
        t: The value.
        dof: Degrees of freedom, 1 or more.

    Examples:
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


def share_interval(found: int, count: int) -> tuple[float, float, float]:
    """A share and its 95 % interval by the score test (Wilson 1927).

    Args:
        found: Number of successes.
        count: Number of trials; without any nothing is known (NaN).

    Examples:
        >>> [round(value, 3) for value in share_interval(19, 20)]
        [0.95, 0.764, 0.991]
    """
    if not count:
        return nan, nan, nan
    share, square = found / count, NORMAL**2 / count
    middle = (share + square / 2.0) / (1.0 + square)
    half = sqrt(square * (share * (1.0 - share) + square / 4.0)) / (1.0 + square)
    # At its ends the interval holds the share but for rounding.
    return share, min(max(middle - half, 0.0), share), max(middle + half, share)
