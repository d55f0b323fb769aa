"""Wu, Klimchik, Caro, Furet, Pashkevich: partial pose measurements, elastostatics.

A tracker measures reference points on the tool of a heavy six-joint robot, positions
only: no orientation is ever measured, and all residuals share one unit. The geometry
is an irreducible model of 18 parameters, base and tool have six each. Joints have
compliance, loaded by gravity and a known payload. Configurations are chosen for the
accuracy at stated test poses.

The published robot, its errors and its tables are not available: `heavy6` has lengths
near those of a KR 270, and all errors are drawn here, seed by seed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from calib_pin.estimation.fit import fit
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.formulation import make_problem
from calib_pin.estimation.solve import descend
from calib_pin.kinematics.spatial import Floats, invert, so3_log
from calib_pin.observations import Measurements, Observations
from calib_pin.parameterizations import NOTHING
from calib_pin.solvers import Status, alternation
from calib_pin.solvers.alternation import MEMORY
from calib_pin.validation.result import CalibrationResult
from studies.klimchik_arm import Settings, configurations, measure, truth
from studies.klimchik_design import Planned, at_test_poses
from studies.klimchik_model import LOADS, POINTS, calibrated, robot, setup_of
from studies.shared import summary

GEOMETRY, BOTH = "geometry", "geometry + compliance"
"""Models of the elastostatic part."""

MODELS: Mapping[str, tuple[str, ...]] = {
    "nominal": (),
    GEOMETRY: ("placement",),
    BOTH: ("placement", "compliance"),
}
"""Errors of the robot by name of the model."""

# --- alternating least squares -----------------------------------------------------


@dataclass(frozen=True)
class Alternation:
    """The joint solution beside alternating least squares (solver two-step).

    Attributes:
        difference: Largest difference of both solutions, in expected sizes of errors.
        cost: Relative difference of their costs.
        converged: Whether the alternation reports convergence.
        steps: Steps of the joint solution.
        mixed: Largest difference to the joint solution before the first round and after
            every round, until it is small or at the limit.
        plain: The same without acceleration.
    """

    difference: float
    cost: float
    converged: bool
    steps: int
    mixed: tuple[float, ...]
    plain: tuple[float, ...]


def alternating_least_squares(settings: Settings, rows: Measurements) -> Alternation:
    """Solve for base, points and robot jointly, and alternating between them."""
    joint, alternating = (
        fit(
            make_problem(robot(), rows, setup_of(solver=solver)),
            np.random.default_rng(0),
        )
        for solver in ("gauss-newton", "two-step")
    )
    return Alternation(
        difference=_apart(joint, alternating.theta),
        cost=abs(alternating.result.cost / joint.result.cost - 1.0),
        converged=alternating.result.status is Status.CONVERGED,
        steps=descend(joint.problem, joint.directions, joint.before).nit,
        mixed=_differences(settings, joint, MEMORY),
        plain=_differences(settings, joint, 0),
    )


def _differences(settings: Settings, joint: Fit, memory: int) -> tuple[float, ...]:
    """Largest difference to the joint solution before and after every round."""
    x = joint.before
    found = [_apart(joint, x)]
    while found[-1] > settings.near and len(found) <= settings.rounds:
        if memory:
            # From the start again: the acceleration mixes all rounds before.
            x = _alternated(joint, joint.before, len(found), memory)
        else:
            x = _alternated(joint, x, 1, memory)
        found.append(_apart(joint, x))
    return tuple(found)


def _alternated(joint: Fit, start: Floats, rounds: int, memory: int) -> Floats:
    """Parameters after rounds from a start: first frames and points, then the robot."""
    problem, directions = joint.problem, joint.directions
    scales = problem.parameters.scales[:, None]
    return alternation(
        problem.linearize,
        problem.cost,
        start,
        scales * directions.nuisances,
        scales * directions.robot,
        max_rounds=rounds,
        memory=memory,
    ).x


def _apart(joint: Fit, x: Floats) -> float:
    """Largest difference to the joint solution, in expected sizes of errors."""
    scales = joint.problem.parameters.scales
    return float(np.abs((x - joint.theta) / scales).max())


# --- elastostatics -----------------------------------------------------------------


@dataclass(frozen=True)
class Compliances:
    """Compliances of the joints, shape (6,) each [rad/Nm].

    Attributes:
        value: Estimates; NaN where unobservable.
        sigma: Their standard deviations.
        unloaded: Standard deviations from the measurements without load.
    """

    value: Floats
    sigma: Floats
    unloaded: Floats


@dataclass(frozen=True)
class Elastostatics:
    """A robot with joint compliance, measured with and without a payload.

    Attributes:
        errors: Distances of the reference points to the true ones at the validation
            configurations by model and load, shape (3 K,) each [m].
        predicted: Root mean square that noise leaves of them, by load [m].
        rank: Rank of the geometry with the compliances.
        compliances: The compliances.
    """

    errors: Mapping[str, Mapping[str, Floats]]
    predicted: Mapping[str, float]
    rank: int
    compliances: Compliances

    def mean(self, model: str, load: str) -> float:
        """Mean error at the validation configurations [m]."""
        return float(self.errors[model][load].mean())

    def numbers(self) -> dict[str, object]:
        """The numbers that are written."""
        return {
            "rank": self.rank,
            "errors": {
                model: {load: summary(x, "m") for load, x in by_load.items()}
                for model, by_load in self.errors.items()
            },
            "predicted_rms_m": self.predicted,
            "compliance_rad_per_Nm": self.compliances,
        }


def elastostatics(settings: Settings, rng: np.random.Generator) -> Elastostatics:
    """Measure a robot with joint compliance; fit it with and without compliances."""
    load = settings.load
    problem, theta = truth(rng, settings.length, settings.angle, load)
    rows = measure(
        problem,
        theta,
        configurations(settings.count, rng),
        rng,
        loads=tuple(LOADS),
        noise=settings.noise,
        repeats=settings.repeats,
    )
    q = configurations(settings.unseen, rng)
    unseen = {name: measure(problem, theta, q, rng, loads=(name,)) for name in LOADS}
    fitted = {
        model: calibrated(
            rows, setup_of(names, load=load if "compliance" in names else None)
        )
        for model, names in MODELS.items()
    }
    alone = rows.rows(np.array([name == NOTHING for name in rows.payload]))
    without = calibrated(alone, setup_of(MODELS[BOTH], load=load))
    return Elastostatics(
        errors={
            model: {name: _distances(found, there) for name, there in unseen.items()}
            for model, found in fitted.items()
        },
        predicted={name: _noise(fitted[BOTH], there) for name, there in unseen.items()},
        rank=fitted[BOTH].identifiability.rank,
        compliances=Compliances(
            *_compliances(fitted[BOTH]), unloaded=_compliances(without)[1]
        ),
    )


def _compliances(found: CalibrationResult) -> tuple[Floats, Floats]:
    """Compliances and standard deviations, NaN where unobservable."""
    of = {p.name: p for p in found.parameters}
    known = [of[f"{joint}.compliance.k"] for joint in robot().joints]
    value = [np.nan if p.sigma is None else p.value for p in known]
    sigma = [np.nan if p.sigma is None else p.sigma for p in known]
    return np.array(value), np.array(sigma)


def _distances(found: CalibrationResult, rows: Measurements) -> Floats:
    """Distances of predicted points to exact ones, shape (N,) [m]."""
    errors = found.model.problem(Observations.of(rows)).errors(found.model.theta)
    return np.asarray(np.linalg.norm(errors.reshape(-1, 3), axis=1))


def _noise(found: CalibrationResult, rows: Measurements) -> float:
    """Root mean square of these that the covariance of the fit predicts [m]."""
    # The covariance is that of deviations from the registered references.
    problem = found.reference.problem(Observations.of(rows))
    _, J = problem.linearize_rows(np.array([p.value for p in found.parameters]))
    J = J * problem.sigma.reshape(-1, 1)
    variances = np.einsum("ip,pq,iq->i", J, found.covariance, J, optimize=True)
    return float(np.sqrt(variances.sum() / len(rows)))


# --- number of reference points ----------------------------------------------------


@dataclass(frozen=True)
class Accuracy:
    """Errors of the tool frame at validation configurations, root mean squares.

    Attributes:
        rank: Rank of the fit.
        position: Error of its origin [m].
        orientation: Error of its orientation [rad].
        robot: Both apart from a constant motion of the tool [m, rad].
        predicted: Position and orientation that noise leaves; NaN where a part of the
            tool frame is unobservable.
        predicted_robot: The same apart from a constant motion of the tool.
    """

    rank: int
    position: float
    orientation: float
    robot: tuple[float, float]
    predicted: tuple[float, float]
    predicted_robot: tuple[float, float]


def accuracies(settings: Settings, rng: np.random.Generator) -> dict[int, Accuracy]:
    """Calibrate the same stiff robot with one, two and three known points."""
    problem, theta = truth(rng, settings.length, settings.angle)
    q = configurations(settings.count, rng)
    rows = measure(
        problem, theta, q, rng, noise=settings.noise, repeats=settings.repeats
    )
    unseen = configurations(settings.unseen, rng)
    true = problem.only.error.poses(unseen, problem.only.values(theta)[0])
    result = {}
    for points in range(1, len(POINTS) + 1):
        names = list(POINTS)[:points]
        seen = rows.rows(np.array([target in names for target in rows.target]))
        found = calibrated(seen, setup_of(points=points, known=True))
        result[points] = _accuracy(found, unseen, true)
    return result


def _accuracy(found: CalibrationResult, q: Floats, true: Floats) -> Accuracy:
    """Judge a calibration at configurations (K, 6) with true poses (K, 4, 4)."""
    error = found.reference.only.error
    count = len(error.screws)
    _, J = error.jacobian(q, np.array([p.value for p in found.parameters[:count]]))
    covariance = found.covariance[:count, :count]

    def predicted(J: Floats) -> tuple[float, float]:
        variances = np.einsum("nap,pq,naq->na", J, covariance, J, optimize=True)
        return _rms(np.sqrt(variances))

    errors = _errors(found.model.of().poses(q), true)
    whole = found.identifiability.rank == found.identifiability.parameters
    return Accuracy(
        found.identifiability.rank,
        *_rms(errors),
        # A constant motion of the tool is a constant body twist of it.
        robot=_rms(errors - errors.mean(axis=0)),
        predicted=predicted(J) if whole else (np.nan, np.nan),
        predicted_robot=predicted(J - J.mean(axis=0)),
    )


def _errors(T: Floats, true: Floats) -> Floats:
    """Errors of poses in the true tool frame, shape (K, 6) [m, rad]."""
    motion = invert(true) @ T
    return np.column_stack([motion[:, :3, 3], so3_log(motion[:, :3, :3])])


def _rms(errors: Floats) -> tuple[float, float]:
    """Root mean squares of position and orientation, of errors (K, 6)."""
    squares = np.mean(errors**2, axis=0)
    return float(np.sqrt(squares[:3].sum())), float(np.sqrt(squares[3:].sum()))


# --- all of it ---------------------------------------------------------------------


@dataclass(frozen=True)
class Seed:
    """Results of one seed.

    Attributes:
        alternation: Joint solution and alternating least squares.
        elastostatics: With compliances and a payload.
        accuracies: By number of reference points.
        planned: At the test poses, by the choice of configurations.
    """

    alternation: Alternation
    elastostatics: Elastostatics
    accuracies: Mapping[int, Accuracy]
    planned: Mapping[str, Planned]


def study(settings: Settings, planned: Floats, seed: int) -> Seed:
    """Draw robots and calibrate them in every way.

    Args:
        settings: The settings of the simulation.
        planned: Configurations for the test poses, shape (N, 6).
        seed: Seed of the robots, the random configurations and the noise.
    """
    # One generator for each part, so that none depends on the others.
    of = [np.random.default_rng([seed, part]) for part in range(4)]
    problem, theta = truth(of[0], settings.length, settings.angle)
    rows = measure(
        problem,
        theta,
        configurations(settings.count, of[0]),
        of[0],
        noise=settings.noise,
        repeats=settings.repeats,
    )
    return Seed(
        alternation=alternating_least_squares(settings, rows),
        elastostatics=elastostatics(settings, of[1]),
        accuracies=accuracies(settings, of[2]),
        planned=at_test_poses(settings, planned, of[3]),
    )
