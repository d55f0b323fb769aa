"""The problem that a plan is made for, and what of it can be identified."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from calib_pin.errors import InputError, OptionError
from calib_pin.estimation.formulation import (
    make_problem,
    nominal_problem,
    require_known,
)
from calib_pin.estimation.identifiability import (
    WEAK,
    Directions,
    Structure,
    visible_directions,
    visible_nuisances,
)
from calib_pin.estimation.nominal import register, structure_at, unmeasured
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.chains import Robots
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import declared
from calib_pin.measurement_models.plane_distance import PlaneDistance
from calib_pin.observations import BlockKey, Conditions, Measurements, Observations
from calib_pin.parameters import ParameterSet
from calib_pin.planning.criteria import Information
from calib_pin.planning.rows import IdentificationRows
from calib_pin.planning.suggestions import ASSUMED_TOOL
from calib_pin.planning.workspace import Aims, Candidates, sides_tried
from calib_pin.setup import Setup
from calib_pin.validation.model_errors import registration_reason
from calib_pin.validation.result import RobotError
from calib_pin.validation.tool_accuracy import SAMPLES


def planned_keys(
    measured: str | Sequence[BlockKey], data: Observations | None
) -> tuple[BlockKey, ...]:
    """The blocks that are planned.

    Args:
        measured: Name of a measurement model, or the blocks themselves.
        data: Measurements that are there already; they name the blocks of a model.

    Raises:
        OptionError: If there are none, or nothing shows yet where an instrument is.
    """
    keys = (BlockKey(measured),) if isinstance(measured, str) else tuple(measured)
    known = keys if data is None else data.keys
    if isinstance(measured, str):
        keys = tuple(key for key in known if key.model == measured)
    missing = [key for key in keys if key not in known] if keys else [measured]
    if missing:
        raise OptionError(
            "there are no measurements of this kind to add to",
            value=str(missing[0]),
            allowed="; ".join(map(str, known)) or None,
        )
    return keys


def planned_problem(
    chains: Robots,
    keys: Sequence[BlockKey],
    setup: Setup,
    measured: Observations | None,
) -> Problem:
    """The problem about the frames of the setup, or those that measurements show."""
    if measured is not None:
        problem = make_problem(chains, measured, setup)
        registered, result = register(problem, np.zeros(len(problem.parameters)))
        if reason := registration_reason(registered, result):
            reason = f"the measurements to add to are too few: {reason}"
            raise InputError(reason, file=measured.files[0] or None)
        # Rows may reach farther than the window that the setup states.
        reach = setup.ranger.range[1]
        return replace(
            registered,
            terms={
                key: replace(term, measurement=replace(term.measurement, reach=reach))
                if isinstance(term.measurement, PlaneDistance)
                else term
                for key, term in registered.terms.items()
            },
        )
    problem = nominal_problem(chains, keys, setup)
    require_known(problem.terms.values(), setup)
    terms, assumed = {}, assumed_tools(problem)
    for key, term in problem.terms.items():
        error = term.error.carrying(setup.heaviest)
        if term.frames.tool in assumed:
            error = error.with_frames(error.base, ASSUMED_TOOL * term.frames.offset)
        terms[key] = replace(term, error=error)
    return replace(problem, terms=terms)


def assumed_tools(problem: Problem) -> set[str]:
    """The tools with a point that must be assumed since nobody has stated it.

    At the tip itself, on the last axis, it would tell less than a real target does.
    """
    terms = [term for term in problem.terms.values() if term.measurement.sees_tool]
    known = {
        term.frames.tool
        for term in terms
        if term.frames.end.xyz is not None
        or term.frames.end.estimate is False
        or term.measurement.targets
        or declared(term.key.model).tracks != "point"
    }
    return {term.frames.tool for term in terms} - known


def identification(
    problem: Problem,
    aims: Aims,
    candidates: Candidates,
    measured: Observations | None = None,
) -> tuple[Structure, IdentificationRows, Floats]:
    """The structure, its rows, and the information that is there already.

    Args:
        problem: The problem at nominal geometry.
        aims: What can be measured at a configuration.
        candidates: Configurations where that may be done; only these are informative.
        measured: Measurements that are there already.

    Returns:
        The structure, the rows of configurations in the identifiable subspace, and the
        information of measured rows and priors in the same columns, shape (m, m).
    """
    zero = np.zeros(len(problem.parameters))
    first = slice(SAMPLES)
    q, aim, at = candidates.q[first], candidates.aim[first], list[Measurements]()
    for look in aims.looks:  # With all targets that each measures in a configuration.
        rows, target = look.measured(q, aim)
        at.append(unmeasured(problem, look.term.key, q[rows], target))
    if measured is not None:
        at += measured.sample(SAMPLES).blocks
    structure, J = structure_at(problem, zero, at)
    nuisances = visible_nuisances(J, problem.parameters)
    robot = visible_directions(J, problem.parameters)
    if robot.shape[1] == 0:
        raise OptionError(
            "no parameter of the robot can be estimated: all of them are fixed or "
            "unobservable",
            file=problem.setup.file or problem.chains.robot.file,
        )
    basis = problem.parameters.scales[:, None] * np.column_stack([nuisances, robot])
    rows_of = IdentificationRows(problem, basis, nuisances.shape[1], aims)
    # Without measurements the problem's own rows only name the targets; priors count.
    known = problem.further.jacobian(zero)
    if measured is not None:
        _, known = problem.linearize_rows(zero)
    U = known @ basis
    return structure, rows_of, U.T @ U


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
    def of(
        rows: IdentificationRows, spread: Candidates, tests: Floats | None = None
    ) -> TipTests:
        """Tests of the tips of the chains of candidates, the mean of these.

        Args:
            rows: The rows, whose columns are those of the tests.
            spread: The candidates.
            tests: Test configurations, shape (N, n) [rad, m]; default the first
                candidates of each chain.
        """
        moments = []
        terms = {key.chain: term for key, term in rows.problem.terms.items()}
        chain_of = np.array([aim.key.chain for aim in rows.aims.each])[spread.aim]
        for chain in dict.fromkeys(chain_of.tolist()):
            q = spread.q[chain_of == chain][:SAMPLES] if tests is None else tests
            term = terms[chain]
            error, local = term.error, q[:, term.columns]
            sides = sides_tried(rows.problem)[:, term.columns]
            held = Conditions(direction=np.resize(sides, local.shape))
            zero = np.zeros(len(error.screws))
            poses = error.linearize(local, zero, error.basis(local, held))
            J = poses.derivative(np.tile(np.eye(6), (len(q), 1, 1)))
            J = (J @ rows.basis[term.of_error]).reshape(len(q), 2, 3, -1)
            moments.append(np.einsum("npdi,npdj->pij", J, J, optimize=True) / len(q))
        return TipTests(*np.mean(moments, axis=0))


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
        robot_errors: The expected estimates for people, each independent error once.
    """

    theta: Floats = field(metadata={"key": None})
    covariance: Floats = field(metadata={"key": None})
    directions: Directions = field(metadata={"key": None})
    position: float
    orientation: float
    robot_errors: tuple[RobotError, ...] = ()

    @property
    def rank(self) -> int:
        """Number of identifiable directions, frames included."""
        return int(self.directions.count + self.directions.weak.shape[1])


def predict(
    information: Information, basis: Floats, tests: TipTests, of: ParameterSet
) -> Predicted:
    """Covariance of a fit; what it will not be able to tell stays at nominal there.

    A fit also holds all errors by the size that its measurements show (`fitted`),
    which nobody knows before: of a variance v it leaves `v / (1 + v / size^2)`.

    Args:
        information: The information.
        basis: Its columns in parameters, shape (P, m).
        tests: Where the tip's error is predicted.
        of: The parameters.
    """
    f = information.nuisances
    s, right = information.singular_values, information.right_vectors
    strong = s * WEAK > 1.0
    kept = np.eye(len(information.factor))[:, : f + int(strong.sum())]
    kept[f:, f:] = right[:, strong]
    R = information.factor @ kept
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
