"""Hold what the measurements do not tell by the size that errors are expected to have.

Measurements in a corner of the workspace determine some directions of the error space
well and others hardly. To estimate the latter freely makes the robot worse everywhere
else; to leave them alone by a hard cut makes it a matter of a threshold. Here every
direction of the robot has a normal prior about nominal, whose size the measurements
tell where they can (evidence, or type II maximum likelihood: MacKay, Bayesian
interpolation, 1992), and the solution is the mode of the posterior. Of all estimates it
has the least expected error at every configuration.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib_pin.estimation.directions import Directions, projected
from calib_pin.estimation.row_blocks import Expected
from calib_pin.kinematics.spatial import Floats
from calib_pin.parameters import ParameterSet

STATED = 2.0
"""Directions that the stated size of errors is worth against those that are measured.

With as few the evidence of a handful of well determined directions prevails."""

SIZES = np.geomspace(1e-3, 1e3, 601)
"""Sizes that are tried, in scales; far finer than any is known."""

PARTS = 3
"""Sizes that stand for the distribution where predictions are averaged over it."""

NOTICED = 1e-3
"""Change of an estimate, in its own standard deviations, that nobody can notice."""

VISIBLE = 1e-9
"""Part of the largest singular value below which the rows do not see a direction."""


@dataclass(frozen=True)
class Evidence:
    """The size of the robot's errors by a least-squares fit.

    Attributes:
        expected: The prior.
        sizes: Sizes in the place of its own that are as likely, see `expected_size`.
        matters: Whether it changes the solution by anything to speak of.
        square: Sum of the squared estimates in their standard deviations: chi-square
            of `count` degrees of freedom if the robot is as nominal.
        count: Number of directions that the rows see.
    """

    expected: Expected
    sizes: Floats
    matters: bool
    square: float
    count: int


def expected_size(values: Floats, variances: Floats) -> tuple[float, Floats]:
    """The size of errors by its evidence, in scales.

    Estimates `b_i ~ N(0, tau^2 + v_i)` of errors of size tau; `tau^2` itself is about 1
    beforehand (inverse chi-square with `STATED` degrees of freedom).

    Args:
        values: Estimates b of errors along independent directions, shape (k,).
        variances: Their variances v, shape (k,).

    Returns:
        The most likely size, and the middles of `PARTS` equally likely parts of its
        distribution, ascending.

    Examples:
        >>> round(expected_size(np.zeros(0), np.zeros(0))[0], 9)
        1.0
    """
    squares = SIZES[:, None] ** 2
    total = squares + variances
    terms = np.sum(np.log(total) + values**2 / total, axis=1)
    terms += STATED * (np.log(squares) + 1.0 / squares)[:, 0]
    likely = np.cumsum(np.exp(0.5 * (terms.min() - terms)))
    middles = (np.arange(PARTS) + 0.5) / PARTS
    parts = SIZES[np.searchsorted(likely, middles * likely[-1])]
    return float(SIZES[np.argmin(terms)]), parts


def expected_errors(
    directions: Directions,
    parameters: ParameterSet,
    theta: Floats,
    fun: Floats,
    jac: Floats,
    unit: float,
) -> Evidence:
    """The prior of the robot's directions by the evidence of a least-squares fit.

    Args:
        directions: Directions that the fit moved, and those held at nominal.
        parameters: The parameters; what has a prior of its own has no other.
        theta: The solution, shape (P,).
        fun: Whitened residual there, shape (M,).
        jac: Whitened Jacobian there, shape (M, P).
        unit: Standard deviation of unit weight.
    """
    V = np.column_stack([directions.robot, directions.weak])
    V = V * ~np.isfinite(parameters.priors)[:, None]
    A = jac * parameters.scales
    system = projected(np.column_stack([A @ V, fun]), A, parameters)
    triangle = np.asarray(np.linalg.qr(system, mode="r"))
    U, s, Wt = np.linalg.svd(triangle[:, :-1], full_matrices=False)
    shown = s > VISIBLE * s.max(initial=0.0)
    s, Wt = s[shown], Wt[shown]
    variances = (unit / s) ** 2
    current = Wt @ (V.T @ (theta / parameters.scales))
    # At the least squares what was moved has no gradient; what was not, has.
    values = current - (U[:, shown].T @ triangle[:, -1]) / s
    size, sizes = expected_size(values, variances)
    part = size**2 / (size**2 + variances)
    shift = (part * values - current) / np.sqrt(part * variances)
    return Evidence(
        expected=Expected(V, size, parameters.scales),
        sizes=sizes,
        matters=bool(np.abs(shift).max(initial=0.0) > NOTICED),
        square=float(np.sum(values**2 / variances)),
        count=len(values),
    )
