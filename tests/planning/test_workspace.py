"""Where configurations may be: limits, region, sight, distances, spread."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.stats import qmc

import calib_pin
from calib_pin.errors import InputError, OptionError, RobotError
from calib_pin.kinematics.chain import Chain
from calib_pin.planning.planned_problem import identification
from calib_pin.planning.workspace import Workspace
from calib_pin.setup import (
    Ball,
    Cone,
    FrameSetup,
    PlaneSetup,
    RangerSetup,
    Region,
    Setup,
)
from calib_pin.simulation import exact_problem

PLANES = {
    "floor": PlaneSetup((0.1, 0.2, 1.0), 1.5),
    "wall": PlaneSetup((1.0, 0.3, 0.2), -3.0),
}


# --- limits ------------------------------------------------------------------------


def test_limits_are_those_of_the_robot(workspace_of: Callable[..., Workspace]) -> None:
    workspace = workspace_of("space6")
    chain = workspace.problem.only.error.chain
    # But for a hundredth of a radian, where controllers would complain already.
    inside = workspace.lower - chain.lower, chain.upper - workspace.upper
    assert all(room.min() >= 0.01 and room.max() < 0.01 + 1e-6 for room in inside)
    digits = workspace.lower * 1e6
    assert digits == pytest.approx(np.round(digits), abs=1e-6)


def test_limits_narrow_by_name_and_glob(workspace_of: Callable[..., Workspace]) -> None:
    limits = {"joint_*": (-1.0, 9.0), "joint_3": (-7.0, 0.5), "joint_[12]": (0.0, 1.0)}
    workspace = workspace_of("space7", limits=limits)
    chain = workspace.problem.only.error.chain
    assert (chain.lower < -1.0).all() and (chain.upper < 9.0).all()
    upper = chain.upper - 0.01
    upper[:2], upper[2] = 1.0, 0.5
    assert workspace.lower.tolist() == [0.0, 0.0, -1.0, -1.0, -1.0, -1.0, -1.0]
    assert workspace.upper == pytest.approx(upper, abs=1e-6)
    # The chain itself stays as it is.
    assert chain.upper[2] > 0.5


def limited(
    urdf_of: Callable[..., str],
    chain_of: Callable[..., Chain],
    limits: tuple[float, float],
) -> Chain:
    joints = [
        {
            "name": f"j{k}",
            "parent": f"l{k}",
            "child": f"l{k + 1}",
            "axis": (0, k, 1 - k),
        }
        for k in range(2)
    ]
    return chain_of(urdf_of(joints[0], {**joints[1], "limits": limits}))


def test_a_joint_that_the_urdf_holds_stays(
    workspace_of: Callable[..., Workspace],
    urdf_of: Callable[..., str],
    chain_of: Callable[..., Chain],
    rng: np.random.Generator,
) -> None:
    workspace = workspace_of(limited(urdf_of, chain_of, (0.5, 0.5)))
    assert (workspace.lower[1], workspace.upper[1]) == (0.5, 0.5)
    assert (workspace.candidates(20, rng).q[:, 1] == 0.5).all()
    # Two zeros mean no limit.
    free = workspace_of(limited(urdf_of, chain_of, (0.0, 0.0)))
    assert free.upper[1] > 3.0


def test_limits_of_the_urdf_that_cross(
    workspace_of: Callable[..., Workspace],
    urdf_of: Callable[..., str],
    chain_of: Callable[..., Chain],
) -> None:
    with pytest.raises(RobotError, match="inverted limits of joint 'j1'"):
        workspace_of(limited(urdf_of, chain_of, (0.5, -0.5)))


def bracketed(urdf_of: Callable[..., str], chain_of: Callable[..., Chain]) -> Chain:
    names = ("arm[1]", "arm1")
    joints = [
        {"name": name, "parent": f"l{k}", "child": f"l{k + 1}", "axis": (0, k, 1 - k)}
        for k, name in enumerate(names)
    ]
    return chain_of(urdf_of(*joints))


def test_the_name_of_a_joint_is_no_pattern(
    workspace_of: Callable[..., Workspace],
    urdf_of: Callable[..., str],
    chain_of: Callable[..., Chain],
) -> None:
    chain = bracketed(urdf_of, chain_of)
    workspace = workspace_of(chain, limits={"arm[1]": (-0.5, 0.5)})
    assert workspace.lower.tolist() == [-0.5, -1.99]
    workspace = workspace_of(chain, limits={"arm[0-9]": (-0.5, 0.5)})
    assert workspace.lower.tolist() == [-1.99, -0.5]


@pytest.mark.parametrize(
    ("limits", "fields"),
    [
        (
            {"joint_3": (3.5, 4.0)},
            {"reason": "'joint_3' leave nothing", "value": [3.5, 4.0]},
        ),
        (
            {"joint_*": (0.0, 1.0), "joint_2": (1.5, 2.0)},
            {"reason": "'joint_2' leave nothing"},
        ),
        (
            {"joint_2": (1.0, -1.0)},
            {"reason": "'joint_2' leave nothing", "value": [1.0, -1.0]},
        ),
        ({"joit_2": (0.0, 1.0)}, {"reason": ["no joint", "'joit_2'", "'joint_2'?"]}),
        (
            {"elbow*": (0.0, 1.0)},
            {"reason": "no joint of the chain: 'elbow*'", "allowed": "joint_1, joint"},
        ),
    ],
)
def test_limits_that_leave_nothing(
    limits: dict[str, Any],
    fields: dict[str, Any],
    workspace_of: Callable[..., Workspace],
    refused: Callable[..., Any],
) -> None:
    with refused(OptionError, **fields):
        workspace_of("space7", limits=limits)


@pytest.mark.parametrize("distance", [-0.1, np.inf, np.nan])
def test_distances_out_of_range(
    distance: float, workspace_of: Callable[..., Workspace]
) -> None:
    with pytest.raises(OptionError, match="distance between configurations"):
        workspace_of("space6", distance=distance)


def test_candidates_stay_within_the_limits(
    workspace_of: Callable[..., Workspace], rng: np.random.Generator
) -> None:
    workspace = workspace_of("space6", limits={"joint_2": (-0.3, 0.4)})
    found = workspace.candidates(1500, rng)
    assert found.q.shape == (1500, 6)
    assert found.tried == 2000
    assert (found.q >= workspace.lower).all() and (found.q <= workspace.upper).all()
    # They fill them, too.
    width = workspace.upper - workspace.lower
    assert (found.q.min(axis=0) < workspace.lower + 0.03 * width).all()
    assert (found.q.max(axis=0) > workspace.upper - 0.03 * width).all()
    assert workspace.inside(found.q, found.aim).all()
    beyond = found.q + width
    assert not workspace.inside(beyond, found.aim).any()


# --- spread ------------------------------------------------------------------------


@pytest.mark.parametrize("robot", ["space6", "space7"])
@pytest.mark.parametrize("count", [100, 600])
def test_candidates_have_a_low_discrepancy(
    robot: str, count: int, workspace_of: Callable[..., Workspace]
) -> None:
    workspace = workspace_of(robot)
    width = workspace.upper - workspace.lower
    ours, random = [], []
    for seed in range(5):
        rng = np.random.default_rng(seed)
        q = workspace.candidates(count, rng).q
        ours.append(qmc.discrepancy((q - workspace.lower) / width))
        random.append(qmc.discrepancy(rng.random((count, len(width)))))
    assert max(ours) < 0.7 * min(random)
    assert np.mean(ours) < 0.5 * np.mean(random)


def test_every_joint_is_covered_evenly(workspace_of: Callable[..., Workspace]) -> None:
    workspace = workspace_of("space7")
    q = workspace.candidates(400, np.random.default_rng(3)).q
    unit = (q - workspace.lower) / (workspace.upper - workspace.lower)
    for column in unit.T:
        counts, _ = np.histogram(column, bins=20, range=(0.0, 1.0))
        # Chance alone gives 20 +- 4.4.
        assert 14 <= counts.min() <= counts.max() <= 26
        assert counts.std() < 3.0


def test_the_seed_moves_them_and_nothing_else_does(
    workspace_of: Callable[..., Workspace],
) -> None:
    workspace = workspace_of("space6")
    first, again, other = (
        workspace.candidates(50, np.random.default_rng(seed)) for seed in (1, 1, 2)
    )
    assert first.q.tobytes() == again.q.tobytes()
    assert np.abs(first.q - other.q).max() > 0.1
    # More candidates continue the same sequence.
    more = workspace.candidates(80, np.random.default_rng(1))
    assert more.q[:50].tobytes() == first.q.tobytes()


# --- region, sight, distance -------------------------------------------------------


def tool_points(workspace: Workspace, q: np.ndarray) -> np.ndarray:
    """Where the tool is in the base, by the chain's own kinematics."""
    problem = workspace.problem
    F = problem.only.error.chain.poses(q)
    return (F @ problem.only.error.tool.homogeneous)[:, :3, 3]


