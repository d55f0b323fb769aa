"""A neural network that corrects the joint positions inside the forward kinematics.

The network gives joint corrections from joint angles q:

    p_h = prod_k (a_hk + b_hk sin q_k + c_hk cos q_k)
    f_j = sum_h (u_hj p_h + v_hj dp_h/dq_j)
          + sum_m (s_jm sin(m q_j) + t_jm cos(m q_j))

All that gravity and the links of a serial chain do is a sum of products with at most
one sine or cosine of each joint, and the torque of gravity at a joint is the slope of
such a sum, the potential energy. A few product units describe what many sigmoid ones
only approach. The series is for gears and encoders, whose errors repeat many times in
a turn of their own joint.

Several are trained through the kinematics, with Bayesian weight decay: minimized is
`|r|^2 / noise^2 + sum_g decay_g |w_g|^2` by Levenberg-Marquardt steps. The decay of
each group of weights and the noise are those that make the data most likely (MacKay
1992, doi 10.1162/neco.1992.4.3.415): with `gamma_g` the number of weights of a group
that the data determine,

    decay_g = gamma_g / |w_g|^2,    noise^2 = |r|^2 / (M - sum gamma_g).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf, dpotrs, dtrtri

from calib_pin.compiled.threads import Threads, serial_blas
from calib_pin.kinematics.spatial import Floats, times
from calib_pin.progress import Progress
from calib_pin.residual_models.base import (
    INDEPENDENT,
    PARTS,
    Space,
    TrainingRows,
    convincing,
    correction_unit,
    root_mean_square,
)
from calib_pin.residual_models.documents import Array, restored, written
from calib_pin.residual_models.region import PIECE, TrainedRegion

BANDS = ((1, 1), (2, 2), (3, 4), (5, 8), (9, 14), (15, 20), (21, 30), (31, 40))
"""Harmonics with a decay in common, the first and the last of each."""

PER_HARMONIC = 3
"""Training configurations for each harmonic that a series may have."""

Circle = tuple[Floats, Floats]


@dataclass(frozen=True)
class Weights:
    """The weights of one network with H units and M harmonics.

    Attributes:
        factors: Weights of 1, sine and cosine in each unit, shape (H, n, 3).
        outputs: Weights of each unit and its slope in the corrections, (H, n, 2).
        series: Weights of sines and cosines of a joint's own multiples, (n, 2, M).
    """

    factors: Floats
    outputs: Floats
    series: Floats


@dataclass(frozen=True)
class Inputs:
    """Inputs of a network.

    Attributes:
        circle: Sines and cosines of the joint angles, shape (N, n) each.
        waves: Sines and cosines of their multiples, shape (n, N, 2 M).
        bands: Band of each of the 2 M, shape (2 M,).
    """

    circle: Circle
    waves: Floats
    bands: NDArray[np.int64]

    @staticmethod
    def of(angle: Floats, configurations: int) -> Inputs:
        """Inputs at joint angles.

        Args:
            angle: Angles, shape (N, n) [rad].
            configurations: How many of them differ: they limit the harmonics.
        """
        used = [k for k, b in enumerate(BANDS) if b[1] * PER_HARMONIC <= configurations]
        band = [k for k in used for _ in range(BANDS[k][0], BANDS[k][1] + 1)]
        multiple = angle.T[:, :, None] * np.arange(1, len(band) + 1)
        return Inputs(
            circle=(np.sin(angle), np.cos(angle)),
            waves=np.concatenate([np.sin(multiple), np.cos(multiple)], axis=2),
            bands=np.array(2 * band, np.int64),
        )


def combined(circle: Circle, weights: Weights) -> Floats:
    """Contribution of the units to the corrections, shape (N, n).

    Args:
        circle: Sines and cosines of the joint angles, shape (N, n) each.
        weights: The weights; their series does not count.
    """
    terms, turned = _terms(circle, weights.factors)
    others = _other_products(terms)
    units, slopes = others[-1] * terms[-1], others * turned
    along = slopes @ weights.outputs[:, :, 1].T[:, :, None]
    return np.asarray(units @ weights.outputs[:, :, 0] + along[:, :, 0].T)


def unit_columns(A: Floats, circle: Circle, weights: Weights) -> Floats:
    """Derivatives of A f by the outputs and the factors of the units.

    Args:
        A: Derivative of the residuals by the corrections, shape (N, d, n).
        circle: Sines and cosines of the joint angles, shape (N, n) each.
        weights: The weights.

    Returns:
        Columns in the order of `outputs` and `factors`, shape (N d, 5 H n).
    """
    rows, d, joints = A.shape
    terms, turned = _terms(circle, weights.factors)
    # The last of these functions is the unit, the others are its slopes: there the term
    # of the joint is replaced by its own slope.
    table = np.repeat(terms[:, None], joints + 1, axis=1)
    j = np.arange(joints)
    table[j, j] = turned
    others = _other_products(table)
    units, slopes = others[-1, -1] * terms[-1], others[j, j] * turned
    both = np.stack([np.broadcast_to(units, slopes.shape), slopes], axis=3)
    by_output = A[:, :, None, :, None] * both.transpose(1, 2, 0, 3)[:, None]
    u, v = weights.outputs[:, :, 0], weights.outputs[:, :, 1]
    gain = np.concatenate(
        [A.transpose(2, 0, 1)[..., None] * v.T[:, None, None], (A @ u.T)[None]]
    )
    turns = gain[:-1] * others[j, j][:, :, None]
    others[j, j] = 0.0
    sums = np.einsum("jndh,kjnh->kndh", gain, others)
    sine, cosine = (part.T[:, :, None, None] for part in circle)
    by_factor = np.stack(
        [sums, sums * sine + turns * cosine, sums * cosine - turns * sine]
    )
    return np.concatenate(
        [
            by_output.reshape(rows * d, -1),
            by_factor.transpose(2, 3, 4, 1, 0).reshape(rows * d, -1),
        ],
        axis=1,
    )


def series(angle: Floats, amplitudes: Floats) -> Floats:
    """Fourier series of each joint's own angle, shape (N, n).

    Args:
        angle: Angles, shape (N, n) [rad].
        amplitudes: Of sines and cosines, shape (n, 2, M).
    """
    z = np.exp(1j * angle)
    total = np.zeros_like(z)
    # Horner's rule: s sin x + t cos x is the real part of (t - i s) exp(i x).
    for term in (amplitudes[:, 1] - 1j * amplitudes[:, 0]).T[::-1]:
        total = (total + term) * z
    return np.asarray(total.real)


def _terms(circle: Circle, factors: Floats) -> tuple[Floats, Floats]:
    """Terms of the products and their slopes, shape (n, N, H) each."""
    sine, cosine = (part.T[:, :, None] for part in circle)
    a, b, c = factors.transpose(2, 1, 0)[:, :, None]
    return a + b * sine + c * cosine, b * cosine - c * sine


def _other_products(terms: Floats) -> Floats:
    """Products of all terms but one, along the first axis."""
    result = np.empty_like(terms)
    result[0] = 1.0
    for k in range(1, len(terms)):
        result[k] = result[k - 1] * terms[k - 1]
    after = terms[-1]
    for k in reversed(range(len(terms) - 1)):
        result[k] *= after
        after = after * terms[k]
    return result


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
        series = np.add.outer(bands * np.arange(joints), inputs.bands)
        out = joints * bands + np.tile(np.arange(2 * joints), units)
        into = joints * (bands + 2) + np.tile(np.repeat(np.arange(joints), 3), units)
        self._group = np.concatenate([series.ravel(), out, into]).astype(np.int64)
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
        self._linearize(np.zeros((len(rows.q), joints)), np.zeros(len(rows.shift)))
        self.before = self.after = self._held_out_residual(self._base)
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
            after = self._held_out_residual(residual)
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
        series = self._inputs.waves @ weights.series.reshape(len(self._unit), -1, 1)
        inside = combined(self._inputs.circle, weights) + series[:, :, 0].T
        return np.asarray(inside * self._unit)

    def _weights(self, w: Floats) -> Weights:
        units, joints, length = self._shape
        cuts = np.cumsum([joints * length, units * joints * 2])
        series, out, into = np.split(w, cuts)
        return Weights(
            into.reshape(units, joints, 3),
            out.reshape(units, joints, 2),
            series.reshape(joints, 2, -1),
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
        self._explained, self._shifts = _shift_basis(at.by_shift[self._training])
        self._target = -self._projected(self._base[self._training].reshape(-1))
        waves = self._inputs.waves[:, self._training]
        columns = np.einsum("ndj,jnm->ndjm", self._A, waves).reshape(values, -1)
        self._columns = self._projected(columns[:, self._kept])
        self._gram = self._columns.T @ self._columns

    def _projected(self, columns: Floats) -> Floats:
        return np.asarray(columns - self._explained @ (self._explained.T @ columns))

    def _shift(self, residual: Floats) -> Floats:
        """Shift that explains most of the training measurements, shape (P,)."""
        r = residual[self._training].reshape(-1)
        return np.asarray(-self._shifts @ (self._explained.T @ r))

    def _held_out_residual(self, residual: Floats) -> Floats:
        """Residuals of the held-out measurements, of those of all, shape (N, d)."""
        shifted = residual + self._by_shift @ self._shift(residual)
        return np.asarray(shifted[~self._training])

    def _system(self) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """Normal matrix and gradient of the squares, and which weights are in it."""
        weights = self._weights(self._w)
        J = self._projected(unit_columns(self._A, self._circle, weights))
        across = self._columns.T @ J
        normal = np.block([[self._gram, across], [across.T, J.T @ J]])
        r = self._residual(self._w)
        gradient = np.concatenate([self._columns.T @ r, J.T @ r])
        inside = np.concatenate([self._kept, np.ones(J.shape[1], bool)])
        return normal, gradient, inside

    def _residual(self, w: Floats) -> Floats:
        """Residuals of the training measurements that the shift does not explain."""
        f = combined(self._circle, self._weights(w))
        r = times(self._A, f).reshape(-1)
        series = w[: len(self._kept)][self._kept]
        return np.asarray(self._projected(r) + self._columns @ series - self._target)

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
        free = r.size - self._explained.shape[1] - determined.sum()
        square = float(r @ r) / max(free, 0.05 * r.size)
        self._noise = float(np.sqrt(max(square, 1e-14 * self._start)))


def _shift_basis(by_shift: Floats) -> tuple[Floats, Floats]:
    """Orthonormal residuals that a shift explains, and the shift for each.

    Args:
        by_shift: Derivative of the residuals by the shift, shape (N, d, P).

    Returns:
        Columns, shape (N d, k), and shifts, shape (P, k).
    """
    count, d, shifts = by_shift.shape
    columns = by_shift.reshape(count * d, shifts)
    U, s, Vt = np.linalg.svd(columns, full_matrices=False)
    keep = s > INDEPENDENT * s.max(initial=0.0)
    return U[:, keep], Vt[keep].T / s[keep]


FAILED = 2.0
"""Multiple of the best member's held-out mean square from which another has failed."""

