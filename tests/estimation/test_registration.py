"""Closed-form starts of several blocks, and of what only other measurements name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.errors import InputError
from calib_pin.estimation.formulation import make_problem, nominal_problem
from calib_pin.estimation.nominal import register
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.registration import extended, registered
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import BlockKey, Observations
from calib_pin.parameterizations import frame_pose
from calib_pin.setup import (
    WORLD,
    CameraSetup,
    FrameSetup,
    PlaneSetup,
    PointSetup,
    Setup,
    ToolSetup,
)

Simulated = Callable[..., tuple[Problem, Floats]]

ARM = calib_pin.load_chain("space6")
BASE = FrameSetup((1.5, -0.4, 0.3), (0.3, 0.2, 2.0), estimate=True)
TOOL = FrameSetup((0.05, 0.08, 0.12), (0.2, -0.3, 0.1), estimate=True)
SOCKETS = {"s/0": PointSetup((0.6, 0.3, 0.4)), "s/1": PointSetup((0.5, -0.2, 0.6))}
PLACES = {
    "one": BASE,
    "two": FrameSetup((-0.8, 1.2, 0.1), (-0.1, 0.3, -1.0), estimate=True),
    "three": FrameSetup((0.3, 1.9, -0.2), (0.2, -0.1, 0.6), estimate=True),
}


def zero(problem: Problem) -> Floats:
    return np.zeros(len(problem.parameters))


def together(
    simulated: Simulated, setup: Setup, counts: dict[str, int], order: int = 1
) -> Observations:
    """Measurements of several models on one robot."""
    found = [simulated(name, setup, count)[0].data for name, count in counts.items()]
    return Observations.of(*found[::order])


@pytest.mark.parametrize("order", [1, -1])
def test_frames_come_first_and_sites_after(simulated: Simulated, order: int) -> None:
    """Sockets stand in the frame of a tracker, which is known when they are put."""
    table = PlaneSetup((0.0, 0.1, 1.0), -0.4)
    setup = Setup(
        base_frame=BASE, tool_frame=TOOL, sockets=SOCKETS, planes={"table": table}
    )
    counts = {"fixed-point": 12, "plane-contact": 12, "position": 15}
    problem = make_problem(ARM, together(simulated, setup, counts, order), Setup())
    assert any(part.measurement.missing for part in problem.parts.values())
    found = registered(problem, zero(problem))
    assert np.abs(found.errors(zero(found))).max() < 1e-9
    located = found.references
    xyz = located["sockets", "s/1"].xyz
    np.testing.assert_allclose(xyz, SOCKETS["s/1"].xyz, atol=1e-9)
    normal = np.array(table.normal) / np.linalg.norm(table.normal)
    np.testing.assert_allclose(located["planes", "table"].normal, normal, atol=1e-9)
    for part in found.parts.values():
        np.testing.assert_allclose(part.error.base.translation, BASE.xyz, atol=1e-9)
        np.testing.assert_allclose(part.error.tool.translation, TOOL.xyz, atol=1e-9)


@pytest.mark.parametrize("order", [1, -1])
def test_unknown_points_leave_the_tool_to_others(
    simulated: Simulated, order: int
) -> None:
    """They say nothing of its frame, which poses show."""
    points = {"a": PointSetup((0.05, 0.08, 0.12)), "b": PointSetup((-0.06, 0.03, 0.1))}
    setup = Setup(base_frame=BASE, tool_frame=TOOL, targets=points)
    data = together(simulated, setup, {"position": 12, "pose": 9}, order)
    problem = make_problem(ARM, data, Setup())
    found, result = register(problem, zero(problem))
    np.testing.assert_allclose(found.only.error.tool.translation, TOOL.xyz, atol=1e-9)
    assert np.abs(found.errors(result.x)).max() < 1e-12


def test_a_camera_beside_a_tracker() -> None:
    """Where it stands and looks is found without a guess."""
    rng = np.random.default_rng(0)
    board = {
        f"m{k}": PointSetup(tuple(rng.uniform(-0.1, 0.1, 3)), False) for k in range(8)
    }
    camera = CameraSetup("world", (900.0, 910.0), (640.0, 500.0), estimate=True)
    far = FrameSetup((0.1, -0.2, 3.0), (0.3, -0.2, 0.4), estimate=True)
    setup = Setup(
        base_frame=BASE,
        tool_frame=TOOL,
        stations={"camera": far},
        tools={"camera": ToolSetup((0.02, 0.05, -0.03), (0.1, 0.3, -0.2))},
        targets=board,
        camera=camera,
    )
    measured = {BlockKey("pose"): ("",), BlockKey("camera"): tuple(board)}
    truth = nominal_problem(ARM, measured, setup)
    rows = calib_pin.simulate(
        truth, zero(truth), rng, count=24, noise=0.0, per_configuration=True
    )
    problem = make_problem(ARM, rows, Setup(targets=board, camera=camera))
    found = registered(problem, zero(problem))
    for key, part in found.parts.items():
        known = truth.parts[key].error
        for frame, other in (
            (part.error.base, known.base),
            (part.error.tool, known.tool),
        ):
            np.testing.assert_allclose(
                frame.homogeneous, other.homogeneous, rtol=0, atol=1e-6
            )
    assert np.abs(found.errors(zero(problem))).max() < 1e-3  # A thousandth of a pixel.


@pytest.mark.parametrize("order", [1, -1])
def test_posts_tell_where_a_station_is(order: int) -> None:
    """One station has seen the robot and the posts, the other the posts alone."""
    posts = {
        f"post {k}": PointSetup(xyz)
        for k, xyz in enumerate([(0.9, 0.1, 0.2), (-0.3, 0.8, 0.1), (0.4, 0.5, 1.1)])
    }
    setup = Setup(
        tools={"ball": ToolSetup(TOOL.xyz, TOOL.rpy)}, stations=PLACES, targets=posts
    )
    chains = Chains.of(ARM).named(("", WORLD))
    measured = {
        BlockKey("position", station="one", tool="ball"): ("",),
        BlockKey("position", WORLD, "one"): tuple(posts),
        BlockKey("position", WORLD, "two"): tuple(posts),
    }
    truth = nominal_problem(chains, dict(list(measured.items())[::order]), setup)
    rng = np.random.default_rng(0)
    rows = calib_pin.simulate(truth, zero(truth), rng, count=60, noise=0.0)
    found = registered(make_problem(chains, rows, Setup()), zero(truth))
    assert np.abs(found.errors(zero(truth))).max() < 1e-9
    for key, part in found.parts.items():
        expected = frame_pose(PLACES[key.station]).homogeneous
        np.testing.assert_allclose(part.error.base.homogeneous, expected, atol=1e-9)


@pytest.mark.parametrize("estimate", [True, False])
def test_a_tool_on_another(estimate: bool) -> None:
    """What is stated is the pose of the other one; its errors are shared."""
    setup = Setup(
        base_frame=BASE,
        tools={
            "ball": ToolSetup(TOOL.xyz, TOOL.rpy, estimate),
            "tip": ToolSetup((0.03, -0.05, 0.08), (0.1, 0.2, -0.2), on="ball"),
        },
    )
    keys = [BlockKey("pose", tool="tip"), BlockKey("pose", tool="ball")]
    problem = nominal_problem(ARM, keys, setup)
    rng = np.random.default_rng(0)
    rows = calib_pin.simulate(problem, zero(problem), rng, count=20, noise=0.0)
    found = registered(make_problem(ARM, rows, setup), zero(problem))
    for key, part in found.parts.items():
        assert part.error.tool.isApprox(problem.parts[key].error.tool, 1e-12)
    assert np.abs(found.errors(zero(problem))).max() < 1e-9


def test_new_sites_are_located_by_their_measurements(simulated: Simulated) -> None:
    setup = Setup(base_frame=BASE, tool_frame=TOOL, sockets=SOCKETS)
    data = together(simulated, setup, {"position": 20, "fixed-point": 20})
    first = np.array([not name.endswith("s/1") for name in data.target])
    known = replace(setup, sockets={"s/0": SOCKETS["s/0"]})
    problem = make_problem(ARM, data.rows(first), known)
    problem = registered(problem, zero(problem))
    wider, theta = extended(problem, zero(problem), data)
    assert [name for _, name in wider.references] == ["s/0", "s/1"]
    xyz = wider.references["sockets", "s/1"].xyz
    np.testing.assert_allclose(xyz, SOCKETS["s/1"].xyz, atol=1e-12)
    assert np.abs(wider.errors(theta)).max() < 1e-12


def test_new_stations_are_located_by_their_measurements() -> None:
    """What was fitted stays as it is; the frame of the new station is the only news."""
    keys = [BlockKey("position", station=name, tool="ball") for name in PLACES]
    truth = nominal_problem(ARM, keys, Setup(stations=PLACES))
    rng = np.random.default_rng(0)
    theta = calib_pin.draw_errors(truth.parameters, rng)
    rows = calib_pin.simulate(truth, theta, rng, count=60, noise=0.0)
    few = make_problem(ARM, rows.rows(np.arange(40)), Setup(stations={}))
    robot = {
        name: value
        for name, value in zip(truth.parameters.names, theta, strict=True)
        if value
    }
    few = registered(few, few.parameters.vector(robot))
    wider, values = extended(few, few.parameters.vector(robot), rows)
    assert len(values) == len(few.parameters) + 6
    assert wider.given.names[12:18] == tuple(
        f"three.station.{c}" for c in ("x", "y", "z", "rx", "ry", "rz")
    )
    assert np.abs(wider.errors(values)).max() < 1e-9
    base = wider.parts[keys[2]].error.base
    np.testing.assert_allclose(
        base.homogeneous, frame_pose(PLACES["three"]).homogeneous, atol=1e-9
    )


def test_measurements_of_what_was_not_fitted_are_refused() -> None:
    keys = [BlockKey("position", tool=name) for name in ("a", "b")]
    truth = nominal_problem(ARM, keys, Setup())
    rng = np.random.default_rng(0)
    rows = calib_pin.simulate(truth, zero(truth), rng, count=40, noise=0.0)
    few = make_problem(ARM, Observations(rows.blocks[:1]), Setup())
    with pytest.raises(InputError, match="fitted: model 'position', tool 'b'"):
        extended(few, zero(few), rows)
