"""Defects of joint columns, and of their order against the measurements."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks.findings.defect import (
    MEASURED,
    Defect,
    Input,
    given,
    half_range,
    one_path,
    text_of,
    told,
)
from benchmarks.verdict.jobs import MODELS, Job
from calib_pin.estimation.evidence import Finding
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Measurements

ALL = tuple(MODELS)
"""All measurement models."""

PLAIN = ("position", "pose", "point-distance")
"""Measurement models with one measurement of each configuration that misses nothing."""

INNER = (1, 2, 3)
"""Joints whose zero neither base nor tool can absorb."""


def _read_otherwise(
    job: Job,
    rows: Measurements,
    read: Callable[[Floats], Floats],
    right: Callable[[Finding], bool],
) -> Input:
    """Measurements whose joint columns hold a function of the joint positions."""
    start = read(rows.start) if rows.start.size else rows.start
    spoiled = given(job, replace(rows, q=read(rows.q), start=start), right)
    return replace(spoiled, columns=read)


def _reversed(
    job: Job, rows: Measurements, rng: np.random.Generator, joint: int
) -> Input:
    """One joint counts the other way."""
    signs = np.ones(len(rows.joints))
    signs[joint] = -1.0
    right = told(rows.joints[joint])
    return _read_otherwise(job, rows, lambda q: q * signs, right)


def _offset(
    job: Job, rows: Measurements, rng: np.random.Generator, degrees: float
) -> Input:
    """The zero of one joint is elsewhere."""
    joint = int(rng.choice(INNER))
    offset = np.zeros(len(rows.joints))
    offset[joint] = np.radians(degrees)
    return _read_otherwise(job, rows, lambda q: q + offset, told(rows.joints[joint]))


def _exchanged(
    job: Job, rows: Measurements, rng: np.random.Generator, order: Sequence[int]
) -> Input:
    """The columns stand in another order."""
    moved = [rows.joints[k] for k, other in enumerate(order) if k != other]
    return _read_otherwise(job, rows, lambda q: q[:, order], told(*moved))


def _coupled(
    job: Job, rows: Measurements, rng: np.random.Generator, factor: float
) -> Input:
    """The elbow counts from the link before it, by a factor."""
    factors = np.eye(len(rows.joints))
    factors[2, 1] = factor
    right = told(rows.joints[1], rows.joints[2])
    return _read_otherwise(job, rows, lambda q: q @ factors.T, right)


def _at_once(
    job: Job, rows: Measurements, rng: np.random.Generator, kinds: str
) -> Input:
    """The elbow is reversed, offset by 90 deg and coupled, or two of these."""
    factors, offset = np.eye(len(rows.joints)), np.zeros(len(rows.joints))
    if "coupled" in kinds:
        factors[2, 1] = 1.0
    if "reversed" in kinds:
        factors[2] *= -1.0
    if "offset" in kinds:
        offset[2] = np.pi / 2
    return _read_otherwise(
        job, rows, lambda q: q @ factors.T + offset, told(rows.joints[2])
    )


def _geared(
    job: Job, rows: Measurements, rng: np.random.Generator, part: float
) -> Input:
    """A gear ratio that is not that of the controller."""
    joint = int(rng.integers(len(rows.joints)))
    factors = np.ones(len(rows.joints))
    factors[joint] = 1.0 / (1.0 + part)
    return _read_otherwise(job, rows, lambda q: q * factors, told(rows.joints[joint]))


def _degrees(
    job: Job, rows: Measurements, rng: np.random.Generator, joints: Sequence[int]
) -> Input:
    """Some joints in degrees."""
    factors = np.ones(len(rows.joints))
    factors[list(joints)] = np.degrees(1.0)
    return _read_otherwise(
        job, rows, lambda q: q * factors, told(rows.joints[joints[0]])
    )


def _shifted(
    job: Job, rows: Measurements, rng: np.random.Generator, lines: int
) -> Input:
    """Joint positions that stand some lines below their measurement, or above."""
    kept = rows.rows(np.arange(lines, len(rows)))
    q = rows.q[: len(rows) - lines]
    if rng.uniform() < 0.5:
        kept, q = rows.rows(np.arange(len(rows) - lines)), rows.q[lines:]
        lines = -lines

    side = "above" if lines < 0 else "below"
    right = told(f"stand {abs(lines)} line", side)
    return given(job, replace(kept, q=q), right)


def _backwards(
    job: Job, rows: Measurements, rng: np.random.Generator, count: int
) -> Input:
    """Joint positions in reversed order."""
    some = rows.rows(np.arange(count))
    return given(job, replace(some, q=some.q[::-1]))


def _lagging(
    job: Job,
    rows: Measurements,
    rng: np.random.Generator,
    part: float,
    *,
    every: bool = False,
) -> Input:
    """Joints still had a part of their last motion before them as it was measured."""
    parts = np.full(len(rows.joints), part)
    joint = int(rng.integers(4))
    if not every:
        parts[np.arange(len(parts)) != joint] = 0.0
    q = rows.q.copy()
    for k in range(1, len(q)):
        q[k] = (rows.q[k] - parts * q[k - 1]) / (1.0 - parts)
    right = told("motion") if every else told("motion", rows.joints[joint])
    return given(job, replace(rows, q=q), right)


def _commanded(
    job: Job, rows: Measurements, rng: np.random.Generator, size: float
) -> Input:
    """Commanded positions in the columns of the joints, and measured ones beside."""
    commanded = rows.q + rng.normal(0.0, size, rows.q.shape)
    lines = text_of(replace(rows, q=commanded)).splitlines()
    names = [f"{MEASURED}{joint}" for joint in rows.joints]
    added = [names, *(map(repr, q) for q in rows.q.tolist())]
    text = "".join(
        f"{line},{','.join(more)}\n" for line, more in zip(lines, added, strict=True)
    )
    return given(job, text, told(*names))


def _of(joints: str) -> tuple[int, ...]:
    return tuple(int(letter) for letter in joints)


DEFECTS = (
    Defect(
        "reversed",
        {"base": 0, "elbow": 2, "wrist": 4},
        ALL,
        ("joint-reversed", "refused"),
        _reversed,
    ),
    Defect(
        "offset",
        {"5 deg": 5.0, "30 deg": 30.0, "90 deg": 90.0},
        ALL,
        ("joint-offset", "large-correction", "refused"),
        _offset,
    ),
    Defect(
        "exchanged",
        {
            "neighbors": _of("013245"),
            "wrist": _of("012543"),
            "cyclic": _of("012453"),
        },
        ALL,
        ("joints-exchanged", "refused"),
        _exchanged,
    ),
    Defect(
        "coupled",
        {"1 %": 0.01, "1": 1.0, "-1": -1.0},
        ALL,
        ("joint-coupled", "refused"),
        _coupled,
    ),
    Defect(
        "at-once",
        {
            "sign, zero": "reversed offset",
            "sign, link": "reversed coupled",
            "all": "reversed offset coupled",
        },
        ("position", "pose", "point-distance", "camera"),
        ("joint-reversed", "joint-offset", "joint-coupled", "refused"),
        _at_once,
        measured=half_range,
    ),
    Defect(
        "geared",
        {"0.1 %": 1e-3, "1 %": 1e-2, "10 %": 0.1},
        ALL,
        ("joint-gear",),
        _geared,
        also=("model-lacks",),
    ),
    Defect(
        "degrees",
        {"one joint": (2,), "wrist": (3, 4, 5), "all": (0, 1, 2, 3, 4, 5)},
        PLAIN,
        ("joint-degrees", "joint-unit", "refused"),
        _degrees,
    ),
    Defect(
        "shifted",
        {"1 line": 1, "3 lines": 3, "10 lines": 10},
        (*PLAIN, "camera"),
        ("lines-shifted", "refused"),
        _shifted,
    ),
    Defect(
        "shifted-path",
        {"1 line": 1, "3 lines": 3, "10 lines": 10},
        PLAIN,
        ("lines-shifted",),
        _shifted,
        also=("lag",),
        measured=one_path,
    ),
    Defect(
        "backwards",
        {"40 lines": 40, "50 lines": 50, "60 lines": 60},
        ("position", "pose"),
        ("lines-reversed",),
        _backwards,
    ),
    Defect(
        "joint-sets",
        {"0.1 mrad": 1e-4, "1 mrad": 1e-3, "10 mrad": 1e-2},
        ("position", "pose", "camera"),
        ("joint-columns",),
        _commanded,
    ),
    Defect(
        "lag",
        {"0.02 %": 2e-4, "0.2 %": 2e-3, "2 %": 0.02},
        PLAIN,
        ("lag",),
        _lagging,
    ),
    Defect(
        "lag-all",
        {"0.02 %": 2e-4, "0.2 %": 2e-3, "2 %": 0.02},
        PLAIN,
        ("lag",),
        partial(_lagging, every=True),
    ),
)
