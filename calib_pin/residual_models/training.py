"""Train one network through the kinematics, with Bayesian weight decay.

Minimized is `|r|^2 / noise^2 + sum_g decay_g |w_g|^2` by Levenberg-Marquardt steps. The
decay of each group of weights and the noise are those that make the data most likely
(MacKay 1992, doi 10.1162/neco.1992.4.3.415): with `gamma_g` the number of weights of a
group that the data determine,

    decay_g = gamma_g / |w_g|^2,    noise^2 = |r|^2 / (M - sum gamma_g).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf, dpotrs, dtrtri

from calib_pin.kinematics.spatial import Floats, times
from calib_pin.residual_models.base import INDEPENDENT, TrainingRows
from calib_pin.residual_models.units import Inputs, Weights, combined, unit_columns

FIRST = 2
"""Bands that a network begins with; the others wait until the units have found form.

With them from the start, they take up what the units do not yet describe.
"""

FACTORS = (0.7, 0.3, 0.5)
"""First factors of a unit: that of 1, its spread, and that of sine and cosine.

Larger ones make products of seven that are wild to begin with.
"""

NOISE = 0.1
"""Noise to begin with, as a part of the residual."""

LEAST_GAIN = 1e-3
"""Part by which the held-out squares must fall to count as better."""

WIDENED = 100.0
"""Decay of harmonics that are newly admitted."""


class Member:
    """One network in training on some of the measurements, watched on the others.

    Args:
        rows: All measurements.
        inputs: Inputs of the network, of all measurements.
        training: True for measurements that it learns from, shape (N,).
        unit: Correction that counts as one, shape (n,) [rad, m].
        units: Number H of product units.
        rng: Source of the first weights.

    Attributes:
        best: The weights that predict the other measurements best.
        before: Residuals of these without a correction, shape (K, d).
        after: Their residuals with the best weights, shape (K, d).
    """

    def __init__(
        self,
        rows: TrainingRows,
        inputs: Inputs,
        training: NDArray[np.bool_],
        unit: Floats,
        units: int,
        rng: np.random.Generator,
    ) -> None:
        """Start from small random weights."""
        self._rows, self._inputs = rows, inputs
        self._training, self._unit = training, unit
        self._circle = inputs.circle[0][training], inputs.circle[1][training]
        joints, length = len(unit), len(inputs.bands)
        self._shape = units, joints, length
        bands = inputs.bands.max(initial=-1) + 1
        own = np.add.outer(bands * np.arange(joints), inputs.bands)
        out = joints * bands + np.tile(np.arange(2 * joints), units)
        into = joints * (bands + 2) + np.tile(np.repeat(np.arange(joints), 3), units)
        self._group = np.concatenate([own.ravel(), out, into]).astype(np.int64)
        self._count = np.bincount(self._group, minlength=joints * (bands + 3))
        self._decay = np.ones(len(self._count))
        self._decay[joints * bands : joints * (bands + 2)] = 0.1
        self._kept = np.tile(inputs.bands < FIRST, joints)
        self._damping = 1e-2
        middle, *spread = FACTORS
        factors = rng.standard_normal((units, joints, 3)) * np.repeat(spread, (1, 2))
        factors[:, :, 0] += middle
        outputs = 0.3 * rng.standard_normal(units * joints * 2)
        self._w = np.concatenate(
            [np.zeros(joints * length), outputs, factors.reshape(-1)]
        )
        self.best = self._weights(np.zeros_like(self._w))
        self._linearize(np.zeros((len(rows.q), joints)), np.zeros(rows.shifts))
        self.before = self.after = self._watched(self._base)
        # Without any residual, any noise will do.
        self._start = float((self._target**2).mean()) or 1.0
        self._noise = NOISE * float(np.sqrt(self._start))

    def aim(self) -> None:
        """Linearize the kinematics anew at the weights so far."""
        f = self.correction(self._weights(self._w))
        self._linearize(f, self._shift(self._base + times(self._slope, f)))

    def train(self, steps: int, patience: int, *, eager: int = 0) -> None:
        """Take some steps about the linearization.

        The best weights are those that predict the held-out measurements.

        Args:
            steps: Largest number of steps.
            patience: Steps without a better prediction that end them early.
            eager: First steps in which noise and decay keep their small values, because
                what the units do not yet describe is no noise.
        """
        waited = 0
        for k in range(steps):
            if not self._step():
                break
            if k >= eager:
                self._weigh()
            weights = self._weights(self._w)
            residual = self._base + times(self._slope, self.correction(weights))
            after = self._watched(residual)
            held_out, best = float((after**2).mean()), self.held_out
            better = held_out < (1.0 - LEAST_GAIN) * best
            waited = 0 if better or k < eager else waited + 1
            if held_out < best:
                self.after, self.best = after, weights
            if waited >= patience:
                break

    @property
    def held_out(self) -> float:
        """Mean square of the best residuals of held-out measurements."""
        return float((self.after**2).mean())

    def widen(self) -> None:
        """Admit the harmonics that were left out."""
        series = len(self._kept)
        self._decay[self._group[:series][~self._kept]] = WIDENED
        self._kept[:] = True

    def correction(self, weights: Weights) -> Floats:
        """Corrections of all measurements, shape (N, n) [rad, m]."""
        own = self._inputs.waves @ weights.series.reshape(len(self._unit), -1, 1)
        inside = combined(self._inputs.circle, weights) + own[:, :, 0].T
        return np.asarray(inside * self._unit)

    def _weights(self, w: Floats) -> Weights:
        units, joints, length = self._shape
        own, out, into = np.split(w, np.cumsum([joints * length, units * joints * 2]))
        return Weights(
            into.reshape(units, joints, 3),
            out.reshape(units, joints, 2),
            own.reshape(joints, 2, -1),
        )

    def _linearize(self, f: Floats, shift: Floats) -> None:
        """Residuals as linear functions of correction and shift, about f and a shift.

        The part that the shift can explain is removed from the training measurements;
        it has no decay.
        """
        at = self._rows.by_joint(f, shift)
        self._slope = at.by_correction
        self._by_shift = at.by_shift
        # Residuals where correction and shift would be zero.
        self._base = at.residual - times(self._slope, f) - at.by_shift @ shift
        self._A = self._slope[self._training] * self._unit
        values = self._A.shape[0] * self._A.shape[1]
        self._left, self._back = _absorbed(at.by_shift[self._training])
        self._target = -self._projected(self._base[self._training].reshape(-1))
        own = np.einsum("ndj,jnm->ndjm", self._A, self._inputs.waves[:, self._training])
        columns = own.reshape(values, -1)[:, self._kept]
        self._own = self._projected(columns)
        self._gram = self._own.T @ self._own

    def _projected(self, columns: Floats) -> Floats:
        return np.asarray(columns - self._left @ (self._left.T @ columns))

    def _shift(self, residual: Floats) -> Floats:
        """Shift that explains most of the training measurements, shape (P,)."""
        r = residual[self._training].reshape(-1)
        return np.asarray(-self._back @ (self._left.T @ r))

    def _watched(self, residual: Floats) -> Floats:
        """Residuals of the held-out measurements, of those of all, shape (N, d)."""
        shifted = residual + self._by_shift @ self._shift(residual)
        return np.asarray(shifted[~self._training])

    def _system(self) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """Normal matrix and gradient of the squares, and which weights are in it."""
        weights = self._weights(self._w)
        J = self._projected(unit_columns(self._A, self._circle, weights))
        across = self._own.T @ J
        normal = np.block([[self._gram, across], [across.T, J.T @ J]])
        r = self._residual(self._w)
        gradient = np.concatenate([self._own.T @ r, J.T @ r])
        inside = np.concatenate([self._kept, np.ones(J.shape[1], bool)])
        return normal, gradient, inside

    def _residual(self, w: Floats) -> Floats:
        """Residuals of the training measurements that the shift does not explain."""
        f = combined(self._circle, self._weights(w))
        r = times(self._A, f).reshape(-1)
        own = w[: len(self._kept)][self._kept]
        return np.asarray(self._projected(r) + self._own @ own - self._target)

    def _cost(self, w: Floats) -> float:
        r = self._residual(w)
        return float(r @ r / self._noise**2 + self._decay[self._group] @ (w * w))

    def _step(self) -> bool:
        """One damped step; False where no damping leads down."""
        normal, gradient, inside = self._system()
        beta, decay = self._noise**-2, self._decay[self._group[inside]]
        pull = beta * gradient + decay * self._w[inside]
        # The series is linear and needs no damping.
        nonlinear = np.arange(len(decay)) >= self._kept.sum()
        level = nonlinear * np.diag(normal)[nonlinear].mean()
        cost = self._cost(self._w)
        self._normal = normal
        for _ in range(8):
            matrix = beta * normal
            matrix[np.diag_indices_from(matrix)] += decay + beta * self._damping * level
            factor, failed = dpotrf(matrix.T, lower=1, overwrite_a=1)
            w = self._w.copy()
            w[inside] -= dpotrs(factor, pull, lower=1)[0]
            if not failed and self._cost(w) < cost:
                self._damping = max(0.2 * self._damping, 1e-7)
                self._w, self._inside = w, inside
                return True
            self._damping = max(8.0 * self._damping, 1e-6)
        return False

    def _weigh(self) -> None:
        """Noise and decay that make the data most likely, one step of the iteration."""
        group = self._group[self._inside]
        w, decay = self._w[self._inside], self._decay
        matrix = self._normal / self._noise**2
        matrix[np.diag_indices_from(matrix)] += decay[group]
        factor, failed = dpotrf(matrix.T, lower=1, overwrite_a=1)
        if failed:
            return  # By rounding, where the data say all; there is nothing to weigh.
        inverse, _ = dtrtri(factor, lower=1, overwrite_c=1)
        variance = np.einsum("ij,ij->j", inverse, inverse)
        trace = np.bincount(group, variance, len(decay))
        size = np.bincount(group, w * w, len(decay))
        inside = np.bincount(group, minlength=len(decay)) > 0
        # The small numbers keep groups without any use from dividing zero by zero.
        determined = np.where(
            inside, np.maximum(self._count - decay * trace, 1e-3), 0.0
        )
        update = np.clip((determined + 1e-3) / (size + 1e-3), 1e-6, 1e6)
        self._decay = np.where(inside, update, decay)
        r = self._residual(self._w)
        free = r.size - self._left.shape[1] - determined.sum()
        square = float(r @ r) / max(free, 0.05 * r.size)
        self._noise = float(np.sqrt(max(square, 1e-14 * self._start)))


def _absorbed(by_shift: Floats) -> tuple[Floats, Floats]:
    """Orthonormal residuals that a shift explains, and the shift for each.

    Args:
        by_shift: Derivative of the residuals by the shift, shape (N, d, P).

    Returns:
        Columns, shape (N d, k), and shifts, shape (P, k).
    """
    count, d, shifts = by_shift.shape
    columns = by_shift.reshape(count * d, shifts)
    left, s, right = np.linalg.svd(columns, full_matrices=False)
    keep = s > INDEPENDENT * s.max(initial=0.0)
    return left[:, keep], right[keep].T / s[keep]
