"""Corrections of the joints and what was learned, in poses and their derivatives."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.io.urdf import load_chain
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.parameterizations.error_model import ErrorModel
from calib_pin.parameterizations.learned import Learned
from calib_pin.setup import Setup

Space = Literal["joint", "tip"]
SPACES: tuple[Space, ...] = ("joint", "tip")
EVERYTHING = ("placement", "transmission", "compliance")


@dataclass(frozen=True)
class Wave:
    """Something learned: a smooth function of all joint positions."""

    space: Space
    size: float = 0.1
    shift: Floats = field(default_factory=lambda: np.zeros(1))

    def __call__(self, q: Floats) -> Floats:
        count = q.shape[1] if self.space == "joint" else 6
        mixed = np.sin(np.arange(1.0, 1.0 + q.shape[1] * count)).reshape(-1, count)
        return np.asarray(self.size * np.sin(q @ mixed + np.arange(count)))

    def weight(self, q: Floats) -> Floats:
        return np.ones(len(q))


@dataclass(frozen=True)
class Constant:
    """A correction that stays where it is."""

    space: Space
    value: Floats
    shift: Floats = field(default_factory=lambda: np.zeros(1))

    def __call__(self, q: Floats) -> Floats:
        return np.tile(self.value, (len(q), 1))

    def weight(self, q: Floats) -> Floats:
        return np.ones(len(q))


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


def body_twists(T: Floats, ahead: Floats, behind: Floats, step: float) -> Floats:
    """Central difference of poses as body twists at T, shape (N, 6)."""

    def log(moved: Floats) -> Floats:
        pairs = zip(T, moved, strict=True)
        return np.array(
            [pin.log6(pin.SE3(at).actInv(pin.SE3(to))).vector for at, to in pairs]
        )

    return np.asarray((log(ahead) - log(behind)) / (2.0 * step))


# Poses.


def test_what_was_learned_of_the_joints_is_added(framed: Setup) -> None:
    model = model_of(load_chain("space6"), framed, Wave("joint"))
    q, theta = some(model)
    plain = replace(model, learned=None)
    at = model.joint_positions(q, theta)
    by_parameters = plain.joint_positions(q, theta) - q
    assert np.abs(by_parameters).max() > 0.01
    np.testing.assert_allclose(at, q + by_parameters + Wave("joint")(q), atol=1e-15)
    geometry = model_of(model.chain, framed, None, ("placement",))
    values = dict(zip(model.parameters.names, theta, strict=True))
    of_geometry = np.array([values[name] for name in geometry.parameters.names])
    np.testing.assert_allclose(
        model.poses(q, theta), geometry.poses(at, of_geometry), rtol=0, atol=1e-14
    )


def test_what_was_learned_of_the_tip_stands_behind_the_tool(framed: Setup) -> None:
    model = model_of(load_chain("space6"), framed, Wave("tip"))
    q, theta = some(model)
    plain = replace(model, learned=None)
    moves = [pin.exp6(twist).homogeneous for twist in Wave("tip")(q)]
    expected = plain.poses(q, theta) @ np.array(moves)
    np.testing.assert_allclose(model.poses(q, theta), expected, rtol=0, atol=1e-14)
    # Neither the joints nor the tip know of it.
    for name in ("joint_positions", "tip_poses"):
        found, same = (getattr(m, name)(q, theta) for m in (model, plain))
        np.testing.assert_array_equal(found, same)


@pytest.mark.parametrize("space", SPACES)
def test_parameters_shift_along_with_what_was_learned(
    space: Space, framed: Setup
) -> None:
    model = model_of(load_chain("space6"), framed)
    q, theta = some(model)
    shift = theta[::-1]
    shifted = replace(model, learned=Wave(space, shift=shift))
    same = replace(model, learned=Wave(space))
    assert np.abs(shifted.poses(q, theta) - same.poses(q, theta)).max() > 0.01
    for name in ("poses", "tip_poses", "joint_positions"):
        found = getattr(shifted, name)(q, theta)
        expected = getattr(same, name)(q, theta + shift)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14)
    for found, expected in zip(
        shifted.jacobian(q, theta), same.jacobian(q, theta + shift), strict=True
    ):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("learned", [None, Wave("joint", 0.5)])
def test_functions_are_of_commanded_positions(
    learned: Learned | None, framed: Setup
) -> None:
    """However far the joints move, harmonics and torques are those of the command."""
    chain = load_chain("space6")
    kinds = ("joint-offset", "transmission", "compliance")
    model = model_of(chain, framed, learned, kinds)
    q, _ = some(model)
    load = next(iter(framed.payloads.values()))
    torque = chain.gravity_torques(q, framed.gravity, load)[:, 2]
    values = {
        "joint_3.joint-offset.q": 0.7,
        "joint_3.transmission.gain": 0.4,
        "joint_3.transmission.sin1": 0.5,
        "joint_3.transmission.motor_cos": 0.2,
        "joint_3.compliance.k": 0.01,
    }
    theta = model.parameters.vector(values)
    x = q[:, 2]
    expected = 0.4 * x + 0.5 * np.sin(x) + 0.2 * np.cos(-31.5 * x) + 0.01 * torque
    found = model.joint_positions(q, theta) - q
    if learned is not None:
        found -= learned(q)
    np.testing.assert_allclose(found[:, 2], expected, rtol=0, atol=1e-14)
    np.testing.assert_allclose(np.delete(found, 2, axis=1), 0.0, rtol=0, atol=1e-15)
    # The offset is a matter of geometry: the chain turns by it all the same.
    moved = q.copy()
    moved[:, 2] += 0.7 + expected
    if learned is not None:
        moved += learned(q)
    T = model.base.homogeneous @ chain.poses(moved) @ model.tool.homogeneous
    np.testing.assert_allclose(model.poses(q, theta), T, rtol=0, atol=1e-13)


def test_functions_are_evaluated_together(
    framed: Setup, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One sweep for the torques of all joints."""
    chain = load_chain("space6")
    model = model_of(chain, framed)
    q, theta = some(model)
    count = 0
    torques = Chain.gravity_torques

    def counted(*arguments: object) -> Floats:
        nonlocal count
        count += 1
        return torques(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(Chain, "gravity_torques", counted)
    model.poses(q, theta)
    assert count == 1


# Derivatives.


@pytest.mark.parametrize("space", [None, *SPACES])
def test_jacobian(space: Space | None, special_chain: Chain, framed: Setup) -> None:
    model = model_of(special_chain, framed)
    q, theta = some(model)
    if space is not None:
        model = replace(model, learned=Wave(space, 0.3, theta[::-1]))
    T, J = model.jacobian(q, theta)
    np.testing.assert_allclose(T, model.poses(q, theta), rtol=0, atol=1e-14)
    step, largest = 1e-6, np.abs(J).max(axis=(0, 1))
    names = model.parameters.names
    assert names[0] == "base.frame.x" and names[-1] == "tool.frame.rz"
    for k in range(len(theta)):
        shift = step * np.eye(len(theta))[k]
        ahead, behind = (model.poses(q, theta + s) for s in (shift, -shift))
        expected = body_twists(T, ahead, behind, step)
        tolerance = 1e-8 * max(1.0, largest[k])
        np.testing.assert_allclose(
            J[:, :, k], expected, rtol=0, atol=tolerance, err_msg=names[k]
        )


@pytest.mark.parametrize("space", SPACES)
def test_twists_by_joint_positions(
    space: Space, special_chain: Chain, framed: Setup
) -> None:
    """Those of the joints themselves: what was learned and what sags stays."""
    count = len(special_chain.joints)
    value = 0.2 * np.sin(np.arange(count if space == "joint" else 6) + 1.0)
    model = model_of(special_chain, framed, Constant(space, value))
    q, theta = some(model)
    linear = model.linearize(q, theta)
    found = linear.joint_twists()
    assert found.shape == (len(q), 6, count)
    if space == "joint":
        value, behind_tool = model.joint_positions(q, theta) - q, np.eye(4)
    else:
        behind_tool = pin.exp6(value).homogeneous
        value = replace(model, learned=None).joint_positions(q, theta) - q
    placed = model.corrections(theta)
    base, tool = model.base * placed[0], placed[-2] * model.tool * placed[-1]
    placements = [
        nominal * correction
        for nominal, correction in zip(
            special_chain.placements, placed[1:-2], strict=True
        )
    ]

    def poses(shift: Floats) -> Floats:
        F = special_chain.poses(q + value + shift, placements)
        return np.asarray(base.homogeneous @ F @ tool.homogeneous @ behind_tool)

    T = poses(np.zeros(count))
    np.testing.assert_allclose(T, linear.T, rtol=0, atol=1e-13)
    step = 1e-6
    for k in range(count):
        shift = step * np.eye(count)[k]
        expected = body_twists(T, poses(shift), poses(-shift), step)
        np.testing.assert_allclose(found[:, :, k], expected, rtol=0, atol=2e-9)


# What there is.


@pytest.mark.parametrize(
    ("parameterizations", "learned", "geometric"),
    [
        (("placement", "joint-offset", "dh"), None, True),
        ((), None, True),
        (("transmission",), None, False),
        (("placement", "compliance"), None, False),
        (("placement",), Wave("joint"), False),
        (("placement",), Wave("tip"), False),
    ],
)
def test_what_a_urdf_can_hold(
    parameterizations: tuple[str, ...],
    learned: Learned | None,
    geometric: bool,
    framed: Setup,
) -> None:
    model = model_of(load_chain("space6"), framed, learned, parameterizations)
    assert model.geometric is geometric


def test_positions_of_joint_corrections(framed: Setup) -> None:
    model = model_of(load_chain("space6"), framed)
    kinds = [name.split(".")[1] for name in model.parameters.names]
    found = [kinds[k] for k in model.joint_corrections]
    assert found == (["transmission"] * 9 + ["compliance"]) * 6
    assert kinds.count("transmission") + kinds.count("compliance") == len(found)
    q, _ = some(model)
    assert model.basis(q).shape == (len(q), len(found))
    assert model.basis(q[:0]).shape == (0, len(found))
    none = model_of(model.chain, framed, None, ("placement",))
    assert none.basis(q).shape == (len(q), 0)


@dataclass(frozen=True)
class Fading(Wave):
    """Counts where the first joint is positive, and fades towards -1 rad."""

    def weight(self, q: Floats) -> Floats:
        return np.clip(1.0 + q[:, 0], 0.0, 1.0)


@pytest.mark.parametrize("space", SPACES)
def test_what_was_learned_fades_with_its_shift(space: Space, framed: Setup) -> None:
    """Far away the robot is as it was fitted; the shift alone would be worse."""
    plain = model_of(load_chain("space6"), framed)
    q, theta = some(plain, 4)
    fading = replace(plain, learned=Fading(space, 1e-3, 0.01 * theta))
    whole = replace(plain, learned=Wave(space, 1e-3, 0.01 * theta))
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
def test_derivatives_where_what_was_learned_fades(space: Space, framed: Setup) -> None:
    model = model_of(load_chain("space6"), framed)
    q, theta = some(model, 4)
    q[:, 0] = 0.5, -0.2, -0.8, -2.0
    model = replace(model, learned=Fading(space, 0.1, 0.5 * theta))
    T, J = model.jacobian(q, theta)
    step = 1e-6
    for k in range(len(theta)):
        ends = [
            model.poses(q, theta + s * np.eye(len(theta))[k]) for s in (step, -step)
        ]
        moved = np.linalg.inv(T) @ (ends[0] - ends[1]) / (2.0 * step)
        found = moved[:, [0, 1, 2, 2, 0, 1], [3, 3, 3, 1, 2, 0]]
        # Central differences err by step^2, rounding by 1e-16 / step.
        np.testing.assert_allclose(J[:, :, k], found, atol=1e-9)


@pytest.mark.parametrize("space", [None, *SPACES])
def test_kinematics_are_those_of_the_linearization(
    space: Space | None, special_chain: Chain, framed: Setup
) -> None:
    model = model_of(special_chain, framed)
    q, theta = some(model, 4)
    if space is not None:
        model = replace(model, learned=Wave(space, 1e-3, 0.1 * theta))
    linear = model.linearize(q, theta)
    T, J = model.kinematics(q, theta)
    np.testing.assert_allclose(T, linear.T, atol=1e-12)
    np.testing.assert_allclose(J, linear.joint_twists(), atol=1e-12)
    still = np.where(np.isin(np.arange(len(theta)), model.joint_corrections), 0, theta)
    np.testing.assert_allclose(
        model.kinematics(q, still)[0], model.poses(q, still), atol=1e-12
    )
