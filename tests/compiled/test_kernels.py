"""The compiled kernels against Pinocchio and numpy, on every robot and every size."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import combinations
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.compiled import comparisons, kernels, link_kernels
from calib_pin.compiled.blocks import BLOCK, motions
from calib_pin.errors import RobotError
from calib_pin.estimation.many_rows import ManyRows
from calib_pin.estimation.population import PopulationCost
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.segments import Segments
from calib_pin.io.urdf import load_chain, load_robot
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.robot import Robot
from calib_pin.kinematics.spatial import Floats, so3_exp, so3_log
from calib_pin.measurement_models import MEASUREMENT_MODELS

Measured = Callable[..., Problem]

COMPILED = ("position", "pose", "plane-distance")
"""One model for each number of vectors that a kernel carries through the chain."""

SIZES = (1, BLOCK - 1, BLOCK, BLOCK + 1, 3 * BLOCK + 5)


def longest_chains(robot: Robot) -> list[Chain]:
    """The longest chains from the root and between two leaves, as far as there are."""
    joints: dict[str, set[str]] = {}
    for leaf in robot.leaves:
        try:
            joints[leaf] = set(Chain(robot, tip=leaf).joints)
        except RobotError as error:
            assert "no moving joint" in error.reason or "cannot contain" in error.reason
    chains = []
    if joints:
        chains.append(Chain(robot, tip=max(joints, key=lambda leaf: len(joints[leaf]))))
    pairs = [(a, b) for a, b in combinations(joints, 2) if joints[a] ^ joints[b]]
    if pairs:
        ends = max(pairs, key=lambda pair: len(joints[pair[0]] ^ joints[pair[1]]))
        chains.append(Chain(robot, *ends))
    return chains


def problems(
    path: Path, measured: Measured, models: Iterable[str] = COMPILED
) -> Iterator[Problem]:
    """Measurement models on the longest chains of a robot."""
    robot = load_robot(path)
    for chain in longest_chains(robot):
        for model in models:
            yield measured(chain, model, ("placement", "dh"), 7, len(robot.source))


def members(problem: Problem, sizes: tuple[float, ...]) -> Floats:
    """Parameters of a size each: base, tool, robot and planes."""
    shape = len(sizes), len(problem.parameters)
    return np.random.default_rng(4).normal(size=shape) * np.array(sizes)[:, None]


def kernel_poses(problem: Problem, theta: Floats) -> Floats:
    """Tool poses of the error model by the kernels."""
    part, data, *_ = problem.blocks[0]
    segments = Segments.of(part.error)
    (chain,) = segments.links(part.values(theta)[0][None])
    q = data.q * segments.signs
    motion, starts = motions(q, segments.revolute)
    T = np.full((len(q), 4, 4), np.nan)
    kernels.poses(chain, motion, starts, T)
    return T


def assert_costs(found: Floats, problem: Problem, theta: Floats) -> None:
    """Compare with costs by Pinocchio.

    A residual is a difference of numbers of the size of the reach; their rounding, some
    ten operations at each, stays however small the difference is.
    """
    expected = [problem.cost(member) for member in theta]
    size = np.abs(problem.data.only.values).max(initial=1.0)
    rounding = 10.0 * np.finfo(float).eps * size / problem.sigma.ravel()
    tolerance = [np.abs(problem.residual(member)) @ rounding for member in theta]
    allowed = 1e-12 * np.array(expected) + tolerance
    assert (np.abs(found - expected) <= allowed).all()


# Every robot of example-robot-data.


def test_poses_agree_with_pinocchio(example_robot: Path, measured: Measured) -> None:
    for problem in problems(example_robot, measured, ["pose"]):
        for theta in members(problem, (0.0, 0.05, 0.5)):
            # The leader of a mimic joint may stand in another chain.
            part, data, *_ = problem.blocks[0]
            expected = part.poses(theta[part.index], data)
            found = kernel_poses(problem, theta)
            # Errors of half a radian about axes that nearly meet far away reach far.
            size = np.abs(expected).max()
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * size)


def test_costs_agree_with_pinocchio(example_robot: Path, measured: Measured) -> None:
    for problem in problems(example_robot, measured):
        # A beam of a distance hits at less than 70 degrees at nominal; errors of this
        # size leave it far from grazing, where rounding would be magnified.
        large = 0.02 if problem.data.models == ("plane-distance",) else 0.5
        theta = members(problem, (0.0, 1e-4, large, large))
        costs = PopulationCost(problem)
        assert costs.evaluator == "kernel"
        assert_costs(costs(theta), problem, theta)


def test_jacobians_agree_with_pinocchio(
    example_robot: Path, measured: Measured
) -> None:
    for problem in problems(example_robot, measured):
        rows = ManyRows(problem.blocks, problem.sigma)
        (theta,) = members(problem, (0.02,))
        r, J = problem.linearize(theta)
        lengths = np.linalg.norm(np.column_stack([J, r]), axis=0)
        lengths[lengths == 0.0] = 1.0
        expected = products(r, J) / np.outer(lengths, lengths)
        exact = products(*rows.factorize(theta)[0])
        exact /= np.outer(lengths, lengths)
        np.testing.assert_allclose(exact, expected, rtol=0, atol=1e-12)
        fast = rows.normal(theta)[0] / np.outer(lengths, lengths)
        np.testing.assert_allclose(fast, expected, rtol=0, atol=1e-12)


def products(r: Floats, J: Floats) -> Floats:
    """All products of columns, `[J r]^T [J r]`."""
    columns = np.column_stack([J, r])
    return np.asarray(columns.T @ columns)


# Blocks.


@pytest.mark.parametrize("rows", SIZES)
@pytest.mark.parametrize("model", COMPILED)
def test_any_number_of_rows(model: str, rows: int, measured: Measured) -> None:
    problem = measured(load_chain("space6"), model, ["placement"], rows)
    theta = members(problem, (0.02, 0.02, 0.0))
    assert_costs(PopulationCost(problem)(theta), problem, theta)


@pytest.mark.parametrize("model", MEASUREMENT_MODELS)
def test_every_model_has_a_batch_form(model: str, measured: Measured) -> None:
    problem = measured(load_chain("space6"), model, ["placement"], 2 * BLOCK + 3)
    theta = members(problem, (0.02, 0.005, 0.0))
    costs = PopulationCost(problem)
    assert costs.evaluator == "kernel"
    assert_costs(costs(theta), problem, theta)


def test_motions_of_turning_and_shifting_joints() -> None:
    q = np.array([[0.3, -0.7, 40.0], [1.2, 0.4, -2.0], [0.0, 2.0, 0.1]])
    revolute = np.array([True, False, True])
    q = np.resize(q, (BLOCK + 1, 3))
    motion, starts = motions(q, revolute)
    assert starts.tolist() == [0, BLOCK, BLOCK + 1]
    assert motion.shape == (2, 3, 3 * BLOCK)
    parts = motion.reshape(2, 3, 3, BLOCK)
    for block, k, row in ((0, 0, 0), (0, 1, 1), (1, 0, BLOCK)):
        for joint, position in enumerate(q[row]):
            turn = [np.cos(position), np.sin(position), 0.0]
            expected = turn if revolute[joint] else [1.0, 0.0, position]
            np.testing.assert_allclose(parts[block, joint, :, k], expected, rtol=1e-15)
    # What lies behind the rows of a block is never read, but stays finite.
    assert not parts[1, :, :, 1:].any()


# Screws.


def link_of(twist: Floats, amount: float) -> Floats:
    """Link (R | p) of a single screw on the identity, shape (3, 4)."""
    result = np.empty((1, 1, 12))
    one = np.zeros(1, np.int64)
    nominal = np.eye(4)[None, :3].reshape(1, 12)
    link_kernels.links(nominal, one, one, twist[None], np.array([[amount]]), result)
    return np.asarray(result.reshape(3, 4))


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    "angle",
    [
        *(1e-12, 1e-6, 1e-3, 9.9e-3, 1e-2 - 1e-9, 1e-2 + 1e-9, 1.1e-2),
        *(0.1, 1.0, 3.0, np.pi, 2.0 * np.pi, 6.0, 40.0),
    ],
)
def test_screws_of_any_angle(angle: float, sign: float) -> None:
    """The closed form takes over from the series at 1e-2."""
    rng = np.random.default_rng(6)
    for speed in (1.0, 0.03, 5.0):
        linear, axis = rng.normal(size=(2, 3))
        twist = np.concatenate([linear, speed * axis / np.linalg.norm(axis)])
        amount = sign * angle / speed
        expected = pin.exp6(twist * amount).homogeneous[:3]
        found = link_of(twist, amount)
        eps = float(np.finfo(float).eps)
        # Relative to the motion, which near zero is far smaller than the identity.
        # Above its series Pinocchio's own 1 - cos loses eps / angle of it.
        lost = 1e-14 + (eps / angle if angle > 1e-4 else 0.0)
        size = np.linalg.norm(expected[:, 3])
        np.testing.assert_allclose(
            found[:, 3], expected[:, 3], rtol=0, atol=lost * size
        )
        np.testing.assert_allclose(
            found[:, :3], expected[:, :3], rtol=0, atol=5e-15 + eps * angle
        )
        turn = found[[2, 0, 1], [1, 2, 0]] - found[[1, 2, 0], [2, 0, 1]]
        exact = 2.0 * np.sin(sign * angle) * twist[3:] / speed
        np.testing.assert_allclose(turn, exact, rtol=1e-13, atol=2e-14)


@pytest.mark.parametrize("amount", [1e-9, -0.3, 7.0])
def test_a_screw_without_rotation_shifts(amount: float) -> None:
    found = link_of(np.array([0.6, 0.0, -0.8, 0.0, 0.0, 0.0]), amount)
    np.testing.assert_array_equal(found[:, :3], np.eye(3))
    np.testing.assert_allclose(found[:, 3], [0.6 * amount, 0.0, -0.8 * amount])


# Rotation vectors.


@pytest.mark.parametrize(
    "angle",
    [
        *(0.0, 1e-300, 1e-15, 1e-12, 1e-8, 1e-4, 1.0, np.pi / 2, 2 * np.pi / 3, 3.0),
        *(np.pi - 1e-4, np.pi - 1e-7, np.pi - 1e-10),
    ],
)
def test_rotation_vectors(angle: float) -> None:
    # Every component takes its turn at being the largest.
    axes = np.random.default_rng(7).normal(size=(20, 3))
    axes = np.concatenate([np.eye(3), -np.eye(3), [[1, 1, 1], [1, -1, 0]], axes])
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    for R in so3_exp(angle * axes):
        found = comparisons.rotation_vector(R)
        np.testing.assert_allclose(found, so3_log(R), rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 0.5, 1.04])
def test_little_rotations_together(angle: float) -> None:
    """The series agree with the logarithm up to 60 degrees, where they end."""
    axes = np.random.default_rng(8).normal(size=(BLOCK, 3))
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    R = so3_exp(angle * axes)
    for i, weights in enumerate(np.eye(3)):
        by_entry = R.reshape(-1, 9).T.ravel().copy()
        found = comparisons.little_turned(by_entry, np.tile(weights[:, None], BLOCK))
        expected = np.sum(so3_log(R)[:, i] ** 2)
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-30)


def test_rotation_vectors_of_half_turns() -> None:
    """Either sign is right."""
    axes = np.random.default_rng(7).normal(size=(20, 3))
    axes = np.concatenate([np.eye(3), axes])
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    for axis, R in zip(axes, so3_exp(np.pi * axes), strict=True):
        found = np.array(comparisons.rotation_vector(R))
        assert np.linalg.norm(found) == pytest.approx(np.pi, rel=1e-14)
        assert abs(found @ axis) == pytest.approx(np.pi, rel=1e-14)
