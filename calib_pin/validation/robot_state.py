"""The state of a robot: a normal distribution of its errors, and how it changes.

An older calibration is the state of a robot: the values of its parameters, with their
covariance, about the frames in which it stood. It moves to the frames of new
measurements (`rebased`), becomes wider by drift and sudden changes, and is then the
prior of the next calibration, or of a plan for it (`prior`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import InputError, OptionError, enumerated
from calib_pin.estimation.evidence import TRUSTED, VarianceComponent, rms
from calib_pin.estimation.fitted import VISIBLE, robot_rows
from calib_pin.estimation.formulation import make_problem
from calib_pin.estimation.nominal import register
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.statistics.distributions import chi_square_quantile
from calib_pin.estimation.statistics.population_prior import (
    Cause,
    Explanation,
    RobotEvidence,
    explained,
)
from calib_pin.estimation.terms import Term, Terms
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.robot_types import robot_type
from calib_pin.kinematics.spatial import Floats, so3_log
from calib_pin.observations import Indices, Observations
from calib_pin.parameterizations.base import LENGTH_SCALE, expected_size, owner
from calib_pin.parameters import ParameterSet
from calib_pin.setup import JointPrior, Setup
from calib_pin.setup.population import ExpectedParameter, PoseSizes
from calib_pin.validation.evaluation import error_sizes
from calib_pin.validation.model_errors import registration_reason
from calib_pin.validation.result import (
    Accuracy,
    CalibrationResult,
    DriftSize,
    Jump,
    NoiseSize,
    Recalibration,
    RecalibrationStep,
    frames_of,
)

FLOOR = 1e-4
"""Least standard deviation of an error, in its expected size: far below any drift."""

EXPECTED = (DriftSize("geometry", 1e-5, 2.0), DriftSize("joint offsets", 3e-5, 2.0))
"""Drift between two calibrations that is expected where nothing is known yet; one of
four times the size is none: the robot has been changed."""

REMEMBERED = 50.0
"""Errors that a drift is worth at most: in a year it may be another one."""

CALM = float(np.log(10.0))
"""Logarithm of the evidence that a robot does not drift which the first calibration
after another one is thought to have; later ones have that of all before them. Without
it one in ten robots that do not drift seems to (months of `scripts/benchmark`)."""

SOME = 300
"""Measurements that are compared, and values that known noise is worth, at most; more
do not make it clearer."""

SELDOM = 0.01
"""Chance that the offset of a joint changes at once between two calibrations, for which
measurements are planned."""

KNOWN = 1e-5
"""Standard deviation of a frame that is known [m, rad]."""

SURE = 30.0
"""Evidence for a sudden change by that for none from which it is told.

