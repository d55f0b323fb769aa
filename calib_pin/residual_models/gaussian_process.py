"""A Gaussian process over the residuals, as joint corrections or as a twist of the tip.

The residuals are linear in the corrections, `r = r_0 + A f`, so a process over f is one
over r, and nothing has to be inverted where A is singular: the unobserved part of a
correction stays at zero. The part that a shift of the geometry can explain has a
variance so large that it is free, and errors of the robot's parameters have the size
that the measurements tell, see `Shifts`. So the process knows how far it holds: where
nothing was measured, it is the parameters that belong to it, and no more.

Its covariance is searched once. With K the covariance of the residuals y, all that the
process says is linear in `alpha = K^-1 y`, and without a group g of measurements it is
that of the others (Rasmussen and Williams 2006, 5.4.2), with parameters and all,

    alpha_others = alpha - (K^-1)_g (K^-1)_gg^-1 alpha_g.

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

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import count
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_solve, cholesky
from scipy.linalg.lapack import dpotri
from scipy.optimize import Bounds, minimize

from calib_pin.compiled.threads import serial_blas
from calib_pin.kinematics.spatial import Floats, times
from calib_pin.progress import Progress, portion
from calib_pin.residual_models.base import (
    MUCH,
    Space,
    TrainingRows,
    convincing,
    correction_unit,
    root_mean_square,
)
from calib_pin.residual_models.documents import Array, restored, written
from calib_pin.residual_models.region import PIECE, TrainedRegion

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
            squares of the expected size, see `base.Shifts`.
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
            product = np.einsum("ac,acbe->abe", a, blocks)
            np.einsum("abe,be->ab", product, a, out=result)
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

    minimum = minimize(
        cost,
        np.clip(first, lower, upper),
        jac=True,
        method="L-BFGS-B",
        bounds=Bounds(lower, upper),
        callback=tell,
        options={"maxiter": STEPS},
    )
    return at(minimum.x)


def symmetric_inverse(factor: Floats) -> Floats:
    """Inverse of a matrix from its lower Cholesky factor, shape (M, M)."""
    lower, _ = dpotri(factor, lower=1)
    result = lower + lower.T  # Above the diagonal there are zeros.
    result[np.diag_indices_from(result)] *= 0.5
    return np.asarray(result)


@dataclass(frozen=True)
class GaussianProcess:
    """A Gaussian process given its measurements.

    Attributes:
        region: Training region; its angles are those of the covariance.
        shift: Shift of the geometry that belongs to it, shape (P,).
        space: Space of the corrections.
        covariance: Covariance of the corrections in their units, and the noise.
        unit: Correction that counts as one, shape (m,) [rad, m].
        q: Training configurations, shape (N, n) [rad, m].
        weights: Weight of each configuration in each component, shape (N, m).
        held_out: Root mean square of the whitened residuals of groups of measurements,
            before, and predicted from all the others.
    """

    region: TrainedRegion
    shift: Annotated[Floats, Array("P", empty=True)]
    space: Space
    covariance: Covariance
    unit: Annotated[Floats, Array("m", positive=True)]
    q: Annotated[Floats, Array("N n")]
    weights: Annotated[Floats, Array("N m")]
    held_out: Annotated[tuple[float, float], Array("2")]
    name: ClassVar[str] = "gaussian-process"

    @serial_blas
    def __call__(self, q: Floats) -> Floats:
        """Corrections at joint positions, (N, m) [rad, m]."""
        at, known = self.region.angles(q), self.region.angles(self.q)
        return self.covariance.predict(at, known, self.weights) * self.unit

    def weight(self, q: Floats) -> Floats:
        """Weight of the correction: one, for it knows how far it holds, (N,)."""
        return np.ones(len(q))

    @serial_blas
    def left_out(
        self,
        rows: TrainingRows,
        masks: Sequence[NDArray[np.bool_]],
        rng: np.random.Generator,
    ) -> list[GaussianProcess]:
        """In closed form, see the module and `ResidualModel.left_out`."""
        chosen = evenly(len(rows.q), len(self.q))
        few = rows.subset(chosen)
        whole = Conditioned.of(self, few, self(few.q), self.shift)
        inverse, alpha = symmetric_inverse(whole.factor), whole.alpha
        result = []
        for mask in masks:
            g = np.repeat(mask[chosen], rows.values)
            block = np.linalg.solve(inverse[np.ix_(g, g)], alpha[g])
            others = np.where(g, 0.0, alpha - inverse[:, g] @ block)
            result.append(whole.posterior(others))
        return result

    def document(self) -> dict[str, Any]:
        """The numbers."""
        return {"kind": self.name, **written(self)}

    @staticmethod
    def restore(document: Mapping[str, Any], joints: int) -> GaussianProcess:
        """The process of a document.

        Raises:
            ValueError: If it is not one.
        """
        sizes = {"n": joints, "m": joints if document.get("space") == "joint" else 6}
        process = restored(GaussianProcess, document, sizes)
        process.covariance.require(joints, sizes["m"])
        return process


@dataclass(frozen=True)
class Conditioned:
    """A process with the covariance of measurements that it is given.

    Attributes:
        process: The process.
        A: Derivative of whitened residuals by corrections in units, shape (N, d, m).
        absorbed: Residuals by amounts of variance one that make up the shift, shape
            (N d, k).
        released: Shift per amount, shape (P, k).
        about: Value of the shift about which the fit stands, shape (P,).
        factor: Cholesky factor of the covariance of the residuals, shape (N d, N d).
        alpha: These times their inverse covariance, shape (N d,).
    """

    process: GaussianProcess
    A: Floats
    absorbed: Floats
    released: Floats
    about: Floats
    factor: Floats
    alpha: Floats

    @staticmethod
    def of(
        process: GaussianProcess, rows: TrainingRows, f: Floats, shift: Floats
    ) -> Conditioned:
        """A process given measurements, linearized about corrections and a shift.

        Args:
            process: Its covariance and what else does not depend on them.
            rows: The measurements.
            f: The corrections, shape (N, m) [rad, m].
            shift: The shift, shape (P,).
        """
        at, known = rows.evaluate(process.space)(f, shift), rows.shift
        base = at.residual - times(at.by_correction, f) - at.by_shift @ shift
        square = process.held_out[0] ** 2 or 1.0  # Of nothing, any variance will do.
        released = known.root(at.by_shift, square, process.covariance.kinds)
        absorbed = at.by_shift.reshape(base.size, len(known)) @ released
        A = at.by_correction * process.unit
        K = process.covariance.of_residuals(process.region.angles(rows.q), A)
        K += absorbed @ absorbed.T
        K[np.diag_indices_from(K)] += process.covariance.noise
        factor = np.asarray(cholesky(K, lower=True, overwrite_a=True))
        target = (at.by_shift @ known.about - base).reshape(-1)
        process, alpha = replace(process, q=rows.q), cho_solve((factor, True), target)
        return Conditioned(process, A, absorbed, released, known.about, factor, alpha)

    def posterior(self, alpha: Floats) -> GaussianProcess:
        """The process by residuals times their inverse covariance, shape (N d,)."""
        weights = np.einsum("ndm,nd->nm", self.A, alpha.reshape(self.A.shape[:2]))
        shift = self.released @ (alpha @ self.absorbed) - self.about
        return replace(self.process, weights=weights, shift=shift)


@dataclass(frozen=True)
class GaussianProcessOptions:
    """Options of the fit of a Gaussian process.

    Attributes:
        searched: Residual components, of random measurements, that choose the
            covariance.
        largest: Residual components that the process is made of at most; time grows
            with their cube. Of more measurements it is made of some, see `evenly`.
        forms: Forms that are tried, simplest first.
    """

    searched: int = 600
    largest: int = 3600
    forms: tuple[Form, ...] = FORMS


@serial_blas
def fit_gaussian_process(
    rows: TrainingRows,
    rng: np.random.Generator,
    *,
    options: GaussianProcessOptions | None = None,
    progress: Progress | None = None,
) -> GaussianProcess:
    """Fit a Gaussian process to the residuals of a geometric fit.

    The simplest, of functions of one joint each, unless another predicts measurements
    that are left out much better, see `base.MUCH`.

    Args:
        rows: The measurements.
        rng: Chooses measurements where not all are used.
        options: Options of the fit.
        progress: Told the part that is done, 0 to 1.

    Raises:
        InputError: If there are too few measurements.
    """
    options = options or GaussianProcessOptions()
    rows.require("Gaussian process", 2 * len(rows.revolute))
    region = TrainedRegion.of(rows.q, rows.revolute, rng)
    rows = rows.subset(evenly(len(rows.q), options.largest // rows.values))
    few = rng.permutation(len(rows.q))[: max(options.searched // rows.values, 1)]
    best, predicted, count = None, np.zeros(0), len(options.forms)
    for k, form in enumerate(options.forms):
        tell = portion(progress, k / count, 1.0 / count)
        draft = _likeliest(rows, form, region, np.sort(few), tell)
        process, others = _conditioned(draft, rows)
        if best is None or convincing(predicted, others, MUCH):
            best, predicted = process, others
    if progress is not None:
        progress(1.0)
    assert best is not None
    return best


def _likeliest(
    rows: TrainingRows,
    form: Form,
    region: TrainedRegion,
    few: NDArray[np.int64],
    progress: Progress | None,
) -> GaussianProcess:
    """A process that knows the likeliest covariance of some rows, and nothing else."""
    kinds = rows.revolute if form.space == "joint" else np.arange(6) < 3
    at = rows.plain(form.space)
    unit = correction_unit(at, kinds)
    G, size, known = at.by_shift[few], root_mean_square(at.residual), rows.shift
    columns = G.reshape(few.size * rows.values, len(known))
    data = Likelihood(
        region.angles(rows.q[few]),
        at.by_correction[few] * unit,
        G @ known.about - at.residual[few],
        columns @ known.root(G, size**2 or 1.0, np.zeros(len(known.kinds))),
        [columns @ kind for kind in known.kinds],
    )
    covariance = most_likely(data, form, portion(progress, 0.0, 0.7))
    return GaussianProcess(
        space=form.space,
        region=region,
        shift=np.zeros(len(rows.shift)),
        covariance=covariance,
        unit=unit,
        q=rows.q,
        weights=np.zeros((len(rows.q), len(kinds))),
        held_out=(size, 0.0),
    )


def _conditioned(
    draft: GaussianProcess, rows: TrainingRows
) -> tuple[GaussianProcess, Floats]:
    """A process given all rows, linearized again at its predictions.

    Returns:
        The process, and the residuals of every group of measurements predicted from
        the others, shape (N, d).
    """
    process = draft
    for _ in range(2):
        known = Conditioned.of(process, rows, process(rows.q), process.shift)
        process = known.posterior(known.alpha)
    predicted = _of_groups(known.factor, known.alpha, rows.groups)
    # All variances times one number predict the same, but less surely: few
    # measurements chose them, and all of them tell how large they are.
    surprise = float(predicted @ known.alpha) / len(predicted) or 1.0
    before, factor = rows.plain(process.space).residual, 1.0
    predicted = predicted.reshape(before.shape)
    if not convincing(before, predicted):
        predicted, factor = before, 0.0
    process = replace(
        process,
        shift=factor * process.shift,
        covariance=process.covariance.scaled(surprise),
        weights=factor * process.weights / surprise,
        held_out=(root_mean_square(before), root_mean_square(predicted)),
    )
    return process, predicted


def _of_groups(factor: Floats, alpha: Floats, groups: NDArray[np.int64]) -> Floats:
    """Residuals of each group of measurements, predicted from all the others.

    Rasmussen and Williams 2006, eq. 5.12, for groups in place of single values.

    Args:
        factor: Lower Cholesky factor of the covariance of the residuals, (N d, N d).
        alpha: Residuals times the inverse covariance, shape (N d,).
        groups: Group of each measurement, shape (N,).
    """
    inverse, result = symmetric_inverse(factor), np.empty_like(alpha)
    labels = np.repeat(groups, len(alpha) // len(groups))
    for label in np.unique(labels):
        part = labels == label
        result[part] = np.linalg.solve(inverse[np.ix_(part, part)], alpha[part])
    return result


def evenly(count: int, most: int) -> NDArray[np.int64]:
    """So many rows of all at most, all along the file and as its rows are spread.

    Rows as far from one another as can be lie at the ends of the joints: on a simulated
    arm with waves in its gears they left 14 % more.
    """
    return np.arange(min(count, most)) * count // min(count, most)
