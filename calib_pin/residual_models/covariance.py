"""The covariance of corrections before any data, and the likeliest one after.

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

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
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
    """

    own: Floats
    short: Floats
    all: Floats
    long: Floats
    kinds: Floats = field(default_factory=lambda: np.zeros(0))

    @property
    def total(self) -> Floats:
        """Variances of the components, shape (m,)."""
        if not len(self.all):
            return self.own
        return self.all + self.own if len(self.own) else self.all

    def scaled(self, factor: float) -> Covariance:
        """The same with all variances times a number."""
        return replace(
            self,
            own=self.own * factor,
            all=self.all * factor,
            kinds=self.kinds * factor,
        )

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
        if not len(self.all):
            yield from (v * values for v, values in zip(self.own, owns, strict=True))
            return
        smooth = self.correlation(a, b)
        for j, variance in enumerate(self.all):
            result = variance * smooth
            if len(self.own):
                result += self.own[j] * next(owns)
            yield result

    def of_residuals(self, angle: Floats, A: Floats) -> Floats:
        """Covariance of the residuals that the corrections make, shape (N d, N d).

        Args:
            angle: Angles, shape (N, n) [rad].
            A: Derivative of the residuals by the corrections, shape (N, d, m).
        """
        d = A.shape[1]
        result = np.zeros((A.shape[0] * d, A.shape[0] * d))
        for j, values in enumerate(self.components(angle, angle)):
            a = A[:, :, j].reshape(-1)
            if a.any():
                blocks = np.repeat(np.repeat(values, d, axis=0), d, axis=1)
                result += blocks * np.multiply.outer(a, a)
        return result

    def predict(self, at: Floats, angle: Floats, weights: Floats) -> Floats:
        """Sums of the covariances with training angles, shape (K, m).

        Args:
            at: Angles, shape (K, n) [rad].
            angle: Training angles, shape (N, n) [rad].
            weights: Weight of each of these in each component, shape (N, m).
        """
        result = np.empty((len(at), weights.shape[1]))
        for start in range(0, len(at), PIECE):
            part = at[start : start + PIECE]
            sums = np.zeros((len(part), weights.shape[1]))
            if len(self.all):
                sums += self.correlation(part, angle) @ (weights * self.all)
            for j, values in enumerate(self.own_correlations(part, angle)):
                sums[:, j] += self.own[j] * (values @ weights[:, j])
            result[start : start + PIECE] = sums
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
        return Covariance(
            own=own,
            short=numbers(parts, "short", own.shape, positive=True, empty=True),
            all=numbers(
                parts, "all", (components * smooth,), positive=True, empty=not smooth
            ),
            long=numbers(
                parts, "long", (joints * smooth,), positive=True, empty=not smooth
            ),
            kinds=np.abs(numbers(parts, "kinds", (None,), empty=True))
            if "kinds" in parts
            else np.zeros(0),
        )


class Likeliest(NamedTuple):
    """The covariance under which measurements are most likely.

    Attributes:
        covariance: The covariance.
        noise: Variance of the noise.
        cost: Negative logarithm of the likelihood.
    """

    covariance: Covariance
    noise: float
    cost: float


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
    progress: Progress | None = None,
) -> Likeliest:
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
    y = target.reshape(-1)
    other = free @ free.T
    squares = [each @ each.T for each in kinds]
    constant = 0.5 * len(y) * np.log(2.0 * np.pi)

    def cost(covariance: Covariance, noise: float) -> tuple[float, Floats]:
        """Negative log-likelihood, and its derivative by logarithms."""
        K = covariance.of_residuals(angle, A) + other
        for size, each in zip(covariance.kinds, squares, strict=True):
            K += size * each
        K[np.diag_indices_from(K)] += noise
        K[np.diag_indices_from(K)] += JITTER
        try:
            L = cholesky(K, lower=True, check_finite=False)
        except LinAlgError:
            return np.inf, np.zeros(1)
        alpha = cho_solve((L, True), y, check_finite=False)
        lower, _ = dpotri(L, lower=1)
        inverse = lower + lower.T  # Above the diagonal there are zeros.
        inverse[np.diag_indices_from(inverse)] *= 0.5
        by_K = 0.5 * (inverse - np.outer(alpha, alpha))
        by_noise = noise * np.trace(by_K)
        by_kinds = [
            size * float(np.vdot(by_K, each))
            for size, each in zip(covariance.kinds, squares, strict=True)
        ]
        of_corrections = _by_logarithms(covariance, angle, A, by_K)
        gradient = np.array([*of_corrections, *by_kinds, by_noise])
        return 0.5 * y @ alpha + np.log(np.diag(L)).sum() + constant, gradient

    square = float((target**2).mean())
    shape = A.shape[2], angle.shape[1], len(kinds)
    return searched(cost, shape, square, form=form, progress=progress)


