"""Corrections that stand in for learned ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, Self

import numpy as np

from calib_pin.kinematics.spatial import Floats
from calib_pin.residual_models import TrainingRows


@dataclass(frozen=True)
class Everywhere:
    """A correction that counts in the whole workspace, whoever is left out."""

    size: float
    shift: Floats
    space: Literal["joint", "tip"] = "joint"

    @property
    def region(self) -> Self:
        return self

    def weight(self, q: Floats) -> Floats:
        return np.ones(len(q))

    def left_out(
        self, rows: TrainingRows, masks: list[Any], rng: np.random.Generator
    ) -> list[Self]:
        return [self for _ in masks]
