"""The state of a robot, and an older calibration: it holds, drifts, or is refused."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

import calib_pin
from calib_pin.errors import InputError, OptionError
from calib_pin.estimation.evidence import PoseErrors
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.observations import Observations
from calib_pin.parameterizations.base import expected_size
from calib_pin.setup import FrameSetup, ReportSetup, Setup
from calib_pin.simulation import draw_errors, simulate
from calib_pin.validation.findings.calibrations import older_calibration
from calib_pin.validation.result import CalibrationResult
from calib_pin.validation.robot_state import changes, drifts, robot_evidence
from calib_pin.validation.tip_drift import absorbed
from tests.shared import refused


@pytest.mark.parametrize("name", ["placement", "dh", "joint-offset", "link-transform"])
def test_an_offset_is_one(name) -> None:
    chain = calib_pin.load_chain("space6")
    problem = nominal_problem(chain, "pose", Setup(parameters=(name,)))
    parameters = problem.parameters
    robot = parameters.free & ~parameters.nuisance
    term, q = problem.only, chain.random_configurations(5, np.random.default_rng(0))
    found = changes(problem, robot)
    offsets = [change for change in found.values() if change.kind == "offset"]
    assert [change.name for change in offsets] == list(chain.joints)
    for k, change in enumerate(offsets):
        theta = change.directions[:, 0] * parameters.scales / 1e3
        moved = q.copy()
        moved[:, k] += expected_size(change.unit) / 1e3
        expected = term.error.poses(moved, 0.0 * theta)
        # Errors apply one after the other: the second order is left.
        np.testing.assert_allclose(term.error.poses(q, theta), expected, atol=1e-10)


def test_drifts_and_other_changes() -> None:
    chain = calib_pin.load_chain("space6")
    setup = Setup(parameters=("placement", "transmission"))
    problem = nominal_problem(chain, "pose", setup)
    parameters = problem.parameters
    robot = parameters.free & ~parameters.nuisance
    found, scales = changes(problem, robot), parameters.scales[robot]
    drifting = drifts(problem, robot, found.values())
    sizes = np.diag(drifting["geometry"][robot]) * scales
    units = np.array([p.unit for p in parameters])[robot]
    np.testing.assert_allclose(
        sizes, np.where(np.isin(units, ["m", "rad"]), 1.0, scales / 1e-3)
    )
    assert drifting["joint offsets"].shape == (len(robot), 6)
    placed = found["placement joint_3"].directions
    touched = [parameters.names[k] for k in np.flatnonzero(placed.any(axis=1))]
    assert touched and all(name.startswith("joint_3.") for name in touched)
    assert found["robot"].directions.shape == (len(robot), robot.sum())


def information(evidence):
    """The matrix of the normal equations, and their right side."""
    W = evidence.rows
    return W.T @ W, W.T @ evidence.values


def test_it_is_the_likelihood(fleet) -> None:
    """Frames projected out of the normal equations (their Schur complement)."""
    result = fleet.results[0]
    evidence = robot_evidence(result)
    problem = replace(
        result.model.problem(result.fitted.rows),
        units=np.array([c.factor for c in result.statistics.noise]),
    )
    p = problem.parameters
    r, J = problem.linearize_rows(result.model.theta)
    J = J * p.scales
    N, robot = J.T @ J, p.free & ~p.nuisance
    frames = p.free & p.nuisance
    cross = N[np.ix_(robot, frames)]
    inverse = np.linalg.pinv(N[np.ix_(frames, frames)], hermitian=True)
    A = N[np.ix_(robot, robot)] - cross @ inverse @ cross.T
    gradient = J.T @ r
    b = A @ (result.model.theta / p.scales)[robot]
    b -= gradient[robot] - cross @ inverse @ gradient[frames]
    found = information(evidence)
    # The normal equations have half the digits.
    np.testing.assert_allclose(found[0], A, atol=1e-7 * np.abs(A).max())
    np.testing.assert_allclose(found[1], b, atol=1e-7 * np.abs(b).max())
    assert evidence.names == tuple(np.array(p.names)[robot])
    assert evidence.rows.shape[0] < evidence.rows.shape[1]


def test_a_prior_does_not_count_twice(fleet) -> None:
    """The evidence of a calibration with a prior is that of one without."""
    data, _ = fleet.measured(100, 24)
    chain, noise = fleet.problem.chains[""], {"position": 1e-4}
    prior = fleet.prior
    without, with_it = (
        robot_evidence(
            calib_pin.calibrate(
                chain, data, Setup(noise=noise, prior=some), validate=False
            )
        )
        for some in ({}, prior)
    )
    A, b = information(without)
    other = information(with_it)
    # Linearized elsewhere: errors of a milliradian change derivatives by a thousandth.
    np.testing.assert_allclose(other[0], A, atol=5e-3 * np.abs(A).max())
    np.testing.assert_allclose(other[1], b, atol=5e-3 * np.abs(b).max())


def test_what_tells_nothing(fleet) -> None:
    result = fleet.results[0]
    quiet = replace(result, statistics=replace(result.statistics, noise=()))
    with refused(InputError, reason="noise"):
        robot_evidence(quiet)
    setup = replace(result.model.setup, learned="network")
    with refused(InputError, reason="learned correction"):
        robot_evidence(replace(result, model=replace(result.model, setup=setup)))


TOOL = FrameSetup((0.05, 0.08, 0.12), estimate=True)
NOISE = 1e-4


@dataclass(frozen=True)
class Bench:
    """A robot with known errors, and its first calibration."""

    problem: object
    theta: np.ndarray
    first: CalibrationResult

    @property
    def chain(self):
        return self.problem.chains[""]

    def measured(self, seed, count=10, changes=None, *, moved=(0, 0, 0), tool=TOOL):
        """Measurements by a tracker that was moved, without stated noise."""
        theta, rng = self.changed(changes), np.random.default_rng(seed)
        base = FrameSetup((1.0 + moved[0], *moved[1:]), (0.1, 0.2, 0.3), estimate=True)
        setup = Setup(base_frame=base, tool_frame=tool)
        problem = nominal_problem(self.chain, "position", setup)
        rows = simulate(problem, theta, rng, count=count, noise=NOISE).only
        return Observations.of(replace(rows, sigma=None))

    def changed(self, changes):
        theta = self.theta.copy()
        for name, change in (changes or {}).items():
            theta[self.problem.parameters.index(name)] += change
        return theta

    def error(self, result, changes=None):
        """True error of the tool over the workspace, rms [m]."""
        q = self.chain.random_configurations(200, np.random.default_rng(5))
        part = self.problem.only
        A = part.error.poses(q, self.changed(changes))
        B = absorbed(A, result.model.of().poses(q))
        squares = np.sum((B[:, :3, 3] - A[:, :3, 3]) ** 2, axis=1)
        return float(np.sqrt(squares.mean()))


@pytest.fixture(scope="module")
def bench() -> Bench:
    chain = calib_pin.load_chain("example:ur10_robot", base="base_link", tip="tool0")
    problem = nominal_problem(chain, "position", Setup(tool_frame=TOOL))
    parameters, rng = problem.parameters, np.random.default_rng(3)
    robot = parameters.free & ~parameters.nuisance
    theta = np.where(robot, parameters.scales * rng.normal(size=len(robot)), 0.0)
    bare = Bench(problem, theta, None)
    first = calib_pin.calibrate(chain, bare.measured(1, 80))
    assert first.verdict == "good"
    return replace(bare, first=first)


def again(bench, data, **options):
    return calib_pin.calibrate(bench.chain, data, **{"start": bench.first} | options)


def codes(result):
    return {finding.code: finding for finding in result.findings}


def test_ten_measurements_keep_it(bench) -> None:
    """The tracker stands elsewhere, and nothing else has changed."""
    result = again(bench, bench.measured(2, moved=(0.3, -0.2, 0.1)))
    assert result.verdict == "good"
    found = codes(result)["old-calibration-holds"]
    assert found.severity == "info"
    step = result.recalibration.last
    (moved,) = step.jumps
    assert step.measurements == 10 and moved.kind == "base"
    assert moved.change == pytest.approx(np.linalg.norm([0.3, -0.2, 0.1]), abs=1e-3)
    assert moved.beside == ("joint 'shoulder_pan_joint'",)
    # As many as positions tell of the robot, of where base and of where the tool is.
    assert step.dof == 27 and 8.0 < step.chi2 < 60.0
    assert bench.error(result) < 1.05 * bench.error(bench.first)
    alone = calib_pin.calibrate(bench.chain, bench.measured(2), validate=False)
    assert bench.error(result) < 0.5 * bench.error(alone)
    # What the older one predicts is worse than the fit, and far better than nominal.
    (name, unit, older), (error,) = result.recalibration.errors[0], result.errors
    assert (name, unit) == ("position", "m")
    assert error.after.rms < older.rms < 0.2 * error.before.rms


def test_chance_alone_ends_no_older_calibration(bench) -> None:
    """Ten measurements that happen to show more errors that nothing describes."""
    result = again(bench, bench.measured(2))
    accuracy = result.accuracies[""]
    grown = replace(
        accuracy.workspace,
        calibrated=PoseErrors(1e-3, 1e-3),
        unmodeled=PoseErrors(0.9998e-3, 1e-3),
    )
    accuracies = {"": replace(accuracy, workspace=grown)}
    more = replace(result, accuracies=accuracies)
    (found,) = older_calibration(bench.first, more)
    assert found.code == "old-calibration-holds" and "use the older" in found.remedy
    (*_, step), recalibration = result.recalibration.steps, result.recalibration
    worse = replace(recalibration, steps=(replace(step, chi2=9.0 * step.dof),))
    (found,) = older_calibration(bench.first, replace(more, recalibration=worse))
    assert found.code == "old-calibration-no-longer-holds"


def test_what_no_parameter_describes_is_carried_on(bench) -> None:
    """Ten measurements do not show gears, and the robot has them all the same."""
    older = bench.first.accuracies[""]
    lacking = PoseErrors(0.2e-3, 0.3e-3)
    every = (older.measured, older.workspace)
    measured, workspace = (replace(one, unmodeled=lacking) for one in every)
    known = replace(older, measured=measured, workspace=workspace)
    start = replace(bench.first, accuracies={"": known})
    result = again(bench, bench.measured(2))
    alike = again(bench, bench.measured(2), start=start)
    then = again(bench, bench.measured(3), start=alike)
    for one in (alike, then):
        for there in (one.accuracy.measured, one.accuracy.workspace):
            assert there.unmodeled == pytest.approx(lacking)
    without = result.accuracy.workspace.calibrated
    expected = np.hypot(without, lacking)
    assert alike.accuracy.workspace.calibrated == pytest.approx(expected)


JUMP = {"elbow_joint.placement.ry": 1.5e-3}


def test_a_hit_joint_is_told_and_followed(bench) -> None:
    result = again(bench, bench.measured(4, changes=JUMP))
    found = codes(result)["old-calibration-no-longer-holds"]
    assert found.severity == "warning" and "'elbow_joint'" in found.message
    (jump,) = result.recalibration.last.jumps
    assert (jump.name, jump.kind, jump.unit) == ("elbow_joint", "offset", "rad")
    assert jump.change == pytest.approx(1.5e-3, abs=4.0 * jump.sigma)
    assert jump.sigma < 1.5e-4
    assert result.verdict == "good"
    assert bench.error(result, JUMP) < 0.15 * bench.error(bench.first, JUMP)
    # The jump does not count as drift, neither now nor the next time.
    sizes = {drift.name: drift.size for drift in result.recalibration.last.drifts}
    assert sizes["joint offsets"] < 6e-5 and sizes["geometry"] < 2e-5


FIRST_JOINT = {"shoulder_pan_joint.placement.rz": 5e-3}
LAST_JOINT = {"wrist_3_joint.placement.ry": 8e-3}
MOUNTED = FrameSetup((0.0505, 0.0796, 0.1203), estimate=True)


@pytest.mark.parametrize(
    ("changes", "tool", "kind", "others"),
    [
        (FIRST_JOINT, TOOL, "offset", "base"),
        (LAST_JOINT, TOOL, "offset", "tool"),
        (None, MOUNTED, "tool", "joint 'wrist_3_joint'"),
    ],
    ids=["first joint", "last joint", "tool"],
)
def test_changes_that_nothing_separates(bench, changes, tool, kind, others) -> None:
    data = bench.measured(4, changes=changes, tool=tool)
    result = again(bench, data, validate=False)
    (jump,) = result.recalibration.last.jumps
    assert jump.kind == kind and others in (*jump.instead, *jump.beside)
    holds = "old-calibration-holds" in codes(result)
    # It is the robot that does not hold, and may not hold.
    assert holds == (changes is None)
    (finding,) = [f for f in result.findings if f.code.startswith("old-calibration")]
    assert others in finding.message
    assert holds or "stated as known" in finding.remedy


def test_two_changes_are_told_apart(bench) -> None:
    data = bench.measured(4, changes=JUMP, tool=MOUNTED)
    result = again(bench, data, validate=False)
    kinds = {jump.kind for jump in result.recalibration.last.jumps}
    assert kinds == {"offset", "tool"}
    assert bench.error(result, JUMP) < 0.15 * bench.error(bench.first, JUMP)


@pytest.mark.parametrize(
    ("size", "count", "more"),
    [(0.5, 60, {}), (0.3, 25, {"moved": (0.3, -0.2, 0.1), "tool": MOUNTED})],
    ids=["on the bench", "set up anew"],
)
def test_many_changes_are_another_robot(bench, size, count, more) -> None:
    """Not a noisier instrument, also where base and tool are others as well."""
    rng = np.random.default_rng(0)
    parameters = bench.problem.parameters
    changes = {
        p.name: size * p.scale * rng.normal() for p in parameters if not p.nuisance
    }
    data = bench.measured(22, count, changes, **more)
    result = again(bench, data, validate=False)
    found = codes(result)["old-calibration-no-longer-holds"]
    assert "another robot of its type" in found.message
    assert bench.error(result, changes) < 0.2 * bench.error(bench.first, changes)


def test_gears_are_told_beside_an_older_calibration(bench) -> None:
    """It knows nothing of parameters that it has not estimated."""
    setup = Setup(parameters=("placement", "transmission"), tool_frame=TOOL)
    problem = nominal_problem(bench.chain, "position", setup)
    robot, rng = ~problem.parameters.nuisance, np.random.default_rng(7)
    theta = np.where(robot, 0.2 * draw_errors(problem.parameters, rng), 0.0)
    first, data = (
        simulate(problem, theta, rng, count=count, noise=NOISE) for count in (60, 30)
    )
    start = calib_pin.calibrate(bench.chain, first, validate=False)
    result = again(bench, data, start=start, validate=False)
    assert "transmission" in codes(result)["model-lacks"].message


def test_refusals(bench) -> None:
    data, first = bench.measured(2), bench.first
    unsure = replace(first, covariance=first.covariance * np.nan)
    with pytest.raises(OptionError, match="how sure it is"):
        calib_pin.calibrate(bench.chain, data, start=unsure)
    other = calib_pin.load_chain("example:ur10_robot", base="base_link", tip="ee_link")
    with pytest.raises(OptionError, match="ee_link"):
        calib_pin.calibrate(other, data, start=first)
    name = "elbow_joint.placement.x"
    held = tuple(
        replace(p, status="fixed") if p.name == name else p for p in first.parameters
    )
    with pytest.raises(OptionError, match=r"not estimated elbow_joint\.placement\.x"):
        calib_pin.calibrate(bench.chain, data, start=replace(first, parameters=held))
    model = replace(first.model, setup=Setup(report=ReportSetup(serial_number="A1")))
    setup = Setup(report=ReportSetup(serial_number="B2"))
    with pytest.raises(OptionError, match="'A1', these measurements are of 'B2'"):
        calib_pin.calibrate(bench.chain, data, setup, start=replace(first, model=model))
