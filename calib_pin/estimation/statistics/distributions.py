"""Quantiles and tails of distributions, by scipy.

Its modules are loaded by what computes with them: to import them takes as long as to
import Pinocchio.
"""

from __future__ import annotations

from math import erfc, nan, sqrt


def normal_tail(deviations: float) -> float:
    """Probability of a normal deviate above so many standard deviations.

    Examples:
        >>> round(normal_tail(1.959964), 6)
        0.025
    """
    return 0.5 * erfc(deviations / sqrt(2.0))


def chi_square_quantile(dof: float, tail: float) -> float:
    """The value that chi-square exceeds with a given probability.

    Examples:
        >>> round(chi_square_quantile(3, 0.05), 6)
        7.814728
    """
    from scipy.special import chdtri

    return float(chdtri(dof, tail))


def chi2_interval(dof: int) -> tuple[float, float]:
    """The interval that holds chi-square in 95 of 100 cases if all sigmas are right."""
    return chi_square_quantile(dof, 0.975), chi_square_quantile(dof, 0.025)


def chi_square_tail(x: float, dof: float) -> float:
    """Probability that chi-square exceeds a value.

    Examples:
        >>> round(chi_square_tail(7.814728, 3), 6)
        0.05
    """
    from scipy.special import chdtrc

    return float(chdtrc(dof, x if x > 0.0 else 0.0))


def f_tail(x: float, above: float, below: float) -> float:
    """Probability that Fisher's F exceeds a value.

    Args:
        x: The value.
        above: Degrees of freedom of the numerator.
        below: Those of the denominator.

    Examples:
        >>> round(f_tail(4.964603, 1, 10), 6)
        0.05
    """
    from scipy.special import fdtrc

    return float(fdtrc(above, below, x if x > 0.0 else 0.0))


def student_tail(t: float, dof: float) -> float:
    """Probability that Student's t exceeds a value.

    Examples:
        >>> round(student_tail(2.0, 10), 6)
        0.036694
    """
    from scipy.special import stdtr

    return float(stdtr(dof, -t))


def student_quantile(dof: float, tail: float) -> float:
    """The value that Student's t exceeds with a given probability.

    Examples:
        >>> round(student_quantile(10, 0.036694), 4)
        2.0
    """
    from scipy.special import stdtrit

    return -float(stdtrit(dof, tail))


def share_interval(successes: int, count: int) -> tuple[float, float, float]:
    """A share and its 95 % interval by the score test (Wilson 1927).

    Args:
        successes: Number of successes.
        count: Number of trials; without any nothing is known (NaN).

    Examples:
        >>> [round(value, 3) for value in share_interval(19, 20)]
        [0.95, 0.764, 0.991]
    """
    if not count:
        return nan, nan, nan
    from scipy.stats import binomtest

    share = successes / count
    low, high = binomtest(successes, count).proportion_ci(0.95, "wilson")
    # At its ends the interval holds the share but for rounding.
    return share, min(float(low), share), max(float(high), share)
