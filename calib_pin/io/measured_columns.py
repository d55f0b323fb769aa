"""Measured columns of a file: positions, orientations, distances and their sigmas."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from calib_pin.chain import Chain
from calib_pin.errors import InputError, OptionError, nearest
from calib_pin.io.columns import ANGLE, LENGTH, PURE, Floats, Kind, Table, closest

__all__ = [
    "COMPONENTS",
    "RESERVED",
    "VALUES",
    "check_model",
    "check_spread",
    "infer_model",
    "read_sigma",
    "read_values",
]

POSITION = {"x": LENGTH, "y": LENGTH, "z": LENGTH}
QUATERNION = {"qx": PURE, "qy": PURE, "qz": PURE, "qw": PURE}
ROTATION_VECTOR = {"rx": ANGLE, "ry": ANGLE, "rz": ANGLE}
FIXED_AXES = {"roll": ANGLE, "pitch": ANGLE, "yaw": ANGLE}
ORIENTATIONS = (QUATERNION, ROTATION_VECTOR, FIXED_AXES)
DISTANCE = {"distance": LENGTH}

COMPONENTS: Mapping[str, Mapping[str, Kind]] = {
    "position": POSITION,
    "pose": {**POSITION, **ROTATION_VECTOR},
    "plane-distance": DISTANCE,
}
"""The residual components of each model; a sigma belongs to one of these."""

VALUES: Mapping[str, tuple[str, ...]] = {
    "position": tuple(POSITION),
    "pose": (*POSITION, *QUATERNION),
    "plane-distance": tuple(DISTANCE),
}
"""The columns of `Measurements.values` of each model."""

LATER = ("point-distance", "fixed-point", "plane-contact", "camera")
MEASURED = frozenset(
    name for kinds in (POSITION, *ORIENTATIONS, DISTANCE) for name in kinds
)
RESERVED = MEASURED | {"target", "set", "sigma"} | {f"sigma_{c}" for c in MEASURED}
"""Names that have a meaning in every file, whatever the robot's joints are called."""

LARGEST_SIGMA = 1.0
"""Largest standard deviation that can be meant [m, rad]."""

SMALLEST_SIGMA = 1e-12
"""Smallest standard deviation that can be meant [m, rad]."""


def check_model(model: str) -> None:
    """Check the name of a measurement model.

    Raises:
        OptionError: If files of that model cannot be read.
    """
    if model in COMPONENTS:
        return
    reason = (
        f"measurement model '{model}' is not available in this version"
        if model in LATER
        else f"unknown measurement model '{model}'{nearest(model, COMPONENTS)}"
    )
    raise OptionError(reason, allowed=", ".join(COMPONENTS))


def infer_model(table: Table) -> str:
    """The one model whose columns a file has.

    Raises:
        InputError: If there is none, or more than one.
    """
    oriented = any(name in table for kinds in ORIENTATIONS for name in kinds)
    positioned = any(name in table for name in POSITION)
    if "distance" in table and (oriented or positioned):
        raise table.error(
            "the file has both a position and a distance; name what is measured with "
            "--model",
            allowed=", ".join(COMPONENTS),
        )
    if "distance" in table:
        return "plane-distance"
    if oriented or positioned:
        return "pose" if oriented else "position"
    raise table.error(
        "no measured columns; position needs x, y, z; pose needs these and an "
        "orientation; plane-distance needs distance"
    )


def read_values(
    table: Table, model: str, spare: Sequence[str]
) -> tuple[tuple[str, ...], Floats]:
    """The measured values of a model.

    Args:
        table: The file.
        model: Name of the model.
        spare: Columns that are no joints, for a hint at a missing one.

    Returns:
        The columns that were used, and the values in the layout of
        `Measurements.values`, shape (N, D).

    Raises:
        InputError: If a column is missing, or a value cannot be.
    """
    kinds = DISTANCE if model == "plane-distance" else POSITION
    _check_present(table, model, tuple(kinds), spare)
    values = _read(table, kinds)
    if model != "pose":
        return tuple(kinds), values
    orientation = _orientation(table)
    quaternions = _quaternions(table, orientation)
    return (*kinds, *orientation), np.hstack([values, quaternions])


