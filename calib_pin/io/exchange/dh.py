"""Denavit-Hartenberg tables of the corrected chain, standard and modified, as CSV.

    standard   A_i = Rz(theta_i) Tz(d) Tx(a) Rx(alpha) Ry(beta)
    modified   A_i = Tx(a) Rx(alpha) Ry(beta) Rz(theta_i) Tz(d)

(Denavit and Hartenberg, 1955; Craig, 1986) with `theta_i = theta + q_i`, or `d + q_i`
of a prismatic joint. Between axes that are parallel or nearly so the common normal is
anywhere, and `d` would be meters; there it is zero and beta tilts the next axis (Hayati
and Mirmirani, 1985). Elsewhere beta is zero.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
import pinocchio as pin

from calib_pin.io.exchange.base import (
    ORIGIN,
    PRISMATIC,
    RIGID,
    Encoded,
    Exported,
    Format,
    origin_of,
    placed,
)
from calib_pin.io.exchange.vendor_kinematics import along, axis_frames, poses_about_z
from calib_pin.io.measurements import encode_table
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats

PARALLEL = np.deg2rad(1.0)
"""Angle between axes below which beta stands for d."""

NUMBERS = ("theta", "d", "a", "alpha", "beta")
"""Of a joint [rad, m]."""


def encode(exported: Exported, _: Path | None) -> Encoded:
    """Both tables, each with the frames before its first and behind its last joint."""
    chain = exported.chain
    kinds = ["revolute" if turns else "prismatic" for turns in chain.revolute]
    first, steps, last = _steps(
        axis_frames(chain), pin.SE3(chain.poses(np.zeros((1, len(kinds))))[0])
    )
    # Before the first axis nothing moves or turns.
    before = [[0.0, 0.0, 0.0], *(step[2:] for step in steps)]
    tables = {
        "standard": steps,
        "modified": [[*s[:2], *b] for s, b in zip(steps, before, strict=False)],
    }
    rows: list[list[object]] = []
    no_step, no_frame = [""] * len(NUMBERS), [""] * len(ORIGIN)
    for convention, numbers in tables.items():
        rows.append([convention, "base", "frame", *no_step, *origin_of(first)])
        for joint, kind, row in zip(chain.joints, kinds, numbers, strict=True):
            rows.append([convention, joint, kind, *row, *no_frame])
        rows.append([convention, "tip", "frame", *no_step, *origin_of(last)])
    headers = ("convention", "joint", "type", *NUMBERS, *ORIGIN)
    table = dict(zip(headers, zip(*rows, strict=True), strict=True))
    ends = "base and tip: the frames before the first and behind the last joint"
    data = encode_table(table, [__doc__ or "", ends])
    for convention in tables:
        read = partial(_poses, data, convention)
        exported.require_same(read, f"the {convention} table")
    return Encoded(data, read=read)


def _steps(
    axes: Sequence[tuple[Floats, Floats]], tip: pin.SE3
) -> tuple[pin.SE3, list[list[float]], pin.SE3]:
    """Base frame, theta, d, a, alpha and beta from axis to axis, and tip frame.

    Everything behind the last joint is in the tip frame.
    """
    frame = first = along(*axes[0], pin.SE3.Identity())
    steps = []
    for after in axes[1:]:
        steps.append(_step(frame, *after))
        frame = frame * _standard(steps[-1])
    return first, [*steps, [0.0] * len(NUMBERS)], frame.actInv(tip)


def _step(frame: pin.SE3, point: Floats, axis: Floats) -> list[float]:
    """From a frame on an axis to the next axis."""
    point = frame.rotation.T @ (point - frame.translation)
    axis = frame.rotation.T @ axis
    cross = np.hypot(axis[0], axis[1])
    if abs(cross) > np.sin(PARALLEL):
        # x along the common normal, away from this axis where it has a length.
        theta = float(np.arctan2(axis[0], -axis[1]))
        x = np.array([np.cos(theta), np.sin(theta), 0.0])
        if x @ point < 0.0:
            theta, x = float(np.arctan2(-axis[0], axis[1])), -x
        alpha = float(np.arctan2(axis @ np.cross(x, [0.0, 0.0, 1.0]), axis[2]))
        a, beta = float(x @ point), 0.0
        # Foot of the common normal on this axis.
        foot = axis * ((point[0] * axis[0] + point[1] * axis[1]) / cross**2)
        d = float((point - foot)[2])
    else:
        # Where the next axis meets the plane across this one.
        met = point - axis * (point[2] / axis[2])
        a, d = float(np.hypot(met[0], met[1])), 0.0
        theta = float(np.arctan2(met[1], met[0])) if a > 1e-9 else 0.0
        turned = pin.utils.rotate("z", theta).T @ axis
        # Rx(alpha) Ry(beta) z = (sin b, -sin a cos b, cos a cos b)
        beta = float(np.arctan2(turned[0], np.hypot(turned[1], turned[2])))
        alpha = float(np.arctan2(-turned[1], turned[2]))
    return [theta, d, a, alpha, beta]


def _turn(axis: str, angle: float) -> pin.SE3:
    return pin.SE3(pin.utils.rotate(axis, float(angle)), np.zeros(3))


def _move(x: float, z: float) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array([x, 0.0, z]))


def _standard(row: Sequence[float]) -> pin.SE3:
    theta, d, a, alpha, beta = row
    return _turn("z", theta) * _move(a, d) * _turn("x", alpha) * _turn("y", beta)


def _modified(row: Sequence[float]) -> pin.SE3:
    theta, d, a, alpha, beta = row
    tilted = _move(a, 0.0) * _turn("x", alpha) * _turn("y", beta)
    return tilted * _turn("z", theta) * _move(0.0, d)


def _poses(data: bytes, convention: str, _: Chain, q: Floats) -> Floats:
    """Forward kinematics of one of the tables as it reads back."""
    lines = [line for line in data.decode().splitlines() if line[:1] != "#"]
    rows = [row for row in csv.DictReader(lines) if row["convention"] == convention]
    base, tip = (
        placed([float(row[key]) for key in ORIGIN]) for row in rows[:: len(rows) - 1]
    )
    steps = [[float(row[key]) for key in NUMBERS] for row in rows[1:-1]]
    if convention == "standard":  # What moves is in front of every step.
        origins = [base, *map(_standard, steps)]
        origins[-1] = origins[-1] * tip
    else:
        origins = [*map(_modified, steps), tip]
        origins[0] = base * origins[0]
    return poses_about_z(origins, [row["type"] == "revolute" for row in rows[1:-1]], q)


DH = Format(
    "dh",
    ".csv",
    "Denavit-Hartenberg tables, standard and modified",
    encode,
    holds=(*RIGID, PRISMATIC),
)
