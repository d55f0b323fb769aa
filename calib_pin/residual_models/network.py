"""A neural network that corrects the joint positions inside the forward kinematics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, ClassVar

import numpy as np

from calib_pin.compiled.threads import Threads, serial_blas
from calib_pin.kinematics.spatial import Floats, times
from calib_pin.progress import Progress
from calib_pin.residual_models.base import (
    INDEPENDENT,
    Space,
    TrainingRows,
    convincing,
    correction_unit,
    root_mean_square,
)
from calib_pin.residual_models.documents import checked, numbers, written
from calib_pin.residual_models.region import PIECE, TrainedRegion
from calib_pin.residual_models.training import Member
from calib_pin.residual_models.units import Inputs, Weights, combined, series

FAILED = 2.0
"""Multiple of the best member's held-out mean square from which another has failed."""

LARGEST_INFLATION = 10.0
"""Largest factor on deviations; beyond, the noise was estimated wrongly."""

FEWEST = 3
"""Members below which those that have failed are trained once more."""

EAGER = 14
"""Steps before noise and decay are estimated."""


@dataclass(frozen=True)
class NetworkOptions:
    """Options of the training of a network.

    Attributes:
        units: Number of product units.
        members: Number of restarts; each holds out another part of the measurements,
            stops by it, and the average of all is the network.
        steps: Largest number of steps with few harmonics, and with all of them.
        patience: Steps without a better prediction that end them early.
        largest: Most measurements to learn from, random ones if there are more; memory
            grows with them.
    """

    units: int = 8
    members: int = 5
    steps: tuple[int, int] = (32, 10)
    patience: int = 4
    largest: int = 20_000


