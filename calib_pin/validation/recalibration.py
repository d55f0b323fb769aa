"""A calibration that goes on from an older one.

The older estimate is the mean of a joint prior of the robot's errors, with the
covariance that it had, what the robot drifts between two calibrations, and sudden
changes where the new measurements show any. Frames and instrument are free: a tracker
that is set up anew stands elsewhere, and a tool that is known has to be stated.

The new measurements are compared with what the older calibration predicts, before
anything is fitted to them. How far robots drift is told by these innovations, week by
week better; noise and drift of a size that was never seen are something else, and so
is a single joint that accounts for nearly all.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import OptionError, enumerated
from calib_pin.estimation.directions import nuisance_basis
from calib_pin.estimation.evidence import TRUSTED, Finding
from calib_pin.estimation.formulation import make_problem
from calib_pin.estimation.problem import Problem, error_table
from calib_pin.estimation.registration import registered
from calib_pin.estimation.robot_rows import RobotRows, robot_rows
from calib_pin.estimation.solve import least_squares
from calib_pin.estimation.statistics.innovations import (
    Cause,
    Explanation,
    Sparse,
    explained,
)
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.robot_types import robot_type
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations
from calib_pin.setup import JointPrior, Setup
from calib_pin.setup.population import ExpectedParameter
from calib_pin.validation.accuracy import Accuracy
from calib_pin.validation.findings.older_calibration import older_calibration
from calib_pin.validation.joint_changes import Change, changes, drifts
from calib_pin.validation.result import CalibrationResult
from calib_pin.validation.summaries import (
    DriftSize,
    Jump,
    NoiseSize,
    Recalibration,
    RecalibrationStep,
)

EXPECTED = (DriftSize("geometry", 1e-5, 4.0), DriftSize("joint offsets", 3e-5, 4.0))
"""Drift between two calibrations that is expected where nothing is known yet."""

REMEMBERED = 50.0
"""Errors that a drift is worth at most: in a year it may be another one."""

BEYOND = 4.0
"""Drift, in expected sizes, from which it is none: the robot has been changed."""

SURE = 50.0
"""Evidence for a sudden change by that for none from which it is told. Chance brings as
much in at most one of 50 calibrations; of simulated ones it was one in a thousand."""

CHANCES = {"offset": 1.0, "placement": 0.05, "robot": 0.05}
"""How likely kinds of sudden changes are beside each other: a joint that was hit slips
on its axis first of all."""

JUMPS = 4
"""Most causes beside drift and noise that are told, sudden changes and wrong
measurements."""

SIZES = np.geomspace(0.03, 10.0, 16)
"""Sizes of sudden changes, in expected sizes of errors: from 30 um and 90 urad on."""

WRONG = np.geomspace(3.0, 1e4, 16)
"""Errors of measurements that are wrong, in standard deviations."""

SOME = 300
"""Measurements that are compared; more do not make it clearer."""

NOISE = 300.0
"""Values that known noise is worth at most."""

NOISIER = np.geomspace(1.0, 30.0, 8)
"""Further noise of another instrument, by what is known of the older one."""

FLOOR = 1e-4
"""Least standard deviation of an error, in its expected size: far below any drift."""


@dataclass(frozen=True)
class Started:
    """The beginning of a calibration by an older one.

    Attributes:
        setup: The setup with the older calibration as prior.
        recalibration: How the older one has predicted the new measurements.
        findings: What that says of the robot.
    """

    setup: Setup
    recalibration: Recalibration
    findings: tuple[Finding, ...]


@serial_blas
def started(
    chains: Chains,
    data: Observations,
    setup: Setup,
    start: CalibrationResult,
    process_noise: float | None = None,
) -> Started:
    """Begin a calibration with an older one.

    Args:
        chains: The nominal chains.
        data: The new measurements to fit.
        setup: Estimated and known quantities.
        start: The older calibration.
        process_noise: Standard deviation of the drift of each error of the geometry
            since then [m, rad], of other errors by their expected sizes; default as the
            measurements show it.

    Raises:
        OptionError: If the older calibration is of another robot or of other
            parameters, or must not be trusted.
    """
    _require_usable(chains, setup, start)
    noise = _noise(start)
    known = {one.quantity: one.sigma for one in noise}
    stated = replace(setup, prior={}, noise={**known, **setup.noise})
    problem = make_problem(chains, data.sample(SOME), stated)
    older = _older(problem, start, known)
    there, theta = _registered(problem, older)
    compared = _Comparison.of(there, theta, older, noise)
    expected = _expected(start, process_noise)
    first = compared.explanation(expected)
    found, sparse = explained(first, compared.sparse, SURE, JUMPS)
    drifted = _updated(expected, found)
    jumps = [cause for cause in sparse if cause.name in compared.sudden]
    step = RecalibrationStep(
        start=start.provenance.file,
        created=start.provenance.created,
        measurements=len(data),
        chi2=first.square,
        dof=len(first.values),
        noise=noise,
        drifts=drifted,
        jumps=tuple(compared.jump(found, cause) for cause in jumps),
    )
    before = () if start.recalibration is None else start.recalibration.steps
    table = error_table(there, theta)
    recalibration = Recalibration(
        tuple(
            (quantity.name, quantity.unit, Accuracy.of(sizes))
            for quantity in there.layout.quantities
            if len(sizes := quantity.errors(table))
        ),
        (*before, step),
    )
    return Started(
        replace(setup, prior=compared.prior(drifted, jumps)),
        recalibration,
        tuple(older_calibration(recalibration)),
    )


def _require_usable(chains: Chains, setup: Setup, start: CalibrationResult) -> None:
    """Refuse an older calibration that says nothing of this robot.

    Raises:
        OptionError: If it is such.
    """
    file, older = start.provenance.file or None, start.model
    difference = robot_type(older.chains).difference(robot_type(chains))
    ends = [
        {(c[name].base, c[name].tip) for name in c.names}
        for c in (older.chains, chains)
    ]
    if not difference and ends[0] != ends[1]:
        base, tip = min(ends[1] - ends[0] or ends[1])
        difference = f"its chain goes from {base} to {tip}"
    if difference:
        raise OptionError(
            f"the older calibration is not of this robot: {difference}",
            file=file,
            value=chains.robot.name,
            allowed=older.chains.robot.name,
        )
    if start.verdict not in TRUSTED:
        raise OptionError(
            f"an older calibration that is {start.verdict} is no start: {start.reason}",
            file=file,
        )
    if older.setup.learned or setup.learned:
        raise OptionError(
            "a learned correction cannot be carried on from an older calibration",
            file=file if older.setup.learned else setup.file or None,
            value=older.setup.learned or setup.learned,
            allowed="parameters alone",
        )
    if set(older.setup.parameters) != set(setup.parameters):
        raise OptionError(
            "the older calibration has other parameters",
            file=file,
            value=", ".join(setup.parameters),
            allowed=", ".join(older.setup.parameters),
        )
    if not np.isfinite(start.covariance).all() or not start.statistics.noise:
        raise OptionError(
            "the older calibration does not say how sure it is of its parameters",
            file=file,
            allowed="a calibration of this version, with noise and redundancy",
        )


def _older(
    problem: Problem, start: CalibrationResult, noise: Mapping[str, float]
) -> JointPrior:
    """The errors of the robot as the older calibration knew them.

    Raises:
        OptionError: If it has not estimated the same ones.
    """
    own = [p for p in problem.parameters if p.free and not p.nuisance]
    known = {p.name: k for k, p in enumerate(start.parameters) if p.status != "fixed"}
    if lacking := [p.name for p in own if p.name not in known]:
        raise OptionError(
            f"the older calibration has not estimated {enumerated(lacking)}",
            file=start.provenance.file or None,
            allowed="the same 'fixed' in both",
        )
    index = [known[p.name] for p in own]
    scales = np.array([p.scale for p in own])
    covariance = np.asarray(start.covariance)[np.ix_(index, index)]
    squares, vectors = np.linalg.eigh(covariance / np.outer(scales, scales))
    scaled = (vectors * np.maximum(squares, FLOOR**2)) @ vectors.T
    found = [(p, start.parameters[k].value) for p, k in zip(own, index, strict=True)]
    return JointPrior(
        robot=robot_type(problem.chains),
        parameters=tuple(ExpectedParameter(p.name, p.unit, v) for p, v in found),
        covariance=_rows(scaled * np.outer(scales, scales)),
        noise=noise,
        file=start.provenance.file,
    )


def _rows(covariance: Floats) -> tuple[tuple[float, ...], ...]:
    """A covariance as plain data, to the last digit symmetric."""
    return tuple(map(tuple, (0.5 * (covariance + covariance.T)).tolist()))


def _registered(problem: Problem, older: JointPrior) -> tuple[Problem, Floats]:
    """A problem about frames and instrument that suit the older robot, and values."""
    values = {p.name: p.mean for p in older.parameters}
    theta = problem.parameters.vector(values)
    there = registered(problem, theta)
    # Stations are not eliminated here: what they absorb is projected out later.
    return there, least_squares(there, theta, nuisance_basis(there.parameters)).x


def _expected(
    start: CalibrationResult, process_noise: float | None
) -> tuple[DriftSize, ...]:
    """The drift since an older calibration before it is compared."""
    if process_noise is not None:
        return (DriftSize(EXPECTED[0].name, process_noise, np.inf),)
    if start.recalibration is None:
        return EXPECTED
    found = {drift.name: drift for drift in start.recalibration.last.drifts}
    # What a user has stated once, says nothing of the next time.
    stated = {name: d for name, d in found.items() if np.isfinite(d.worth)}
    return tuple(stated.get(drift.name, drift) for drift in EXPECTED)


def _updated(
    expected: Sequence[DriftSize], found: Explanation
) -> tuple[DriftSize, ...]:
    """The drift as it is known after a comparison."""
    _, told = found.fitted()
    return tuple(
        replace(drift, size=cause.size, worth=min(drift.worth + count, REMEMBERED))
        if np.isfinite(drift.worth)
        else drift
        for drift, cause, count in zip(expected, found.causes, told, strict=False)
    )


@dataclass(frozen=True)
class _Comparison:
    """New measurements beside what an older calibration predicts.

    Attributes:
        older: The older calibration.
        scales: Scales of its parameters, shape (K,).
        told: What the measurements tell of these.
        covariance: Of the scaled parameters, shape (K, K).
        noise: Values that tell the noise.
        drifting: How the scaled parameters drift, shape (K, k), by the names of drifts.
        sudden: What may have changed at once, by name.
        wrong: What may be wrong of the measurements.
    """

    older: JointPrior
    scales: Floats
    told: RobotRows
    covariance: Floats
    noise: float
    drifting: Mapping[str, Floats]
    sudden: Mapping[str, Change]
    wrong: tuple[Sparse, ...]

    @staticmethod
    def of(
        problem: Problem,
        theta: Floats,
        older: JointPrior,
        noise: Sequence[NoiseSize],
    ) -> _Comparison:
        """The comparison of the measurements of a problem, robot and frames at theta.

        Args:
            problem: The problem, without a prior.
            theta: Parameter values, shape (P,).
            older: The errors of the robot as the older calibration knew them.
            noise: The noise as it is known.
        """
        problem = replace(problem, units=_factors(problem, noise))
        told = robot_rows(problem, theta, ())
        parameters = problem.parameters
        scales = parameters.scales[told.robot]
        rows, groups = problem.layout.row, problem.data.groups()
        labels = np.unique(groups)
        return _Comparison(
            older=older,
            scales=scales,
            told=told,
            covariance=np.array(older.covariance) / np.outer(scales, scales),
            noise=min(max(sum(one.worth for one in noise), 1.0), NOISE),
            drifting=drifts(problem, told.robot),
            sudden=changes(problem, told.robot),
            wrong=tuple(
                Sparse(
                    f"measurement {k}",
                    told.along[:, groups[rows] == k],
                    WRONG,
                    1.0 / len(labels),
                )
                for k in labels.tolist()
            ),
        )

    @property
    def sparse(self) -> tuple[Sparse, ...]:
        """Causes that are there or not: of the robot, and of the measurements."""
        kinds = Counter(change.kind for change in self.sudden.values())
        of_robot = (
            Sparse(
                name,
                self.told.rows @ change.directions,
                SIZES,
                CHANCES[change.kind] / kinds[change.kind],
            )
            for name, change in self.sudden.items()
        )
        noisier = Sparse("noisier", np.eye(len(self.told.values)), NOISIER)
        return (*of_robot, *self.wrong, noisier)

    def explanation(self, expected: Sequence[DriftSize]) -> Explanation:
        """The innovations, with drift and noise as they are expected."""
        W, K = self.told.rows, len(self.told.values)
        usual = {drift.name: drift.size for drift in EXPECTED}
        mean = np.array([p.mean for p in self.older.parameters]) / self.scales
        return Explanation(
            self.told.values - W @ mean,
            W @ self.covariance @ W.T,
            (
                *(
                    Cause(
                        d.name,
                        W @ self.drifting[d.name],
                        d.size,
                        d.worth,
                        max(BEYOND * usual.get(d.name, 0.0), d.size),
                    )
                    for d in expected
                ),
                Cause("noise", np.eye(K), 1.0, self.noise, np.inf),
            ),
        )

    def jump(self, found: Explanation, cause: Cause) -> Jump:
        """A sudden change as the innovations tell it."""
        change = self.sudden[cause.name]
        effects, covariance = found.effects(cause)
        if change.kind == "offset":
            size = float(change.size)
            sigma = size * float(covariance[0, 0]) ** 0.5
            return Jump(
                change.joint, "offset", change.unit, size * float(effects[0]), sigma
            )
        moved = change.directions @ effects * self.scales
        lengths = np.array([p.unit == "m" for p in self.older.parameters])
        angles = np.array([p.unit == "rad" for p in self.older.parameters])
        shift, turn = (float(np.linalg.norm(moved[of])) for of in (lengths, angles))
        return Jump(change.joint, change.kind, "m", shift, np.nan, turn)

    def prior(self, drifted: Sequence[DriftSize], sparse: Sequence[Cause]) -> JointPrior:
        """The prior of the new calibration, wider by drift and sudden changes."""
        result = self.covariance.copy()
        for drift in drifted:
            D = self.drifting[drift.name]
            result += drift.size**2 * D @ D.T
        for cause in sparse:
            E = self.sudden[cause.name].directions
            # Of a size that one change has told, the next may be a few times as large.
            result += max(cause.size, 1.0) ** 2 * E @ E.T
        whole = result * np.outer(self.scales, self.scales)
        return replace(self.older, covariance=_rows(whole))


def _noise(start: CalibrationResult) -> tuple[NoiseSize, ...]:
    """The noise of all quantities by an older calibration and those before it."""
    before = () if start.recalibration is None else start.recalibration.last.noise
    found = {one.quantity: one for one in before}
    for own in start.statistics.noise:
        name, left = own.quantity.split(" ")[0], own.redundancy * own.values
        known = found.get(name, NoiseSize(name, 0.0, 0.0))
        worth = known.worth + left
        if own.estimate > 0.0 and left > 0.0:
            square = known.worth * known.sigma**2 + left * own.estimate**2
            sigma = float(np.sqrt(square / worth))
            found[name] = NoiseSize(name, sigma, min(worth, NOISE))
    return tuple(found.values())


def _factors(problem: Problem, noise: Sequence[NoiseSize]) -> Floats:
    """Noise of every quantity by what is stated now, where it is known to be larger.

    What a robot does that no parameter describes is there whatever the instrument
    states.
    """
    sigmas = {one.quantity: one.sigma for one in noise}
    found = np.ones(len(problem.layout.components))
    for k, component in enumerate(problem.layout.components):
        own = problem.given_sigma[problem.layout.of_components[k]]
        sigma = sigmas.get(component.quantity.name, 0.0)
        given = float(np.sqrt(np.mean(own**2))) if len(own) else sigma
        found[k] = max(sigma / given, 1.0) if sigma > 0.0 else 1.0
    return found
