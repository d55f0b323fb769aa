"""Whole jobs of several stations, tools and chains: one fit, and it knows its errors.

The rank of a job is counted by hand. A joint has a frame in each of the two bodies that
it connects, less two numbers: along and about its axis both can move together. A body
has no frame of its own, so it takes six off. What is mounted on a body adds its own:
six for a frame, three for a point:

    rank = 10 joints - 6 bodies + 6 frames + 3 points
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.fit import fit
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.formulation import make_problem, nominal_problem
from calib_pin.estimation.problem import Problem, measured_count
from calib_pin.io.urdf import load_chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import BlockKey, Observations
from calib_pin.parameterizations import frame_pose
from calib_pin.setup import FrameSetup, Setup, ToolSetup
from calib_pin.simulation import simulate


def robot_errors(problem: Problem, rng: np.random.Generator, size: float) -> Floats:
    """Errors of the robot alone, in sizes of 1 mm and 3 mrad, shape (P,)."""
    parameters = problem.parameters
    drawn = size * parameters.scales * rng.normal(size=len(parameters))
    return np.where(parameters.free & ~parameters.nuisance, drawn, 0.0)


def fitted_to(problem: Problem, data: Observations, rng: np.random.Generator) -> Fit:
    """The fit of measurements without a first guess of stations and tools."""
    setup = problem.setup
    if len({key.model for key in problem.terms}) == 1:
        # Where a camera looks from, measurements of points do not tell.
        setup = replace(setup, stations={}, tools={})
    return fit(make_problem(problem.chains, data, setup), rng)


def normalized_error(fitted: Fit, exact: Observations) -> float:
    """Squared error of a fit in the metric of its covariance, by its dimensions.

    By noise-free measurements at other configurations: they see all that can be
    identified, and nothing of what is a matter of convention.
    """
    fresh = replace(fitted.problem, data=exact, units=np.zeros(0))
    count = measured_count(fresh)
    error, J = (part[:count] for part in fresh.linearize_rows(fitted.theta))
    U, s, _ = np.linalg.svd(J @ fitted.posterior.by_noise, full_matrices=False)
    seen = s > 1e-7 * s[0]
    return float(np.mean(((U.T @ error)[seen] / s[seen]) ** 2))


# Three stations and two tools.

STATIONS, TOOLS = ("morning", "noon", "evening"), ("short", "long")
KEYS = [BlockKey("position", "", s, t) for s in STATIONS for t in TOOLS]
PLACES = (
    FrameSetup((2.0, 0.5, -0.3), (0.2, -0.1, 1.0)),
    FrameSetup((-1.0, 2.0, 0.4), (-0.3, 0.4, 2.5)),
    FrameSetup((0.5, -2.5, 0.1), (0.1, 0.2, -2.0)),
)
ENDS = ToolSetup((0.05, 0.03, 0.1)), ToolSetup((-0.08, 0.02, 0.25))
MOVED = Setup(
    stations=dict(zip(STATIONS, PLACES, strict=True)),
    tools=dict(zip(TOOLS, ENDS, strict=True)),
)


def test_a_tracker_that_moved_and_two_tools_are_one_fit() -> None:
    """6 joints, 7 bodies, three frames of stations, two points: 60 - 42 + 18 + 6."""
    rng = np.random.default_rng(3)
    chain = load_chain("example:ur10_robot", tip="tool0")
    problem = nominal_problem(chain, KEYS, MOVED)
    truth = robot_errors(problem, rng, 1.0)
    data = simulate(problem, truth, rng, count=90, noise=5e-5)
    found = fitted_to(problem, data, rng)
    assert found.rank == 42
    exact = simulate(problem, truth, rng, count=180, noise=0.0)
    assert normalized_error(found, exact) == pytest.approx(1.0, abs=4 * np.sqrt(2 / 42))
    # Without their stations two findings name the last line before each move.
    blocks, line = [], 2
    for block in data.blocks:  # As in a file: station after station.
        lines, line = np.arange(line, line + len(block)), line + len(block)
        blocks.append(replace(block, station="", lines=lines))
    lost = calib_pin.calibrate(chain, Observations.of(*blocks), validate=False)
    assert lost.verdict == "untrusted"
    moves = [f for f in lost.findings if f.code == "instrument-moved"]
    assert [f.evidence["line"] for f in moves] == [31, 61]
    for finding, (before, after) in zip(moves, pairwise(PLACES), strict=True):
        # Frames are those of the robot, as the tracker sees it.
        moved = frame_pose(before) * frame_pose(after).inverse()
        assert finding.severity == "error"
        assert finding.evidence["distance"] == pytest.approx(
            float(np.linalg.norm(moved.translation)), abs=0.01
        )


# One hand touches the other, and nothing else is measured.