@pytest.mark.parametrize(
    "region",
    [
        Region(box=((0.2, -0.5, 0.1), (3.0, 0.9, 2.0))),
        Region(sphere=Ball((0.5, 0.2, 1.0), 0.9)),
        Region(cone=Cone((-1.0, 0.0, 0.5), (1.0, 0.2, 0.3), 0.5, (0.5, 2.5))),
        Region(
            box=((-1.0, -1.0, 0.0), (2.0, 2.0, 2.0)), sphere=Ball((0.5, 0.2, 1.0), 1.2)
        ),
    ],
    ids=["box", "sphere", "cone", "box and sphere"],
)
def test_candidates_lie_in_the_region(
    region: Region, workspace_of: Callable[..., Workspace], rng: np.random.Generator
) -> None:
    # The region is one of the base, wherever the instrument stands.
    frames = {
        "base_frame": FrameSetup((1.0, -2.0, 0.5), (0.3, -0.2, 0.4)),
        "tool_frame": FrameSetup((0.1, 0.05, 0.2)),
    }
    workspace = workspace_of("space6", region=region, **frames)
    found = workspace.candidates(100, rng)
    points = tool_points(workspace, found.q)
    assert len(found.q) == 100
    if region.box is not None:
        lower, upper = np.array(region.box)
        assert (points >= lower).all() and (points <= upper).all()
    if region.sphere is not None:
        center, radius = region.sphere.center, region.sphere.radius
        assert (np.linalg.norm(points - center, axis=1) <= radius).all()
    if region.cone is not None:
        ray = points - np.array(region.cone.apex)
        distance = np.linalg.norm(ray, axis=1)
        axis = np.array(region.cone.axis) / np.linalg.norm(region.cone.axis)
        assert (np.arccos(ray @ axis / distance) <= 0.5 + 1e-9).all()
        assert distance.min() >= 0.5 and distance.max() <= 2.5
    # Without it most would have been elsewhere.
    free = workspace_of("space6", **frames).candidates(200, rng)
    assert region.contains(tool_points(workspace, free.q)).mean() < 0.7
    assert not workspace.inside(free.q, free.aim).all()


