"""Measured columns of a file: which model reads which, their values and sigmas."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import InputError
from calib_pin.io.columns import (
    ANGLE,
    LENGTH,
    PIXEL,
    PURE,
    Floats,
    Kind,
    closest,
)
from calib_pin.io.table import Table
from calib_pin.kinematics.chain import Chain
from calib_pin.measurement_models import MEASUREMENT_MODELS, declared
from calib_pin.measurement_models.declaration import DIAL
from calib_pin.measurement_models.orientations import quaternions
from calib_pin.observations import AT, BlockKey, Labels
from calib_pin.setup import STATED, WORLD, OrientationSetup

ORIENTATIONS: Mapping[str, Mapping[str, Kind]] = {
    way: dict.fromkeys(names, PURE if way == "quaternion" else ANGLE)
    for way, names in STATED.items()
}
"""The kinds of the columns of an orientation, by the ways to state it."""


def read_kinds(table: Table, kinds: Mapping[str, Kind]) -> Floats:
    """Columns side by side, shape (N, k), checked for their unit."""
    values = np.empty((len(table.lines), len(kinds)))
    for k, (name, kind) in enumerate(kinds.items()):
        values[:, k] = table.numbers(name, kind)
        table.check_size(name, values[:, k], kind, kind.largest)
    return values


def orientation_columns(table: Table) -> str:
    """The one way in which a file states orientations, one of `STATED`."""
    ways = " or ".join(",".join(kinds) for kinds in STATED.values())
    present = {
        way: [name for name in kinds if name in table] for way, kinds in STATED.items()
    }
    stated = [way for way, names in present.items() if names]
    if not stated:
        raise table.error("model 'pose' needs an orientation", allowed=ways)
    if len(stated) > 1:
        names = [present[way][0] for way in stated]
        raise table.error(
            f"the orientation is given more than once, by {' and by '.join(names)}",
            names[1],
            f"one of {ways}",
        )
    missing = [name for name in STATED[stated[0]] if name not in table]
    if missing:
        whole = ", ".join(STATED[stated[0]])
        raise table.error(
            f"of the orientation {whole} the file lacks {', '.join(missing)}",
            missing[0],
        )
    return stated[0]


def stated_way(columns: Collection[str]) -> str:
    """The way in which columns state an orientation; empty for none."""
    ways = (way for way, names in STATED.items() if set(names) <= set(columns))
    return next(ways, "")


def read_quaternions(
    table: Table, way: str, reading: OrientationSetup | None = None
) -> Floats:
    """Unit quaternions qx qy qz qw with qw >= 0, shape (N, 4).

    Args:
        table: The file.
        way: How it states orientations, one of `STATED`.
        reading: How they are to be read.
    """
    given = quaternions(read_kinds(table, ORIENTATIONS[way]), way, reading)
    with np.errstate(over="ignore"):
        norm = np.linalg.norm(given, axis=1)
    row = int(np.argmax(np.abs(norm - 1.0)))
    if abs(norm[row] - 1.0) > 1e-2:
        raise InputError(
            f"the quaternion has the norm {norm[row]:.6g}",
            file=table.file,
            line=int(table.lines[row]),
            column=", ".join(STATED[way]),
            value=", ".join(table.columns[c].text(row) for c in STATED[way]),
            allowed="a norm of 0.99 to 1.01",
        )
    # Dividing a unit quaternion once more may change its last bit, and a file that was
    # written from here must read back as it was.
    norm[np.abs(norm - 1.0) < 1e-14] = 1.0
    unit = given / norm[:, None]
    return np.asarray(np.where(unit[:, 3:] < 0.0, -unit, unit))


POSITION = ("x", "y", "z")
"""Columns of a position."""

KINDS: Mapping[str, Kind] = {kind.si: kind for kind in (LENGTH, ANGLE, PIXEL)}
"""How numbers of a unit may be written."""

ORIENTED = frozenset(name for names in STATED.values() for name in names)
"""Columns of an orientation, in any of the ways."""


NAMES = (*BlockKey._fields, "target", "payload", "set")
"""Columns of names; the first tell blocks apart."""


def needed(model: str) -> dict[str, Kind]:
    """The measured columns that a model cannot do without."""
    return {name: KINDS[unit] for name, unit in declared(model).columns.items()}


def components(model: str) -> dict[str, Kind]:
    """The residual components of a model; a sigma belongs to one of these."""
    return {name: KINDS[unit] for name, unit in declared(model).units.items()}


STROKE = replace(LENGTH, largest=0.1)
"""Readings of gauges."""


def optional(model: str) -> frozenset[str]:
    """The measured columns that a model reads where there are any."""
    return frozenset(name for ways in declared(model).readings for name in ways)


def gauges() -> frozenset[str]:
    """Columns that hold deviations of some contact."""
    return frozenset[str]().union(*map(optional, MEASUREMENT_MODELS))


def measured() -> frozenset[str]:
    """Columns that hold what some model measures."""
    return ORIENTED.union(gauges(), *map(needed, MEASUREMENT_MODELS))


def sigmas() -> frozenset[str]:
    """Columns that hold standard deviations."""
    names = measured().union(*map(components, MEASUREMENT_MODELS))
    return frozenset({"sigma"} | {f"sigma_{name}" for name in names})


def reserved() -> frozenset[str]:
    """Names that have a meaning in every file, whatever the robot's joints are."""
    return measured() | sigmas() | set(NAMES)


