"""Columns of a file that hold an orientation, in one of three ways."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib_pin.errors import InputError
from calib_pin.io.columns import ANGLE, PURE, Floats, Kind
from calib_pin.io.table import Table

QUATERNION = {"qx": PURE, "qy": PURE, "qz": PURE, "qw": PURE}
ROTATION_VECTOR = {"rx": ANGLE, "ry": ANGLE, "rz": ANGLE}
FIXED_AXES = {"roll": ANGLE, "pitch": ANGLE, "yaw": ANGLE}
ORIENTATIONS = (QUATERNION, ROTATION_VECTOR, FIXED_AXES)


def read_kinds(table: Table, kinds: Mapping[str, Kind]) -> Floats:
    """Columns side by side, shape (N, k), checked for their unit."""
    values = np.empty((len(table.lines), len(kinds)))
    for k, (name, kind) in enumerate(kinds.items()):
        values[:, k] = table.numbers(name, kind)
        table.check_size(name, values[:, k], kind, kind.largest)
    return values


def orientation_columns(table: Table) -> Mapping[str, Kind]:
    """The columns of the one complete orientation of a file."""
    ways = " or ".join(",".join(kinds) for kinds in ORIENTATIONS)
    present = [kinds for kinds in ORIENTATIONS if any(name in table for name in kinds)]
    if not present:
        raise table.error("model 'pose' needs an orientation", allowed=ways)
    if len(present) > 1:
        names = [next(name for name in kinds if name in table) for kinds in present]
        raise table.error(
            f"the orientation is given more than once, by {' and by '.join(names)}",
            names[1],
            f"one of {ways}",
        )
    missing = [name for name in present[0] if name not in table]
    if missing:
        whole = ", ".join(present[0])
        raise table.error(
            f"of the orientation {whole} the file lacks {', '.join(missing)}",
            missing[0],
        )
    return present[0]


def read_quaternions(table: Table, orientation: Mapping[str, Kind]) -> Floats:
    """Unit quaternions qx qy qz qw with qw >= 0, shape (N, 4)."""
    given = read_kinds(table, orientation)
    if orientation is ROTATION_VECTOR:
        half = 0.5 * np.linalg.norm(given, axis=1, keepdims=True)
        # sinc is exact at zero angle.
        given = np.hstack([0.5 * np.sinc(half / np.pi) * given, np.cos(half)])
    elif orientation is FIXED_AXES:
        given = _from_fixed_axes(given)
    with np.errstate(over="ignore"):
        norm = np.linalg.norm(given, axis=1)
    row = int(np.argmax(np.abs(norm - 1.0)))
    if abs(norm[row] - 1.0) > 1e-2:
        raise InputError(
            f"the quaternion has the norm {norm[row]:.6g}",
            file=table.file,
            line=int(table.lines[row]),
            column=", ".join(orientation),
            value=", ".join(table.cell(c, row) for c in orientation),
            allowed="a norm of 0.99 to 1.01",
        )
    # Dividing a unit quaternion once more may change its last bit, and a file that was
    # written from here must read back as it was.
    norm[np.abs(norm - 1.0) < 1e-14] = 1.0
    quaternions = given / norm[:, None]
    return np.asarray(np.where(quaternions[:, 3:] < 0.0, -quaternions, quaternions))


def _from_fixed_axes(angles: Floats) -> Floats:
    """Quaternions of R = Rz(yaw) Ry(pitch) Rx(roll), shape (N, 3) -> (N, 4)."""
    (sr, sp, sy), (cr, cp, cy) = np.sin(0.5 * angles).T, np.cos(0.5 * angles).T
    return np.stack(
        [
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        ],
        axis=1,
    )
