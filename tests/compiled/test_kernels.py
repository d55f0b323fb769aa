"""The compiled kernels against Pinocchio and numpy."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.compiled import comparisons, kernels, link_kernels
from calib_pin.compiled.blocks import BLOCK, motions
from calib_pin.errors import RobotError
from calib_pin.estimation.many_rows import ManyRows, Segments
from calib_pin.estimation.population import PopulationCost
from calib_pin.estimation.problem import Problem
from calib_pin.io.urdf import load_chain, load_robot
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.robot import Robot
from calib_pin.kinematics.spatial import Floats, so3_exp, so3_log
from calib_pin.measurement_models import MEASUREMENT_MODELS
from calib_pin.parameterizations.error_model import ErrorModel

Measured = Callable[..., Problem]

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


def problems(path: Path, measured: Measured) -> Iterator[Problem]:
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


def assert_poses(error: ErrorModel, theta: Floats, q: Floats) -> None:
    expected = error.poses(q, theta)
    # Errors of half a radian about axes that nearly meet far away reach far.
    size = max(1.0, np.abs(expected).max())
    found = kernel_poses(error, theta, q)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * size)


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


def test_all_robots(example_robot: Path, measured: Measured) -> None:
    """Poses, costs and Jacobians agree with Pinocchio."""
    for problem in problems(example_robot, measured):
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


@pytest.mark.parametrize("kind", ["link-transform", "dh-full", "joint-offset"])
def test_parameterizations(kind: str, special_chain: Chain) -> None:
    """Screws large enough that their order matters, between frames that stand off."""
    rng = np.random.default_rng(2)
    frames = (pin.exp6(rng.normal(size=6)) for _ in range(2))
    error = ErrorModel.create(special_chain, [kind, "placement"]).with_frames(*frames)
    theta = rng.normal(size=len(error.parameters))
    assert_poses(error, theta, special_chain.random_configurations(4, rng))


@pytest.mark.parametrize("kind", ["revolute", "continuous", "prismatic"])
@pytest.mark.parametrize("ends", [("a", "c"), ("c", "a"), ("c", "d")])
def test_any_axis_both_ways(
    kind: str,
    ends: tuple[str, str],
    urdf_of: Callable[..., str],
    chain_of: Callable[..., Chain],
) -> None:
    rng = np.random.default_rng(4)
    names = [("first", "a", "b"), ("second", "b", "c"), ("other", "a", "d")]
    for axis in ((0, 0, -1), (1, 0, 0), (1, 2, 3), (1e-7, 0, -1)):
        joints = [
            {
                **dict(zip(("name", "parent", "child"), each, strict=True)),
                "placement": pin.exp6(rng.normal(size=6)),
                "type": kind,
                "axis": axis,
            }
            for each in names
        ]
        chain = chain_of(urdf_of(*joints), *ends)
        error = ErrorModel.create(chain, ["placement", "joint-offset"])
        theta = rng.normal(size=len(error.parameters))
        assert_poses(error, theta, chain.random_configurations(4, rng))


@pytest.mark.parametrize(
    ("model", "rows"),
    [
        *((model, 2 * BLOCK + 3) for model in MEASUREMENT_MODELS),
        *(("pose", rows) for rows in (1, BLOCK - 1, BLOCK, BLOCK + 1)),
    ],
)
def test_every_model_has_a_batch_form(
    model: str, rows: int, measured: Measured
) -> None:
    """Of any number of rows."""
    problem = measured(load_chain("space6"), model, ["placement"], rows)
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
        found = comparisons.rotation_vector(R)
        np.testing.assert_allclose(found, so3_log(R), rtol=1e-12, atol=atol)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 1.04])
def test_little_rotations_together(angle: float) -> None:
    """The series agree with the logarithm up to 60 degrees, where they end."""
    R = so3_exp(angle * axes_of(8))
    for i, weights in enumerate(np.eye(3)):
        by_entry = R.reshape(-1, 9).T.ravel().copy()
        found = comparisons.little_turned(by_entry, np.tile(weights[:, None], BLOCK))
        expected = np.sum(so3_log(R)[:, i] ** 2)
        np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-30)
