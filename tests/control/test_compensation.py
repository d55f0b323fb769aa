"""Commands that make up for errors, and what is said of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.control.compensation import JUMP, compensate, follow
from calib_pin.control.joints import Joints
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.io.urdf import load_chain
from calib_pin.kinematics.spatial import Floats, invert
from calib_pin.observations import Conditions, approached
from calib_pin.parameterizations.error_model import ErrorModel
from calib_pin.setup import FrameSetup, Setup
from calib_pin.validation.calibrated_model import CalibratedChain, CalibratedModel
from tests.control.test_reaching import calibrated, robot
from tests.residual_models.corrections import Wave
from tests.shared import simulated

FIRST = np.array([0.2, -1.2, 1.5, -0.8, 1.2, 0.3])
WAY = np.array([0.8, 0.4, -0.5, 0.3, 0.4, 1.0])
LOST = [2e-3, 5e-4, 1e-3, 0.0, 2e-4, 1.5e-3]
"""Lost motion of each joint [rad]."""


@pytest.fixture(scope="module")
def model() -> CalibratedChain:
    """An UR10 with errors of millimeters, about known frames."""
    return calibrated(robot("ur10"))


@pytest.fixture
def q() -> Floats:
    """A motion away from singularities."""
    return FIRST + np.linspace(0.0, 1.0, 40)[:, None] * WAY


def test_targets(model, q):
    targets = model.poses(q)
    found = compensate(model, targets, q + 1e-3)
    assert found.reached.all()
    np.testing.assert_allclose(found.q, q, atol=1e-8)
    assert found.oriented
    # Before: where the real robot goes with what the nominal one would be told.
    nominal = model.error.poses(found.nominal, 0.0 * model.theta)
    np.testing.assert_allclose(nominal, targets, atol=1e-9)
    real = model.poses(found.nominal)
    distances = np.linalg.norm((real - targets)[:, :3, 3], axis=1)
    np.testing.assert_allclose(found.position_before, distances, atol=1e-12)
    assert distances.min() > 1e-4
    assert found.orientation_before.min() > 1e-4
    np.testing.assert_array_equal(found.corrections, found.q - found.nominal)
    assert 1e-4 < np.abs(found.corrections).max() < 0.1
    # At a limit, which is said.
    q[3, 5] = Joints.of(model.chain).upper[5]
    found = compensate(model, model.poses(q), q)
    assert found.reached.all()
    assert np.flatnonzero(found.at_limit).tolist() == [3]


def test_a_motion(model, q):
    found = follow(model, q)
    assert found.reached.all()
    assert not found.jumps.any()
    tips = model.error.tip_poses(found.q, model.theta)
    np.testing.assert_allclose(tips, model.chain.poses(q), atol=1e-9)
    np.testing.assert_array_equal(found.nominal, q)
    assert np.abs(found.corrections).max() < 0.05
    # As smooth as the motion itself.
    bends = np.diff(found.corrections, n=2, axis=0)
    assert np.abs(bends).max() < 1e-4
    # The base frame does not matter to a motion.
    moved = model.error.with_frames(model.error.base.inverse(), model.error.tool)
    other = follow(replace(model, error=moved), q)
    np.testing.assert_allclose(other.q, found.q, atol=1e-8)
    torn = found.q.copy()
    torn[7:] += 1.01 * JUMP * np.eye(6)[4]
    torn[20:] += 0.9 * JUMP
    assert np.flatnonzero(replace(found, q=torn).jumps).tolist() == [7]
    assert len(follow(model, q[:1]).jumps) == 1
    assert len(follow(model, q[:0]).jumps) == 0


def test_a_target_that_the_nominal_robot_cannot_reach(model):
    # Straight out: the real arm reaches a little farther than the nominal one, or less.
    q = np.tile([0.3, -0.8, 0.0, 0.2, 0.5, 0.1], (20, 1))
    q[:, 0] = np.linspace(-3.0, 3.0, 20)
    found = compensate(model, model.poses(q), q)
    assert found.reached.all()
    lost = np.isnan(found.nominal).any(axis=1)
    assert lost.any()
    assert np.isnan(found.position_before[lost]).all()
    assert len(found.corrections) == (~lost).sum()
    assert np.isfinite(found.corrections).all()


def test_what_was_learned_of_the_tool_moves_the_tip(model, q):
    learned = Wave(1e-3, np.zeros(len(model.theta)), "tip")
    model = replace(model, error=replace(model.error, learned=learned))
    found = follow(model, q)
    assert found.reached.all()
    # The tool stands still on the tip.
    tool = model.error.tool.homogeneous
    tips = invert(model.error.base.homogeneous) @ model.poses(found.q) @ invert(tool)
    np.testing.assert_allclose(tips, model.chain.poses(q), atol=1e-9)


def test_where_nothing_was_learned(model, q, monkeypatch):
    assert not follow(model, q).outside.any()
    monkeypatch.setattr(CalibratedChain, "outside", lambda _, q: q[:, 0] >= 0.6)
    for found in (follow(model, q), compensate(model, model.poses(q), q)):
        np.testing.assert_array_equal(found.outside, found.q[:, 0] >= 0.6)
        assert 0 < found.outside.sum() < len(q)


def test_the_real_robot_is_as_accurate_as_the_model() -> None:
    """Commanded targets are reached as well as unseen rows are predicted."""
    tool = FrameSetup((0.06, 0.02, 0.1), (0.0, 0.0, 0.0))
    setup = Setup(parameters=("placement", "transmission", "compliance"))
    true = replace(setup, tool_frame=tool)
    real, truth = simulated("position", true, 80, 1.0, 5, robot="pa10", noise=2e-5)
    q = real.chains.random_configurations(200, np.random.default_rng(6))
    targets = real.only.error.poses(q, truth)
    result = calib_pin.calibrate(real.chains, real.data, setup, validate=False)
    model = result.model.of()

    def error(poses: Floats, rows: Floats) -> float:
        return float(np.linalg.norm((poses - targets)[rows, :3, 3], axis=1).mean())

    found = compensate(model, targets, orientation=False)
    assert found.reached.mean() > 0.98
    assert found.position[found.reached].max() < 1e-9
    reached = real.only.error.poses(found.q, truth)
    assert error(reached, found.reached) < 1.25 * error(model.poses(q), found.reached)


def test_successive_targets_are_reached_without_whole_turns():
    """Also where gears are not exact, so that another turn is another solution."""
    setup = Setup(parameters=("joint-offset", "transmission"))
    chain = load_chain("example:ur10_robot", tip="tool0")
    problem = nominal_problem(chain, "pose", setup)
    names = list(problem.parameters.names)
    theta = np.zeros(len(names))
    theta[names.index("wrist_3_joint.transmission.gain")] = 3e-3
    theta[names.index("wrist_3_joint.transmission.sin1")] = 1e-3
    geared = CalibratedModel.create(problem, theta).of()
    q = np.tile([0.2, -1.2, 1.5, -0.8, 1.2, 0.0], (9, 1))
    q[:, 5] = np.linspace(2.0, 5.0, 9)
    found = compensate(geared, geared.poses(q))
    assert found.reached.all()
    np.testing.assert_allclose(geared.poses(found.q), geared.poses(q), atol=2e-9)
    joints = Joints.of(chain)
    np.testing.assert_array_equal(joints.within(found.q), found.q)
    # The wrist may flip, which is half a turn; no joint makes a whole one.
    assert np.abs(np.diff(found.q[:, 5])).max() < np.pi + 0.1
    # The wrist passes half a turn: without the turns it would come back.
    assert found.q[:, 5].max() > np.pi or found.q[:, 5].min() < -np.pi


@pytest.fixture(scope="module")
def lagging(model) -> CalibratedChain:
    """The same robot with lost motion of up to two milliradians."""
    names = ["placement", "transmission", "hysteresis"]
    error = ErrorModel.create(model.chain, names).with_frames(
        model.error.base, model.error.tool
    )
    known = dict(zip(model.error.parameters.names, model.theta, strict=True))
    known |= {
        f"{joint}.hysteresis.backlash": size
        for joint, size in zip(model.chain.joints, LOST, strict=True)
    }
    known |= {f"{joint}.transmission.gain": 1e-3 for joint in model.chain.joints}
    names = error.parameters.names
    theta = np.array([known.get(name, 0.0) for name in names])
    return replace(model, error=error, theta=theta)


def actual(model: CalibratedChain, q: Floats, before: Floats) -> Floats:
    """Where a robot gets that goes to one command after the other."""
    sides = approached(np.concatenate([before[None], q]))[1:]
    basis = model.error.basis(q, Conditions(direction=sides))
    return model.error.poses(q, model.theta, basis)


@pytest.mark.parametrize("stated", [True, False])
def test_lost_motion_along_a_path_with_reversals(lagging, stated):
    """Forth and back, in small steps, with joints that stand still for a while."""
    part = 0.5 * np.sin(np.linspace(0.0, 14.0, 60))[:, None]
    q = FIRST + part * WAY
    q[20:25] = q[20]
    before = q[0] - np.array([0.1, 0.1, -0.1, 0.1, 0.1, 0.1])
    targets = lagging.poses(q)
    found = compensate(lagging, targets, q if stated else None, before=before)
    assert found.reached.all()
    # No joint is at the edge of a reversal: it moves by its lost motion, or by none.
    np.testing.assert_allclose(
        actual(lagging, found.q, before), targets, rtol=0, atol=1e-9
    )
    assert found.position.max() < 1e-9
    if stated:
        lost = np.abs(np.diff(found.q, axis=0) - np.diff(q, axis=0)).max(axis=0)
        np.testing.assert_allclose(lost, LOST, rtol=0, atol=1e-4)
    # In the middle of the lost motion a robot would be off by half a millimeter.
    missed = actual(lagging, q, before)
    assert np.linalg.norm((missed - targets)[:, :3, 3], axis=1).max() > 5e-4


def test_a_motion_with_lost_motion(lagging, q):
    there_and_back = np.concatenate([q, q[::-1]])
    found = follow(lagging, there_and_back, before=q[0] - 0.05)
    sides = approached(np.concatenate([q[:1] - 0.05, found.q]))[1:]
    tips = lagging.error.tip_poses(found.q, lagging.theta, Conditions(direction=sides))
    expected = lagging.chain.poses(there_and_back)
    np.testing.assert_allclose(tips, expected, rtol=0, atol=1e-9)
    # Nothing is lost before a joint has moved.
    found = compensate(lagging, lagging.poses(q), q)
    assert not found.sides[0].any() and found.sides[1:].all()
