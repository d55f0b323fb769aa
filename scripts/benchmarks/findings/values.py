"""Defects of measured values: axes, units, steps, orientations."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.findings.defect import FILE, Defect, Input, given, told
from benchmarks.verdict.jobs import Job
from calib_pin.estimation.evidence import Finding
from calib_pin.io.measurements import encode_table, measurement_columns
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.readings import measured_lengths
from calib_pin.observations import Measurements
from calib_pin.setup import STATED

LENGTHS = ("position", "pose", "plane-distance", "point-distance", "relative-distance")
"""Measurement models that measure lengths."""

FOOT = 0.3048


def _says(reading: Mapping[str, Any]) -> Callable[[Finding], bool]:
    """Whether a finding proposes these lines."""

    def right(finding: Finding) -> bool:
        found = finding.setup.get("reading", {})
        return all(found.get(key) == value for key, value in reading.items())

    return right


def _held(
    job: Job, rows: Measurements, rng: np.random.Generator, axes: Sequence[str]
) -> Input:
    """The columns x, y and z hold other axes."""
    values = rows.values.copy()
    for column, axis in enumerate(axes):
        sign = -1.0 if axis.startswith("-") else 1.0
        values[:, column] = sign * rows.values[:, "xyz".index(axis[-1])]
    # Nothing but an orientation tells a turned frame from another one.
    said = _says({"axes": list(axes)} if job.model == "pose" else {})

    def right(finding: Finding) -> bool:
        """Whether it says so; an arm that looks the same in a mirror has two names."""
        both = finding.code in _AXES or told("left-handed")(finding)
        return both and said(finding)

    return given(job, replace(rows, values=values), right)


def _scaled(
    job: Job, rows: Measurements, rng: np.random.Generator, factor: float
) -> Input:
    """All lengths times a factor."""
    values = np.where(measured_lengths(rows), rows.values * factor, rows.values)
    return given(job, replace(rows, values=values))


def _unit(job: Job, rows: Measurements, rng: np.random.Generator, unit: float) -> Input:
    """All lengths in another unit."""
    spoiled = _scaled(job, rows, rng, 1.0 / unit)
    return replace(spoiled, right=lambda f: not f.setup or _says({"scale": unit})(f))


def _some(job: Job, rows: Measurements, rng: np.random.Generator, part: float) -> Input:
    """The lengths of some measurements in feet."""
    which = rng.permutation(len(rows)) < max(part * len(rows), 1.0)
    feet = np.where(measured_lengths(rows) & which[:, None], 1.0 / FOOT, 1.0)

    def right(finding: Finding) -> bool:
        """Whether nearly all of them are found, and no more."""
        count = int(which.sum())
        found = int(finding.evidence.get("measurements", count))
        return 0.85 * count <= found <= count

    return given(job, replace(rows, values=rows.values * feet), right)


def _rounded(
    job: Job, rows: Measurements, rng: np.random.Generator, step: float
) -> Input:
    """Lengths in coarse steps."""
    rounded = step * np.round(rows.values / step)
    values = np.where(measured_lengths(rows), rounded, rows.values)
    return given(job, replace(rows, values=values))


def _rounded_joints(
    job: Job, rows: Measurements, rng: np.random.Generator, degrees: float
) -> Input:
    """Joint positions in coarse steps."""

    def rounded(q: Floats) -> Floats:
        return np.asarray(np.radians(degrees * np.round(np.degrees(q) / degrees)))

    start = rounded(rows.start) if rows.start.size else rows.start
    return given(job, replace(rows, q=rounded(rows.q), start=start))


def _quaternion(
    job: Job,
    rows: Measurements,
    rng: np.random.Generator,
    spoiled: tuple[Sequence[int], float],
) -> Input:
    """Quaternions in another order, or with another sign of the vector."""
    order, sign = spoiled
    quaternions = (rows.values[:, 3:] * [sign, sign, sign, 1.0])[:, order]
    values = np.hstack([rows.values[:, :3], quaternions])
    return given(job, replace(rows, values=values))


def _angles(
    job: Job, rows: Measurements, rng: np.random.Generator, way: tuple[str, Any]
) -> Input:
    """Angles of another convention than the columns say."""
    columns, held = way
    turned = Rotation.from_quat(rows.values[:, 3:])
    numbers = turned.as_rotvec() if held == "rotvec" else turned.as_euler(held)
    table = {
        name: cells
        for name, cells in measurement_columns(rows).items()
        if name not in STATED["quaternion"]
    }
    table |= dict(zip(STATED[columns], numbers.T, strict=True))
    return Input({FILE: encode_table(table, ()).decode()}, job.setup)


def _inverted(
    job: Job, rows: Measurements, rng: np.random.Generator, part: None
) -> Input:
    """Poses of the measurement frame in the tool."""
    turned = Rotation.from_quat(rows.values[:, 3:]).inv()
    values = np.hstack([-turned.apply(rows.values[:, :3]), turned.as_quat()])
    return given(job, replace(rows, values=values), _says({"inverted": True}))


_AXES = ("left-handed-frame", "axes-exchanged", "axes-negated")

DEFECTS: tuple[Defect, ...] = (
    Defect(
        "left-handed",
        {
            "x, y exchanged": ("y", "x", "z"),
            "y negated": ("x", "-y", "z"),
            "three faults": ("-z", "-y", "x"),
        },
        ("position", "pose"),
        (*_AXES, "joint-reversed"),
        _held,
    ),
    Defect(
        "turned-axes",
        {
            "y, z, x": ("y", "z", "x"),
            "x, -z, y": ("x", "-z", "y"),
            "-x, -y, z": ("-x", "-y", "z"),
        },
        ("pose",),
        _AXES,
        _held,
    ),
    Defect(
        "unit",
        {"feet": FOOT, "inches": 0.0254, "m as mm": 1e3},
        LENGTHS,
        ("unit", "refused"),
        _unit,
    ),
    Defect(
        "unit-of-some",
        {"2 %": 0.02, "5 %": 0.05, "20 %": 0.2},
        LENGTHS,
        ("unit-of-some", "refused"),
        _some,
        ("outliers",),
    ),
    Defect(
        "scale",
        {"0.999": 0.999, "1.01": 1.01, "1.03": 1.03},
        LENGTHS,
        ("scale",),
        _scaled,
    ),
    Defect(
        "steps",
        {"0.2 mm": 2e-4, "1 mm": 1e-3, "1 cm": 1e-2},
        LENGTHS,
        ("coarse-steps",),
        _rounded,
    ),
    Defect(
        "joint-steps",
        {"0.01 deg": 0.01, "0.1 deg": 0.1, "0.5 deg": 0.5},
        ("position", "pose", "plane-distance", "point-distance"),
        ("coarse-steps",),
        _rounded_joints,
    ),
    Defect(
        "quaternion",
        {
            "w first": ((3, 0, 1, 2), 1.0),
            "conjugate": ((0, 1, 2, 3), -1.0),
            "both": ((3, 0, 1, 2), -1.0),
        },
        ("pose",),
        ("orientation-convention",),
        _quaternion,
    ),
    Defect(
        "angles",
        {
            "ZYX as vector": ("rotation-vector", "ZYX"),
            "zyz as rpy": ("roll-pitch-yaw", "zyz"),
            "vector as rpy": ("roll-pitch-yaw", "rotvec"),
        },
        ("pose",),
        ("orientation-convention",),
        _angles,
    ),
    Defect(
        "inverted",
        {"pose": None},
        ("pose",),
        ("pose-inverted",),
        _inverted,
    ),
)
