"""A neural network that corrects the joint positions inside the forward kinematics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from calib_pin.compiled.threads import Threads, serial_blas
from calib_pin.kinematics.spatial import Floats
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
from calib_pin.residual_models.training import Member
from calib_pin.residual_models.units import Inputs, Weights, combined, series

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
    """The average of several networks, see `training`.

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
        kept = [rows.some(np.flatnonzero(~mask)) for mask in masks]
        return [fit_network(some, rng, options=few) for some in kept]

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
        rows = rows.some(np.sort(rng.permutation(len(rows.q))[: options.largest]))
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
    kept = [member for member in members if member.held_out <= limit]
    before = np.concatenate([member.before for member in kept])
    after = np.concatenate([member.after for member in kept])
    weights = [member.best for member in kept]
    correction = np.mean([m.correction(m.best) for m in kept], axis=0)
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
    shift = np.zeros(rows.shifts)
    for _ in range(2 if rows.shifts else 0):
        at = rows.by_joint(correction, shift)
        columns = at.by_shift.reshape(-1, rows.shifts)
        step = np.linalg.lstsq(columns, at.residual.reshape(-1), rcond=INDEPENDENT)[0]
        shift = shift - step
    return shift
