"""A Gaussian process over the residuals, as joint corrections or as a twist of the tip.

The residuals are linear in the corrections, `r = r_0 + A f`, so a process over f is one
over r, and nothing has to be inverted where A is singular: the unobserved part of a
correction stays at zero. The part that a shift of the geometry can explain has a
variance so large that it is free, and errors of the robot's parameters have the size
that the measurements tell, see `shifts`. So the process knows how far it holds: where
nothing was measured, it is the parameters that belong to it, and no more.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, cast, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, cholesky, solve_triangular

from calib_pin.compiled.threads import serial_blas
from calib_pin.kinematics.spatial import Floats, times
from calib_pin.progress import Progress
from calib_pin.residual_models.base import (
    Space,
    TrainingRows,
    convincing,
    correction_unit,
    root_mean_square,
)
from calib_pin.residual_models.covariance import Covariance, left_out, most_likely
from calib_pin.residual_models.documents import checked, numbers, stated, written
from calib_pin.residual_models.harmonic_process import (
    HarmonicProcess,
    fit_harmonics,
)
from calib_pin.residual_models.region import PIECE, TrainedRegion

LOADED = 6_000
"""Most residual components in a document; their covariance must fit the memory."""

FEWEST = 5
"""Configurations per joint without which lengths are guesses."""

FOLDS = 10
"""Parts of very many measurements, of which one is held out."""


FORMS: tuple[tuple[Space, bool, bool], ...] = (
    ("joint", True, False),
    ("joint", True, True),
    ("tip", False, True),
)
"""Space, whether with functions of the own angle, and whether with those of all.
Simplest first."""


@dataclass(frozen=True)
class GaussianProcessOptions:
    """Options of the fit of a Gaussian process.

    Attributes:
        searched: Residual components, of random measurements, that choose the
            covariance.
        largest: Residual components that the process is made of at most; time grows
            with their cube. Of more measurements it is made of harmonics, or of some
            of them where that predicts the others better.
        functions: Most harmonics.
        screened: Measurements that choose the harmonics, at random; up to as many
            both ways are compared.
        spaces: Spaces of the correction that are tried, see `FORMS`.
    """

    searched: int = 360
    largest: int = 3600
    functions: int = 1200
    screened: int = 20_000
    spaces: tuple[Space, ...] = ("joint", "tip")


@dataclass(frozen=True)
class GaussianProcess:
    """A Gaussian process given its measurements.

    Attributes:
        region: Training region; its angles are those of the covariance.
        shift: Shift of the geometry that belongs to it, shape (P,).
        space: Space of the corrections.
        covariance: Covariance of the corrections in their units.
        noise: Variance of the whitened residuals beside that.
        unit: Correction that counts as one, shape (m,) [rad, m].
        q: Training configurations, shape (N, n) [rad, m].
        A: Derivative of whitened residuals by corrections in units, shape (N, d, m).
        absorbed: Residuals that a shift explains, by amounts of variance `free`, shape
            (N d, k).
        released: Shift per amount, shape (P, k).
        free: Variance of these.
        weights: Weight of each configuration in each component, shape (N, m).
        held_out: Root mean square of the whitened residuals of groups of measurements,
            before, and predicted from all the others.
        fades: Whether it fades outside the region, as those did whose shift was free.
    """

    region: TrainedRegion
    shift: Floats
    space: Space
    covariance: Covariance
    noise: float
    unit: Floats
    q: Floats
    A: Floats
    absorbed: Floats
    released: Floats
    free: float
    weights: Floats
    held_out: tuple[float, float]
    fades: bool = False
    name: ClassVar[str] = "gaussian-process"

    @serial_blas
    def __call__(self, q: Floats) -> Floats:
        """Corrections at joint positions, (N, m) [rad, m]."""
        at = self.region.angles(q)
        inside = self.covariance.predict(at, self._angle, self.weights) * self.unit
        return np.asarray(self.weight(q)[:, None] * inside)

    def weight(self, q: Floats) -> Floats:
        """Weight of the correction: one, since it knows how far it holds, shape (N,)."""
        return self.region.weight(q) if self.fades else np.ones(len(q))

    @serial_blas
    def deviation(
        self,
        q: Floats,
        by_correction: Floats | None = None,
        by_shift: Floats | None = None,
    ) -> Floats:
        """Standard deviations, see `ResidualModel.deviation`."""
        weight = self.weight(q)[:, None]
        if by_correction is None:
            by_correction = np.tile(np.eye(len(self.unit)), (len(q), 1, 1))
        A = by_correction * self.unit
        # The absorbed residuals, as amplitudes of unit columns.
        G = np.zeros((*A.shape[:2], len(self.shift))) if by_shift is None else by_shift
        G = G @ self.released
        size = (A**2).dot(self.covariance.total)
        known = np.empty_like(size)
        for start in range(0, len(q), PIECE):
            piece = slice(start, start + PIECE)
            known[piece] = self._known(self.region.angles(q[piece]), A[piece], G[piece])
        total = size + self.free * (G**2).sum(axis=2)
        inside = np.sqrt(np.maximum(total - known, 0.0))
        return np.asarray(weight * inside + (1.0 - weight) * np.sqrt(size))

    def _known(self, at: Floats, A: Floats, G: Floats) -> Floats:
        """Part of the variance that the measurements remove, shape (K, d).

        Of something with derivatives by corrections in units, A (K, d, m), and by the
        absorbed amplitudes, G (K, d, k), at angles (K, n) [rad].
        """
        components = self.covariance.components(self._angle, at)
        blocks = self.A.reshape(-1, len(self.unit))
        across = [
            np.repeat(values, self.A.shape[1], axis=0) * blocks[:, [j]]
            for j, values in enumerate(components)
        ]
        result = np.empty(A.shape[:2])
        for k in range(A.shape[1]):
            together = self.free * (self.absorbed @ G[:, k].T)
            for j in np.flatnonzero(A[:, k].any(axis=0)):
                together += across[j] * A[:, k, j]
            known = solve_triangular(self._factor, together, lower=True)
            result[:, k] = np.einsum("ij,ij->j", known, known)
        return result

    @cached_property
    def _angle(self) -> Floats:
        return self.region.angles(self.q)

    @cached_property
    def _factor(self) -> Floats:
        """Cholesky factor of the covariance of all residuals, shape (N d, N d)."""
        K = self.covariance.of_residuals(self._angle, self.A)
        K += self.free * (self.absorbed @ self.absorbed.T)
        K[np.diag_indices_from(K)] += self.noise
        return np.asarray(cholesky(K, lower=True, overwrite_a=True))

    def document(self) -> dict[str, Any]:
        """The numbers."""
        return {"kind": self.name, **written(self)}

    @staticmethod
    def restore(document: Mapping[str, Any], joints: int) -> GaussianProcess:
        """The process of a document; its factor is computed when it is needed.

        Raises:
            ValueError: If it is not one.
        """
        parts = checked(document, "gaussian-process")
        space = cast(Space, stated(parts, "space", get_args(Space)))
        m = joints if space == "joint" else 6
        q = numbers(parts, "q", (None, joints))
        A = numbers(parts, "A", (len(q), None, m))
        components = len(q) * A.shape[1]
        if components > LOADED:
            raise ValueError(f"'A' has {components} rows, more than {LOADED}")
        shift = numbers(parts, "shift", (None,), empty=True)
        columns = numbers(parts, "absorbed", (components, None), empty=True)
        before, after = numbers(parts, "held_out", (2,))
        return GaussianProcess(
            region=TrainedRegion.restore(parts.get("region"), joints),
            shift=shift,
            space=space,
            covariance=Covariance.restore(parts.get("covariance"), joints, m),
            noise=float(numbers(parts, "noise", (), positive=True)),
            unit=numbers(parts, "unit", (m,), positive=True),
            q=q,
            A=A,
            absorbed=columns,
            released=numbers(
                parts, "released", (len(shift), columns.shape[1]), empty=True
            ),
            free=float(numbers(parts, "free", (), positive=True)),
            weights=numbers(parts, "weights", (len(q), m)),
            held_out=(float(before), float(after)),
            fades=parts.get("fades") is not False,
        )


@serial_blas
def fit_gaussian_process(
    rows: TrainingRows,
    rng: np.random.Generator,
    *,
    options: GaussianProcessOptions | None = None,
    progress: Progress | None = None,
) -> GaussianProcess | HarmonicProcess:
    """Fit a Gaussian process to the residuals of a geometric fit.

    Args:
        rows: The measurements.
        rng: Chooses measurements where not all are used.
        options: Options of the fit.
        progress: Told the part that is done, 0 to 1.

    Raises:
        InputError: If there are too few measurements.
    """
    options, tell = options or GaussianProcessOptions(), progress or (lambda part: None)
    rows.require("Gaussian process", 2 * len(rows.revolute), FEWEST)
    region = TrainedRegion.of(rows.q, rows.revolute, rng)
    if rows.values * len(rows.q) <= options.largest:
        return _exact(rows, region, rng, options, tell)
    part = rows.folds(FOLDS, rng)
    training = rng.permutation(np.flatnonzero(part > 0))
    held = np.flatnonzero(part == 0)
    compared = len(rows.q) <= options.screened
    harmonic = fit_harmonics(
        rows,
        region,
        training,
        held,
        spaces=options.spaces,
        functions=options.functions,
        screened=options.screened,
        report=lambda part: tell(0.5 * part if compared else part),
    )
    if not compared:
        return harmonic
    # Errors that no few harmonics describe are better predicted from some of the
    # measurements than from the harmonics of all.
    few = rows.some(np.sort(training[: options.largest // rows.values]))
    exact = _exact(few, region, rng, options, lambda part: tell(0.5 + 0.5 * part))
    there = rows.some(held)
    evaluate = there.by_joint if exact.space == "joint" else there.by_tip
    after = root_mean_square(evaluate(exact(there.q), exact.shift).residual)
    before, by_harmonics = harmonic.held_out
    return (
        replace(exact, held_out=(before, after)) if after < by_harmonics else harmonic
    )


def _exact(
    rows: TrainingRows,
    region: TrainedRegion,
    rng: np.random.Generator,
    options: GaussianProcessOptions,
    progress: Progress,
) -> GaussianProcess:
    """The process that is made of measurements, in the better space.

    The simplest, of functions of one joint each, unless another predicts measurements
    that are left out better by more than chance.
    """
    forms = [form for form in FORMS if form[0] in options.spaces]
    best, predicted = None, np.zeros(0)
    for k, (space, own, smooth) in enumerate(forms):

        def report(part: float, k: int = k) -> None:
            progress((k + part) / len(forms))

        draft = _Draft(rows, space, region, rng)
        covariance, noise = draft.likeliest(
            options.searched, own, smooth, lambda part: report(0.7 * part)
        )
        report(0.7)
        process, others = draft.solve(covariance, noise)
        if best is None or convincing(predicted, others):
            best, predicted = process, others
        report(1.0)
    assert best is not None
    return best


class _Draft:
    """A process in one space, on its way; the generator chooses measurements."""

    def __init__(
        self,
        rows: TrainingRows,
        space: Space,
        region: TrainedRegion,
        rng: np.random.Generator,
    ) -> None:
        """Linearize about no correction."""
        self.rows, self.space, self.region = rows, space, region
        kinds = rows.revolute if space == "joint" else np.arange(6) < 3
        self.evaluate = rows.by_joint if space == "joint" else rows.by_tip
        self.f, self.z = np.zeros((len(rows.q), len(kinds))), np.zeros(rows.shifts)
        self.at = self.evaluate(self.f, self.z)
        self.unit = correction_unit(self.at, kinds)
        self.angle = region.angles(rows.q)
        # Without any residual, any variance will do.
        self.square = float((self.at.residual**2).mean()) or 1.0
        self.order = rng.permutation(len(rows.q))

    @property
    def A(self) -> Floats:
        """Derivative by corrections in units, shape (N, d, m)."""
        return self.at.by_correction * self.unit

    def likeliest(
        self, components: int, own: bool, smooth: bool, progress: Progress
    ) -> tuple[Covariance, float]:
        """Covariance and noise by some rows with as many residual components at most.

        Arguments otherwise as for `covariance.most_likely`.
        """
        few = np.sort(self.order[: max(components // self.at.residual.shape[1], 1)])
        G, about = self.at.by_shift[few], self.rows.shift.about
        free, kinds = self.rows.shift.columns(G)
        found = most_likely(
            self.angle[few],
            self.A[few],
            G @ about - self.at.residual[few],
            np.sqrt(self.square) * free,
            kinds,
            own=own,
            smooth=smooth,
            progress=progress,
        )
        return found.covariance, found.noise

    def solve(
        self, covariance: Covariance, noise: float
    ) -> tuple[GaussianProcess, Floats]:
        """The process, linearized again at its predictions.

        Returns:
            The process, and the residuals of every group of measurements predicted from
            the others, shape (N, d).
        """
        known = self.rows.shift
        before = self.at.residual
        for _ in range(2):
            G, A = self.at.by_shift, self.A
            effect = times(self.at.by_correction, self.f)
            base = self.at.residual - effect - G @ self.z
            released = known.root(G, self.square, covariance.kinds)
            columns = G.reshape(-1, len(known)) @ released
            process = GaussianProcess(
                region=self.region,
                shift=self.z,
                space=self.space,
                covariance=covariance,
                noise=noise,
                unit=self.unit,
                q=self.rows.q,
                A=A,
                absorbed=columns,
                released=released,
                free=1.0,
                weights=np.zeros((len(A), len(self.unit))),
                held_out=(0.0, 0.0),
            )
            target = (G @ known.about - base).reshape(-1)
            alpha = cho_solve((process._factor, True), target)
            weights = (A.transpose(0, 2, 1) @ alpha.reshape(*base.shape, 1))[:, :, 0]
            self.f = covariance.predict(self.angle, self.angle, weights) * self.unit
            self.z = released @ (columns.T @ alpha) - known.about
            self.at = self.evaluate(self.f, self.z)
        predicted, surprise = left_out(process._factor, alpha, self.rows.groups)
        predicted = predicted.reshape(before.shape)
        if not convincing(before, predicted):
            weights, predicted, self.z = 0.0 * weights, before, 0.0 * self.z
        # All variances times one number predict the same, but less surely: few
        # measurements chose them, and all of them tell how large they are.
        found = replace(
            process,
            shift=self.z,
            covariance=covariance.scaled(surprise),
            noise=noise * surprise,
            free=surprise,
            weights=weights / surprise,
            held_out=(root_mean_square(before), root_mean_square(predicted)),
        )
        return found, predicted
