"""Where configurations may be: limits, region, sight, distances, spread."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.stats import qmc

from calib_pin.errors import InputError, OptionError, RobotError
from calib_pin.kinematics.chain import Chain
from calib_pin.planning.workspace import Workspace
from calib_pin.setup import (
    Ball,
    Cone,
    FrameSetup,
    PlaneSetup,
    RangerSetup,
    Region,
)

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


def test_limits_of_the_urdf(
    workspace_of: Callable[..., Workspace],
    urdf_of: Callable[..., str],
    chain_of: Callable[..., Chain],
    rng: np.random.Generator,
) -> None:
    def limited(*limits: float) -> Workspace:
        joints = [
            {
                "name": name,
                "parent": f"l{k}",
                "child": f"l{k + 1}",
                "axis": (0, k, 1 - k),
            }
            for k, name in enumerate(("arm[1]", "arm1"))
        ]
        return workspace_of(
            chain_of(urdf_of(joints[0], {**joints[1], "limits": limits})), **settings
        )

    settings: dict[str, Any] = {}
    held = limited(0.5, 0.5)
    assert (held.lower[1], held.upper[1]) == (0.5, 0.5)
    assert (held.candidates(20, rng).q[:, 1] == 0.5).all()
    # Two zeros mean no limit.
    assert limited(0.0, 0.0).upper[1] > 3.0
    with pytest.raises(RobotError, match="'arm1'"):
        limited(0.5, -0.5)
    # The name of a joint is no pattern.
    for key, lower in (("arm[1]", [-0.5, -1.99]), ("arm[0-9]", [-1.99, -0.5])):
        settings = {"limits": {key: (-0.5, 0.5)}}
        assert limited(-2.0, 2.0).lower.tolist() == lower


@pytest.mark.parametrize(
    ("limits", "fields"),
    [
        ({"joint_3": (3.5, 4.0)}, {"reason": "'joint_3'", "value": [3.5, 4.0]}),
        (
            {"joint_*": (0.0, 1.0), "joint_2": (1.5, 2.0)},
            {"reason": "'joint_2'"},
        ),
        ({"joint_2": (1.0, -1.0)}, {"reason": "'limits.joint_2'", "value": (1, -1)}),
        ({"joit_2": (0.0, 1.0)}, {"reason": ["'joit_2'", "'joint_2'?"]}),
        ({"elbow*": (0.0, 1.0)}, {"reason": "'elbow*'", "allowed": "joint_1, joint"}),
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


def test_candidates_have_a_low_discrepancy(
    workspace_of: Callable[..., Workspace],
) -> None:
    workspace = workspace_of("space7")
    width, rng = workspace.upper - workspace.lower, np.random.default_rng(1)
    q = workspace.candidates(300, rng).q
    unit = (q - workspace.lower) / width
    assert qmc.discrepancy(unit) < 0.6 * qmc.discrepancy(rng.random(unit.shape))
    for column in unit.T:
        counts, _ = np.histogram(column, bins=15, range=(0.0, 1.0))
        # Chance alone gives 20 +- 4.4.
        assert 13 <= counts.min() <= counts.max() <= 27
    # The seed moves them, and more continue the same sequence.
    again, more, other = (
        workspace.candidates(count, np.random.default_rng(seed)).q
        for count, seed in ((300, 1), (330, 1), (300, 2))
    )
    assert again.tobytes() == more[:300].tobytes() == q.tobytes()
    assert np.abs(other - q).max() > 0.1


# --- region, sight, distance -------------------------------------------------------


def tool_points(workspace: Workspace, q: np.ndarray) -> np.ndarray:
    """Where the tool is in the base, by the chain's own kinematics."""
    problem = workspace.problem
    F = problem.only.error.chain.poses(q)
    return (F @ problem.only.error.tool.homogeneous)[:, :3, 3]


@pytest.mark.parametrize(
    "region",
    [
        Region(cone=Cone((-1.0, 0.0, 0.5), (1.0, 0.2, 0.3), 0.5, (0.5, 2.5))),
        Region(
            box=((-1.0, -1.0, 0.0), (2.0, 2.0, 2.0)), sphere=Ball((0.5, 0.2, 1.0), 1.2)
        ),
    ],
    ids=["cone", "box and sphere"],
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
    found = workspace.candidates(60, rng)
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


def test_candidates_keep_their_distance(
    workspace_of: Callable[..., Workspace], rng: np.random.Generator
) -> None:
    distance = 1.0
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
    # A cube of edge 0.2 has room for one such box at each of its 64 corners.
    limits = {"*": (-0.1, 0.1)}
    narrow = workspace_of("space6", distance=0.15, limits=limits)
    assert 2 <= len(narrow.candidates(200, rng).q) <= 64
    for wrong in (-0.1, np.nan):
        with pytest.raises(OptionError) as caught:
            workspace_of("space6", distance=wrong)
        assert caught.value.value == pytest.approx(wrong, nan_ok=True)


# --- what cannot be ----------------------------------------------------------------


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
    outside, unseen = re.search(
        r"(\d+) outside\D+(\d+) not", caught.value.reason
    ).groups()
    assert min(int(outside), int(unseen)) > 1000
    assert int(outside) + int(unseen) == 60_000
