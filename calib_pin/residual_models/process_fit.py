"""The fit of a Gaussian process, made of measurements or of harmonics."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_solve

from calib_pin.compiled.threads import serial_blas
from calib_pin.kinematics.spatial import Floats, times
from calib_pin.progress import Progress
from calib_pin.residual_models.base import (
    MUCH,
    TrainingRows,
    convincing,
    correction_unit,
    root_mean_square,
)
from calib_pin.residual_models.covariance import (
    FORMS,
    Covariance,
    Form,
    left_out,
    most_likely,
)
from calib_pin.residual_models.gaussian_process import GaussianProcess
from calib_pin.residual_models.harmonic_process import (
    HarmonicProcess,
    fit_harmonics,
)
from calib_pin.residual_models.region import TrainedRegion

FEWEST = 5
"""Configurations per joint without which lengths are guesses."""

FOLDS = 10
"""Parts of very many measurements, of which one is held out."""


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
        forms: Forms that are tried, simplest first.
    """

    searched: int = 600
    largest: int = 3600
    functions: int = 1200
    screened: int = 20_000
    forms: tuple[Form, ...] = FORMS


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
    harmonic, predicted = fit_harmonics(
        rows,
        region,
        training,
        held,
        forms=options.forms,
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
    after = evaluate(exact(there.q), exact.shift).residual
    if not convincing(predicted, after):
        return harmonic
    return replace(exact, held_out=(harmonic.held_out[0], root_mean_square(after)))


def _exact(
    rows: TrainingRows,
    region: TrainedRegion,
    rng: np.random.Generator,
    options: GaussianProcessOptions,
    progress: Progress,
) -> GaussianProcess:
    """The process that is made of measurements, in the better space.

    The simplest, of functions of one joint each, unless another predicts measurements
    that are left out much better, see `convincing`.
    """
    best, predicted = None, np.zeros(0)
    for k, form in enumerate(options.forms):

        def report(part: float, k: int = k) -> None:
            progress((k + part) / len(options.forms))

        draft = _Draft(rows, form, region, rng)
        covariance, noise = draft.likeliest(
            options.searched, lambda part: report(0.7 * part)
        )
        report(0.7)
        process, others = draft.solve(covariance, noise)
        if best is None or convincing(predicted, others, MUCH):
            best, predicted = process, others
        report(1.0)
    assert best is not None
    return best


class _Draft:
    """A process of one form, on its way; the generator chooses measurements."""

    def __init__(
        self,
        rows: TrainingRows,
        form: Form,
        region: TrainedRegion,
        rng: np.random.Generator,
    ) -> None:
        """Linearize about no correction."""
        self.rows, self.form, self.region = rows, form, region
        joint = form.space == "joint"
        kinds = rows.revolute if joint else np.arange(6) < 3
        self.evaluate = rows.by_joint if joint else rows.by_tip
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
        self, components: int, progress: Progress
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
            form=self.form,
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
            columns = G.reshape(before.size, len(known)) @ released
            process = GaussianProcess(
                region=self.region,
                shift=self.z,
                space=self.form.space,
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
