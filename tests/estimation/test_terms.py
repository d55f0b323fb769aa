"""Blocks of measurements before their parts: what these share, and what adds up."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from benchmarks.exact import exact_at
from calib_pin.errors import InputError, OptionError
from calib_pin.estimation.formulation import make_problem, nominal_problem
from calib_pin.estimation.nominal import named_targets, registered, unmeasured
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.terms import frames_of_blocks
from calib_pin.io.urdf_tree import parse_robot
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import BlockKey, Observations
from calib_pin.setup import (
    WORLD,
    CameraSetup,
    ChainSetup,
    FrameSetup,
    PointSetup,
    Setup,
)
from tests.shared import equipped_problem, refused, simulated, urdf_of

ARM = calib_pin.load_chain("space6")
BASE = FrameSetup((1.5, -0.4, 0.3), (0.3, 0.2, 2.0), estimate=True)
TOOL = FrameSetup((0.05, 0.08, 0.12), (0.2, -0.3, 0.1), estimate=True)
SOCKETS = {"s/0": PointSetup((0.6, 0.3, 0.4)), "s/1": PointSetup((0.5, -0.2, 0.6))}
SETUP = Setup(base_frame=BASE, tool_frame=TOOL, sockets=SOCKETS)
SEVERAL = ("position", "pose", "fixed-point", "plane-contact", "camera")


POINT, POSE = BlockKey("position"), BlockKey("pose")


def keys(*models: str) -> list[BlockKey]:
    return [BlockKey(model) for model in models]


def anywhere(problem: Problem, theta: Floats, rng: np.random.Generator) -> Problem:
    """Measurements of every target of every block, at random configurations."""
    at = []
    for key in problem.terms:
        names = named_targets(problem, key)
        q = problem.chains.random_configurations(len(names), rng)
        at.append(unmeasured(problem, key, q, names))
    return exact_at(problem, theta, *at)


@pytest.fixture
def several() -> tuple[Problem, Floats]:
    """A problem with noisy measurements of several instruments, and parameters."""
    problem, rng = equipped_problem(ARM, keys(*SEVERAL)), np.random.default_rng(0)
    theta = 0.01 * rng.normal(size=len(problem.parameters))
    there, blocks = anywhere(problem, theta, rng), []
    for term, data, _, _ in there.blocks:
        noise = 0.1 * rng.normal(size=(len(data), term.components))
        values = term.measurement.disturb(data.values, noise)
        blocks.append(replace(data, values=values))
    return replace(there, data=Observations(tuple(blocks))), theta


# What blocks share.


def test_what_several_blocks_name_is_one_reference() -> None:
    """The ball that a tracker sees rests in the sockets."""
    setup = replace(SETUP, targets={"ball": PointSetup((0.05, 0.08, 0.12))})
    problem = nominal_problem(ARM, keys("position", "fixed-point"), setup)
    assert list(problem.references) == [
        ("targets", "ball"),
        ("sockets", "s/0"),
        ("sockets", "s/1"),
    ]
    assert len(problem.given) == 6 + 36 + 6 + 9
    theta = np.zeros(len(problem.given))
    theta[-9], theta[-5] = 0.1, 0.2
    moved, _ = problem.rebased(theta)
    for term in moved.terms.values():
        ball = term.measurement.references[0]
        np.testing.assert_allclose(ball.xyz, [0.15, 0.08, 0.12])
    np.testing.assert_allclose(moved.references["sockets", "s/0"].xyz[1], 0.5)


def test_what_one_block_estimates_is_estimated() -> None:
    """Points are known to a camera unless it is told, and unknown to a tracker."""
    setup = Setup(
        targets={"m": PointSetup((0.05, 0.08, 0.12)), "n": PointSetup((0.1, 0, 0))},
        tools={"camera": TOOL, "ball": TOOL},
        camera=CameraSetup("world", (900.0, 910.0), (640.0, 500.0)),
    )
    own, shared = (
        nominal_problem(
            ARM, [BlockKey(m, tool=tool) for m in ("camera", "position")], setup
        )
        for tool in ("", "ball")
    )
    # Among others a camera looks at something of its own, unless that has one name.
    names = {"m", "n", "camera"}
    assert {name for _, name in shared.references} == names
    assert {name for _, name in own.references} == {*names, "camera/m", "camera/n"}
    for found in (own, shared):
        point = [name.startswith("m.") for name in found.given.names]
        assert found.given.free[point].tolist() == [True] * 3
    assert not any(name.startswith("camera/m") for name in own.given.names)


@pytest.mark.parametrize(
    ("measured", "names"),
    [
        ([POINT, POINT._replace(tool="b")], ["position"]),
        ([POINT._replace(station=s) for s in "ab"], ["position (a)", "position (b)"]),
        ([POINT, POSE], ["position", "position (pose)", "orientation"]),
    ],
)
def test_each_instrument_at_each_station_has_noise_of_its_own(
    measured: list[BlockKey], names: list[str]
) -> None:
    layout = nominal_problem(ARM, measured, Setup()).layout
    assert [component.name for component in layout.components] == names


# Residuals.


def test_residuals_are_those_of_each_block_alone(
    several: tuple[Problem, Floats],
) -> None:
    problem, theta = several
    errors, sigma = problem.errors(theta), problem.sigma
    r, J = problem.linearize(theta)
    stop = 0
    for block in problem.blocks:
        term, data = block.term, block.data
        assert block.values.start == stop
        stop = block.values.stop
        residual = term.measurement.residual(
            term.poses(theta, data), term.values(theta)[1], data
        )
        np.testing.assert_array_equal(block.table(errors), residual)
        alone = replace(problem, data=Observations.of(data), setup=problem.setup)
        # Of the only block the same rows, and behind them the known distance.
        _, expected = alone.linearize(theta)
        np.testing.assert_array_equal(J[block.values], expected[:-1])
        others = np.setdiff1d(np.arange(len(theta)), term.index)
        assert not J[block.values][:, others].any()
    assert stop == len(errors) == len(r) - 1
    np.testing.assert_allclose(r[:-1], errors / sigma, rtol=1e-12, atol=1e-9)


# What does not go.


def test_unknown_models_and_what_a_block_lacks() -> None:
    with refused(OptionError, reason="'fixed-pont'"):
        nominal_problem(ARM, keys("position", "fixed-pont"), SETUP)
    with refused(OptionError, reason="'sockets'"):
        nominal_problem(ARM, keys("pose", "fixed-point"), Setup())


def test_measurements_of_an_unknown_socket() -> None:
    positions, sockets = (
        simulated(model, SETUP, 5)[0].data.only for model in ("position", "fixed-point")
    )
    target = (*list(sockets.target)[:-1], "s/2")
    wrong = replace(
        sockets, target=target, lines=np.arange(6, 11), files=("m.csv",) * 5
    )
    problem = make_problem(ARM, Observations((positions, wrong)), SETUP)
    with refused(InputError, reason="'s/2'", file="m.csv", line=10):
        registered(problem, np.zeros(len(problem.parameters)))


MEASURED, CAMERA, TOUCH = map(BlockKey, ("position", "camera", "fixed-point"))
BALL = MEASURED._replace(tool="ball")


@pytest.fixture(scope="module")
def tree() -> Callable[..., Chains]:
    """Chains of a trunk with two limbs: `tree("", "right")`."""
    joints = [("trunk", "root", "chest"), ("l", "chest", "left"), ("r", "chest", "end")]
    text = urdf_of(*({"name": n, "parent": p, "child": c} for n, p, c in joints))
    robot = parse_robot(text.encode(), "tree.urdf")
    stated = {
        "right": ChainSetup(tip="end"),
        "touch": ChainSetup(base="left", tip="end"),
    }

    def make(*names: str) -> Chains:
        return Chains(robot, None, "left", stated, names)

    return make


OWN = AT_BASE, AT_TOOL = "base.frame", "tool.frame"


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ([MEASURED], [OWN]),
        # A name alone tells nothing apart.
        ([MEASURED._replace(station="one", tool="ball")], [OWN]),
        (
            [MEASURED._replace(station="one"), BALL._replace(station="two")],
            [("one.station", AT_TOOL), ("two.station", "ball.tool")],
        ),
        # What stands still has the station of what moves.
        ([MEASURED, MEASURED._replace(chain=WORLD)], [OWN, (AT_BASE, "root.tool")]),
        # A tool of each limb; the base is one link.
        ([MEASURED, MEASURED._replace(chain="right")], [OWN, (AT_BASE, "end.tool")]),
        # The same probe, mounted on one hand and then on the other.
        (
            [BALL, BALL._replace(chain="right")],
            [(AT_BASE, "ball.tool"), (AT_BASE, "ball/end.tool")],
        ),
        # A hand that is touched is a place of its own.
        (
            [MEASURED, TOUCH._replace(chain="touch")],
            [OWN, ("left.station", "end.tool")],
        ),
        # A camera among others follows nothing that these do.
        ([MEASURED, CAMERA], [OWN, ("camera.station", "camera.tool")]),
        (
            [MEASURED, CAMERA._replace(tool="ball")],
            [OWN, ("camera.station", "ball.tool")],
        ),
        ([CAMERA], [OWN]),
        ([MEASURED, TOUCH], [OWN, OWN]),
    ],
)
def test_names_of_frames(
    keys: list[BlockKey], expected: list[tuple[str, str]], tree: Callable[..., Chains]
) -> None:
    chains = tree(*dict.fromkeys(key.chain for key in keys))
    found = frames_of_blocks(chains, keys, Setup())
    assert [(found[key].station, found[key].tool) for key in keys] == expected