LARGEST_SIGMA = {"m": 1.0, "rad": 1.0, "px": 1e3}
"""Largest standard deviation that can be meant, by unit."""

SMALLEST_SIGMA = {"m": 1e-12, "rad": 1e-12, "px": 1e-9}
"""Smallest standard deviation that can be meant, by unit."""


def read_values(
    table: Table,
    model: str,
    spare: Sequence[str],
    orientation: OrientationSetup | None = None,
) -> tuple[tuple[str, ...], Floats]:
    """The measured values of a model.

    Args:
        table: The file.
        model: Name of the model.
        spare: Columns that are no joints, for a hint at a missing one.
        orientation: How columns of an orientation are to be read.

    Returns:
        The columns that were used, and the values in the layout of
        `Measurements.values`, shape (N, D).

    Raises:
        InputError: If a column is missing, or a value cannot be.
    """
    kinds = needed(model)
    _check_present(table, model, tuple(kinds), spare)
    if declared(model).contact:
        return read_deviations(table, model)
    values = read_kinds(table, kinds)
    if not declared(model).oriented:
        return tuple(kinds), values
    way = orientation_columns(table)
    turned = read_quaternions(table, way, orientation)
    return (*kinds, *STATED[way]), np.hstack([values, turned])


def read_deviations(table: Table, model: str) -> tuple[tuple[str, ...], Floats]:
    """The deviations of contacts, as `read_values`; none where no gauge was read.

    Raises:
        InputError: If only some components have one, or one has two.
    """
    ways = declared(model).readings
    there = sorted(gauges() & table.columns.keys())
    there = [name for name in there if not table.columns[name].missing().all()]
    found = [name for names in ways for name in names if name in there]
    others = [name for name in there if name not in found]
    once = all((names[0] in found) != (names[1] in found) for names in ways)
    if others or (found and not once):
        raise table.error(
            f"of a gauge '{model}' needs every column once, and no other",
            (others or found)[-1],
            ", ".join(map(" or ".join, ways)),
        )
    if not found:
        return (), np.zeros((len(table.lines), 0))
    values = read_kinds(table, dict.fromkeys(found, STROKE))
    return tuple(found), values * [-1.0 if DIAL in n else 1.0 for n in found]


def read_sigma(table: Table, model: str) -> tuple[Mapping[str, str], Floats | None]:
    """The standard deviations of a model's residual components.

    Args:
        table: The file.
        model: Name of the model.

    Returns:
        The column of each component and the values, shape (N, d) [m, rad, px]; nothing
        and None where the file states none.

    Raises:
        InputError: If only some components have one, or a value is not positive.
    """
    kinds = components(model)
    of_gauges = declared(model).readings or [("", "")] * len(kinds)
    if declared(model).oriented:
        _check_pose_sigma(table, model)
    if declared(model).contact and len(kinds) == 1:
        _check_contact_sigma(table)
    found = {
        component: name
        for component, ways in zip(kinds, of_gauges, strict=True)
        for name in ("sigma", *(f"sigma_{way}" for way in (component, *ways)))
        if name in table
    }
    if not found:
        return {}, None
    missing = [f"sigma_{name}" for name in kinds if name not in found]
    if missing:
        raise table.error(
            "a sigma is needed for every component or for none; missing: "
            f"{', '.join(missing)}",
            missing[0],
        )
    columns = []
    for component, name in found.items():
        kind = kinds[component]
        column = table.numbers(name, kind, positive=True)
        table.check_size(name, column, kind, LARGEST_SIGMA[kind.si])
        row, smallest = int(np.argmin(column)), SMALLEST_SIGMA[kind.si]
        if column[row] < smallest:
            raise table.cell_error(
                "too small for a standard deviation",
                name,
                row,
                f"{smallest:g} {kind.si} or more",
            )
        columns.append(column)
    return found, np.stack(columns, axis=1)


