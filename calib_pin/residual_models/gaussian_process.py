"""A Gaussian process over the residuals, as joint corrections or as a twist of the tip.

The residuals are linear in the corrections, `r = r_0 + A f`, so a process over f is one
over r, and nothing has to be inverted where A is singular: the unobserved part of a
correction stays at zero. The part that a shift of the geometry can explain has a
variance so large that it is free, and errors of the robot's parameters have the size
that the measurements tell, see `shifts`. So the process knows how far it holds: where
nothing was measured, it is the parameters that belong to it, and no more.

Its covariance is searched once. With K the covariance of the residuals y, all that the
process says is linear in `alpha = K^-1 y`, and without a group g of measurements it is
that of the others (Rasmussen and Williams 2006, 5.4.2), with parameters and all,

    alpha_others = alpha - (K^-1)_g (K^-1)_gg^-1 alpha_g.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, cholesky

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
from calib_pin.residual_models.covariance import (
    FORMS,
    Covariance,
    Form,
    Likelihood,
    most_likely,
    symmetric_inverse,
)
from calib_pin.residual_models.documents import Array, restored, written
from calib_pin.residual_models.region import TrainedRegion


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
        few = rows.some(chosen)
        whole = Conditioned.of(self, few, self(few.q), self.shift)
        inverse, alpha = symmetric_inverse(whole.factor), whole.alpha
        result = []
        for mask in masks:
            g = np.repeat(mask[chosen], rows.values)
            block = np.linalg.solve(inverse[np.ix_(g, g)], alpha[g])
            others = np.where(g, 0.0, alpha - inverse[:, g] @ block)
            result.append(whole.given(others))
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
        found = restored(GaussianProcess, document, sizes)
        found.covariance.require(joints, sizes["m"])
        return found


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
        found, alpha = replace(process, q=rows.q), cho_solve((factor, True), target)
        return Conditioned(found, A, absorbed, released, known.about, factor, alpha)

    def given(self, alpha: Floats) -> GaussianProcess:
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
    rows = rows.some(evenly(len(rows.q), options.largest // rows.values))
    few = rng.permutation(len(rows.q))[: max(options.searched // rows.values, 1)]
    best, predicted, count = None, np.zeros(0), len(options.forms)
    for k, form in enumerate(options.forms):
        tell = portion(progress, k / count, 1.0 / count)
        draft = _searched(rows, form, region, np.sort(few), tell)
        process, others = _given_all(draft, rows)
        if best is None or convincing(predicted, others, MUCH):
            best, predicted = process, others
    if progress is not None:
        progress(1.0)
    assert best is not None
    return best


def _searched(
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
        shift=np.zeros(rows.shifts),
        covariance=covariance,
        unit=unit,
        q=rows.q,
        weights=np.zeros((len(rows.q), len(kinds))),
        held_out=(size, 0.0),
    )


def _given_all(
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
        process = known.given(known.alpha)
    predicted = _of_groups(known.factor, known.alpha, rows.groups)
    # All variances times one number predict the same, but less surely: few
    # measurements chose them, and all of them tell how large they are.
    surprise = float(predicted @ known.alpha) / len(predicted) or 1.0
    before, kept = rows.plain(process.space).residual, 1.0
    predicted = predicted.reshape(before.shape)
    if not convincing(before, predicted):
        predicted, kept = before, 0.0
    found = replace(
        process,
        shift=kept * process.shift,
        covariance=process.covariance.scaled(surprise),
        weights=kept * process.weights / surprise,
        held_out=(root_mean_square(before), root_mean_square(predicted)),
    )
    return found, predicted


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
