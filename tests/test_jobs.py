"""Whole jobs of several stations, tools and chains: one fit, and it knows its errors.

The rank of a job is counted by hand. A joint has a frame in each of the two bodies that
it connects, less two numbers: along and about its axis both can move together. A body
has no frame of its own, so it takes six off. What is mounted on a body adds its own:
six for a frame, three for a point:

    rank = 10 joints - 6 bodies + 6 frames + 3 points
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import calib_pin
from calib_pin.cli import main
from calib_pin.estimation.fit import fit
from calib_pin.estimation.fitted import Fit, posterior_about
from calib_pin.estimation.formulation import make_problem, nominal_problem
from calib_pin.estimation.nominal import analyze_structure
from calib_pin.estimation.problem import Problem
from calib_pin.io.urdf import load_chain
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import BlockKey, Observations
from calib_pin.parameterizations import frame_pose
from calib_pin.setup import (
    CameraSetup,
    ChainSetup,
    FrameSetup,
    PointSetup,
    Setup,
    ToolSetup,
)
from calib_pin.simulation import simulate

NORMAL = 1.959964
"""Standard deviations within which 95 % of a normal distribution lie."""


def robot_errors(problem: Problem, rng: np.random.Generator, size: float) -> Floats:
    """Errors of the robot alone, in sizes of 1 mm and 3 mrad, shape (P,)."""
    parameters = problem.parameters
    drawn = size * parameters.scales * rng.normal(size=len(parameters))
    return np.where(parameters.free & ~parameters.nuisance, drawn, 0.0)


def fitted_to(problem: Problem, data: Observations, rng: np.random.Generator) -> Fit:
    """The fit of measurements without a first guess of stations and tools."""
    setup = problem.setup
    if len({key.model for key in problem.parts}) == 1:
        # Where a camera looks from, measurements of points do not tell.
        setup = replace(setup, stations={}, tools={})
    return fit(make_problem(problem.chains, data, setup), rng)


def normalized_error(fitted: Fit, exact: Observations) -> float:
    """Squared error of a fit in the metric of its covariance, by its dimensions.

    By noise-free measurements at other configurations: they see all that can be
    identified, and nothing of what is a matter of convention.
    """
    fresh = replace(fitted.problem, data=exact, units=np.zeros(0))
    error, J = (part[: fresh.values] for part in fresh.linearize_rows(fitted.theta))
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
POSITIONS, NOISE = 90, 5e-5


@dataclass(frozen=True)
class Trials:
    """Calibrations of R robots.

    Attributes:
        ranks: Rank of each fit.
        nees: Normalized error of each fit, shape (R,).
        between: Whether the 95 % intervals of where stations stand relative to the
            first hold the truth, shape (R, stations - 1, 6).
        frames: The same of where they stand before the robot, (R, stations, 6).
    """

    ranks: set[int]
    nees: Floats
    between: Floats
    frames: Floats


def moved_tracker(runs: int, seed: int = 3) -> Trials:
    """Jobs of three stations that share two tools, with noise as stated."""
    rng = np.random.default_rng(seed)
    chain = load_chain("example:ur10_robot", tip="tool0")
    problem = nominal_problem(chain, KEYS, MOVED)
    ranks, nees, between, frames = set(), [], [], []
    for _ in range(runs):
        truth = robot_errors(problem, rng, 1.0)
        data = simulate(problem, truth, rng, count=POSITIONS, noise=NOISE)
        found = fitted_to(problem, data, rng)
        ranks.add(found.rank)
        exact = simulate(problem, truth, rng, count=180, noise=0.0)
        nees.append(normalized_error(found, exact))
        frames.append(stations_within(found, problem))
        between.append(pairs_within(found, problem))
    return Trials(ranks, np.array(nees), np.array(between), np.array(frames))


def about_solution(fitted: Fit) -> tuple[Problem, Floats]:
    """The problem about its solution, and the covariance of the parameters there.

    Averaged over the likely sizes of errors: what the robot's own base link hides is
    held by a size that eighteen combinations have told.
    """
    problem, theta = fitted.problem.rebased(fitted.theta)
    assert fitted.evidence is not None
    found = [
        posterior_about(fitted, problem, theta, sizes).covariance
        for sizes in fitted.evidence.likely
    ]
    return problem, np.mean(found, axis=0)


def bases(problem: Problem) -> list[tuple[pin.SE3, Floats]]:
    """Base frame of every station, and where its parameters stand."""
    parts = [problem.parts[BlockKey("position", "", s, TOOLS[0])] for s in STATIONS]
    return [(part.error.base, part.index[:6]) for part in parts]


def stations_within(fitted: Fit, truth: Problem) -> list[Floats]:
    """Whether intervals of the frames of stations hold those of the true problem."""
    problem, covariance = about_solution(fitted)
    deviation = np.sqrt(np.diag(covariance))
    return [
        np.abs(pin.log6(base.actInv(true)).vector) < NORMAL * deviation[own]
        for (base, own), (true, _) in zip(bases(problem), bases(truth), strict=True)
    ]


def pairs_within(fitted: Fit, truth: Problem) -> list[Floats]:
    """The same of their poses relative to the first, which the robot does not change.

    `B_s Exp(x_s) Exp(-x_0) B_0^-1` turns and shifts by `Ad(B_0) (x_s - x_0)`.
    """
    problem, covariance = about_solution(fitted)
    ((first, origin), *others), ((true_first, _), *true) = bases(problem), bases(truth)
    result = []
    for (base, own), (true_base, _) in zip(others, true, strict=True):
        apart = true_base * true_first.inverse()
        error = pin.log6((base * first.inverse()).actInv(apart)).vector
        J = np.zeros((6, len(covariance)))
        J[:, own], J[:, origin] = first.action, -first.action
        deviation = np.sqrt(np.diag(J @ covariance @ J.T))
        result.append(np.abs(error) < NORMAL * deviation)
    return result


@pytest.mark.parametrize("runs", [12, pytest.param(200, marks=pytest.mark.slow)])
def test_a_tracker_that_moved_and_two_tools_are_one_fit(runs: int) -> None:
    """6 joints, 7 bodies, three frames of stations, two points: 60 - 42 + 18 + 6."""
    found = moved_tracker(runs)
    assert found.ranks == {42}
    within = 0.06 if runs == 200 else 3.0 * np.sqrt(2.0 / (42 * runs))
    assert found.nees.mean() == pytest.approx(1.0, abs=within)
    # Where stations stand to each other is measured; where they stand before the robot
    # is also a matter of its first joint, and known as well as that is expected to be.
    # Components of one run are not independent.
    chance = 0.01 if runs == 200 else 0.06
    assert found.between.mean() == pytest.approx(0.95, abs=chance)
    assert found.frames.mean() == pytest.approx(0.95, abs=chance)


def test_measurements_without_their_stations_are_untrusted() -> None:
    """Two findings name the last line before each move, and what to do."""
    rng = np.random.default_rng(3)
    chain = load_chain("example:ur10_robot", tip="tool0")
    problem = nominal_problem(chain, KEYS, MOVED)
    truth = robot_errors(problem, rng, 1.0)
    data = simulate(problem, truth, rng, count=POSITIONS, noise=NOISE)
    assert calib_pin.calibrate(chain, data).verdict == "good"
    blocks, line = [], 2
    for block in data.blocks:  # As in a file: station after station.
        lines, line = np.arange(line, line + len(block)), line + len(block)
        blocks.append(replace(block, station="", lines=lines))
    found = calib_pin.calibrate(chain, Observations.of(*blocks))
    assert found.verdict == "untrusted"
    moves = [f for f in found.findings if f.code == "instrument-moved"]
    assert [f.evidence["line"] for f in moves] == [31, 61]
    for finding, (before, after) in zip(moves, pairwise(PLACES), strict=True):
        # Frames are those of the robot, as the tracker sees it.
        moved = frame_pose(before) * frame_pose(after).inverse()
        assert finding.severity == "error" and "station" in finding.remedy
        assert str(finding.evidence["line"]) in finding.message
        assert finding.evidence["distance"] == pytest.approx(
            float(np.linalg.norm(moved.translation)), abs=0.01
        )


# Both arms and the head of a humanoid.

LEFT, RIGHT, HEAD = "arm_left_7_link", "arm_right_7_link", "head_2_link"
CORNERS = ((0.03, 0.04, 0.01), (-0.04, 0.03, 0.0), (0.02, -0.05, 0.02))
HUMANOID = Setup(
    chains={
        "left": ChainSetup(LEFT, "base_link"),
        "right": ChainSetup(RIGHT, "base_link"),
        "left seen": ChainSetup(LEFT, HEAD),
        "right seen": ChainSetup(RIGHT, HEAD),
        "touch": ChainSetup(RIGHT, LEFT),
    },
    # Markers on a board at each hand.
    targets={
        f"c{k}": PointSetup(corner, estimate=False) for k, corner in enumerate(CORNERS)
    },
    sockets={
        "left/0": PointSetup((0.05, 0.02, -0.12)),
        "left/1": PointSetup((-0.03, 0.05, -0.15)),
    },
    camera=CameraSetup("world", (600.0, 605.0), (320.0, 240.0)),
    stations={
        "mocap": FrameSetup((2.0, 1.0, 0.5), (0.1, 0.2, 1.0)),
        "eyes": FrameSetup((0.02, 0.03, -0.1), (1.6, -1.5, 0.05)),
    },
    tools={
        "left board": ToolSetup((0.02, 0.05, -0.08), (0.3, 0.1, 0.2)),
        "right board": ToolSetup((0.03, -0.04, -0.09), (0.1, -0.2, 0.4)),
    },
    noise={"position": 1e-4, "pixel": 0.3},
)
MOCAP = [BlockKey("position", s, "mocap", f"{s} board") for s in ("left", "right")]
SEEN = [
    BlockKey("camera", f"{s} seen", "eyes", f"{s} board") for s in ("left", "right")
]
TOUCH = [BlockKey("fixed-point", "touch", "", "right board")]
EVERY = [*MOCAP, *SEEN, *TOUCH]


def humanoid(keys: Sequence[BlockKey]) -> Problem:
    """The problem of some instruments."""
    robot = load_chain("example:talos_reduced", tip=LEFT).robot
    names = [key.chain for key in keys]
    chains = Chains(robot, stated=HUMANOID.chains, names=names)
    return nominal_problem(chains, keys, HUMANOID)


@pytest.mark.parametrize(
    ("keys", "rank"),
    [
        pytest.param(MOCAP[:1], 42, id="9 joints, 10 bodies, 2 frames"),
        pytest.param(MOCAP, 76, id="16 joints, 17 bodies, 3 frames"),
        pytest.param(SEEN, 76, id="without the torso, with the head: as many"),
        pytest.param(TOUCH, 62, id="14 joints, 15 bodies, 1 frame, 2 points"),
        pytest.param([*MOCAP, *SEEN], 90, id="18 joints, 19 bodies, 4 frames"),
        pytest.param(EVERY, 96, id="18 joints, 19 bodies, 4 frames, 2 points"),
    ],
)
def test_the_rank_of_a_humanoid_is_counted_by_hand(
    keys: Sequence[BlockKey], rank: int
) -> None:
    """Frames: the mocap, the camera, a board at each hand. Points: sockets on the left.

    Torso 2 joints, arms 7 each, head 2. Instruments share boards and joints, so that
    together they know less than the sum of what each knows alone.
    """
    problem = humanoid(keys)
    zero = np.zeros(len(problem.parameters))
    found, _ = analyze_structure(problem, zero, np.random.default_rng(0))
    assert found.rank == rank
    assert found.scaled


@dataclass(frozen=True)
class Compared:
    """Humanoids of R runs, fitted as a whole and arm by arm.

    Attributes:
        nees: Normalized error of the whole, shape (R,).
        joint: Error of the markers at new configurations of each hand, by the whole,
            root mean square, shape (R, 2) [m].
        alone: The same by fits of one arm with what its own instruments have measured.
        torso: Largest difference of an angle of the torso between these, (R,) [rad].
    """

    nees: Floats
    joint: Floats
    alone: Floats
    torso: Floats


def compared(runs: int, seed: int = 5) -> Compared:
    """Fits of whole humanoids and of their arms."""
    rng, whole = np.random.default_rng(seed), humanoid(EVERY)
    arms = [humanoid(pair) for pair in zip(MOCAP, SEEN, strict=True)]
    nees, joint, alone, torso = [], [], [], []
    for _ in range(runs):
        truth = robot_errors(whole, rng, 0.5)
        data = simulate(whole, truth, rng, count=300)
        exact = simulate(whole, truth, rng, count=300, noise=0.0)
        found = fitted_to(whole, data, rng)
        nees.append(normalized_error(found, exact))
        parts = [fitted_to(arm, only(data, arm), rng) for arm in arms]
        joint.append([missed(found, exact, key) for key in MOCAP])
        alone.append(
            [
                missed(part, only(exact, arm), key)
                for part, arm, key in zip(parts, arms, MOCAP, strict=True)
            ]
        )
        left, right = (turned_torso(part) for part in parts)
        torso.append(np.abs(left - right).max())
    return Compared(*map(np.array, (nees, joint, alone, torso)))


def only(data: Observations, problem: Problem) -> Observations:
    """The measurements of the blocks and of the joints of a problem."""
    joints = problem.chains.joints
    columns = [data.joints.index(name) for name in joints]
    return Observations(
        tuple(
            replace(
                block,
                joints=joints,
                q=block.q[:, columns],
                conditions=block.conditions.of_joints(columns),
            )
            for block in data.blocks
            if block.key in problem.parts
        )
    )


def missed(fitted: Fit, exact: Observations, key: BlockKey) -> float:
    """Error of predicted positions of a block, root mean square [m]."""
    (block,) = (block for block in exact.blocks if block.key == key)
    error = fitted.problem.predict(fitted.theta, block) - block.values
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))


def turned_torso(fitted: Fit) -> Floats:
    names = [f"torso_2_joint.placement.r{axis}" for axis in "xyz"]
    return fitted.theta[[fitted.problem.parameters.index(name) for name in names]]


@pytest.mark.parametrize("runs", [2, pytest.param(100, marks=pytest.mark.slow)])
def test_a_humanoid_is_one_fit(runs: int) -> None:
    """Two fits, one for each arm, have a torso each, and both are worse."""
    found = compared(runs)
    within = 0.06 if runs == 100 else 4.0 * np.sqrt(2.0 / (96 * runs))
    assert found.nees.mean() == pytest.approx(1.0, abs=within)
    gain = found.alone.mean(axis=0) / found.joint.mean(axis=0)
    assert (gain > 1.1).all()
    assert (found.torso > 1e-5).all()


# One hand touches the other, and nothing else is measured.

TOUCHING = """
base: l_hand
tip: r_hand
model: fixed-point
frames: {tool: {xyz: [0.01, 0.02, 0.08], estimate: true}}
sockets: {left/0: {xyz: [0.02, 0.03, 0.05]}, left/1: {xyz: [-0.03, 0.01, 0.06]}}
"""
KNOWN = "distances: [{between: [left/0, left/1], value: 0.0547722557505, sigma: 1e-5}]"


@pytest.mark.parametrize(
    ("known", "rank"),
    [pytest.param("", 58, id="alone"), pytest.param(KNOWN, 59, id="known")],
)
def test_self_touch_has_no_scale_but_for_a_known_length(
    known: str, rank: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """14 joints, 15 bodies, three points: 140 - 90 + 9, without the scale one less."""
    file = tmp_path / "setup.yaml"
    file.write_text(TOUCHING + known)
    assert main(["identify", "example:icub", "--setup", str(file)]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert f"structural rank {rank} " in text
    assert ("absolute scale unobservable; add a known length" in text) != bool(known)
    # The hands are told apart, and every combination has a name.
    assert "l_wrist_yaw.placement" in text and "r_wrist_yaw.placement" in text