@dataclass(frozen=True)
class Network:
    """The average of several networks, see `training`.

    Attributes:
        region: Training region.
        shift: Shift of the geometry that belongs to them, shape (P,).
        shifts: Shifts that the members found, shape (K, P).
        factors: Weights of 1, sine and cosine in each unit, shape (K, H, n, 3).
        outputs: Corrections per unit and its slope, shape (K, H, n, 2) [rad, m].
        series: Amplitudes of sines and cosines of each joint's own multiples, shape
            (K, n, 2, M) [rad, m].
        typical: Size of the corrections in training, shape (n,) [rad, m].
        inflation: Factor on the deviations, at least one, by which they explain the
            errors of held-out measurements.
        held_out: Root mean square of the whitened residuals of measurements that a
            network had not learned from, before and after.
    """

    region: TrainedRegion
    shift: Floats
    shifts: Floats
    factors: Floats
    outputs: Floats
    series: Floats
    typical: Floats
    inflation: float
    held_out: tuple[float, float]
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

    @serial_blas
    def deviation(
        self,
        q: Floats,
        by_correction: Floats | None = None,
        by_shift: Floats | None = None,
    ) -> Floats:
        """Standard deviations by the jackknife, see `ResidualModel.deviation`.

        Every member lacks another part of the measurements, so the variance of their
        mean is (K - 1) times their mean square deviation from it (Efron and Stein
        1981). Where only one is left, it is the part of the residuals that is left.
        """
        angle = self.region.angles(q)
        circle = np.sin(angle), np.cos(angle)
        each = np.stack(
            [
                combined(circle, weights) + series(angle, weights.series)
                for weights in map(Weights, self.factors, self.outputs, self.series)
            ]
        )
        size = np.tile(self.typical, (len(q), 1))
        if by_correction is not None:
            each = times(by_correction, each)
            if by_shift is not None:
                each = each + times(by_shift, self.shifts[:, None])
            size = np.sqrt(times(by_correction**2, size**2))
        inside = self.inflation * _jackknife(each)
        if len(each) == 1:
            before, after = self.held_out
            inside = size * min(after / max(before, 1e-300), 1.0)
        weight = self.weight(q)[:, None]
        return np.asarray(weight * inside + (1.0 - weight) * size)

    @cached_property
    def _average(self) -> Weights:
        """All members side by side, as one network."""
        joints = self.factors.shape[2]
        return Weights(
            self.factors.reshape(-1, joints, 3),
            self.outputs.reshape(-1, joints, 2) / len(self.outputs),
            self.series.mean(axis=0),
        )

    def document(self) -> dict[str, Any]:
        """The numbers; files know the inflation factor as `caution`."""
        parts = {"kind": self.name, **written(self)}
        return {"caution" if k == "inflation" else k: v for k, v in parts.items()}

    @staticmethod
    def restore(document: Mapping[str, Any], joints: int) -> Network:
        """The network of a document.

        Raises:
            ValueError: If it is not one.
        """
        parts = checked(document, "network")
        region = TrainedRegion.restore(parts.get("region"), joints)
        factors = numbers(parts, "factors", (None, None, joints, 3))
        members, units = factors.shape[:2]
        shift = numbers(parts, "shift", (None,), empty=True)
        before, after = numbers(parts, "held_out", (2,))
        return Network(
            region=region,
            shift=shift,
            shifts=numbers(parts, "shifts", (members, len(shift)), empty=True),
            factors=factors,
            outputs=numbers(parts, "outputs", (members, units, joints, 2)),
            series=numbers(parts, "series", (members, joints, 2, None), empty=True),
            typical=numbers(parts, "typical", (joints,)),
            inflation=float(numbers(parts, "caution", (), positive=True)),
            held_out=(float(before), float(after)),
        )


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
    joints = len(rows.revolute)
    rows.require("network", 2 * joints, options.members)
    region = TrainedRegion.of(rows.q, rows.revolute, rng)
    if len(rows.q) > options.largest:
        rows = rows.some(np.sort(rng.permutation(len(rows.q))[: options.largest]))
    inputs = Inputs.of(region.angles(rows.q), len(np.unique(rows.groups)))
    nothing = np.zeros(rows.q.shape), np.zeros(rows.shifts)
    unit = correction_unit(rows.by_joint(*nothing), rows.revolute)
    part = rows.folds(options.members, rng)

    threads = Threads()

    def trained(parts: Sequence[int], start: float, end: float) -> list[Member]:
        members = [
            Member(rows, inputs, part != k, unit, options.units, rng) for k in parts
        ]
        half = options.steps[0] // 2
        done = 0
        for steps, eager in ((half, EAGER), (half, 0), (options.steps[1], 0)):
            if done == 2 * len(members):
                for member in members:
                    member.widen()
            # The kinematics are one for all; what follows is each one's own.
            for member in members:
                member.aim()
            train = partial(
                Member.train, steps=steps, patience=options.patience, eager=eager
            )
            for _ in threads.map(train, members):
                done += 1
                if progress is not None:
                    progress(start + (end - start) * done / (3 * len(members)))
        return members

    members = trained(range(options.members), 0.0, 0.8)
    kept = _successful(members)
    if len(kept) < FEWEST:
        failed = [k for k, member in enumerate(members) if member not in kept]
        kept = _successful([*kept, *trained(failed, 0.8, 1.0)])
    if progress is not None:
        progress(1.0)
    before, after = (
        np.concatenate([getattr(member, name) for member in kept])
        for name in ("before", "after")
    )
    weights = [member.best for member in kept]
    each = np.stack([m.correction(w) for m, w in zip(kept, weights, strict=True)])
    shifts = np.stack([member.shift for member in kept])
    if not convincing(before, after):
        weights = [Weights(w.factors, 0.0 * w.outputs, 0.0 * w.series) for w in weights]
        each, shifts, after = 0.0 * each, 0.0 * shifts, before
    correction = each.mean(axis=0)
    # Where no measurements teach anything the shift of their noise is no use, either.
    shift = _shift(rows, correction) if correction.any() else np.zeros(rows.shifts)
    at = rows.by_joint(correction, shift)
    effects = times(at.by_correction, each) + times(at.by_shift, shifts[:, None])
    return Network(
        region=region,
        shift=shift,
        shifts=shifts,
        factors=np.stack([w.factors for w in weights]),
        outputs=np.stack([w.outputs * unit[:, None] for w in weights]),
        series=np.stack([w.series * unit[:, None, None] for w in weights]),
        typical=np.sqrt((correction**2).mean(axis=0)),
        inflation=_inflation_factor(
            _jackknife(effects),
            float((after**2).mean() - np.mean([m.noise**2 for m in kept])),
        ),
        held_out=(root_mean_square(before), root_mean_square(after)),
    )


def _jackknife(each: Floats) -> Floats:
    """Standard deviation of the mean of members, (K, N, n) -> (N, n)."""
    return np.asarray(np.sqrt(len(each) - 1.0) * each.std(axis=0))


def _inflation_factor(deviation: Floats, excess: float) -> float:
    """Factor by which deviations, (N, d), explain a mean square beyond the noise.

    Members have errors in common, which their differences do not show.
    """
    explained = float((deviation**2).mean())
    if explained <= 0.0 or excess <= explained:
        return 1.0
    return float(min(np.sqrt(excess / explained), LARGEST_INFLATION))


def _successful(members: Sequence[Member]) -> list[Member]:
    """The members that did not end in a poor local minimum."""
    limit = FAILED * min(member.held_out for member in members)
    return [member for member in members if member.held_out <= limit]


def _shift(rows: TrainingRows, correction: Floats) -> Floats:
    """Shift of the geometry that fits best with a correction, shape (P,)."""
    shift = np.zeros(rows.shifts)
    for _ in range(2 if rows.shifts else 0):
        at = rows.by_joint(correction, shift)
        columns = at.by_shift.reshape(-1, rows.shifts)
        step = np.linalg.lstsq(columns, at.residual.reshape(-1), rcond=INDEPENDENT)[0]
        shift = shift - step
    return shift
