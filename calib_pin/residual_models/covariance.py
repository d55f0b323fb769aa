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
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, cho_solve, cholesky
from scipy.linalg.lapack import dpotri
from scipy.optimize import Bounds, minimize

from calib_pin.kinematics.spatial import Floats
from calib_pin.progress import Progress
from calib_pin.residual_models.base import Space
from calib_pin.residual_models.documents import checked, numbers
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

JITTER = 1e-10
"""Variance beside the noise that keeps the covariance positive definite."""

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

    own: Floats
    short: Floats
    all: Floats
    long: Floats
    kinds: Floats
    noise: float

    @property
    def total(self) -> Floats:
        """Variances of the components, shape (m,)."""
        if not len(self.all):
            return self.own
        return self.all + self.own if len(self.own) else self.all

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

    def correlation(self, a: Floats, b: Floats) -> Floats:
        """Correlation by all angles, shape (A, B)."""
        return _correlation(a, b, self.long)

    def components(self, a: Floats, b: Floats) -> Iterator[Floats]:
        """Covariance of each component, shape (A, B) each."""
        owns = self.own_correlations(a, b)
        smooth = self.correlation(a, b) if len(self.all) else np.zeros(())
        for j in range(len(self.total)):
            result = self.all[j] * smooth if len(self.all) else smooth
            yield result + self.own[j] * next(owns) if len(self.own) else result

    def of_residuals(self, angle: Floats, A: Floats) -> Floats:
        """Covariance of the residuals that corrections and noise make, (N d, N d).

        Args:
            angle: Angles, shape (N, n) [rad].
            A: Derivative of the residuals by the corrections, shape (N, d, m).
        """
        rows, d, _ = A.shape
        result = np.zeros((d, d, rows, rows))
        for j, values in enumerate(self.components(angle, angle)):
            columns = np.ascontiguousarray(A[:, :, j].T)
            for part, column in zip(result, columns, strict=True):
                part += column[:, None] * values * columns[:, None]
        K = result.transpose(2, 0, 3, 1).reshape(rows * d, rows * d)
        K[np.diag_indices_from(K)] += self.noise
        return K

    def predict(self, at: Floats, angle: Floats, weights: Floats) -> Floats:
        """Sums of the covariances with training angles, shape (K, m).

        Args:
            at: Angles, shape (K, n) [rad].
            angle: Training angles, shape (N, n) [rad].
            weights: Weight of each of these in each component, shape (N, m).
        """
        result = np.zeros((len(at), weights.shape[1]))
        for start in range(0, len(at), PIECE):
            part, sums = at[start : start + PIECE], result[start : start + PIECE]
            if len(self.all):
                sums += self.correlation(part, angle) @ (weights * self.all)
            for j, values in enumerate(self.own_correlations(part, angle)):
                sums[:, j] += self.own[j] * (values @ weights[:, j])
        return result

    @staticmethod
    def restore(document: object, joints: int, components: int) -> Covariance:
        """The covariance of a document; only joints have a function of their own.

        Raises:
            ValueError: If it is not one.
        """
        parts = checked(document, "covariance")
        own = numbers(parts, "own", (None,), positive=True, empty=True)
        if len(own) not in (0, components) or (len(own) and components != joints):
            raise ValueError(f"'own' has {len(own)} numbers, not {components}")
        smooth = not (len(own) and parts.get("all") == [])

        def positive(key: str, count: int) -> Floats:
            return numbers(parts, key, (count,), positive=True, empty=not count)

        return Covariance(
            own=own,
            short=positive("short", len(own)),
            all=positive("all", components * smooth),
            long=positive("long", joints * smooth),
            kinds=np.abs(numbers(parts, "kinds", (None,), empty=True)),
            noise=float(numbers(parts, "noise", (), positive=True)),
        )


def _correlation(a: Floats, b: Floats, length: Floats) -> Floats:
    """Correlation of functions of angles, shape (A, n), (B, n) -> (A, B)."""
    scaled = np.concatenate([np.cos(a) / length**2, np.sin(a) / length**2], axis=1)
    result = scaled @ np.concatenate([np.cos(b), np.sin(b)], axis=1).T
    result -= (1.0 / length**2).sum()
    return np.asarray(np.exp(result, out=result))


