"""The covariance of corrections, and the likeliest one.

Each component j of a correction is a sum of at most two independent functions,

    cov(f_j(q), f_j(q')) = own_j exp((cos(q_j - q_j') - 1) / s_j^2)
                         + all_j exp(sum_k (cos(q_k - q_k') - 1) / l_k^2)

one of its joint's own angle, which may repeat many times in a turn as gears do, and one
of all angles, which is smooth. What depends on the own angle alone carries over to
wherever only the other joints stand differently; what depends on all is gone there. A
twist of the tip has no joint of its own, and only the second. The exponents are squared
distances on the circles: this is a Gaussian kernel of the points (sin, cos).

The likeliest covariance has the highest marginal likelihood (Rasmussen and Williams
2006, 5.4). It is written out here: scikit-learn's general search holds the derivative
of the covariance by every parameter in memory, and takes twice as long.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import count
from typing import Annotated, NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, cho_solve, cholesky
from scipy.linalg.lapack import dpotri
from scipy.optimize import Bounds, minimize

from calib_pin.kinematics.spatial import Floats
from calib_pin.progress import Progress
from calib_pin.residual_models.base import Space
from calib_pin.residual_models.documents import Array
from calib_pin.residual_models.region import PIECE

BOUNDS = {
    "own": (1e-6, 1e4),
    "short": (0.02, 3.0),
    "all": (1e-6, 1e6),
    "long": (0.05, 30.0),
    "kinds": (1e-6, 1e4),
    "noise": (1e-6, 1e2),
}
"""Least and largest values; variances in squared units of the correction."""

STARTS = {"own": 0.1, "short": 0.1, "all": 0.3, "long": 1.5, "kinds": 0.3, "noise": 0.1}
"""Where the search starts; the noise as a part of the mean square."""

QUIETEST = 1e-5
"""Least noise, as a part of the mean square; few measurements look noise-free."""

STEPS = 40
"""Steps of the search; by then the likelihood hardly changes."""


class Form(NamedTuple):
    """Functions that a process is made of.

    Attributes:
        space: Space of the corrections.
        own: Whether they have functions of their own joint's angle.
        smooth: Whether they have functions of all angles.
    """

    space: Space
    own: bool
    smooth: bool


FORMS = (
    Form("joint", own=True, smooth=False),
    Form("joint", own=True, smooth=True),
    Form("tip", own=False, smooth=True),
)
"""All of them, simplest first."""


@dataclass(frozen=True)
class Covariance:
    """The two functions of each of m components, in n joint angles.

    Attributes:
        own: Variances of the functions of the own angle, shape (m,), or (0,) without.
        short: Their lengths s, of the shape of `own`.
        all: Variances of the functions of all angles, shape (m,), or (0,) without.
        long: Their lengths l in each angle, shape (n,), or (0,).
        kinds: Variances of the errors of each kind of parameter that belong to them, in
            squares of the expected size, see `shifts.Shifts`.
        noise: Variance of the whitened residuals beside all that.
    """

    own: Annotated[Floats, Array("own", positive=True, empty=True)]
    short: Annotated[Floats, Array("own", positive=True, empty=True)]
    all: Annotated[Floats, Array("all", positive=True, empty=True)]
    long: Annotated[Floats, Array("long", positive=True, empty=True)]
    kinds: Annotated[Floats, Array("kinds", positive=True, empty=True)]
    noise: Annotated[float, Array(positive=True)]

    def scaled(self, factor: float) -> Covariance:
        """The same with all variances times a number."""
        variances = ("own", "all", "kinds", "noise")
        return replace(self, **{k: getattr(self, k) * factor for k in variances})

    def own_correlations(self, a: Floats, b: Floats) -> Iterator[Floats]:
        """Correlation by the own angle for each component, shape (A, B) each.

        Args:
            a: Angles, shape (A, n) [rad].
            b: Angles, shape (B, n) [rad].
        """
        for j, length in enumerate(self.short):
            yield _correlation(a[:, [j]], b[:, [j]], np.array([length]))

    def components(self, a: Floats, b: Floats) -> Iterator[Floats]:
        """Covariance of each component, shape (A, B) each."""
        owns = self.own_correlations(a, b)
        smooth = _correlation(a, b, self.long) if len(self.all) else np.zeros(())
        for j in range(max(len(self.own), len(self.all))):
            result = self.all[j] * smooth if len(self.all) else smooth
            yield result + self.own[j] * next(owns) if len(self.own) else result

    def of_residuals(self, angle: Floats, A: Floats) -> Floats:
        """Covariance of residuals that depend on corrections, shape (N d, N d).

        Args:
            angle: Angles, shape (N, n) [rad].
            A: Derivative by the corrections, shape (N, d, m).
        """
        rows, d, _ = A.shape
        result = np.zeros((d, d, rows, rows))
        for j, values in enumerate(self.components(angle, angle)):
            right = np.ascontiguousarray(A[:, :, j].T)[:, None]
            for part, left in zip(result, A[:, :, j].T, strict=True):
                part += left[:, None] * values * right
        return result.transpose(2, 0, 3, 1).reshape(rows * d, rows * d)

    def predict(self, at: Floats, angle: Floats, weights: Floats) -> Floats:
        """Sums of the covariances with training angles, shape (K, m).

        Args:
            at: Angles, shape (K, n) [rad].
            angle: Training angles, shape (N, n) [rad].
            weights: Weight of each of these in each component, shape (N, m).
        """
        result = np.empty((len(at), weights.shape[1]))
        for start in range(0, len(at), PIECE):
            piece = slice(start, start + PIECE)
            for j, values in enumerate(self.components(at[piece], angle)):
                result[piece, j] = values @ weights[:, j]
        return result

    def require(self, joints: int, components: int) -> None:
        """Refuse what is no covariance of corrections, of joints or of the tip.

        Raises:
            ValueError: If it is none.
        """
        own, each, long = len(self.own), len(self.all), len(self.long)
        fits = own in (0, components) and each in (0, components) and own + each > 0
        fits &= not own or components == joints
        if not fits or long != joints * bool(each):
            raise ValueError(f"'covariance' is not of {components} corrections")


def _correlation(a: Floats, b: Floats, length: Floats) -> Floats:
    """Correlation of functions of angles, shape (A, n), (B, n) -> (A, B)."""
    scaled = np.concatenate([np.cos(a) / length**2, np.sin(a) / length**2], axis=1)
    result = scaled @ np.concatenate([np.cos(b), np.sin(b)], axis=1).T
    result -= (1.0 / length**2).sum()
    return np.asarray(np.exp(result, out=result))


@dataclass(frozen=True)
class Likelihood:
    """Marginal likelihood of measurements, a cost of the covariance.

    Attributes:
        angle: Joint angles, shape (N, n) [rad].
        A: Derivative of the residuals by the corrections, shape (N, d, m).
        target: Residuals that the corrections should make, shape (N, d).
        free: Residuals by free directions beside the corrections, a random amount of
            deviation one of each, shape (N d, f).
        kinds: The same by errors of each kind of parameter, shape (N d, p) each.
    """

    angle: Floats
    A: Floats
    target: Floats
    free: Floats
    kinds: Sequence[Floats] = ()

    @cached_property
    def _squares(self) -> list[Floats]:
        return [each @ each.T for each in (self.free, *self.kinds)]

    @cached_property
    def _distance(self) -> Floats:
        return np.asarray(2.0 - 2.0 * np.cos(self.angle[:, None] - self.angle))

    def __call__(self, covariance: Covariance) -> tuple[float, Floats]:
        """Negative log-likelihood but for a constant, and its gradient.

        By the logarithms of own, short, all, long, kinds and noise in this order.
        """
        y, (K, *kinds) = self.target.reshape(-1), self._squares
        K = K + covariance.of_residuals(self.angle, self.A)
        for size, each in zip(covariance.kinds, kinds, strict=True):
            K += size * each
        K[np.diag_indices_from(K)] += covariance.noise
        try:
            L = cholesky(K, lower=True, check_finite=False)
        except LinAlgError:
            parts = ("own", "short", "all", "long", "kinds")
            count = sum(len(getattr(covariance, name)) for name in parts)
            return np.inf, np.zeros(count + 1)
        alpha = cho_solve((L, True), y, check_finite=False)
        by_K = 0.5 * (symmetric_inverse(L) - np.outer(alpha, alpha))
        by_kinds = [
            size * float(np.vdot(by_K, each))
            for size, each in zip(covariance.kinds, kinds, strict=True)
        ]
        by_noise = covariance.noise * np.trace(by_K)
        gradient = [*self._by_corrections(covariance, by_K), *by_kinds, by_noise]
        return 0.5 * y @ alpha + np.log(np.diag(L)).sum(), np.array(gradient)

    def _by_corrections(self, covariance: Covariance, by_K: Floats) -> Floats:
        """Gradient by own, short, all and long, from that by K, shape (N d, N d)."""
        rows, d, m = self.A.shape
        # By the covariance of each component of the corrections, shape (m, N, N).
        blocks = by_K.reshape(rows, d, rows, d)
        by_component = np.empty((m, rows, rows))
        for a, result in zip(np.moveaxis(self.A, 2, 0), by_component, strict=True):
            left = np.einsum("ac,acbe->abe", a, blocks)
            np.einsum("abe,be->ab", left, a, out=result)
        own, short = np.zeros(len(covariance.own)), np.zeros(len(covariance.own))
        owns = covariance.own_correlations(self.angle, self.angle)
        for j, values in enumerate(owns):
            by_own = covariance.own[j] * values * by_component[j]
            own[j] = by_own.sum()
            turn = np.vdot(by_own, self._distance[:, :, j])
            short[j] = turn / covariance.short[j] ** 2
        if not len(covariance.all):
            return np.concatenate([own, short])
        by_all = covariance.all[:, None, None] * by_component
        by_all *= _correlation(self.angle, self.angle, covariance.long)
        long = np.einsum("ab,abi->i", by_all.sum(axis=0), self._distance)
        long /= covariance.long**2
        return np.concatenate([own, short, by_all.sum((1, 2)), long])


def most_likely(data: Likelihood, form: Form, progress: Progress | None) -> Covariance:
    """Maximize the marginal likelihood.

    Args:
        data: The measurements.
        form: Functions that the process is made of.
        progress: Told the part that is done, 0 to 1.
    """
    m, n, square = data.A.shape[2], data.angle.shape[1], (data.target**2).mean()
    least = max(QUIETEST * square, BOUNDS["noise"][0])
    limits = {**BOUNDS, "noise": (least, BOUNDS["noise"][1])}
    starts = {**STARTS, "noise": max(STARTS["noise"] * square, least)}
    counts = [m * form.own, m * form.own, m * form.smooth, n * form.smooth]
    counts += [len(data.kinds), 1]
    lower, upper = np.log(np.repeat(list(limits.values()), counts, axis=0)).T
    first = np.log(np.repeat(list(starts.values()), counts))
    steps = count(1)

    def at(x: Floats) -> Covariance:
        own, short, each, long, kinds, noise = np.split(
            np.exp(x), np.cumsum(counts)[:-1]
        )
        return Covariance(own, short, each, long, kinds, float(noise[0]))

    def cost(x: Floats) -> tuple[float, Floats]:
        return data(at(x))

    def tell(xk: Floats) -> None:
        if progress is not None:
            progress(next(steps) / STEPS)

    found = minimize(
        cost,
        np.clip(first, lower, upper),
        jac=True,
        method="L-BFGS-B",
        bounds=Bounds(lower, upper),
        callback=tell,
        options={"maxiter": STEPS},
    )
    return at(found.x)


def symmetric_inverse(factor: Floats) -> Floats:
    """Inverse of a matrix from its lower Cholesky factor, shape (M, M)."""
    lower, _ = dpotri(factor, lower=1)
    result = lower + lower.T  # Above the diagonal there are zeros.
    result[np.diag_indices_from(result)] *= 0.5
    return np.asarray(result)
