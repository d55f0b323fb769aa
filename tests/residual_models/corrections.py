"""Corrections that stand in for learned ones."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal, Self

import numpy as np

from calib_pin.kinematics.spatial import Floats
from calib_pin.residual_models import TrainingRows


@dataclass(frozen=True)
class Everywhere:
    """A correction that counts in the whole workspace, whoever is left out."""

    size: float = 0.1
    shift: Floats = field(default_factory=lambda: np.zeros(1))
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


@dataclass(frozen=True)
class Wave(Everywhere):
    """A smooth function of all joint positions."""

    def __call__(self, q: Floats) -> Floats:
        count = q.shape[1] if self.space == "joint" else 6
        mixed = np.sin(np.arange(1.0, 1.0 + q.shape[1] * count)).reshape(-1, count)
        return np.asarray(self.size * np.sin(q @ mixed + np.arange(count)))
