"""Sizes of errors, before and after."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from calib_pin.kinematics.spatial import Floats
from calib_pin.units import DISPLAY


@dataclass(frozen=True)
class Accuracy:
    """Size of the errors of one quantity over measurements, in the quantity's unit.

    Attributes:
        mean: Mean size.
        rms: Root-mean-square.
        p95: 95th percentile of the sizes.
        max: Largest size.
    """

    mean: float
    rms: float
    p95: float
    max: float

    @staticmethod
    def of(sizes: Floats) -> Accuracy:
        """Accuracy of the error sizes of measurements, shape (N,)."""
        return Accuracy(
            float(sizes.mean()),
            float(np.sqrt(np.mean(sizes**2))),
            # No interpolation: where a row cannot be predicted its size is infinite.
            float(np.quantile(sizes, 0.95, method="inverted_cdf")),
            float(sizes.max()),
        )


@dataclass(frozen=True)
class QuantityErrors:
    """Errors of one quantity before and after, on fitted and on held-out ones.

    *Before* is registration only: base, tool and instrument fitted to the training
    measurements, the robot nominal.

    Raises:
        ValueError: If the unit is none.
    """

    name: str
    unit: str
    before: Accuracy = field(metadata={"key": "training.before"})
    after: Accuracy = field(metadata={"key": "training.after"})
    validation_before: Accuracy | None = field(metadata={"key": "validation.before"})
    validation_after: Accuracy | None = field(metadata={"key": "validation.after"})

    def __post_init__(self) -> None:
        """Refuse a unit that is none."""
        if self.unit not in DISPLAY:
            raise ValueError(f"'{self.unit}' is no unit of '{self.name}'")
