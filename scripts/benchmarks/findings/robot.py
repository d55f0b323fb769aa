"""Defects of the robot, and of the configurations that were measured."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.findings.defect import CONFIGURATIONS, Defect, Input, given, told
from benchmarks.verdict.defects import narrow, path, stuck
from benchmarks.verdict.jobs import BASE, TOOL, Job
from calib_pin.observations import Measurements

FREE = ("position", "pose", "point-distance")
"""Measurement models that measure at any configuration."""


def _other_robot(
    job: Job, rows: Measurements, rng: np.random.Generator, robot: str
) -> Input:
    """A URDF of another robot, whose joints have the same names."""
    return replace(given(job, rows, told("ur10")), robot=f"example:{robot}_robot")


def _other_link(
    job: Job, rows: Measurements, rng: np.random.Generator, ends: dict[str, Any]
) -> Input:
    """The wrong link is the tip, or the base."""
    return replace(given(job, rows), setup=replace(job.setup, **ends))


def _other_tool(
    job: Job, rows: Measurements, rng: np.random.Generator, size: float
) -> Input:
    """A tool that is known, but not the one that was mounted; base unknown."""
    assert TOOL.xyz is not None
    x, y, z = TOOL.xyz
    frame = replace(TOOL, xyz=(x + size, y, z), estimate=False)
    return replace(given(job, rows), setup=replace(job.setup, tool_frame=frame))


def _other_base(
    job: Job, rows: Measurements, rng: np.random.Generator, size: float
) -> Input:
    """A base that is known, but elsewhere; tool unknown."""
    assert BASE.xyz is not None
    x, y, z = BASE.xyz
    frame = replace(BASE, xyz=(x, y + size, z), estimate=False)
    # It moves what is behind the first origin just as well.
    first = told(rows.joints[0])
    spoiled = given(job, rows, lambda f: f.code == "base-frame" or first(f))
    return replace(spoiled, setup=replace(job.setup, base_frame=frame))


def _stuck(job: Job, rows: Measurements, rng: np.random.Generator, joint: int) -> Input:
    """A joint that never moved."""
    q = stuck(job, rng, len(rows), joint)
    return given(job, job.measured(rng, q=q), told(rows.joints[joint]))


def _narrow(
    job: Job, rows: Measurements, rng: np.random.Generator, half: float
) -> Input:
    """All configurations close together."""
    return given(job, job.measured(rng, q=narrow(job, rng, len(rows), half)))


def _path(job: Job, rows: Measurements, rng: np.random.Generator, count: int) -> Input:
    """All configurations on one smooth path."""
    return given(job, job.measured(rng, q=path(job, rng, count)))


DEFECTS: tuple[Defect, ...] = (
    Defect(
        "other-robot",
        {"UR5": "ur5", "UR3": "ur3", "UR5, limited": "ur5_joint_limited"},
        FREE,
        ("other-robot", "robot"),
        _other_robot,
    ),
    Defect(
        "other-link",
        {
            "forearm": {"tip": "forearm_link"},
            "wrist 1": {"tip": "wrist_1_link"},
            "shoulder": {"base": "shoulder_link"},
        },
        FREE,
        ("tip-link", "base-link"),
        _other_link,
    ),
    Defect(
        "other-tool",
        {"1 mm": 1e-3, "1 cm": 0.01, "20 cm": 0.2},
        ("position", "pose"),
        ("tool-frame",),
        _other_tool,
    ),
    Defect(
        "other-base",
        {"1 mm": 1e-3, "1 cm": 0.01, "50 cm": 0.5},
        ("position", "pose"),
        ("base-frame", "large-correction"),
        _other_base,
    ),
    Defect(
        "stuck",
        {"lift": 1, "elbow": 2, "wrist": 4},
        FREE,
        ("unmoved-joints", "unmoved-joint"),
        _stuck,
    ),
    Defect(
        "narrow",
        {"0.2 rad": 0.2, "0.5 rad": 0.5, "1 rad": 1.0},
        FREE,
        ("small-range",),
        _narrow,
    ),
    Defect(
        "path",
        {"60": CONFIGURATIONS, "120": 2 * CONFIGURATIONS, "240": 4 * CONFIGURATIONS},
        FREE,
        ("one-path",),
        _path,
    ),
)
