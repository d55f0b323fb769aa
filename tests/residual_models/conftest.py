"""Simulated robots with errors that geometry cannot explain."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from calib_pin.io.urdf import load_chain
from calib_pin.kinematics.spatial import Floats, skew, so3_exp
from calib_pin.parameterizations.error_model import ErrorModel
from calib_pin.residual_models.base import (
    Linearized,
    ResidualModel,
    Shifts,
    TrainingRows,
)

SIGMA = 1e-4


def moved(T: Floats, xi: Floats) -> Floats:
    """T Exp(xi) to second order of small twists, which is far below the noise."""
    step = np.tile(np.eye(4), (len(xi), 1, 1))
    step[:, :3, :3] = so3_exp(xi[:, 3:])
    half = np.eye(3) + 0.5 * skew(xi[:, 3:])
    step[:, :3, 3] = (half @ xi[:, :3, None])[:, :, 0]
    return T @ step


@dataclass(frozen=True)
class Study:
    """An arm whose tool position is measured, and what it really does.

    Attributes:
        error: Its error model.
        columns: Parameters per shift, shape (P, k).
        theta: True parameters; the rows hold them at zero.
        dq: True corrections of the joints.
        xi: True twist of the tip.
    """

    error: ErrorModel
    columns: Floats
    theta: Floats
    dq: Callable[[Floats], Floats]
    xi: Callable[[Floats], Floats]

    def truth(self, q: Floats) -> Floats:
        """True tool positions, shape (N, 3)."""
        T = self.error.poses(q + self.dq(q), self.theta)
        return moved(T, self.xi(q))[:, :3, 3]

    def rows(self, count: int, noise: float, seed: int) -> TrainingRows:
        """Measured rows at random configurations."""
        rng = np.random.default_rng(seed)
        q = self.error.chain.random_configurations(count, rng)
        measured = self.truth(q) + noise * rng.standard_normal((count, 3))
        return self.of(q, measured, np.arange(count))

    def of(
        self, q: Floats, measured: Floats, groups: NDArray[np.int64]
    ) -> TrainingRows:
        """Rows of measured positions, shape (N, 3)."""
        count = len(q)

        def linearized(dq: Floats, xi: Floats, shift: Floats, tip: bool) -> Linearized:
            linear = self.error.linearize(q + dq, self.columns @ shift)
            T = moved(linear.T, xi)
            J_pose = np.concatenate([T[:, :3, :3], np.zeros((count, 3, 3))], axis=2)
            J_pose /= SIGMA
            return Linearized(
                residual=(T[:, :3, 3] - measured) / SIGMA,
                by_correction=J_pose if tip else J_pose @ linear.joint_twists(),
                by_shift=linear.derivative(J_pose) @ self.columns,
            )

        return TrainingRows(
            q=q,
            groups=groups,
            revolute=np.asarray(self.error.chain.revolute, bool),
            by_joint=lambda dq, z: linearized(dq, np.zeros((count, 6)), z, False),
            by_tip=lambda xi, z: linearized(np.zeros(q.shape), xi, z, True),
            values=3,
            subset=lambda index: self.of(q[index], measured[index], groups[index]),
            shift=Shifts(np.zeros(self.columns.shape[1])),
        )

    def errors(self, model: ResidualModel | None, count: int = 300) -> Floats:
        """Position errors at configurations that no rows have, shape (N,) [m]."""
        q = self.error.chain.random_configurations(count, np.random.default_rng(99))
        dq, xi, theta = np.zeros(q.shape), np.zeros((count, 6)), np.zeros(0)
        if model is not None:
            dq, xi = (model(q), xi) if model.space == "joint" else (dq, model(q))
            theta = model.shift
        theta = self.columns @ theta if len(theta) else 0.0 * self.theta
        T = moved(self.error.poses(q + dq, theta), xi)
        return np.linalg.norm(T[:, :3, 3] - self.truth(q), axis=1)


@pytest.fixture(scope="session")
def study() -> Callable[..., Study]:
    """An arm: `study(sag=1e-3, gear=2e-4, flex=0.0, shifts=0)`.

    A sag and a gear error of the joints [rad], a flexible tip [m], and errors of
    some parameters, which the rows do not know of, in directions of a shift.
    """
    chain = load_chain("space6")
    error = ErrorModel.create(
        chain, ["placement"], estimate_base=False, estimate_tool=False
    )

    def make(
        sag: float = 1e-3, gear: float = 2e-4, flex: float = 0.0, shifts: int = 0
    ) -> Study:
        free = np.flatnonzero(error.parameters.free)[6 : 6 + shifts]
        columns = 1e-3 * np.eye(len(error.parameters))[:, free]
        phase = np.arange(len(chain.joints))

        def dq(q: Floats) -> Floats:
            near = np.roll(q, -1, axis=1)
            return sag * np.sin(q + phase) * np.cos(near) + gear * np.sin(5 * q + phase)

        def xi(q: Floats) -> Floats:
            wave = np.sin(q[:, :3] + phase[:3]) * np.cos(q[:, 1:4])
            return flex * np.concatenate([wave, np.zeros((len(q), 3))], axis=1)

        theta = columns.sum(axis=1)
        return Study(error, columns, theta, dq, xi)

    return make
