"""How far tips are apart once frames have absorbed what they can."""

from __future__ import annotations

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.kinematics.spatial import invert, se3_exp, so3_log
from calib_pin.setup import Setup
from calib_pin.validation.calibrated_model import CalibratedChain, CalibratedModel
from calib_pin.validation.tip_drift import TipDrift, absorbed, tip_drift
from tests.shared import chain_of, urdf_of

LEFT = se3_exp(np.array([0.3, -0.2, 0.1, 0.4, -0.3, 0.2]))
RIGHT = se3_exp(np.array([0.02, 0.03, -0.05, 0.2, 0.1, -0.3]))


@pytest.fixture(scope="module")
def poses():
    chain = calib_pin.load_chain("space6")
    return chain.poses(chain.random_configurations(50, np.random.default_rng(0)))


def model_of(theta_of=lambda names: {}, setup=None, chain=None) -> CalibratedChain:
    """A robot with parameter values by name."""
    chain = chain or calib_pin.load_chain("space6")
    problem = nominal_problem(chain, "pose", setup or Setup())
    theta = problem.parameters.vector(theta_of(problem.parameters.names))
    return CalibratedModel.create(problem, theta).of()


# --- displacements -----------------------------------------------------------------


@pytest.mark.parametrize(
    ("L", "R", "left", "right"),
    [
        (LEFT, RIGHT, True, True),
        (LEFT, np.eye(4), True, False),
        (np.eye(4), RIGHT, False, True),
        (np.eye(4), np.eye(4), False, False),
    ],
)
def test_displacements_are_found(L, R, left, right, poses):
    moved = invert(L) @ poses @ invert(R)
    found = absorbed(poses, moved, left=left, right=right)
    np.testing.assert_allclose(found, poses, atol=1e-10)
    # What is known is not absorbed.
    if left and not right:
        by_tool = absorbed(poses, moved, left=False)
        assert np.linalg.norm((by_tool - poses)[:, :3, 3], axis=1).max() > 0.1


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_a_single_joint_leaves_frames_that_do_alike(kind):
    joint = {"name": "j", "type": kind, "parent": "a", "child": "b"}
    chain = chain_of(urdf_of(joint))
    T = chain.poses(np.linspace(-1.0, 1.0, 20)[:, None])
    found = absorbed(T, LEFT @ T @ RIGHT)
    np.testing.assert_allclose(found, T, atol=1e-9)


# --- robots ------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["joint_1.placement.rz", "joint_6.placement.rz"])
def test_what_base_and_tool_can_absorb_is_no_drift(name):
    nominal, moved = model_of(), model_of(lambda _: {name: 2e-3})
    honest = tip_drift(nominal, moved, base=True, tool=True)
    assert honest.position.max < 1e-10 and honest.orientation.max < 1e-10
    assert honest.absorbed == ("base", "tool")
    plain = tip_drift(nominal, moved, base=False, tool=False)
    assert plain.orientation.max == pytest.approx(2e-3, rel=1e-6)
    assert plain.absorbed == ()


def test_a_drift_beyond_frames():
    first, second = model_of(), model_of(lambda _: {"joint_3.placement.rz": 2e-3})
    drift = tip_drift(first, second, base=False, tool=False, seed=3)
    q, k = drift.q, drift.farthest
    assert q.shape == (1000, 6) and drift.drift.shape == drift.turn.shape == (1000,)
    T, moved = (model.poses(q) for model in (first, second))
    np.testing.assert_allclose(drift.points, T[:, :3, 3], atol=1e-12)
    sizes = np.linalg.norm((moved - T)[:, :3, 3], axis=1)
    np.testing.assert_allclose(drift.drift, sizes, atol=1e-12)
    turns = so3_log(invert(T)[:, :3, :3] @ moved[:, :3, :3])
    np.testing.assert_allclose(drift.turn, np.linalg.norm(turns, axis=1), atol=1e-9)
    assert drift.drift[k] == drift.position.max
    again = tip_drift(first, second, base=False, tool=False, seed=4)
    assert not np.array_equal(again.q, q)


def test_rounding_is_beyond_no_noise():
    # Joints that slide do not turn the tool: noise explains nothing of its rounding.
    none, explained = np.zeros((3, 3)), (1e-5, 1e-20)
    drift = TipDrift(none, none, np.full(3, 2e-6), np.full(3, 3e-17), (), explained)
    assert drift.ratio == pytest.approx(0.2)
