"""Hold what the measurements do not tell by the size that errors are expected to have.

Measurements in a corner of the workspace determine some directions of the error space
well and others hardly. To estimate the latter freely makes the robot worse everywhere
else; to leave them alone by a hard cut makes it a matter of a threshold. Here every
error of the robot has a normal prior about nominal, and the solution is the mode of the
posterior. Of all estimates it has the least expected error at every configuration. The
size of errors, one for each kind of parameter (placement, compliance, ...), is told by
the measurements where they can (evidence, or type II maximum likelihood: MacKay,
Bayesian interpolation, 1992): what a kind shows nowhere does not grow where the
measurements do not see it.
"""

from __future__ import annotations

from collections.abc import Sequence
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

SWEEPS = 50
"""Most rounds over the kinds; a few suffice."""

PARTS = 3
"""Sizes that stand for the distribution where predictions are averaged over it."""

NOTICED = 1e-3
"""Change of an estimate, in its own standard deviations, that nobody can notice."""

CLEAR = 10.0
"""Deviation of a direction, by that of the last of the best determined quarter, from
which it counts as evidence by more than noise.

The worse a direction is determined, the more of what the model lacks it collects: gears
with the size that noise alone allows made other motions of a real UR10 worse than
nominal (1.2 mm rms; 0.51 to 0.52 mm with any limit from 3 to 30).
"""

VISIBLE = 1e-9
"""Part of the largest singular value below which the rows do not see a direction."""


@dataclass(frozen=True)
class Evidence:
    """The size of the robot's errors by a least-squares fit.

    Attributes:
        expected: The prior.
        likely: Sizes in the place of its own that are as likely, shape (PARTS, P).
        matters: Whether it changes the solution by anything to speak of.
        square: Sum of the squared estimates in their standard deviations: chi-square
            of `count` degrees of freedom if the robot is as nominal.
        count: Number of directions that the rows see.
    """

    expected: Expected
    likely: Floats
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


def expected_sizes(
    values: Floats, variances: Floats, halves: Sequence[Floats]
) -> tuple[Floats, Floats]:
    """The size of errors of each kind by their evidence, in scales.

    Estimates `b ~ N(0, sum_k tau_k^2 H_k H_k^T + diag(v))`; one size after the other is
    chosen beside the others until none changes.

    Args:
        values: Estimates b, shape (k,).
        variances: Their variances v, shape (k,).
        halves: What errors of every kind, one scale large, contribute to them: H, shape
            (k, p) each, K of them.

    Returns:
        The most likely sizes, shape (K,), and for each kind the middles of `PARTS`
        equally likely parts of its distribution beside the others, (K, PARTS).
    """
    sizes, parts = np.ones(len(halves)), np.ones((len(halves), PARTS))
    deviations = np.sqrt(variances)
    values = values / deviations
    halves = [half / deviations[:, None] for half in halves]
    for _ in range(SWEEPS):
        before = sizes.copy()
        for k, half in enumerate(halves):
            others = [sizes[j] * halves[j] for j in range(len(halves)) if j != k]
            P, t = _principal(np.hstack([np.zeros((len(values), 0)), *others]))
            # In these units all but this kind is one, and this kind diagonal.
            units = (P / np.hypot(1.0, t)).T
            U, s, _ = np.linalg.svd(units @ half, full_matrices=False)
            told = s > VISIBLE * s.max(initial=0.0)
            along = U[:, told].T @ units @ values
            sizes[k], parts[k] = expected_size(along / s[told], s[told] ** -2.0)
        if np.array_equal(sizes, before):
            break
    return sizes, parts


def _principal(G: Floats) -> tuple[Floats, Floats]:
    """All directions of an (n, p) matrix, shape (n, n), and their lengths, (n,)."""
    P, t, _ = np.linalg.svd(G)
    return P, np.append(t, np.zeros(len(P) - len(t)))


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
    of_kind = [parameters.kinds == kind for kind in np.unique(parameters.kinds)]
    of_kind = [own for own in of_kind if V[own].any()]
    A = jac * parameters.scales
    system = projected(np.column_stack([A @ V, fun]), A, parameters)
    triangle = np.asarray(np.linalg.qr(system, mode="r"))
    U, s, Wt = np.linalg.svd(triangle[:, :-1], full_matrices=False)
    seen = s > VISIBLE * s.max(initial=0.0)
    s, Wt = s[seen], Wt[seen]
    variances = (unit / s) ** 2
    current = Wt @ (V.T @ (theta / parameters.scales))
    # At the least squares what was moved has no gradient; what was not, has.
    values = current - (U[:, seen].T @ triangle[:, -1]) / s
    quarter = np.quantile(variances, 0.25) if len(variances) else np.inf
    beside = variances * (1.0 + variances / (CLEAR**2 * quarter))
    half = Wt @ V.T
    found = expected_sizes(values, beside, [half[:, own] for own in of_kind])
    sizes, likely = np.ones(len(V)), np.ones((PARTS, len(V)))
    for own, size, parts in zip(of_kind, *found, strict=True):
        sizes[own], likely[:, own] = size, parts[:, None]
    deviations = np.sqrt(variances)
    P, t = _principal(half * sizes / deviations[:, None])
    kept = (P * (t / np.hypot(1.0, t)) ** 2) @ P.T
    change = kept @ (values / deviations) - current / deviations
    shift = change / np.sqrt(np.diag(kept))
    return Evidence(
        expected=Expected(V, sizes, parameters.scales),
        likely=likely,
        matters=bool(np.abs(shift).max(initial=0.0) > NOTICED),
        square=float(np.sum(values**2 / variances)),
        count=len(values),
    )
