"""Closed-form starts of several blocks, and of what only other measurements name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import calib_pin
from calib_pin.errors import InputError
from calib_pin.estimation.formulation import make_problem, nominal_problem
from calib_pin.estimation.nominal import extended, register, registered
from calib_pin.estimation.problem import Problem
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


def exact(problem: Problem, count: int, **options: Any) -> Observations:
    """Measurements of the nominal robot without noise."""
    rng = np.random.default_rng(0)
    return calib_pin.simulate(
        problem, zero(problem), rng, count=count, noise=0.0, **options
    )


def largest(problem: Problem, theta: Floats | None = None) -> float:
    """Of the errors, by default of the parameters at zero."""
    at = zero(problem) if theta is None else theta
    return float(np.abs(problem.errors(at)).max())


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
    assert any(term.measurement.missing for term in problem.terms.values())
    found = registered(problem, zero(problem))
    assert largest(found) < 1e-9
    located = found.references
    xyz = located["sockets", "s/1"].xyz
    np.testing.assert_allclose(xyz, SOCKETS["s/1"].xyz, atol=1e-9)
    normal = np.array(table.normal) / np.linalg.norm(table.normal)
    np.testing.assert_allclose(located["planes", "table"].normal, normal, atol=1e-9)
    for term in found.terms.values():
        np.testing.assert_allclose(term.error.base.translation, BASE.xyz, atol=1e-9)
        np.testing.assert_allclose(term.error.tool.translation, TOOL.xyz, atol=1e-9)


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
    assert largest(found, result.x) < 1e-11


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
    rows = exact(truth, 24, per_configuration=True)
    problem = make_problem(ARM, rows, Setup(targets=board, camera=camera))
    found = registered(problem, zero(problem))
    for key, term in found.terms.items():
        known = truth.terms[key].error
        assert term.error.base.isApprox(known.base, 1e-6)
        assert term.error.tool.isApprox(known.tool, 1e-6)
    assert largest(found) < 1e-3  # A thousandth of a pixel.


def test_posts_tell_where_a_station_is() -> None:
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
    truth = nominal_problem(chains, dict(list(measured.items())[::-1]), setup)
    problem = make_problem(chains, exact(truth, 60), Setup())
    found = registered(problem, zero(truth))
    assert largest(found) < 1e-9
    for key, term in found.terms.items():
        expected = frame_pose(PLACES[key.station]).homogeneous
        np.testing.assert_allclose(term.error.base.homogeneous, expected, atol=1e-9)


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
    problem_of_rows = make_problem(ARM, exact(problem, 20), setup)
    found = registered(problem_of_rows, zero(problem))
    for key, term in found.terms.items():
        assert term.error.tool.isApprox(problem.terms[key].error.tool, 1e-11)
    assert largest(found) < 1e-9


def test_new_stations_are_located_by_their_measurements() -> None:
    """What was fitted stays as it is; the frame of the new station is the only news."""
    keys = [BlockKey("position", station=name, tool="ball") for name in PLACES]
    truth = nominal_problem(ARM, keys, Setup(stations=PLACES))
    rng = np.random.default_rng(0)
    theta = calib_pin.draw_errors(truth.parameters, rng)
    rows = calib_pin.simulate(truth, theta, rng, count=60, noise=0.0)
    few = make_problem(ARM, rows.rows(np.arange(40)), Setup(stations={}))
    values = dict(zip(truth.parameters.names, theta, strict=True))
    robot = few.parameters.vector({k: v for k, v in values.items() if v})
    few = registered(few, robot)
    wider, values = extended(few, robot, rows)
    assert len(values) == len(few.parameters) + 6
    new = wider.given.names[12:18]
    assert all(name.startswith("three.station.") for name in new)
    assert largest(wider, values) < 1e-9
    base = wider.terms[keys[2]].error.base
    np.testing.assert_allclose(
        base.homogeneous, frame_pose(PLACES["three"]).homogeneous, atol=1e-9
    )


def test_measurements_of_what_was_not_fitted_are_refused(
    refused: Callable[..., Any],
) -> None:
    keys = [BlockKey("position", tool=name) for name in ("a", "b")]
    truth = nominal_problem(ARM, keys, Setup())
    rows = exact(truth, 40)
    few = make_problem(ARM, Observations(rows.blocks[:1]), Setup())
    with refused(InputError, reason="'b'"):
        extended(few, zero(few), rows)