def check_targets(table: Table, key: BlockKey, target: Labels) -> None:
    """Refuse measurements that do not name what they cannot do without.

    Args:
        table: The file.
        key: What the measurements have in common.
        target: The target of each; empty names if the file has no such column.

    Raises:
        InputError: If there are such.
    """
    naming, noun = declared(key.model).naming, ""
    if naming.required == "every":
        noun, reason = naming.noun, f"model '{key.model}'"
    elif key.chain == WORLD:
        noun, reason = "point that stands still", f"chain '{WORLD}'"
    if not noun:
        return
    if "target" not in table:
        raise table.error(
            f"{reason} needs a column 'target' with the {noun} of each row", "target"
        )
    nameless = target.map(place_of).where("")
    if nameless.any():
        row = int(np.argmax(nameless))
        raise table.cell_error(f"the row names no {noun}", "target", row)


def place_of(target: str) -> str:
    """The plane, socket or other place in the name of a target."""
    return target.rpartition(AT)[2]


def find_starts(
    table: Table, target: Labels, payload: Labels, distance: Floats, q: Floats
) -> NDArray[np.int64]:
    """The row at which the relative measurement of each row starts, shape (N,).

    Rows of one target belong together; the first of them is their start.

    Args:
        table: The file.
        target: Target of each row.
        payload: Payload of each row.
        distance: Distances from the start, shape (N,) [m].
        q: Joint positions, shape (N, n) [rad, m].

    Raises:
        InputError: If a start is not one, nothing starts there, or a row cannot be
            measured from it.
    """
    count = len(distance)
    _, first, which = np.unique(target.codes, return_index=True, return_inverse=True)
    start = np.asarray(first[which])
    begins = start == np.arange(count)
    sizes = np.bincount(start, minlength=count)
    still = (q == q[start]).all(axis=1) & ~begins
    other = payload.codes != payload.codes[start]
    of = "the first row of a target is its start"
    for wrong, reason, column, allowed in (
        (begins & (distance != 0.0), f"{of}, where the distance is 0", "distance", "0"),
        (
            sizes == 1,
            f"{of}, and no other row is measured from it",
            "target" if "target" in table else "distance",
            None,
        ),
        (
            ~begins & (distance <= 0.0),
            f"{of}; all others are away from it, a new start needs a target of its own",
            "distance",
            "more than 0",
        ),
        (
            still,
            "the joint positions are those of the start, from where no distance can be "
            "measured",
            "distance",
            None,
        ),
        (other, "the payload is not that of the start", "payload", None),
    ):
        if wrong.any():
            raise table.cell_error(reason, column, int(np.argmax(wrong)), allowed)
    return start


def check_spread(
    table: Table, chain: Chain, positions: Floats, base: Floats | None = None
) -> None:
    """Refuse positions that lie much farther apart than the chain can reach.

    Args:
        table: The file, with columns x, y and z.
        chain: The chain.
        positions: Values of these columns, shape (N, 3) [m].
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
            what = "the measurements span"
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
    unknown = [name for name in spare if name not in reserved()]
    hint = next(filter(None, (closest(name, unknown) for name in missing)), "")
    what = ", ".join(missing)
    raise table.error(f"model '{model}' needs the missing {what}{hint}", missing[0])


def _check_pose_sigma(table: Table, model: str) -> None:
    """Refuse a sigma whose meaning for a pose would have to be guessed."""
    allowed = ", ".join(f"sigma_{name}" for name in components(model))
    if "sigma" in table:
        raise table.error(
            "'sigma' cannot hold for lengths and angles at once", "sigma", allowed
        )
    for name in (*STATED["quaternion"], *STATED["roll-pitch-yaw"]):
        if f"sigma_{name}" in table:
            raise table.error(
                "the sigma of an orientation is that of its rotation vector in the "
                "tool frame",
                f"sigma_{name}",
                allowed,
            )


def _check_contact_sigma(table: Table) -> None:
    """Refuse a sigma that a contact does not have."""
    kinds = {k: v for name in MEASUREMENT_MODELS for k, v in needed(name).items()}
    for name in (name for name, kind in kinds.items() if kind is LENGTH):
        # Beside its own column it is of something that is not read either.
        if f"sigma_{name}" in table and name not in table:
            raise table.error(
                "a contact is off its surface in one direction only",
                f"sigma_{name}",
                "sigma, sigma_contact",
            )
