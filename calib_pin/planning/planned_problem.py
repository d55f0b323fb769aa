"""The problem that a plan is made for, and what of it can be identified."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from calib_pin.errors import InputError, OptionError
from calib_pin.estimation.directions import (
    WEAK,
    Directions,
    visible_directions,
    visible_nuisances,
)
from calib_pin.estimation.formulation import make_problem, nominal_problem
from calib_pin.estimation.identifiability import Structure
from calib_pin.estimation.nominal import register, structure_at
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import MEASUREMENT_MODELS, declared, tracked
from calib_pin.measurement_models.mixed import assumed_sigma
from calib_pin.measurement_models.plane_distance import PlaneDistance
from calib_pin.observations import PLUS, Measurements
from calib_pin.parameters import ParameterSet
from calib_pin.planning.information import Information
from calib_pin.planning.rows import IdentificationRows
from calib_pin.planning.workspace import Candidates
from calib_pin.setup import Setup
from calib_pin.validation.assessment import registration_reason

STRUCTURE = 300
"""Candidates that show what can be identified at all."""

ASSUMED_TOOL = pin.SE3(np.eye(3), np.array([0.05, 0.03, 0.02]))
"""Where a target sits in the tip that nobody has stated: beside the last axis [m]."""


def require_plannable(model: str) -> None:
    """Refuse models that do not measure one configuration at any pose.

    Raises:
        OptionError: If it is such a model.
    """
    parts = model.split(PLUS)
    if len(parts) > 1 or not declared(model).plannable:
        raise OptionError(
            "configurations are planned for one instrument that measures each of them "
            "by itself and without contact",
            value=model,
            allowed=", ".join(m for m in MEASUREMENT_MODELS if declared(m).plannable),
        )


def planned_problem(
    chain: Chain, model: str, setup: Setup, measured: Measurements | None
) -> Problem:
    """The problem about the frames of the setup, or those that rows show."""
    if measured is not None:
        problem = make_problem(chain, measured, setup)
        found, result = register(problem, np.zeros(len(problem.parameters)))
        if reason := registration_reason(found, result):
            raise InputError(f"the measurements to add to are too few: {reason}")
        if isinstance(found.measurement, PlaneDistance):
            # Rows may reach farther than the window that the setup states.
            window = replace(found.measurement, reach=setup.ranger.range[1])
            found = replace(found, measurement=window)
        return found
    problem = nominal_problem(chain, model, setup)
    if len(setup.payloads) > 1:
        heaviest = max(setup.payloads, key=lambda name: setup.payloads[name].mass)
        problem = replace(problem, error=problem.error.carrying(heaviest))
    if assumes_tool(problem):
        error = problem.error
        problem = replace(problem, error=error.with_frames(error.base, ASSUMED_TOOL))
    return problem


def assumes_tool(problem: Problem) -> bool:
    """Whether a point on the tool must be assumed where nobody has stated it.

    At the tip itself, on the last axis, it would tell less than a real target does.
    """
    tool, measurement = problem.setup.tool_frame, problem.measurement
    unknown = tool.xyz is None and tool.estimate is not False
    unknown &= measurement.sees_tool and not measurement.targets
    return unknown and tracked(measurement.name) == {"point"}


def identification(
    problem: Problem, candidates: Candidates, measured: Measurements | None = None
) -> tuple[Structure, IdentificationRows, Floats]:
    """The structure, its rows, and the information that is there already.

    Args:
        problem: The problem at nominal geometry.
        candidates: Measurements that may be made; only these are informative.
        measured: Rows that are there already.

    Returns:
        The structure, the rows of configurations in the identifiable subspace, and the
        information of measured rows and priors in the same columns, shape (m, m).
    """
    zero = np.zeros(len(problem.parameters))
    q, target = candidates.q[:STRUCTURE], candidates.target[:STRUCTURE]
    if measured is not None:
        few = measured.sample(STRUCTURE)
        q, target = np.concatenate([q, few.q]), target + few.target
    structure, J = structure_at(problem, zero, q, target)
    nuisances = visible_nuisances(J, problem.parameters)
    robot = visible_directions(J, problem.parameters)
    if robot.shape[1] == 0:
        raise OptionError(
            "no parameter of the robot can be estimated: all of them are fixed or "
            "unobservable"
        )
    basis = problem.parameters.scales[:, None] * np.column_stack([nuisances, robot])
    rows = IdentificationRows(
        problem=problem,
        basis=basis,
        nuisances=nuisances.shape[1],
        measurement=problem.measurement,
        sigma=assumed_sigma(problem.measurement, problem.setup.noise),
    )
    if measured is None:
        # The problem's own rows only name the targets; priors count.
        U = J[len(q) * problem.components :] @ basis
    else:
        _, derivative = problem.linearize_rows(zero)
        U = derivative @ basis
    return structure, rows, U.T @ U


@dataclass(frozen=True)
class TipTests:
    """The error of the tip at test poses, in the columns of an information matrix.

    Attributes:
        position: `J_0' J_0` of its position, mean of the test poses, (m, m) [m^2].
        orientation: The same of its rotation vector, shape (m, m) [rad^2].
    """

    position: Floats
    orientation: Floats

    @staticmethod
    def at(rows: IdentificationRows, q: Floats) -> TipTests:
        """Tests at configurations.

        Args:
            rows: Rows that tell the pose of the tool, with unit sigma.
            q: Test configurations, shape (N, n) [rad, m].
        """
        J = rows.rows(q, ("",) * len(q))
        position, orientation = (
            np.einsum("ndi,ndj->ij", part, part, optimize=True) / len(q)
            for part in (J[:, :3], J[:, 3:])
        )
        return TipTests(position, orientation)


@dataclass(frozen=True)
class Predicted:
    """The expected result of a fit of planned measurements; satisfies `Estimated`.

    Attributes:
        theta: Parameter values, all zero, shape (P,).
        covariance: Of the parameters, shape (P, P).
        directions: The directions that will be estimated, and those too weak for it.
        position: Root-mean-square error of the tip over the test poses that noise
            leaves [m].
        orientation: The same of its orientation [rad].
    """

    theta: Floats
    covariance: Floats
    directions: Directions
    position: float
    orientation: float


def predict(
    found: Information, basis: Floats, tests: TipTests, of: ParameterSet
) -> Predicted:
    """Covariance of a fit; what it will not be able to tell stays at nominal there.

    A fit also holds all errors by the size that its measurements show (`shrinkage`),
    which nobody knows before: of a variance v it leaves `v / (1 + v / size^2)`.

    Args:
        found: The information.
        basis: Its columns in parameters, shape (P, m).
        tests: Where the tip's error is predicted.
        of: The parameters.
    """
    f = found.nuisances
    _, s, right = found.svd
    strong = s * WEAK > 1.0
    kept = np.eye(len(found.factor))[:, : f + int(strong.sum())]
    kept[f:, f:] = right[:, strong]
    R = found.factor @ kept
    covariance = kept @ np.linalg.inv(R.T @ R) @ kept.T
    scaled = basis / of.scales[:, None]
    robot = scaled[:, f:] @ right
    return Predicted(
        theta=np.zeros(len(of)),
        covariance=basis @ covariance @ basis.T,
        directions=Directions(scaled[:, :f], robot[:, strong], robot[:, ~strong]),
        position=float(np.sqrt(np.sum(tests.position * covariance))),
        orientation=float(np.sqrt(np.sum(tests.orientation * covariance))),
    )
