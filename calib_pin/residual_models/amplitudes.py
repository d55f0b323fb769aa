"""Amplitudes of harmonics given their sums, and the likeliest covariance of them.

With V the variances of the amplitudes and S the products of the columns in squares of
the noise, all follows from `B = 1 + V^(1/2) S V^(1/2)` (Rasmussen and Williams 2006,
2.1): its size is that of the harmonics, and that of the measurements has no part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve, cholesky
from scipy.linalg.lapack import dpotri, dtrtri

from calib_pin.kinematics.spatial import Floats
from calib_pin.residual_models.covariance import Covariance, Form, Likeliest, searched
from calib_pin.residual_models.harmonics import HIGHEST, Harmonics, Spectrum
from calib_pin.residual_models.sums import Sums


@dataclass(frozen=True)
class Variances:
    """Variances of amplitudes, out of a covariance.

    Attributes:
        of_all: Part of the function of all angles, shape (D,).
        of_own: Part of the function of the own angle, shape (D,).
        by_long: Derivative of the logarithms of the former by those of the lengths in
            each angle, shape (n, D).
        by_short: Derivative of those of the latter by that of their length, (D,).
    """

    of_all: Floats
    of_own: Floats
    by_long: Floats
    by_short: Floats

    @property
    def total(self) -> Floats:
        """The variances, shape (D,)."""
        return self.of_all + self.of_own

    @staticmethod
    def of(covariance: Covariance, harmonics: Harmonics) -> Variances:
        """The variances that a covariance gives to harmonics."""
        orders, component = harmonics.orders, harmonics.component
        spectra = [Spectrum.of(length, HIGHEST) for length in covariance.long]
        of_all = np.zeros(len(harmonics))
        if len(covariance.all):
            of_all = covariance.all[component]
            for spectrum, order in zip(spectra, orders.T, strict=True):
                of_all = of_all * spectrum.value[order]
        of_own, by_short = np.zeros(len(harmonics)), np.zeros(len(harmonics))
        for j, length in enumerate(covariance.short):
            own = np.flatnonzero(harmonics.alone & (component == j))
            spectrum, order = Spectrum.of(length, HIGHEST), orders[own, j]
            of_own[own] = covariance.own[j] * spectrum.value[order]
            by_short[own] = spectrum.slope[order]
        by_long = np.zeros((len(spectra), len(harmonics)))
        for row, spectrum, order in zip(by_long, spectra, orders.T, strict=False):
            row[:] = spectrum.slope[order]
        return Variances(of_all, of_own, by_long, by_short)


@dataclass(frozen=True)
class Amplitudes:
    """Amplitudes and shifts given their sums.

    Attributes:
        mean: Their values, shape (D + P,).
        root: Standard deviations before any measurement, shape (D + P,).
        factor: Lower Cholesky factor of B, see the module, shape (D + P, D + P).
        cost: Negative logarithm of the likelihood of the measurements, but for a
            constant.
        slope: Derivative of the cost by the logarithms of the variances, (D + P,).
        by_noise: Its derivative by that of the noise.
    """

    mean: Floats
    root: Floats
    factor: Floats
    cost: float
    slope: Floats
    by_noise: float

    @staticmethod
    def of(sums: Sums, variance: Floats, noise: float) -> Amplitudes:
        """The amplitudes.

        Args:
            sums: The sums.
            variance: Variances before any measurement, shape (D + P,).
            noise: Variance of the residuals beside the corrections.
        """
        root = np.sqrt(variance)
        B = sums.normal * root
        B *= root[:, None] / noise
        B[np.diag_indices_from(B)] += 1.0
        L = cholesky(B, lower=True, overwrite_a=True, check_finite=False)
        b = root * sums.right / noise
        v = cho_solve((L, True), b, check_finite=False)
        explained, square = float(b @ v), sums.square / noise
        inverse, _ = dpotri(L, lower=1)
        diagonal = np.diag(inverse)
        left = square - explained - float(v @ v)
        return Amplitudes(
            mean=root * v,
            root=root,
            factor=L,
            cost=float(
                0.5 * (sums.count * np.log(noise) + square - explained)
                + np.log(np.diag(L)).sum()
            ),
            slope=0.5 * (1.0 - diagonal - v**2),
            by_noise=0.5 * float(sums.count - len(b) + diagonal.sum() - left),
        )

    @property
    def spread(self) -> Floats:
        """Lower triangle T: the variance of `x mean` is `|T (root x)|^2`."""
        inverse, _ = dtrtri(self.factor, lower=1)
        return np.tril(inverse)


def likeliest(
    sums: Sums,
    harmonics: Harmonics,
    free: Floats,
    kinds: Sequence[int] = (),
    *,
    form: Form,
) -> Likeliest:
    """Maximize the marginal likelihood of the measurements.

    Args:
        sums: Their sums.
        harmonics: The harmonics, of every component at least one.
        free: Variances of the free amounts of the shift, shape (f,).
        kinds: Number of amounts of each kind behind these, see `shifts.Shifts`.
        form: Functions that the process is made of.
    """
    m, D = int(harmonics.component.max()) + 1, len(harmonics)

    def cost(covariance: Covariance, noise: float) -> tuple[float, Floats]:
        variances = Variances.of(covariance, harmonics)
        others = shift_variances(covariance, free, kinds)
        found = Amplitudes.of(sums, np.r_[variances.total, others], noise)
        # Of a variance that is a sum each part has its share of the derivative.
        by_part = found.slope[:D] / np.maximum(variances.total, 1e-300)
        of_all, of_own = by_part * variances.of_all, by_part * variances.of_own

        def summed(values: Floats) -> Floats:
            return np.bincount(harmonics.component, values, m).astype(float)

        gradient = np.zeros(0)
        if form.own:
            short = summed(of_own * variances.by_short)
            gradient = np.r_[summed(of_own), short]
        if form.smooth:
            gradient = np.r_[gradient, summed(of_all), variances.by_long @ of_all]
        by_kind = np.bincount(of_kind, found.slope[D + len(free) :], len(kinds))
        return found.cost, np.r_[gradient, by_kind, [found.by_noise]]

    of_kind = np.repeat(np.arange(len(kinds)), kinds)
    shape = m, harmonics.modes.shape[1], len(kinds)
    square = sums.square / sums.count
    return searched(cost, shape, square, form=form)


def shift_variances(
    covariance: Covariance, free: Floats, kinds: Sequence[int]
) -> Floats:
    """Variances of all amounts of the shift, see `likeliest`, shape (f + p,)."""
    return np.concatenate([free, np.repeat(covariance.kinds, kinds)])
