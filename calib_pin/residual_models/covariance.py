"""Covariance of the corrections that a Gaussian process expects before any data.

Each component j of a correction is a sum of two independent functions,

    cov(f_j(q), f_j(q')) = own_j exp((cos(q_j - q_j') - 1) / s_j^2)
                         + all_j exp(sum_k (cos(q_k - q_k') - 1) / l_k^2)

one of its joint's own angle, which may repeat many times in a turn as gears do, and one
of all angles, which is smooth. A twist of the tip has no joint of its own, and only the
second. The exponents are squared distances on the circles: this is a Gaussian kernel of
the points (sin, cos).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calib_pin.kinematics.spatial import Floats
from calib_pin.residual_models.documents import checked, numbers
from calib_pin.residual_models.region import PIECE


@dataclass(frozen=True)
class Covariance:
    """The two functions of each of m components, in n joint angles.

    Attributes:
        own: Variances of the functions of the own angle, shape (m,), or (0,) without.
        short: Their lengths s, of the shape of `own`.
        all: Variances of the functions of all angles, shape (m,).
        long: Their lengths l in each angle, shape (n,).
    """

    own: Floats
    short: Floats
    all: Floats
    long: Floats

    @property
    def total(self) -> Floats:
        """Variances of the components, shape (m,)."""
        return self.all + self.own if len(self.own) else self.all

    def scaled(self, factor: float) -> Covariance:
        """The same with all variances times a number."""
        return replace(self, own=self.own * factor, all=self.all * factor)

    def owns(self, a: Floats, b: Floats) -> Iterator[Floats]:
        """Correlation by the own angle for each component, shape (A, B) each.

        Args:
            a: Angles, shape (A, n) [rad].
            b: Angles, shape (B, n) [rad].
        """
        for j, length in enumerate(self.short):
            yield _correlation(a[:, [j]], b[:, [j]], np.array([length]))

    def alls(self, a: Floats, b: Floats) -> Floats:
        """Correlation by all angles, shape (A, B)."""
        return _correlation(a, b, self.long)

    def components(self, a: Floats, b: Floats) -> Iterator[Floats]:
        """Covariance of each component, shape (A, B) each."""
        smooth, owns = self.alls(a, b), self.owns(a, b)
        for j, variance in enumerate(self.all):
            result = variance * smooth
            if len(self.own):
                result += self.own[j] * next(owns)
            yield result

    def seen(self, angle: Floats, A: Floats) -> Floats:
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
                result += _spread(values, d) * np.multiply.outer(a, a)
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
            sums = self.alls(part, angle) @ (weights * self.all)
            for j, values in enumerate(self.owns(part, angle)):
                sums[:, j] += self.own[j] * (values @ weights[:, j])
            result[start : start + PIECE] = sums
        return result

    def document(self) -> dict[str, Any]:
        """The numbers."""
        return {
            "own": self.own.tolist(),
            "short": self.short.tolist(),
            "all": self.all.tolist(),
            "long": self.long.tolist(),
        }

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
        return Covariance(
            own=own,
            short=numbers(parts, "short", own.shape, positive=True, empty=True),
            all=numbers(parts, "all", (components,), positive=True),
            long=numbers(parts, "long", (joints,), positive=True),
        )


def _correlation(a: Floats, b: Floats, length: Floats) -> Floats:
    """Correlation of functions of angles, shape (A, n), (B, n) -> (A, B)."""
    scaled = np.concatenate([np.cos(a) / length**2, np.sin(a) / length**2], axis=1)
    result = scaled @ np.concatenate([np.cos(b), np.sin(b)], axis=1).T
    result -= (1.0 / length**2).sum()
    return np.asarray(np.exp(result, out=result))


def _spread(values: Floats, d: int) -> Floats:
    """Every entry for a block of d x d, shape (N, N) -> (N d, N d)."""
    return np.asarray(np.repeat(np.repeat(values, d, axis=0), d, axis=1))