def most_likely(
    angle: Floats,
    A: Floats,
    target: Floats,
    free: Floats,
    kinds: Sequence[Floats] = (),
    *,
    form: Form,
    progress: Progress,
) -> Covariance:
    """Maximize the marginal likelihood.

    Args:
        angle: Joint angles, shape (N, n) [rad].
        A: Derivative of the residuals by the corrections, shape (N, d, m).
        target: Residuals that the corrections should make, shape (N, d).
        free: Residuals by free directions beside the corrections, a random amount of
            deviation one of each, shape (N d, f).
        kinds: The same by errors of each kind of parameter, shape (N d, p) each.
        form: Functions that the process is made of.
        progress: Told the part that is done, 0 to 1.
    """
    m, n, square = A.shape[2], angle.shape[1], float((target**2).mean())
    least = max(QUIETEST * square, BOUNDS["noise"][0])
    limits = {**BOUNDS, "noise": (least, BOUNDS["noise"][1])}
    starts = {**STARTS, "noise": max(STARTS["noise"] * square, least)}
    counts = [m * form.own, m * form.own, m * form.smooth, n * form.smooth]
    counts += [len(kinds), 1]
    lower, upper = np.log(np.repeat(list(limits.values()), counts, axis=0)).T
    first = np.log(np.repeat(list(starts.values()), counts))

    def at(x: Floats) -> Covariance:
        own, short, all_, long, errors, noise = np.split(
            np.exp(x), np.cumsum(counts)[:-1]
        )
        return Covariance(own, short, all_, long, errors, float(noise[0]))

    likelihood, done = Likelihood(angle, A, target, free, kinds), 0

    def cost(x: Floats) -> tuple[float, Floats]:
        return likelihood(at(x))

    def count(xk: Floats) -> None:
        nonlocal done
        done += 1
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
    return at(found.x)


class Likelihood:
    """Marginal likelihood of measurements, a cost of the covariance.

    Arguments as for `most_likely`.
    """

    def __init__(
        self,
        angle: Floats,
        A: Floats,
        target: Floats,
        free: Floats,
        kinds: Sequence[Floats],
    ) -> None:
        """Prepare what no covariance changes."""
        self._angle, self._A, self._y = angle, A, target.reshape(-1)
        self._free = free @ free.T
        self._kinds = [each @ each.T for each in kinds]
        self._distance = 2.0 - 2.0 * np.cos(angle[:, None] - angle)

    def __call__(self, covariance: Covariance) -> tuple[float, Floats]:
        """Negative log-likelihood but for a constant, and its gradient.

        By the logarithms of own, short, all, long, kinds and noise in this order.
        """
        K = covariance.of_residuals(self._angle, self._A) + self._free
        for size, each in zip(covariance.kinds, self._kinds, strict=True):
            K += size * each
        K[np.diag_indices_from(K)] += JITTER
        parts = ("own", "short", "all", "long", "kinds")
        try:
            L = cholesky(K, lower=True, check_finite=False)
        except LinAlgError:
            count = sum(len(getattr(covariance, name)) for name in parts)
            return np.inf, np.zeros(count + 1)
        alpha = cho_solve((L, True), self._y, check_finite=False)
        by_K = 0.5 * (symmetric_inverse(L) - np.outer(alpha, alpha))
        by_kinds = [
            size * float(np.vdot(by_K, each))
            for size, each in zip(covariance.kinds, self._kinds, strict=True)
        ]
        by_noise = covariance.noise * np.trace(by_K)
        gradient = [*self._by_corrections(covariance, by_K), *by_kinds, by_noise]
        return 0.5 * self._y @ alpha + np.log(np.diag(L)).sum(), np.array(gradient)

    def _by_corrections(self, covariance: Covariance, by_K: Floats) -> Floats:
        """Gradient by own, short, all and long, from that by K, shape (N d, N d)."""
        rows, d, m = self._A.shape
        # By the covariance of each component of the corrections, shape (m, N, N).
        blocks = by_K.reshape(rows, d, rows, d)
        by_component = np.empty((m, rows, rows))
        for a, result in zip(np.moveaxis(self._A, 2, 0), by_component, strict=True):
            left = np.einsum("ac,acbe->abe", a, blocks)
            np.einsum("abe,be->ab", left, a, out=result)
        own, short = np.zeros(len(covariance.own)), np.zeros(len(covariance.own))
        owns = covariance.own_correlations(self._angle, self._angle)
        for j, values in enumerate(owns):
            by_own = covariance.own[j] * values * by_component[j]
            own[j] = by_own.sum()
            turn = np.vdot(by_own, self._distance[:, :, j])
            short[j] = turn / covariance.short[j] ** 2
        if not len(covariance.all):
            return np.concatenate([own, short])
        by_all = covariance.all[:, None, None] * by_component
        by_all *= covariance.correlation(self._angle, self._angle)
        long = np.einsum("ab,abi->i", by_all.sum(axis=0), self._distance)
        long /= covariance.long**2
        return np.concatenate([own, short, by_all.sum((1, 2)), long])


def symmetric_inverse(factor: Floats) -> Floats:
    """Inverse of a matrix from its lower Cholesky factor, shape (M, M)."""
    lower, _ = dpotri(factor, lower=1)
    result = lower + lower.T  # Above the diagonal there are zeros.
    result[np.diag_indices_from(result)] *= 0.5
    return np.asarray(result)