EAGER = 14
"""Steps before noise and decay are estimated."""


@dataclass(frozen=True)
class NetworkOptions:
    """Options of the training of a network.

    Attributes:
        units: Number of product units.
        members: Number of restarts, `PARTS` at most; each holds out another part of the
            measurements, stops by it, and the average of all is the network.
        steps: Largest number of steps with few harmonics, and with all of them.
        patience: Steps without a better prediction that end them early.
        largest: Most measurements to learn from, random ones if there are more; memory
            grows with them.
    """

    units: int = 8
    members: int = PARTS
    steps: tuple[int, int] = (32, 10)
    patience: int = 4
    largest: int = 20_000


@dataclass(frozen=True)
class Network:
    """The average of several networks, see `Member`.

    Attributes:
        region: Training region.
        shift: Shift of the geometry that belongs to them, shape (P,).
        factors: Weights of 1, sine and cosine in each unit, shape (K, H, n, 3).
        outputs: Corrections per unit and its slope, shape (K, H, n, 2) [rad, m].
        series: Amplitudes of sines and cosines of each joint's own multiples, shape
            (K, n, 2, M) [rad, m].
        held_out: Root mean square of the whitened residuals of measurements that a
            network had not learned from, before and after.
    """

    region: TrainedRegion
    shift: Annotated[Floats, Array("P", empty=True)]
    factors: Annotated[Floats, Array("K H n 3")]
    outputs: Annotated[Floats, Array("K H n 2")]
    series: Annotated[Floats, Array("K n 2 M", empty=True)]
    held_out: Annotated[tuple[float, float], Array("2")]
    name: ClassVar[str] = "network"
    space: ClassVar[Space] = "joint"

    @serial_blas
    def __call__(self, q: Floats) -> Floats:
        """Corrections at joint positions, (N, n) [rad, m], zero outside the region."""
        angle = self.region.angles(q)
        inside = series(angle, self._average.series)
        for start in range(0, len(q), PIECE):
            part = angle[start : start + PIECE]
            circle = np.sin(part), np.cos(part)
            inside[start : start + PIECE] += combined(circle, self._average)
        return np.asarray(self.weight(q)[:, None] * inside)

    def weight(self, q: Floats) -> Floats:
        """Weight from 1 in the region to 0 far outside, shape (N,)."""
        return self.region.weight(q)

    @cached_property
    def _average(self) -> Weights:
        """All members side by side, as one network."""
        joints = self.factors.shape[2]
        return Weights(
            self.factors.reshape(-1, joints, 3),
            self.outputs.reshape(-1, joints, 2) / len(self.outputs),
            self.series.mean(axis=0),
        )

    def left_out(
        self,
        rows: TrainingRows,
        masks: Sequence[NDArray[np.bool_]],
        rng: np.random.Generator,
    ) -> list[Network]:
        """One member each, trained without, see `ResidualModel.left_out`."""
        few = NetworkOptions(members=1)
        parts = [rows.subset(np.flatnonzero(~mask)) for mask in masks]
        return [fit_network(part, rng, options=few) for part in parts]

    def document(self) -> dict[str, Any]:
        """The numbers."""
        return {"kind": self.name, **written(self)}

    @staticmethod
    def restore(document: Mapping[str, Any], joints: int) -> Network:
        """The network of a document.

        Raises:
            ValueError: If it is not one.
        """
        return restored(Network, document, {"n": joints})


