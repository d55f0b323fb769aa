"""Sums over any number of measurements, from which amplitudes follow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib_pin.compiled.threads import Threads
from calib_pin.kinematics.spatial import Floats
from calib_pin.residual_models.harmonics import Harmonics, products

CHUNK = 2048
"""Measurements whose products are one sum; for any number of threads the same."""

SCREENED = 512
"""As many where all functions are looked at, of which there are more."""


@dataclass(frozen=True)
class Linear:
    """Residuals of N measurements, linear in corrections and a shift.

    Attributes:
        angle: Joint angles, shape (N, n) [rad].
        A: Derivative of the residuals by the corrections, shape (N, d, m).
        G: Their derivative by the shift, shape (N, d, P).
        target: What correction and shift should make of them, shape (N, d).
    """

    angle: Floats
    A: Floats
    G: Floats
    target: Floats

    def rows(self, index: NDArray[np.int64] | slice) -> Linear:
        """Some of the measurements."""
        return Linear(
            self.angle[index], self.A[index], self.G[index], self.target[index]
        )

    def chunks(self, size: int = CHUNK) -> list[slice]:
        """The measurements, so many at a time."""
        return [slice(k, k + size) for k in range(0, len(self.angle), size)]


@dataclass(frozen=True)
class Sums:
    """Normal equations of D amplitudes and P shifts.

    Attributes:
        normal: Products of the columns, first those of the amplitudes, shape
            (D + P, D + P).
        right: Their products with the target, shape (D + P,).
        square: Square of the target.
        count: Number of residual components.
    """

    normal: Floats
    right: Floats
    square: float
    count: int

    def __add__(self, other: Sums) -> Sums:
        """The sums over both."""
        return Sums(
            self.normal + other.normal,
            self.right + other.right,
            self.square + other.square,
            self.count + other.count,
        )

    @staticmethod
    def of(harmonics: Harmonics, linear: Linear) -> Sums:
        """The sums over measurements, chunk by chunk."""
        size = len(harmonics) + linear.G.shape[2] + 1
        # The target is one more column; of blocks of amplitudes only the lower half.
        whole = np.zeros((size, size))

        def added(part: slice) -> Floats:
            return _squares(harmonics, linear.rows(part))

        for each in Threads().map(added, linear.chunks()):
            whole += each
        lower = np.tril(whole)
        whole = lower + np.tril(lower, -1).T
        return Sums(
            whole[:-1, :-1],
            whole[:-1, -1],
            float(whole[-1, -1]),
            linear.target.size,
        )


def _squares(harmonics: Harmonics, linear: Linear) -> Floats:
    """Products of the columns of some measurements; the upper half is incomplete."""
    A, D, m = linear.A, len(harmonics), linear.A.shape[2]
    others = np.concatenate([linear.G, linear.target[:, :, None]], axis=2)
    values, columns = harmonics.values(linear.angle), harmonics.of_components(m)
    across = A.transpose(0, 2, 1)
    weights, right = across @ A, others.transpose(0, 2, 1) @ A
    result = np.zeros((D + others.shape[2],) * 2)
    for j, own in enumerate(columns):
        for k, other in enumerate(columns[: j + 1]):
            weight = weights[:, j, k]
            if weight.any():
                result[own, other] = (values[:, own].T * weight) @ values[:, other]
        result[D:, own] = right[:, :, j].T @ values[:, own]
    flat = others.reshape(-1, others.shape[2])
    result[D:, D:] = flat.T @ flat
    return result


def scores(harmonics: Harmonics, linear: Linear) -> Floats:
    """How much each function alone would explain of the target, shape (D,).

    Squares, which are that of the noise where the function explains nothing.
    """
    modes, place = harmonics.distinct

    def sums(part: slice) -> tuple[Floats, Floats]:
        rows = linear.rows(part)
        values = products(modes, rows.angle)
        along = np.einsum("ndm,nd->mn", rows.A, rows.target) @ values
        values *= values
        return along, np.einsum("ndm,ndm->mn", rows.A, rows.A) @ values

    shape = linear.A.shape[2], len(modes)
    along, size = np.zeros(shape), np.zeros(shape)
    for more, larger in Threads().map(sums, linear.chunks(SCREENED)):
        along += more
        size += larger
    unseen = size == 0.0
    explained = np.where(unseen, 0.0, along**2 / np.where(unseen, 1.0, size))
    return np.asarray(explained[harmonics.component, place])