@pytest.mark.parametrize("incidence", [0.4, 1.2])
def test_the_ranger_sees_its_planes(
    incidence: float, workspace_of: Callable[..., Workspace], rng: np.random.Generator
) -> None:
    ranger = RangerSetup(range=(0.3, 2.5), incidence=incidence)
    workspace = workspace_of("space6", "plane-distance", planes=PLANES, ranger=ranger)
    assert [aim.target for aim in workspace.aims.each] == ["floor", "wall"]
    found = workspace.candidates(120, rng)
    targets = [workspace.aims.each[k].target for k in found.aim]
    assert set(targets) == {"floor", "wall"}
    problem = workspace.problem
    T = problem.only.error.chain.poses(found.q) @ problem.only.error.tool.homogeneous
    T = problem.only.error.base.homogeneous @ T
    for pose, target in zip(T, targets, strict=True):
        normal = np.array(PLANES[target].normal)
        beam, origin = pose[:3, 2], pose[:3, 3]
        distance = -(normal @ origin + PLANES[target].offset) / (normal @ beam)
        assert 0.3 - 1e-9 <= distance <= 2.5 + 1e-9
        angle = np.arccos(min(1.0, abs(normal @ beam) / np.linalg.norm(normal)))
        assert angle <= incidence + 1e-9


