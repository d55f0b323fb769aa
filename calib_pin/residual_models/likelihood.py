"""The covariance of the highest marginal likelihood (Rasmussen and Williams 2006, 5.4).

Written out for this covariance: scikit-learn's general search holds the derivative of
the covariance by every parameter in memory, and takes twice as long.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_solve, cholesky
from scipy.linalg.lapack import dpotri
from scipy.optimize import Bounds, minimize

from calib_pin.kinematics.spatial import Floats
from calib_pin.progress import Progress
from calib_pin.residual_models.covariance import Covariance

BOUNDS = {
    "own": (1e-6, 1e4),
    "short": (0.02, 3.0),
    "all": (1e-6, 1e6),
    "long": (0.05, 30.0),
    "noise": (1e-6, 1e2),
}
"""Least and largest values; variances in squared units of the correction."""

QUIETEST = 1e-5
"""Least noise, as a part of the mean square; few measurements look noise-free."""

JITTER = 1e-10
"""Variance beside the noise that keeps the covariance positive definite."""

STEPS = 30
"""Steps of the search; by then the likelihood hardly changes."""


def most_likely(
    angle: Floats,
    A: Floats,
    target: Floats,
    other: Floats,
    *,
    own: bool,
    progress: Progress | None = None,
) -> tuple[Covariance, float]:
    """Maximize the marginal likelihood.

    Args:
        angle: Joint angles, shape (N, n) [rad].
        A: Derivative of the residuals by the corrections, shape (N, d, m).
        target: Residuals that the corrections should make, shape (N, d).
        other: Covariance beside noise and corrections, shape (N d, N d).
        own: Whether components have functions of their own angle.
        progress: Told the part that is done, 0 to 1.

    Returns:
        The covariance and the variance of the noise.
    """
    m, n = A.shape[2], angle.shape[1]
    counts = {"own": m * own, "short": m * own, "all": m, "long": n, "noise": 1}
    y = target.reshape(-1)
    constant = 0.5 * len(y) * np.log(2.0 * np.pi)

    def parts(values: Floats) -> tuple[Covariance, float]:
        cuts = np.cumsum(list(counts.values()))[:-1]
        *of_corrections, noise = np.split(np.exp(values), cuts)
        return Covariance(*of_corrections), float(noise[0])

    def cost(values: Floats) -> tuple[float, Floats]:
        """Negative log-likelihood, and its derivative by the logarithms `values`."""
        covariance, noise = parts(values)
        K = covariance.seen(angle, A) + other
        K[np.diag_indices_from(K)] += noise
        K[np.diag_indices_from(K)] += JITTER
        try:
            L = cholesky(K, lower=True, check_finite=False)
        except LinAlgError:
            return np.inf, np.zeros(len(values))
        alpha = cho_solve((L, True), y, check_finite=False)
        inverse = cho_solve((L, True), np.eye(len(y)), check_finite=False)
        by_K = 0.5 * (inverse - np.outer(alpha, alpha))
        by_noise = noise * np.trace(by_K)
        gradient = np.array([*_by_logarithms(covariance, angle, A, by_K), by_noise])
        return 0.5 * y @ alpha + np.log(np.diag(L)).sum() + constant, gradient

    square = float((target**2).mean())
    least = max(QUIETEST * square, BOUNDS["noise"][0])
    starts = {"own": 0.1, "short": 0.1, "all": 0.3, "long": 1.5}
    starts["noise"] = max(0.1 * square, least)
    limits = {**BOUNDS, "noise": (least, BOUNDS["noise"][1])}
    lower, upper = np.log(np.repeat(list(limits.values()), list(counts.values()), 0)).T
    first = np.log(np.repeat(list(starts.values()), list(counts.values())))
    done = 0

    def count(xk: Floats) -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done / STEPS)

    found = minimize(
        cost,
        np.clip(first, lower, upper),
        jac=True,
        method="L-BFGS-B",
        bounds=Bounds(lower, upper),
        callback=count,
        options={"maxiter": STEPS},
    )
    return parts(found.x)


def _by_logarithms(
    covariance: Covariance, angle: Floats, A: Floats, by_K: Floats
) -> Floats:
    """Derivative of a cost by the logarithms of the covariance's numbers.

    Args:
        covariance: The covariance of the corrections.
        angle: Joint angles, shape (N, n) [rad].
        A: Derivative of the residuals by the corrections, shape (N, d, m).
        by_K: Derivative of the cost by the covariance K of the residuals, shape
            (N d, N d).
    """
    rows, d, _ = A.shape
    # By the covariance of each component of the corrections, shape (m, N, N).
    blocks = by_K.reshape(rows, d, rows, d)
    by_component = np.array(
        [np.einsum("ac,acbe,be->ab", a, blocks, a) for a in np.moveaxis(A, 2, 0)]
    )
    distance = 2.0 - 2.0 * np.cos(angle[:, None] - angle)
    own, short = np.zeros(len(covariance.own)), np.zeros(len(covariance.own))
    for j, values in enumerate(covariance.owns(angle, angle)):
        by_own = covariance.own[j] * values * by_component[j]
        own[j] = by_own.sum()
        short[j] = (by_own * distance[:, :, j]).sum() / covariance.short[j] ** 2
    by_all = covariance.all[:, None, None] * by_component
    by_all *= covariance.alls(angle, angle)
    long = np.einsum("jab,abi->i", by_all, distance, optimize=True)
    return np.concatenate([own, short, by_all.sum((1, 2)), long / covariance.long**2])


def left_out(
    factor: Floats, alpha: Floats, groups: NDArray[np.int64]
) -> tuple[Floats, float]:
    """Residuals of each group of measurements, predicted from all the others.

    Rasmussen and Williams 2006, eq. 5.12, for groups in place of single values.

    Args:
        factor: Lower Cholesky factor of the covariance of the residuals, (N d, N d).
        alpha: Residuals times the inverse covariance, shape (N d,).
        groups: Group of each measurement, shape (N,).

    Returns:
        Residuals, shape (N d,), and their mean square in predicted variances.
    """
    inverse, _ = dpotri(factor, lower=1)
    labels = np.repeat(groups, len(alpha) // len(groups))
    order = np.argsort(labels, kind="stable")
    cuts = np.flatnonzero(np.diff(labels[order])) + 1
    result = np.empty_like(alpha)
    for part in np.split(order, cuts):
        block = np.tril(inverse[np.ix_(part, part)])
        block += np.tril(block, -1).T
        result[part] = np.linalg.solve(block, alpha[part])
    square = float(result @ alpha) / len(alpha)
    return result, square if square > 0.0 else 1.0
