"""The compiled kernels against Pinocchio and numpy."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.compiled import kernels, link_kernels
from calib_pin.compiled.blocks import BLOCK, motions
from calib_pin.errors import RobotError
from calib_pin.estimation.many_rows import ManyRows, Segments
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.solve import PopulationCost
from calib_pin.io.urdf import load_chain, load_robot
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.robot import Robot
from calib_pin.kinematics.spatial import Floats, so3_exp, so3_log
from calib_pin.parameterizations.error_model import ErrorModel
from tests.shared import measured

COMPILED = ("position", "pose", "plane-distance")
"""One model for each number of vectors that a kernel carries through the chain."""


def longest_chain(robot: Robot) -> Chain | None:
    """The chain of the most joints from the root to a leaf, if one moves."""
    chains = []
    for leaf in robot.leaves:
        try:
            chains.append(Chain(robot, tip=leaf))
        except RobotError:
            continue  # No joint moves on the way, or one of an unknown kind.
    return max(chains, key=lambda chain: len(chain.joints), default=None)


def problems(path: Path) -> Iterator[Problem]:
    """Measurement models on the longest chain of a robot."""
    robot = load_robot(path)
    chain = longest_chain(robot)
    for model in COMPILED if chain is not None else ():
        yield measured(chain, model, ("placement", "dh"), 7, len(robot.source))


def members(problem: Problem, sizes: tuple[float, ...]) -> Floats:
    """Parameters of a size each: base, tool, robot and planes."""
    shape = len(sizes), len(problem.parameters)
    return np.random.default_rng(4).normal(size=shape) * np.array(sizes)[:, None]


def kernel_poses(error: ErrorModel, theta: Floats, q: Floats) -> Floats:
    """Tool poses of an error model by the kernels, shape (N, 4, 4)."""
    segments = Segments(error)
    (chain,) = segments.links(theta[None])
    motion, starts = motions(q * segments.signs, segments.revolute)
    T = np.full((len(q), 4, 4), np.nan)
    kernels.poses(chain, motion, starts, T)
    return T


def assert_costs(problem: Problem, theta: Floats) -> None:
    """Compare with costs by Pinocchio.

    A residual is a difference of numbers of the size of the reach; their rounding, some
    ten operations at each, stays however small the difference is.
    """
    costs = PopulationCost(problem)
    assert costs.evaluator == "kernel"
    expected = [problem.cost(member) for member in theta]
    size = np.abs(problem.data.only.values).max(initial=1.0)
    rounding = 10.0 * np.finfo(float).eps * size / problem.sigma.ravel()
    tolerance = [np.abs(problem.residual(member)) @ rounding for member in theta]
    allowed = 1e-12 * np.array(expected) + tolerance
    assert (np.abs(costs(theta) - expected) <= allowed).all()


def products(r: Floats, J: Floats) -> Floats:
    """All products of columns, `[J r]^T [J r]`."""
    columns = np.column_stack([J, r])
    return np.asarray(columns.T @ columns)


def test_all_robots(example_robot: Path) -> None:
    """Poses, costs and Jacobians agree with Pinocchio."""
    for problem in problems(example_robot):
        part, data, *_ = problem.blocks[0]
        # A beam of a distance hits at less than 70 degrees at nominal; errors of this
        # size leave it far from grazing, where rounding would be magnified.
        large = 0.02 if problem.data.models == ("plane-distance",) else 0.5
        theta = members(problem, (0.0, 0.02, large, large))
        assert_costs(problem, theta)
        # The leader of a mimic joint may stand in another chain.
        for member in theta[:3]:
            expected = part.poses(member[part.index], data)
            size = np.abs(expected).max()
            found = kernel_poses(part.error, part.values(member)[0], data.q)
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * size)
        rows = ManyRows(problem.blocks[0], problem.sigma)
        r, J = problem.linearize(theta[1])
        lengths = np.linalg.norm(np.column_stack([J, r]), axis=0)
        lengths[lengths == 0.0] = 1.0
        unit, exact = np.outer(lengths, lengths), products(r, J)
        found = products(*rows.factorize(theta[1]))
        np.testing.assert_allclose(found / unit, exact / unit, rtol=0, atol=1e-11)


@pytest.mark.parametrize("rows", [1, BLOCK - 1, BLOCK, BLOCK + 1])
def test_costs_of_any_number_of_rows(rows: int) -> None:
    """Of every model they are compared in `test_many_rows`."""
    problem = measured(load_chain("space6"), "pose", ["placement"], rows)
    assert_costs(problem, members(problem, (0.02, 0.005, 0.0)))


# Screws and rotation vectors.


def link_of(twist: Floats, amount: float) -> Floats:
    """Link (R | p) of a single screw on the identity, shape (3, 4)."""
    result = np.empty((1, 1, 12))
    one = np.zeros(1, np.int64)
    nominal = np.eye(4)[None, :3].reshape(1, 12)
    link_kernels.links(nominal, one, one, twist[None], np.array([[amount]]), result)
    return np.asarray(result.reshape(3, 4))


@pytest.mark.parametrize(
    "angle", [0.0, 1e-12, 1e-4, 1e-2 - 1e-9, -1e-2 - 1e-9, 0.1, np.pi, -40.0]
)
def test_screws_of_any_angle(angle: float) -> None:
    """The closed form takes over from the series at 1e-2."""
    rng = np.random.default_rng(6)
    for speed in (1.0, 0.03, 5.0):
        linear, axis = rng.normal(size=(2, 3))
        twist = np.concatenate([linear, speed * axis / np.linalg.norm(axis)])
        amount = angle / speed
        expected = pin.exp6(twist * amount).homogeneous[:3]
        # Relative to the motion, which near zero is far smaller than the identity.
        # Above its series Pinocchio's own 1 - cos loses eps / angle of it.
        eps, size = float(np.finfo(float).eps), abs(angle)
        lost = 1e-13 + (10.0 * eps / size if size > 1e-4 else 0.0)
        reach, found = np.linalg.norm(expected[:, 3]), link_of(twist, amount)
        assert np.abs(found[:, 3] - expected[:, 3]).max() <= lost * reach
        assert np.abs(found - expected)[:, :3].max() <= 1e-14 + 10.0 * eps * size
        turn = found[[2, 0, 1], [1, 2, 0]] - found[[1, 2, 0], [2, 0, 1]]
        exact = 2.0 * np.sin(angle) * twist[3:] / speed
        # The angle itself is rounded.
        assert np.abs(turn - exact).max() <= 1e-12 * size


def test_a_screw_without_rotation_shifts() -> None:
    for amount in (1e-9, -0.3, 7.0):
        found = link_of(np.array([0.6, 0.0, -0.8, 0.0, 0.0, 0.0]), amount)
        np.testing.assert_array_equal(found[:, :3], np.eye(3))
        np.testing.assert_allclose(found[:, 3], [0.6 * amount, 0.0, -0.8 * amount])


def axes_of(seed: int) -> Floats:
    """Every component takes its turn at being the largest."""
    axes = np.random.default_rng(seed).normal(size=(BLOCK - 8, 3))
    axes = np.concatenate([np.eye(3), -np.eye(3), [[1, 1, 1], [1, -1, 0]], axes])
    return np.asarray(axes / np.linalg.norm(axes, axis=1)[:, None])


@pytest.mark.parametrize("angle", [0.0, 1e-300, 1e-12, 1e-4, 1.0, 3.0, np.pi - 1e-7])
def test_rotation_vectors(angle: float) -> None:
    # Near a half turn the matrix tells the axis to eps over what is left of it.
    atol = 1e-9 if angle > 3.1 else 1e-15
    for R in so3_exp(angle * axes_of(7)):
        found = kernels.rotation_vector(R)
        np.testing.assert_allclose(found, so3_log(R), rtol=1e-12, atol=atol)