@serial_blas
def fit_network(
    rows: TrainingRows,
    rng: np.random.Generator,
    *,
    options: NetworkOptions | None = None,
    progress: Progress | None = None,
) -> Network:
    """Train a network on the residuals of a geometric fit.

    Args:
        rows: The measurements.
        rng: Source of first weights and of the parts that are held out.
        options: Options of the training.
        progress: Told the part that is done, 0 to 1.

    Raises:
        InputError: If there are too few measurements.
    """
    options = options or NetworkOptions()
    rows.require("network", 2 * len(rows.revolute))
    region = TrainedRegion.of(rows.q, rows.revolute, rng)
    if len(rows.q) > options.largest:
        rows = rows.subset(np.sort(rng.permutation(len(rows.q))[: options.largest]))
    inputs = Inputs.of(region.angles(rows.q), len(np.unique(rows.groups)))
    unit = correction_unit(rows.plain("joint"), rows.revolute)
    part = rows.folds(rng)
    members = [
        Member(rows, inputs, part != k, unit, options.units, rng)
        for k in range(options.members)
    ]
    threads, half, done = Threads(), options.steps[0] // 2, 0
    for steps, eager in ((half, EAGER), (half, 0), (options.steps[1], 0)):
        # The kinematics are one for all; what follows is each one's own.
        for member in members:
            if done == 2 * len(members):
                member.widen()
            member.aim()
        patience = options.patience
        train = partial(Member.train, steps=steps, patience=patience, eager=eager)
        for _ in threads.map(train, members):
            done += 1
            if progress is not None:
                progress(done / (3 * len(members)))
    # Some may have ended in a poor local minimum.
    limit = FAILED * min(member.held_out for member in members)
    usable = [member for member in members if member.held_out <= limit]
    before = np.concatenate([member.before for member in usable])
    after = np.concatenate([member.after for member in usable])
    weights = [member.best for member in usable]
    correction = np.mean([m.correction(m.best) for m in usable], axis=0)
    shift = _shift(rows, correction)
    if not convincing(before, after):
        # Where nothing is learned the shift of the noise is no use, either.
        weights = [Weights(w.factors, 0.0 * w.outputs, 0.0 * w.series) for w in weights]
        shift, after = 0.0 * shift, before
    return Network(
        region=region,
        shift=shift,
        factors=np.stack([w.factors for w in weights]),
        outputs=np.stack([w.outputs * unit[:, None] for w in weights]),
        series=np.stack([w.series * unit[:, None, None] for w in weights]),
        held_out=(root_mean_square(before), root_mean_square(after)),
    )


def _shift(rows: TrainingRows, correction: Floats) -> Floats:
    """Shift of the geometry that fits best with a correction, shape (P,)."""
    shift = np.zeros(len(rows.shift))
    for _ in range(2 if len(rows.shift) else 0):
        at = rows.by_joint(correction, shift)
        columns = at.by_shift.reshape(-1, len(rows.shift))
        step = np.linalg.lstsq(columns, at.residual.reshape(-1), rcond=INDEPENDENT)[0]
        shift = shift - step
    return shift
