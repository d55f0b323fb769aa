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
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, cast, get_args

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from calib_pin.compiled.threads import serial_blas
from calib_pin.kinematics.spatial import Floats
from calib_pin.residual_models.base import Space
from calib_pin.residual_models.covariance import Covariance
from calib_pin.residual_models.documents import (
    checked,
    fades,
    numbers,
    stated,
    written,
)
from calib_pin.residual_models.region import PIECE, TrainedRegion

LOADED = 6_000
"""Most residual components in a document; their covariance must fit the memory."""


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
        """Weight of the correction: one, for it knows how far it holds, (N,)."""
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
            fades=fades(parts),
        )
