"""The covariance that makes the rows most likely, found by scikit-learn."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import Bounds, minimize
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import Kernel

from calib_pin.kinematics.spatial import Floats
from calib_pin.progress import Progress
from calib_pin.residual_models.covariance import Covariance

__all__ = ["most_likely"]

BOUNDS = {
    "own": (1e-6, 1e4),
    "short": (0.02, 3.0),
    "all": (1e-6, 1e6),
    "long": (0.05, 30.0),
    "noise": (1e-6, 1e2),
}
"""Least and largest values; variances in squared units of the correction."""

QUIETEST = 1e-5
"""Least noise, as a part of the mean square; few rows look as if there were none."""

STEPS = 30
"""Steps of the search; by then the likelihood hardly changes."""


class _Seen(Kernel):  # type: ignore[misc]
    """What scikit-learn calls a kernel: the covariance of numbered residuals.

    Args:
        values: Logarithms of all parameters of the covariance and of the noise.
        angle: Joint angles, shape (N, n) [rad].
        A: What multiplies the corrections, shape (N, d, m).
        other: Covariance beside noise and corrections, shape (N d, N d).
        own: Whether components have functions of their own angle.
    """

    def __init__(
        self, values: Floats, angle: Floats, A: Floats, other: Floats, own: bool
    ) -> None:
        self.values, self.angle, self.A = values, angle, A
        self.other, self.own = other, own

    @property
    def theta(self) -> Floats:
        return self.values

    @theta.setter
    def theta(self, values: Floats) -> None:
        self.values = values

    @property
    def bounds(self) -> Floats:
        m, n = self.A.shape[2], self.angle.shape[1]
        counts = {"own": m, "short": m} if self.own else {}
        counts |= {"all": m, "long": n, "noise": 1}
        return np.log([BOUNDS[name] for name in counts for _ in range(counts[name])])

    def covariance(self) -> tuple[Covariance, float]:
        """The covariance and the variance of the noise."""
        m, n = self.A.shape[2], self.angle.shape[1]
        own = m if self.own else 0
        parts = np.split(np.exp(self.values), np.cumsum([own, own, m, n]))
        return Covariance(*parts[:4]), float(parts[4][0])

    def __call__(
        self, X: Floats, Y: Floats | None = None, eval_gradient: bool = False
    ) -> Floats | tuple[Floats, Floats]:
        covariance, noise = self.covariance()
        K = covariance.seen(self.angle, self.A) + self.other
        K[np.diag_indices_from(K)] += noise
        if not eval_gradient:
            return K
        return K, self._gradient(covariance, noise)

    def _gradient(self, covariance: Covariance, noise: float) -> Floats:
        """Derivative by the logarithms, one matrix after the other in memory."""
        rows, d, m = self.A.shape
        gradient = np.zeros((len(self.values), rows, d, rows, d))
        of_own, of_all, own = gradient, gradient[2 * m * self.own :], covariance.own
        a = self.A.transpose(2, 0, 1)
        blocks = a[:, :, :, None, None] * a[:, None, None]
        distance = 2.0 - 2.0 * np.cos(self.angle[:, None] - self.angle)
        for j, values in enumerate(covariance.owns(self.angle, self.angle)):
            by_length = values * distance[:, :, j] / covariance.short[j] ** 2
            of_own[j] = (own[j] * values)[:, None, :, None] * blocks[j]
            of_own[m + j] = (own[j] * by_length)[:, None, :, None] * blocks[j]
        smooth = covariance.alls(self.angle, self.angle)
        for j, variance in enumerate(covariance.all):
            of_all[j] = (variance * smooth)[:, None, :, None] * blocks[j]
        total = of_all[:m].sum(axis=0)
        for i, length in enumerate(covariance.long):
            of_all[m + i] = total * (distance[:, :, i] / length**2)[:, None, :, None]
        flat = gradient.reshape(len(self.values), rows * d, rows * d)
        np.einsum("ii->i", flat[-1])[:] = noise
        return np.moveaxis(flat, 0, -1)

    def diag(self, X: Floats) -> Floats:
        return np.asarray(np.diag(self(X)))

    def is_stationary(self) -> bool:
        return False


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
        A: What multiplies the corrections, shape (N, d, m).
        target: What the corrections should make, shape (N, d).
        other: Covariance beside noise and corrections, shape (N d, N d).
        own: Whether components have functions of their own angle.
        progress: Told the part that is done, 0 to 1.

    Returns:
        The covariance and the variance of the noise.
    """
    m, n = A.shape[2], angle.shape[1]
    start = [0.1] * m + [0.1] * m if own else []
    square = float((target**2).mean())
    least = max(QUIETEST * square, BOUNDS["noise"][0])
    noise = max(0.1 * square, least)
    values = np.log([*start, *[0.3] * m, *[1.5] * n, noise])

    def search(
        cost: Callable[[Floats], tuple[float, Floats]], first: Floats, bounds: Floats
    ) -> tuple[Floats, float]:
        done = 0
        bounds[-1, 0] = np.log(least)

        def count(xk: Floats) -> None:
            nonlocal done
            done += 1
            if progress is not None:
                progress(done / STEPS)

        found = minimize(
            cost,
            np.clip(first, *bounds.T),
            jac=True,
            method="L-BFGS-B",
            bounds=Bounds(*bounds.T),
            callback=count,
            options={"maxiter": STEPS},
        )
        return found.x, float(found.fun)

    kernel = _Seen(values, angle, A, other, own)
    process = GaussianProcessRegressor(kernel, optimizer=search)
    process.fit(np.arange(target.size, dtype=float)[:, None], target.reshape(-1))
    found: tuple[Covariance, float] = process.kernel_.covariance()
    return found