def searched(
    cost: Callable[[Covariance, float], tuple[float, Floats]],
    shape: tuple[int, int, int],
    square: float,
    *,
    form: Form,
    progress: Progress | None = None,
) -> Likeliest:
    """Minimize a cost of a covariance and a noise.

    Args:
        cost: Cost, and its derivative by the logarithms of the numbers of the
            covariance, in their order, and of the noise; any where it is infinite.
        shape: Numbers m of components, n of angles and of kinds of parameters.
        square: Mean square of the residuals.
        form: Functions that the process is made of.
        progress: Told the part that is done, 0 to 1.
    """
    (m, n, kinds), (_, own, smooth) = shape, form
    counts = {"own": m * own, "short": m * own, "all": m * smooth, "long": n * smooth}
    counts |= {"kinds": kinds, "noise": 1}
    cuts = np.cumsum(list(counts.values()))[:-1]

    def parts(values: Floats) -> tuple[Covariance, float]:
        *of_corrections, noise = np.split(np.exp(values), cuts)
        return Covariance(*of_corrections), float(noise[0])

    def of_logarithms(values: Floats) -> tuple[float, Floats]:
        found, gradient = cost(*parts(values))
        return found, gradient if np.isfinite(found) else np.zeros(len(values))

    least = max(QUIETEST * square, BOUNDS["noise"][0])
    starts = {"own": 0.1, "short": 0.1, "all": 0.3, "long": 1.5, "kinds": 0.3}
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
        of_logarithms,
        np.clip(first, lower, upper),
        jac=True,
        method="L-BFGS-B",
        bounds=Bounds(lower, upper),
        callback=count,
        options={"maxiter": STEPS},
    )
    return Likeliest(*parts(found.x), cost=float(found.fun))


def _by_logarithms(
    covariance: Covariance, angle: Floats, A: Floats, by_K: Floats
) -> Floats:
    """Derivative of a cost by the logarithms of the covariance's numbers.

    From its derivative by the covariance K of the residuals, shape (N d, N d).
    """
    rows, d, _ = A.shape
    # By the covariance of each component of the corrections, shape (m, N, N).
    blocks = by_K.reshape(rows, d, rows, d)
    by_component = np.array(
        [np.einsum("ac,acbe,be->ab", a, blocks, a) for a in np.moveaxis(A, 2, 0)]
    )
    distance = 2.0 - 2.0 * np.cos(angle[:, None] - angle)
    own, short = np.zeros(len(covariance.own)), np.zeros(len(covariance.own))
    for j, values in enumerate(covariance.own_correlations(angle, angle)):
        by_own = covariance.own[j] * values * by_component[j]
        own[j] = by_own.sum()
        short[j] = (by_own * distance[:, :, j]).sum() / covariance.short[j] ** 2
    if not len(covariance.all):
        return np.concatenate([own, short])
    by_all = covariance.all[:, None, None] * by_component
    by_all *= covariance.correlation(angle, angle)
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
