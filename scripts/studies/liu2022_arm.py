"""The arm of Liu Qian et al. (2022) and its identification matrix."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

import calib_pin
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.identifiability import visible_directions
from calib_pin.estimation.nominal import analyze_structure
from calib_pin.estimation.problem import Problem
from calib_pin.io.collision import load_collisions
from calib_pin.io.measurements import read_configurations
from calib_pin.io.setup import read_true_errors
from calib_pin.kinematics.collision import Collisions
from calib_pin.kinematics.spatial import Floats, adjoint, from_quaternion, invert
from calib_pin.measurement_models.base import Linearization
from calib_pin.measurement_models.pose import Pose
from calib_pin.observations import Measurements
from calib_pin.planning.rows import IdentificationRows
from calib_pin.planning.workspace import Aims

PUBLISHED = {"hand-picked": "hand_picked.csv", "swarm": "swarm.csv"}
"""The published sets of configurations."""

POSES = 6
"""Configurations of a set."""


@dataclass(frozen=True)
class SpatialTwist(Pose):
    """The pose of the tool, compared as published: a twist in the base frame.

    `residual = -((T_y - T) T^-1)`, its position term and half its skew term, to first
    order a spatial twist, so that `J_pose = Ad(T)` where T_y = T.
    """

    def residual(self, T: Floats, instrument: Floats, data: Measurements) -> Floats:
        """Predicted against measured pose, shape (N, 6) [m, rad]."""
        measured = np.zeros_like(T)
        measured[:, :3, :3] = from_quaternion(data.values[:, 3:])
        measured[:, :3, 3] = data.values[:, :3]
        measured[:, 3, 3] = 1.0
        E = (T - measured) @ invert(T)
        turn = [
            E[:, 2, 1] - E[:, 1, 2],
            E[:, 0, 2] - E[:, 2, 0],
            E[:, 1, 0] - E[:, 0, 1],
        ]
        return np.column_stack([E[:, :3, 3], 0.5 * np.transpose(turn)])

    def linearize(
        self, T: Floats, instrument: Floats, data: Measurements
    ) -> Linearization:
        """`Ad(T)`; exact where the measured pose is the predicted one."""
        none = np.zeros((len(T), 6, 0))
        return Linearization(self.residual(T, instrument, data), adjoint(T), none)


@dataclass(frozen=True)
class Arm:
    """The published arm.

    Attributes:
        problem: The arm measured by poses, both frames known.
        preset: The published errors, shape (P,).
        truth: Errors with the same identifiable linear combinations, of all such the
            closest to nominal, shape (P,).
        combinations: Coefficients of these 34, shape (34, P).
        kept: Indices of the parameters whose columns are kept, one for each of them.
    """

    problem: Problem
    preset: Floats
    truth: Floats
    combinations: Floats
    kept: tuple[int, ...]

    @staticmethod
    @cache
    def load() -> Arm:
        """Read the files of `space7`."""
        chain = calib_pin.load_chain("space7")
        setup = calib_pin.read_setup(calib_pin.robot_file("space7", "setup.yaml"))
        problem = nominal_problem(chain, "pose", setup)
        errors = read_true_errors(calib_pin.robot_file("space7", "errors.yaml"))
        preset, scale = problem.parameters.vector(errors), problem.parameters.scales
        found, J = analyze_structure(
            problem, np.zeros_like(preset), np.random.default_rng(0)
        )
        visible = visible_directions(J, problem.parameters)
        rows = np.array([c.row(len(preset)) for c in found.combinations])
        return Arm(
            problem=problem,
            preset=preset,
            truth=scale * (visible @ (visible.T @ (preset / scale))),
            combinations=rows,
            # They are ordered by the column that stands for each of them.
            kept=tuple(c.terms[0][0] for c in found.combinations),
        )

    @property
    def rows(self) -> IdentificationRows:
        """Rows of the published matrix, six for each configuration."""
        basis = np.eye(len(self.preset))[:, self.kept]
        term = replace(self.problem.only, measurement=SpatialTwist())
        unit = dict.fromkeys(("position", "orientation"), 1.0)
        problem = replace(
            self.problem,
            terms={term.key: term},
            setup=replace(self.problem.setup, noise=unit),
        )
        return IdentificationRows(problem, basis, 0, Aims.of(problem, [term.key]))

    @property
    def bounds(self) -> Floats:
        """Joint limits of +-120 degrees, shape (7, 2)."""
        chain = self.problem.chains
        return np.column_stack([chain.lower, chain.upper])

    @staticmethod
    @cache
    def collisions() -> Collisions:
        """The collision model of the arm."""
        found = load_collisions(Arm.load().problem.chains)
        assert found is not None, "the URDF describes solids"
        return found

    def configurations(self, name: str) -> Floats:
        """A published set, shape (6, 7) [rad]."""
        file = calib_pin.robot_file("space7", PUBLISHED[name])
        return read_configurations(file, self.problem.chains)

    def poses(self, q: Floats, theta: Floats) -> Floats:
        """Tool poses of the arm with some errors, shape (N, 4, 4)."""
        term = self.problem.only
        return term.error.poses(q, term.values(theta)[0])

    def measure(
        self, q: Floats, theta: Floats, noise: Mapping[str, float], seed: int
    ) -> Measurements:
        """Measured poses, with noise or without."""
        setup = replace(self.problem.setup, noise=dict(noise))
        return calib_pin.simulate(
            replace(self.problem, setup=setup),
            theta,
            np.random.default_rng(seed),
            q=q,
            noise=None if noise else 0.0,
        ).only

    def relative_errors(self, theta: Floats) -> Floats:
        """Relative errors of the linear combinations whose true value is not zero."""
        true, found = self.combinations @ self.truth, self.combinations @ theta
        # 7m_y + tool m_z is preset to zero.
        stated = np.abs(true) > 1e-12
        return np.asarray(np.abs(found - true)[stated] / np.abs(true[stated]))


def singular_values(arm: Arm, q: Floats) -> Floats:
    """Singular values of the published matrix, descending, shape (34,)."""
    A = arm.rows.rows(q, np.zeros(len(q), int))
    return np.asarray(np.linalg.svd(A.reshape(-1, A.shape[2]), compute_uv=False))


def condition(arm: Arm, q: Floats) -> float:
    """Condition number of the published matrix."""
    s = singular_values(arm, q)
    return float(s[0] / s[-1])


def conditions(arm: Arm, sets: Floats) -> Floats:
    """Condition numbers of S sets, shape (S, 6, 7) -> (S,)."""
    q = sets.reshape(-1, sets.shape[2])
    rows = arm.rows.rows(q, np.zeros(len(q), int))
    s = np.linalg.svd(rows.reshape(len(sets), -1, rows.shape[2]), compute_uv=False)
    with np.errstate(divide="ignore"):
        return np.asarray(s[:, 0] / s[:, -1])
