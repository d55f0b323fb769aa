"""Corrections of the joints and what was learned, in poses and their derivatives."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.io.urdf import load_chain
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.parameterizations.error_model import ErrorModel, Learned
from calib_pin.setup import Setup
from tests.residual_models.corrections import Wave
from tests.shared import FRAMED

Space = Literal["joint", "tip"]
SPACES: tuple[Space, ...] = ("joint", "tip")
EVERYTHING = ("placement", "transmission", "compliance")


def model_of(
    chain: Chain,
    setup: Setup,
    learned: Learned | None = None,
    parameterizations: tuple[str, ...] = EVERYTHING,
) -> ErrorModel:
    """A model between frames that stand somewhere."""
    rng = np.random.default_rng(2)
    frames = (pin.exp6(rng.normal(size=6)) for _ in range(2))
    model = ErrorModel.create(chain, parameterizations, setup=setup)
    return replace(model.with_frames(*frames), learned=learned)


def some(model: ErrorModel, count: int = 3) -> tuple[Floats, Floats]:
    """Configurations, and parameter values of some size."""
    rng = np.random.default_rng(5)
    q = model.chain.random_configurations(count, rng)
    # Compliances are small, and so are those of the torques.
    sizes = 20.0 * np.minimum(model.parameters.scales, 2e-3)
    return q, sizes * rng.normal(size=len(sizes))


def test_what_was_learned_of_the_joints_is_added() -> None:
    model = model_of(load_chain("space6"), FRAMED, Wave())
    q, theta = some(model)
    plain = replace(model, learned=None)
    at = model.joint_positions(q, theta)
    by_parameters = plain.joint_positions(q, theta) - q
    assert np.abs(by_parameters).max() > 0.01
    np.testing.assert_allclose(at, q + by_parameters + Wave()(q), atol=1e-12)
    geometry = model_of(model.chain, FRAMED, None, ("placement",))
    values = dict(zip(model.parameters.names, theta, strict=True))
    of_geometry = np.array([values[name] for name in geometry.parameters.names])
    np.testing.assert_allclose(
        model.poses(q, theta), geometry.poses(at, of_geometry), rtol=0, atol=1e-13
    )
    assert plain.geometric is model.geometric is False
    assert (
        geometry.geometric
        and not replace(geometry, learned=Wave(space="tip")).geometric
    )


def test_what_was_learned_of_the_tip_stands_behind_the_tool() -> None:
    model = model_of(load_chain("space6"), FRAMED, Wave(space="tip"))
    q, theta = some(model)
    plain = replace(model, learned=None)
    moves = [pin.exp6(twist).homogeneous for twist in Wave(space="tip")(q)]
    expected = plain.poses(q, theta) @ np.array(moves)
    np.testing.assert_allclose(model.poses(q, theta), expected, rtol=0, atol=1e-13)
    # Neither the joints nor the tip know of it.
    for name in ("joint_positions", "tip_poses"):
        found, same = (getattr(m, name)(q, theta) for m in (model, plain))
        np.testing.assert_array_equal(found, same)


@pytest.mark.parametrize("space", SPACES)
def test_parameters_shift_along_with_what_was_learned(space: Space) -> None:
    model = model_of(load_chain("space6"), FRAMED)
    q, theta = some(model)
    shift = theta[::-1]
    shifted = replace(model, learned=Wave(space=space, shift=shift))
    same = replace(model, learned=Wave(space=space))
    assert np.abs(shifted.poses(q, theta) - same.poses(q, theta)).max() > 0.01
    for name in ("poses", "tip_poses", "joint_positions"):
        found = getattr(shifted, name)(q, theta)
        expected = getattr(same, name)(q, theta + shift)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13)
    for found, expected in zip(
        shifted.jacobian(q, theta), same.jacobian(q, theta + shift), strict=True
    ):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


def test_functions_are_of_commanded_positions() -> None:
    """However far the joints move, harmonics and torques are those of the command."""
    chain, learned = load_chain("space6"), Wave(0.5)
    kinds = ("joint-offset", "transmission", "compliance")
    model = model_of(chain, FRAMED, learned, kinds)
    q, _ = some(model)
    load = next(iter(FRAMED.payloads.values()))
    torque = chain.gravity_torques(q, FRAMED.gravity, load)[:, 2]
    values = {
        "joint_3.joint-offset.q": 0.7,
        "joint_3.transmission.gain": 0.4,
        "joint_3.transmission.sin1": 0.5,
        "joint_3.transmission.motor_cos": 0.2,
        "joint_3.compliance.k": 0.01,
    }
    theta = model.parameters.vector(values)
    moved, x = q + learned(q), q[:, 2]
    own = 0.4 * x + 0.5 * np.sin(x) + 0.2 * np.cos(-31.5 * x) + 0.01 * torque
    moved[:, 2] += own
    found = model.joint_positions(q, theta)
    np.testing.assert_allclose(found, moved, rtol=0, atol=1e-13)
    # The offset is a matter of geometry: the chain turns by it all the same.
    moved[:, 2] += 0.7
    T = model.base.homogeneous @ chain.poses(moved) @ model.tool.homogeneous
    np.testing.assert_allclose(model.poses(q, theta), T, rtol=0, atol=1e-13)


@dataclass(frozen=True)
class Fading(Wave):
    """Counts where the first joint is positive, and fades towards -1 rad."""

    def weight(self, q: Floats) -> Floats:
        return np.clip(1.0 + q[:, 0], 0.0, 1.0)


@pytest.mark.parametrize("space", SPACES)
def test_what_was_learned_fades_with_its_shift(space: Space) -> None:
    """Far away the robot is as it was fitted; the shift alone would be worse."""
    plain = model_of(load_chain("space6"), FRAMED)
    q, theta = some(plain, 4)
    fading = replace(plain, learned=Fading(1e-3, 0.01 * theta, space))
    whole = replace(plain, learned=Wave(1e-3, 0.01 * theta, space))
    q[:, 0] = 0.5, -0.5, -1e-9, -2.0
    before, after = plain.poses(q, theta), whole.poses(q, theta)
    found = fading.poses(q, theta)
    np.testing.assert_array_equal(found[3], before[3])
    np.testing.assert_allclose(found[[0, 2]], after[[0, 2]], atol=1e-8)
    middle = 0.5 * (before[1, :3, 3] + after[1, :3, 3])
    np.testing.assert_allclose(found[1, :3, 3], middle, atol=1e-12)
    halves = [pin.log3(T[1, :3, :3].T @ found[1, :3, :3]) for T in (before, after)]
    np.testing.assert_allclose(halves[0], -halves[1], atol=1e-12)
    # Derivatives by parameters and joints are those of the poses but for what fades.
    linear, size = fading.linearize(q, theta), np.abs(after - before).max()
    np.testing.assert_array_equal(linear.T, found)
    exact = plain.linearize(q, theta).joint_twists()
    assert 0.0 < size < 0.2
    assert np.abs(linear.joint_twists() - exact).max() < 5.0 * size


@pytest.mark.parametrize("space", SPACES)
def test_derivatives_where_what_was_learned_fades(space: Space) -> None:
    """Where it counts in full, in part, and not at all."""
    model = model_of(load_chain("space6"), FRAMED)
    q, theta = some(model, 4)
    q[:, 0] = 0.5, -0.2, -0.8, -2.0
    model = replace(model, learned=Fading(0.1, 0.5 * theta, space))
    T, J = model.jacobian(q, theta)
    step = 1e-6
    # The columns of two joints in the middle, and of the frames.
    for k in [*range(6), *range(22, 42), *range(len(theta) - 6, len(theta))]:
        ends = [
            model.poses(q, theta + s * np.eye(len(theta))[k]) for s in (step, -step)
        ]
        moved = np.linalg.inv(T) @ (ends[0] - ends[1]) / (2.0 * step)
        found = moved[:, [0, 1, 2, 2, 0, 1], [3, 3, 3, 1, 2, 0]]
        # Central differences err by step^2, rounding by 1e-16 / step.
        np.testing.assert_allclose(J[:, :, k], found, atol=1e-8)


@pytest.mark.parametrize("space", [None, *SPACES])
def test_kinematics_are_those_of_the_linearization(
    space: Space | None, special_chain: Chain
) -> None:
    model = model_of(special_chain, FRAMED)
    q, theta = some(model, 2)
    if space is not None:
        model = replace(model, learned=Wave(1e-3, 0.1 * theta, space))
    linear = model.linearize(q, theta)
    T, J = model.kinematics(q, theta)
    np.testing.assert_allclose(T, linear.T, atol=1e-12)
    np.testing.assert_allclose(J, linear.joint_twists(), atol=1e-12)
    still = np.where(np.isin(np.arange(len(theta)), model.joint_corrections), 0, theta)
    T, J = model.kinematics(q, still)
    np.testing.assert_allclose(T, model.poses(q, still), atol=1e-12)
    if space is None:
        # Only the geometry is left, and twists are the derivatives of the poses.
        for k in range(q.shape[1]):
            step = 1e-6 * np.eye(q.shape[1])[k]
            ends = [model.poses(q + s, still) for s in (step, -step)]
            moved = np.linalg.inv(T) @ (ends[0] - ends[1]) / 2e-6
            found = moved[:, [0, 1, 2, 2, 0, 1], [3, 3, 3, 1, 2, 0]]
            np.testing.assert_allclose(J[:, :, k], found, atol=1e-8)