By chance as much comes about in at most one of 30 calibrations (Markov's inequality,
which is wide: of 704 simulated weeks without a change one was told to have one)."""

CLOSE = 9.0
"""Chi-square by which one simple change may explain less than another, and is not told
from it: three standard deviations."""

CHANCES = {"offset": 1.0, "base": 1.0, "tool": 1.0, "placement": 0.05, "robot": 0.05}
"""How likely kinds of sudden changes are beside each other: a joint that was hit slips
on its axis first of all, and instruments and tools are set up anew."""

FRAMES, SIMPLE = ("base", "tool"), ("offset", "base", "tool")
"""Changes of frames, and of one thing, which few measurements tell from each other."""

NOISE = "noise"
"""The cause that always acts beside drifts."""

JUMPS = 4
"""Most causes beside drift and noise that are told, sudden changes and wrong
measurements."""

SIZES = {
    "changes": np.geomspace(0.03, 10.0, 16),
    "frames": np.geomspace(0.03, 1e4, 24),
    "wrong": np.geomspace(3.0, 1e4, 16),
    "noise": np.geomspace(1.0, 30.0, 8),
}
"""Sizes of sudden changes, in expected sizes of errors (from 30 um and 90 urad on) and
of frames, which may be anywhere; errors of wrong measurements, in standard deviations;
and further noise of another instrument, by what is known of the older one."""

Frame = tuple[str, str]
"""`base` or `tool`, and the station or the tool; empty for the only one."""


@dataclass(frozen=True)
class RobotState:
    """The parameters of a robot as a calibration knows them, and how they drift.

    Attributes:
        system: The robot, about the references that values belong to.
        values: Values of its P parameters, shape (P,).
        covariance: Of these, shape (P, P).
        free: Which of them were estimated, shape (P,).
        drifts: The drift that is expected until the next calibration.
        noise: The noise of every quantity, as it is known.
        steps: The calibrations that began with another one, the last is this one.
        made: File of the calibration, for messages, and when it was made.
        unmodeled: See `JointPrior.unmodeled`.
    """

    system: Terms
    values: Floats
    covariance: Floats
    free: NDArray[np.bool_]
    drifts: tuple[DriftSize, ...]
    noise: tuple[NoiseSize, ...]
    steps: tuple[RecalibrationStep, ...]
    made: tuple[str, str]
    unmodeled: Mapping[str, tuple[PoseSizes, PoseSizes]]

    @staticmethod
    def of(result: CalibrationResult, process_noise: float | None) -> RobotState:
        """The state that a calibration has found.

        Args:
            result: The calibration.
            process_noise: The drift that a user states [m, rad]; None for none.
        """
        begun, places = result.recalibration, result.accuracies.items()
        steps = () if begun is None else begun.steps
        return RobotState(
            result.model,
            result.model.theta,
            np.asarray(result.covariance),
            np.array([p.status != "fixed" for p in result.parameters]),
            _drifts(steps[-1:], process_noise),
            _noise(steps[-1:], result.statistics.noise),
            steps,
            (result.provenance.file, result.provenance.created),
            {
                chain: (accuracy.measured.unmodeled, accuracy.workspace.unmodeled)
                for chain, accuracy in places
                if accuracy.measured and accuracy.workspace
            },
        )

    @property
    def sigmas(self) -> dict[str, float]:
        """The noise by quantity, see `NoiseSize.sigma`."""
        return {size.quantity: size.sigma for size in self.noise}

    @property
    def robot(self) -> NDArray[np.bool_]:
        """The estimated parameters that are errors of the robot, shape (P,)."""
        return self.free & ~self.system.given.nuisance

    def rebased(
        self, system: Terms, robot: NDArray[np.bool_]
    ) -> tuple[RobotState, Mapping[Frame, Indices]]:
        """The state about the references of new measurements.

        Frames that both have are where they were, seen from where they stand now. What
        else is new has no covariance.

        Args:
            system: The robot before the new instrument.
            robot: The errors of the robot among its parameters, shape (P,).

        Returns:
            The state, and the positions of the parameters of frames that both have.
        """
        names, old = system.given.names, self.system.given.names
        values, known, before = np.zeros(len(names)), robot.copy(), _frames(self.system)
        values[robot] = self.values[self.places(system.given, robot)]
        shared = {f: both for f, both in _frames(system).items() if f in before}
        for frame, (pose, index) in shared.items():
            moved = pose.actInv(before[frame][0])
            known[index] = True
            # Positions alone do not tell how a tool is turned, and move it nowhere.
            values[index] = np.append(moved.translation, so3_log(moved.rotation))
        frames = {frame: index for frame, (_, index) in shared.items()}
        targets = [k for k in np.flatnonzero(known).tolist() if names[k] in old]
        sources = [old.index(names[k]) for k in targets]
        covariance = np.zeros((len(names), len(names)))
        covariance[np.ix_(targets, targets)] = self.covariance[np.ix_(sources, sources)]
        state = replace(self, system=system, values=values, free=known)
        return replace(state, covariance=covariance), frames

    def places(self, parameters: ParameterSet, robot: NDArray[np.bool_]) -> list[int]:
        """Positions of the errors of the robot among the parameters of a problem.

        Raises:
            OptionError: If one of them was not estimated.
        """
        known = {p.name: k for k, p in enumerate(self.system.given) if self.free[k]}
        names = [p.name for p, free in zip(parameters, robot, strict=True) if free]
        if lacking := [name for name in names if name not in known]:
            reason = f"the older calibration has not estimated {enumerated(lacking)}"
            raise OptionError(reason, file=self.made[0] or None)
        return [known[name] for name in names]

    def prior(
        self, effects: Iterable[tuple[float, Floats]], noise: Mapping[str, float]
    ) -> JointPrior:
        """The state as a prior of the errors of the robot, wider by changes.

        Args:
            effects: Sizes and directions of these, of the scaled parameters, shapes
                (P, k).
            noise: The noise of every quantity.
        """
        robot, given = self.robot, self.system.given
        scales = np.outer(given.scales[robot], given.scales[robot])
        index = np.flatnonzero(robot).tolist()
        squares, V = np.linalg.eigh(self.covariance[np.ix_(index, index)] / scales)
        C = (V * np.maximum(squares, FLOOR**2)) @ V.T
        for size, directions in effects:
            C += size**2 * directions[robot] @ directions[robot].T
        values = [(given[k], float(self.values[k])) for k in index]
        means = tuple(ExpectedParameter(p.name, p.unit, value) for p, value in values)
        rows = tuple(map(tuple, (0.5 * scales * (C + C.T)).tolist()))
        of_type = robot_type(self.system.chains)
        return JointPrior(of_type, means, rows, noise, self.made[0], self.unmodeled)


def _frames(system: Terms) -> Mapping[Frame, tuple[pin.SE3, Indices]]:
    """Pose and positions of the parameters of every frame."""
    frames: dict[Frame, tuple[pin.SE3, Indices]] = {}
    for term in system.terms.values():
        tool = term.error.tool * term.frames.offset.inverse()
        scopes, poses = (term.frames.station, term.frames.tool), (term.error.base, tool)
        indices = (index for _, index in frames_of(term))
        for end, scope, pose, index in zip(FRAMES, scopes, poses, indices, strict=True):
            name = "" if scope == f"{end}.frame" else scope.rpartition(".")[0]
            frames.setdefault((end, name), (pose, index))
    return frames


@dataclass(frozen=True)
class Change:
    """A sudden change that parameters may show.

    Attributes:
        name: The joint, station or tool; empty for the whole robot, or the only one.
        kind: `offset` of the joint, `placement` for all of its errors, `robot`, or the
            frame that moves, `base` or `tool`.
        directions: Its independent effects on all parameters divided by their scales,
            shape (P, k), each of the expected size of an error.
        unit: Unit of an offset, rad or m.
    """

    name: str
    kind: str
    directions: Floats
    unit: str = "m"

    @property
    def label(self) -> str:
        """It in words."""
        word = self.kind if self.kind in FRAMES else "joint"
        return f"{word} '{self.name}'" if self.name else word


def drifts(
    system: Terms, robot: NDArray[np.bool_], sudden: Iterable[Change]
) -> Mapping[str, Floats]:
    """How errors drift by independent effects, shapes (P, k) in their scales, by name.

    Of a drift of size one [m, rad] errors without such a unit have the same part of
    their expected sizes as a length.

    Args:
        system: The robot.
        robot: The errors of the robot among its parameters, shape (P,).
        sudden: What may change at once: offsets drift as well.
    """
    scales = [p.scale if p.unit in ("m", "rad") else LENGTH_SCALE for p in system.given]
    moved = (c for c in sudden if c.kind == "offset")
    offsets = [c.directions / expected_size(c.unit) for c in moved]
    by_joint = np.hstack([np.zeros((len(robot), 0)), *offsets])
    geometry = np.diag(1.0 / np.array(scales))[:, robot]
    return {"geometry": geometry, "joint offsets": by_joint}


def changes(system: Terms, robot: NDArray[np.bool_]) -> dict[str, Change]:
    """The sudden changes that the errors of a robot may show, by name.

    Args:
        system: The robot.
        robot: The errors of the robot among its parameters, shape (P,).
    """
    by_name, unit = dict[str, Change](), np.eye(len(robot))
    owners = np.array([p.name.rsplit(".", 2)[0] for p in system.given])
    of_joint = {j: robot & (owners == owner(j)) for j in system.chains.joints}
    for term in system.terms.values():
        chain = term.error.chain
        for k, joint in enumerate(chain.joints):
            along = _along(term, k, of_joint[joint])
            if along is not None:
                turned = "rad" if chain.revolute[k] else "m"
                directions = expected_size(turned) * along[:, None]
                offset = Change(joint, "offset", directions, turned)
                by_name.setdefault(f"offset {joint}", offset)
    for joint, mask in of_joint.items():
        if mask.sum() > 1:
            by_name[f"placement {joint}"] = Change(joint, "placement", unit[:, mask])
    by_name["robot"] = Change("", "robot", unit[:, robot])
    return by_name


def _along(term: Term, k: int, mask: NDArray[np.bool_]) -> Floats | None:
    """The errors that are the motion of joint k of a chain, (P,); None without such.

    Args:
        term: A term of the chain.
        k: Number of the joint.
        mask: The errors of the joint, shape (P,).
    """
    chain, frame, T = term.error.chain, k + 1, np.zeros((6, len(mask)))
    behind = [*chain.placements, chain.tip_placement][frame]
    # Errors in the next frame, as those of a DH matrix, move with the joint.
    to_frame = {frame: np.eye(6), frame + 1: behind.toActionMatrix()}
    for screw, column in zip(term.error.screws, term.of_error, strict=True):
        if mask[column] and screw.frame in to_frame and screw.basis is None:
            twist = to_frame[screw.frame] @ screw.twist
            T[:, column] += twist * screw.parameter.scale
    along = np.linalg.lstsq(T, chain.motions[k], rcond=1e-9)[0]
    return along if np.abs(T @ along - chain.motions[k]).max() <= 1e-9 else None


@serial_blas
def robot_evidence(result: CalibrationResult) -> RobotEvidence:
    """The equations for the errors of its robot that a calibration amounts to.

    Args:
        result: The calibration, of this program or read from its folder.

    Raises:
        InputError: If it does not say what was measured, how large the noise is, or
            learned more than errors of parameters.
    """
    model, noise = result.model, result.statistics.noise
    for refused, reason in (
        (model.setup.learned, "with a learned correction tells a fleet nothing"),
        (not np.isfinite(result.fitted.after).any(), "does not say what was measured"),
        (not noise, "does not know its noise: its measurements are too few"),
    ):
        if refused:
            file = result.provenance.file or None
            raise InputError(f"the calibration {reason}", file=file)
    factors = np.array([component.factor for component in noise])
    problem = replace(model.problem(result.fitted.rows), units=factors)
    linear = robot_rows(problem, model.theta, noise)
    errors = [problem.parameters[k] for k in np.flatnonzero(linear.robot).tolist()]
    names, units = tuple(p.name for p in errors), tuple(p.unit for p in errors)
    scales, robot = np.array([p.scale for p in errors]), robot_type(model.chains)
    sizes = {c.quantity: c.estimate for c in noise if c.estimate > 0.0}
    return RobotEvidence(robot, names, units, scales, linear.rows, linear.values, sizes)


@serial_blas
def resume(
    chains: Chains,
    data: Observations,
    setup: Setup,
    start: CalibrationResult | None,
    process_noise: float | None = None,
    ladder: bool = False,
) -> tuple[Setup, Recalibration]:
    """Begin a calibration with an older one.

    Args:
        chains: The nominal chains.
        data: The new measurements to fit.
        setup: Estimated and known quantities.
        start: The older calibration.
        process_noise: Standard deviation of the drift of each error of the geometry
            since then [m, rad], of other errors by their expected sizes; default as the
            measurements show it.
        ladder: Whether the model is to be selected, which the older one has fixed.

    Returns:
        The setup with the older calibration as prior, and how that has predicted the
        new measurements.

    Raises:
        InputError: If frames and instrument use up the measurements.
        OptionError: If there is no older calibration, or it is of another robot or of
            other parameters, or must not be trusted.
    """
    if start is None:
        raise OptionError("a process noise belongs to an older calibration, 'start'")
    if ladder:
        raise OptionError("the model of an older calibration is kept, not selected")
    require_usable(chains, setup, start)
    older = RobotState.of(start, process_noise)
    plain = replace(setup, prior={}, noise=older.sigmas | dict(setup.noise))
    problem = make_problem(chains, data.sample(SOME), plain)
    robot = problem.parameters.free & ~problem.parameters.nuisance
    # About frames and instrument that suit the older robot.
    theta = np.zeros(len(robot))
    theta[robot] = older.values[older.places(problem.given, robot)]
    problem, result = register(problem, theta)
    if reason := registration_reason(problem, result):
        reason = f"cannot go on from the older calibration: {reason}"
        raise InputError(reason, file=data.files[0] or None)
    step, prior = Innovations(problem, result.x, older).explain(len(data))
    sizes = error_sizes(problem, result.x)
    errors = tuple((name, unit, Accuracy.of(size)) for name, unit, size in sizes)
    begun = Recalibration(errors, (*older.steps, step))
    return replace(setup, prior=prior), begun


def expected_setup(
    chains: Chains,
    setup: Setup,
    start: CalibrationResult,
    process_noise: float | None = None,
) -> Setup:
    """A setup that knows beforehand what a calibration will, to plan for it.

    Args:
        chains: The nominal chains.
        setup: Estimated and known quantities.
        start: The older calibration that it will begin with.
        process_noise: As for `resume`.

    Raises:
        OptionError: As for `resume`.
    """
    require_usable(chains, setup, start)
    state = RobotState.of(start, process_noise)
    sudden = changes(state.system, state.robot).values()
    directions = drifts(state.system, state.robot, sudden)
    effects = [(drift.size, directions[drift.name]) for drift in state.drifts]
    # Which joint was hit, if one was, must show as well.
    effects += [(SELDOM**0.5, c.directions) for c in sudden if c.kind == "offset"]
    return replace(setup, prior=state.prior(effects, state.sigmas))


def require_usable(chains: Chains, setup: Setup, start: CalibrationResult) -> None:
    """Refuse an older calibration that says nothing of this robot.

    Raises:
        OptionError: If it is such.
    """
    model, older = start.model.chains, start.model.setup
    difference = robot_type(model).difference(robot_type(chains))
    ends, new = ({(c[n].base, c[n].tip) for n in c.names} for c in (model, chains))
    if not difference and ends != new:
        difference = "its chain goes from {} to {}".format(*min(new - ends or new))
    serials = older.report.serial_number, setup.report.serial_number
    whose = "of serial number '{}', these measurements are of '{}'".format(*serials)
    known, given = (", ".join(s.parameters) for s in (older, setup))
    unsure = not np.isfinite(start.covariance).all() or not start.statistics.noise
    nominal = "take its nominal robot, nominal.urdf in its folder"
    for refused, reason in (
        (difference, f"is not of this robot: {difference}; {nominal}"),
        (all(serials) and len({*serials}) > 1, f"is {whose} ({setup.file})"),
        (start.verdict not in TRUSTED, f"is {start.verdict}: {start.reason}"),
        (older.learned or setup.learned, "cannot carry a learned correction on"),
        (
            {*older.parameters} != {*setup.parameters},
            f"has parameters {known}, not {given}",
        ),
        (unsure, "does not say how sure it is of its parameters: calibrate again"),
    ):
        if refused:
            reason = f"the older calibration {reason}"
            raise OptionError(reason, file=start.provenance.file or None)


def _drifts(
    last: Sequence[RecalibrationStep], process_noise: float | None
) -> tuple[DriftSize, ...]:
    """The drift since a calibration, and its last step, as it is stated or expected."""
    if process_noise is not None:
        return (DriftSize(EXPECTED[0].name, process_noise, np.inf),)
    # What a user has stated once, says nothing of the next time.
    before = (d for step in last for d in step.drifts if np.isfinite(d.worth))
    by_name = {drift.name: drift for drift in before}
    return tuple(by_name.get(drift.name, drift) for drift in EXPECTED)


def _noise(
    last: Sequence[RecalibrationStep], components: Sequence[VarianceComponent]
) -> tuple[NoiseSize, ...]:
    """The noise of all quantities that a calibration and those before it have shown."""
    by_name = {size.quantity: size for step in last for size in step.noise}
    for part in components:
        name, dof = part.quantity.split(" ")[0], part.redundancy * part.values
        known = by_name.get(name, NoiseSize(name, 0.0, 0.0))
        if part.estimate > 0.0 and dof > 0.0:
            worth = known.worth + dof
            square = known.worth * known.sigma**2 + dof * part.estimate**2
            sigma = float(np.sqrt(square / worth))
            by_name[name] = NoiseSize(name, sigma, min(worth, SOME))
    return tuple(by_name.values())


class Innovations:
    """New measurements beside what an older calibration predicts.

    That is of the errors of the robot, and of the frames of stations and tools that
    both have: they are as they were, unless something was moved.

    Attributes:
        state: The older calibration about the references of the new measurements.
        parameters: All P parameters, frames among the errors of the robot.
        measured: Noise of the m measured values among the r rows, shape (r, m); the
            others are of frames which are known now and were not.
        sudden: What may have changed at once, by name.
        drifting: How the parameters drift, shapes (P, k), by the names of drifts.
        causes: The sudden changes as causes of innovations, by the same names.
        scatter: The largest noise that they show, in that of the older one.
        wrong: That single measurements are wrong.
        first: The innovations, with drift and noise as they are expected.
    """

    def __init__(self, problem: Problem, theta: Floats, older: RobotState) -> None:
        """Compare the measurements of a problem, robot and frames at theta.

        Args:
            problem: The problem, without a prior.
            theta: Parameter values, shape (P,).
            older: The older calibration.
        """
        problem, theta = problem.rebased(theta)
        robot = problem.parameters.free & ~problem.parameters.nuisance
        self.state, frames = older.rebased(problem, robot)
        given = list(problem.given)
        for k in (int(k) for index in frames.values() for k in index):
            scale = expected_size(given[k].unit)
            given[k] = replace(given[k], nuisance=False, scale=scale)
        units = _factors(problem, older.sigmas)
        problem = replace(problem, given=ParameterSet(tuple(given)), units=units)
        self.parameters, scales = problem.parameters, problem.parameters.scales
        known = np.diag(self.state.covariance) > 0.0
        linear, identity = robot_rows(problem, theta, ()), np.eye(len(scales))
        below = np.diag(scales / KNOWN)[~self.parameters.free & known]
        rows = np.vstack([linear.rows @ identity[linear.robot], below])
        self.measured = M = np.eye(len(rows))[:, : len(linear.values)]
        self.scatter = _scatter(problem, theta)
        self.sudden = changes(problem, robot)
        self.drifting = drifts(problem, robot, self.sudden.values())
        for (kind, name), index in frames.items():
            self.sudden[f"{kind} {name}"] = Change(name, kind, identity[:, index])
        counts = Counter(change.kind for change in self.sudden.values())
        self.causes = {
            name: Cause(
                name,
                rows @ change.directions,
                sizes=SIZES["frames" if change.kind in FRAMES else "changes"],
                chance=CHANCES[change.kind] / counts[change.kind],
            )
            for name, change in self.sudden.items()
        }
        groups, along = problem.data.groups(), M @ linear.along
        labels, of_value = np.unique(groups).tolist(), groups[problem.layout.row]
        wrong = ((f"measurement {k}", along[:, of_value == k]) for k in labels)
        sizes, chance = SIZES["wrong"], 1.0 / len(labels)
        self.wrong = [Cause(n, E, sizes=sizes, chance=chance) for n, E in wrong]
        # In scales, of which frames that have been free had others.
        W, most = rows / scales, {d.name: 4.0 * d.size for d in EXPECTED}
        V = W @ self.state.covariance @ W.T + np.eye(len(W)) - M @ M.T
        drifting = (
            Cause(d.name, rows @ self.drifting[d.name], d.size, d.worth, limit)
            for d in older.drifts
            for limit in [max(most[d.name], d.size)]
        )
        worth = min(max(sum(size.worth for size in older.noise), 1.0), SOME)
        causes = *drifting, Cause(NOISE, M, 1.0, worth)
        values = M @ linear.values - W @ self.state.values
        self.first = Explanation(values, V, causes)

    def explain(self, count: int) -> tuple[RecalibrationStep, JointPrior]:
        """Drift, noise, sudden changes and wrong measurements that explain it best.

        All of a joint or of the robot explains nearly everything, and so does noise:
        what has been found with them is compared with the best of few simple changes.

        Args:
            count: Number of all new measurements.

        Returns:
            The step, and the prior that the older calibration is.
        """
        first, state = self.first, self.state
        simple = [c for n, c in self.causes.items() if self.sudden[n].kind in SIMPLE]
        sizes = SIZES["noise"][SIZES["noise"] <= max(self.scatter, 1.0)]
        noisier = Cause("noisier", self.measured, sizes=sizes)
        families = simple, [*simple, noisier], [*self.causes.values(), noisier]
        trials = (
            explained(first, [*family, *self.wrong], SURE, JUMPS) for family in families
        )
        best, sparse, _ = max(trials, key=lambda trial: trial[2])
        names = {drift.name for drift in state.drifts}
        calm, _ = best.without(names).fitted()
        still = calm.likelihood + first.without(names).expected(calm)
        still -= best.likelihood + first.expected(best)
        before = state.steps[-1].still if state.steps else CALM
        believed = still + before
        still += before if state.steps else 0.0
        _, counts = best.fitted()
        drifted, effects = list[DriftSize](), list[tuple[float, Floats]]()
        for drift, cause, n in zip(state.drifts, best.causes, counts, strict=False):
            wider = 1.0
            if np.isfinite(drift.worth):
                worth = min(drift.worth + n, REMEMBERED)
                drift = replace(drift, size=cause.size, worth=worth)
                # A robot that may drift is as uncertain as that is likely; and squares
                # of sizes that few errors tell are larger in the mean than their
                # likeliest.
                part = float(np.exp(-np.logaddexp(0.0, believed)))
                wider = (part * worth / max(worth - 2.0, 1.0)) ** 0.5
            drifted.append(drift)
            effects.append((wider * drift.size, self.drifting[drift.name]))
        if np.isfinite(state.drifts[0].worth) and believed > 0.0:
            best = calm
        sudden, jumps = [c for c in sparse if c.name in self.sudden], list[Jump]()
        hit = dict[str, float]()
        for cause in sudden:
            instead, beside = self._alternatives(best, cause, sudden)
            others = (
                [self.sudden[n].label for n in names] for names in (instead, beside)
            )
            jumps.append(self._jump(best, cause, *map(tuple, others)))
            # A single change tells little of the size that such changes have.
            hit |= dict.fromkeys([cause.name, *instead], max(cause.size, 1.0))
        effects += [(size, self.sudden[name].directions) for name, size in hit.items()]
        # A tracker that was set up anew is no error of the prediction.
        moved = (c for c in sudden if self.sudden[c.name].kind in FRAMES)
        chi2 = replace(first, causes=(*first.causes, *moved)).square
        # Beside what all have shown, as much more as these show by chance.
        inflation = max(best.square / len(first.values), 1.0) ** 0.5
        inflation *= next(c.size for c in best.causes if c.name == NOISE)
        noise = {name: inflation * sigma for name, sigma in state.sigmas.items()}
        start, created = state.made
        step = RecalibrationStep(
            start,
            created,
            measurements=count,
            chi2=chi2,
            dof=len(first.values),
            noise=state.noise,
            drifts=tuple(drifted),
            jumps=tuple(jumps),
            still=float(still),
        )
        return step, state.prior(effects, noise)

    def _alternatives(
        self, best: Explanation, cause: Cause, sudden: Sequence[Cause]
    ) -> tuple[list[str], list[str]]:
        """Simple changes that may have come about in place of a simple one.

        And offsets of joints that would not show beside a frame that has moved.
        """
        instead, beside = list[str](), list[str]()
        reduced, E = best.without({cause.name}), cause.effects
        limit, named = reduced.misfit(E) + CLOSE, {other.name for other in sudden}
        for name, change in self.sudden.items():
            moved = self.causes[name].effects
            simple = {change.kind, self.sudden[cause.name].kind} <= {*SIMPLE}
            # Nothing that is measured now depends on where a known frame has stood.
            if name in named or not simple or not (self.measured.T @ moved).any():
                continue
            rest = moved - E @ np.linalg.lstsq(E, moved, rcond=None)[0]
            if reduced.misfit(moved) <= limit:
                instead.append(name)
            # All but a hundredth of it is done by the other one.
            elif np.linalg.norm(rest) < 0.01 * np.linalg.norm(moved):
                beside.append(name)
        return instead, beside

    def _jump(self, best: Explanation, cause: Cause, *others: tuple[str, ...]) -> Jump:
        """A sudden change as the innovations tell it, and what it may be instead."""
        change, parameters = self.sudden[cause.name], self.parameters
        effects, covariance = best.effects(cause)
        about = change.name, change.kind, change.unit
        if change.kind == "offset":
            size = expected_size(change.unit)
            sigma = size * float(covariance[0, 0]) ** 0.5
            return Jump(*about, size * float(effects[0]), sigma, 0.0, *others)
        moved = change.directions @ effects * parameters.scales
        units = np.array([parameter.unit for parameter in parameters])
        far, turn = (np.linalg.norm(moved[units == unit]) for unit in ("m", "rad"))
        return Jump(*about, float(far), np.nan, float(turn), *others)


def _scatter(problem: Problem, theta: Floats) -> float:
    """The largest noise of measurements, whatever the robot may have become.

    In the noise that the problem takes; infinite where any robot fits.
    """
    count, free = len(problem.layout.row), problem.parameters.free
    fun, jac = problem.linearize_rows(theta)
    U, s, _ = np.linalg.svd(jac[:count, free] * problem.parameters.scales[free], False)
    U = U[:, s > VISIBLE * s.max(initial=0.0)]
    rest, dof = fun[:count] - U @ (U.T @ fun[:count]), count - U.shape[1]
    if dof < 1:
        return np.inf
    return float(np.sqrt(rest @ rest / chi_square_quantile(dof, 1.0 - 1.0 / SURE)))


def _factors(problem: Problem, sigmas: Mapping[str, float]) -> Floats:
    """Noise of every quantity by what is stated now, where it is known to be larger.

    What a robot does that no parameter describes is there whatever the instrument
    states.
    """
    factors = np.ones(len(problem.layout.components))
    for k, component in enumerate(problem.layout.components):
        sigma = problem.given_sigma[problem.layout.of_components[k]]
        if len(sigma) and component.quantity.name in sigmas:
            factors[k] = max(sigmas[component.quantity.name] / rms(sigma), 1.0)
    return factors