@pytest.mark.parametrize("distance", [0.3, 1.0])
def test_candidates_keep_their_distance(
    distance: float, workspace_of: Callable[..., Workspace], rng: np.random.Generator
) -> None:
    workspace = workspace_of("space6", distance=distance)
    q = workspace.candidates(150, rng).q
    between = np.abs(q[:, None] - q[None]).max(axis=2)
    np.fill_diagonal(between, np.inf)
    assert len(q) == 150
    assert between.min() >= distance
    assert workspace.apart(q).all()
    assert workspace.allowed(q, np.zeros(150, int)).all()
    # One that comes too close makes two of them bad, and no others.
    q[7] = q[3] + 0.9 * distance * np.sign(0.1 - q[3])
    bad = np.flatnonzero(~workspace.apart(q))
    assert {3, 7} <= set(bad.tolist())
    expected = (np.abs(q[:, None] - q[None]).max(axis=2) < distance).sum(axis=1) > 1
    assert bad.tolist() == np.flatnonzero(expected).tolist()


def test_a_distance_that_leaves_room_for_few(
    workspace_of: Callable[..., Workspace], rng: np.random.Generator
) -> None:
    limits = {"*": (-0.1, 0.1)}
    workspace = workspace_of("space6", distance=0.15, limits=limits)
    q = workspace.candidates(200, rng).q
    # A cube of edge 0.2 has room for one such box at each of its 64 corners.
    assert 2 <= len(q) <= 64


# --- what cannot be ----------------------------------------------------------------


def test_a_region_out_of_reach(
    workspace_of: Callable[..., Workspace],
    rng: np.random.Generator,
    refused: Callable[..., Any],
) -> None:
    """However many are wanted, no more are tried."""
    workspace = workspace_of(
        "space6", region=Region(sphere=Ball((50.0, 0.0, 0.0), 0.5))
    )
    for count in (10, 1000):
        with refused(InputError, ["none of 60000", "60000 outside the region"]):
            workspace.candidates(count, rng)


def test_reasons_are_counted_apart(
    workspace_of: Callable[..., Workspace], rng: np.random.Generator
) -> None:
    """What is not in the region is no matter of sight, and adds up to all tried."""
    workspace = workspace_of(
        "space6",
        "plane-distance",
        planes={"wall": PlaneSetup((1.0, 0.0, 0.0), -50.0)},
        region=Region(box=((-9.0, -9.0, 0.5), (9.0, 9.0, 9.0))),
    )
    with pytest.raises(InputError) as caught:
        workspace.candidates(10, rng)
    numbers = re.findall(
        r"(\d+) (outside the region|not measurable)", caught.value.reason
    )
    assert [reason for _, reason in numbers] == ["outside the region", "not measurable"]
    assert all(int(number) > 1000 for number, _ in numbers)
    assert sum(int(number) for number, _ in numbers) == 60_000


def test_a_joint_whose_limits_are_equal_stays_fixed(
    workspace_of: Callable[..., Workspace], rng: np.random.Generator
) -> None:
    """What its motion would show cannot be identified then."""
    ranks = []
    for limits in ({}, {"joint_3": (0.25, 0.25)}):
        workspace = workspace_of("space6", limits=limits)
        found = workspace.candidates(400, rng)
        structure, rows, _ = identification(workspace.problem, workspace.aims, found)
        ranks.append((structure.rank, rows.basis.shape[1]))
        # The rank of those very configurations, without our decomposition.
        zero = np.zeros(len(workspace.problem.parameters))
        exact = exact_problem(workspace.problem, zero, found.q, ("",) * 400)
        _, J = exact.linearize(zero)
        J = J * workspace.problem.parameters.scales
        ranks[-1] += (np.linalg.matrix_rank(J, tol=1e-9 * np.linalg.norm(J, 2)),)
    assert (found.q[:, 2] == 0.25).all()
    assert ranks[0] == (25, 25, 25)
    # Its own four errors become part of the link before; nothing else is lost.
    assert ranks[1][0] == ranks[1][1] == ranks[1][2] < 25


def test_setup_file_is_named_where_its_limits_are_wrong() -> None:
    setup = Setup(limits={"elbow": (0.0, 1.0)}, file="cell.yaml")
    with pytest.raises(OptionError, match="elbow"):
        calib_pin.plan(calib_pin.load_chain("space6"), "position", 10, setup)