def read_sigma(table: Table, model: str) -> tuple[Mapping[str, str], Floats | None]:
    """The standard deviations of a model's residual components.

    Args:
        table: The file.
        model: Name of the model.

    Returns:
        The column of each component and the values, shape (N, d) [m, rad]; nothing
        and None where the file states none.

    Raises:
        InputError: If only some components have one, or a value is not positive.
    """
    components = COMPONENTS[model]
    if model == "pose":
        _check_pose_sigma(table)
    found = {
        component: name
        for component in components
        for name in ("sigma", f"sigma_{component}")
        if name in table
    }
    if not found:
        return {}, None
    missing = [f"sigma_{name}" for name in components if name not in found]
    if missing:
        raise table.error(
            "a sigma is needed for every component or for none; missing: "
            f"{', '.join(missing)}",
            missing[0],
        )
    columns = []
    for component, name in found.items():
        kind = components[component]
        column = table.numbers(name, kind, positive=True)
        table.check_size(name, column, kind, LARGEST_SIGMA)
        row = int(np.argmin(column))
        if column[row] < SMALLEST_SIGMA:
            raise table.cell_error(
                "too small for a standard deviation",
                name,
                row,
                f"{SMALLEST_SIGMA:g} {kind.si} or more",
            )
        columns.append(column)
    return found, np.stack(columns, axis=1)


def check_spread(
    table: Table, chain: Chain, positions: Floats, base: Floats | None = None
) -> None:
    """Refuse positions that lie much farther apart than the chain can reach.

    Args:
        table: The file, with columns x, y and z.
        chain: The chain.
        positions: What these columns hold, shape (N, 3) [m].
        base: Where the chain stands among them, shape (3,) [m]; None if unknown.

    Raises:
        InputError: If they do; blames the outermost position.
    """
    placements = (*chain.placements, chain.tip_placement)
    reach = sum(float(np.linalg.norm(M.translation)) for M in placements)
    reach += float((chain.upper - chain.lower)[~chain.revolute].sum())
    for k, (name, column) in enumerate(zip(POSITION, positions.T, strict=True)):
        if base is None:
            center, spread = float(np.median(column)), float(np.ptp(column))
            what = "the rows span"
        else:
            center, what = float(base[k]), "it is away from the base"
            spread = float(np.abs(column - center).max())
        # One meter for a tool, and a factor for a URDF that is far off.
        if spread > 4.0 * (reach + 1.0):
            row = int(np.argmax(np.abs(column - center)))
            why = f"{what} {spread:.3g} m and the robot reaches {reach:.3g} m"
            raise table.implausible(name, row, float(column[row]), LENGTH, why)


def _check_present(
    table: Table, model: str, names: Sequence[str], spare: Sequence[str]
) -> None:
    missing = [name for name in names if name not in table]
    if not missing:
        return
    unknown = [name for name in spare if name not in RESERVED]
    hint = next(filter(None, (closest(name, unknown) for name in missing)), "")
    what = ", ".join(missing)
    raise table.error(f"model '{model}' needs the missing {what}{hint}", missing[0])


def _read(table: Table, kinds: Mapping[str, Kind]) -> Floats:
    """Columns side by side, shape (N, k), checked for their unit."""
    columns = []
    for name, kind in kinds.items():
        columns.append(table.numbers(name, kind))
        table.check_size(name, columns[-1], kind, kind.largest)
    return np.stack(columns, axis=1)


def _orientation(table: Table) -> Mapping[str, Kind]:
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


def _quaternions(table: Table, orientation: Mapping[str, Kind]) -> Floats:
    """Unit quaternions qx qy qz qw with qw >= 0, shape (N, 4)."""
    given = _read(table, orientation)
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
            value=", ".join(table.columns[c].cells[row].strip() for c in orientation),
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


def _check_pose_sigma(table: Table) -> None:
    """Refuse a sigma whose meaning for a pose would have to be guessed."""
    allowed = ", ".join(f"sigma_{name}" for name in COMPONENTS["pose"])
    if "sigma" in table:
        raise table.error(
            "'sigma' cannot hold for lengths and angles at once", "sigma", allowed
        )
    for name in (*QUATERNION, *FIXED_AXES):
        if f"sigma_{name}" in table:
            raise table.error(
                "the sigma of an orientation is that of its rotation vector in the "
                "tool frame",
                f"sigma_{name}",
                allowed,
            )
