"""The measurements in one file, one part for each model."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence, Set
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import InputError, OptionError, nearest
from calib_pin.io.columns import Floats
from calib_pin.io.joint_columns import JointSource, read_positions, spare_columns
from calib_pin.io.measured_columns import (
    ORIENTED,
    check_spread,
    check_targets,
    components,
    find_starts,
    measured,
    needed,
    read_sigma,
    read_values,
    reserved,
    sigmas,
)
from calib_pin.io.table import Table
from calib_pin.kinematics.chain import Chain
from calib_pin.measurement_models import MEASUREMENT_MODELS, declared
from calib_pin.observations import AT, PLUS, Measurements
from calib_pin.progress import Progress
from calib_pin.setup import JointMap


def check_model(model: str) -> None:
    """Check the name of a measurement model, or of several with a plus between them.

    Raises:
        OptionError: If there is no model of a name, or one is named twice.
    """
    names = model.split(PLUS)
    for name in names:
        declared(name)
    if len(set(names)) != len(names):
        raise OptionError("a measurement model is named twice", value=model)


def infer_model(table: Table, model: str | None = None) -> str:
    """The one model whose columns a file has.

    Args:
        table: The file.
        model: The model that is asked for, which wins; of several the file has to be
            one, None allows all that columns tell apart.

    Raises:
        InputError: If there is none, or more than one.
    """
    if model is not None:
        names = model.split(PLUS)
        return names[0] if len(names) == 1 else _one_of(table, names)
    oriented = any(name in table for name in ORIENTED)
    found: dict[str, list[str]] = {}
    partly = ""
    for name in MEASUREMENT_MODELS:
        stated = declared(name)
        if stated.inference is None:
            continue
        there = [column in table for column in needed(name)]
        shown = oriented and stated.oriented
        shown |= all(there) if stated.inference.complete else any(there)
        if shown:
            found.setdefault(stated.inference.phrase, []).append(name)
        elif any(there):
            partly = partly or name
    if len(found) > 1:
        both = "both " if len(found) == 2 else ""
        raise table.error(
            f"the file has {both}{' and '.join(found)}; name what is measured with "
            "--model, or row by row in a column 'model'",
            allowed=", ".join(MEASUREMENT_MODELS),
        )
    for names in found.values():
        return next((n for n in names if declared(n).oriented == oriented), names[0])
    if partly:
        return partly
    contacts = [name for name in MEASUREMENT_MODELS if declared(name).contact]
    if "target" in table:
        raise table.error(
            "no measured columns, the rows only name targets; say what is measured "
            "with --model",
            allowed=", ".join(contacts),
        )
    needs: dict[str, list[str]] = {}
    for name in MEASUREMENT_MODELS:
        if name not in contacts:
            needs.setdefault(_columns_of(name), []).append(name)
    told = [
        f"{', '.join(names)} need{'s' * (len(names) == 1)} {columns}"
        for columns, names in needs.items()
    ]
    raise table.error(
        f"no measured columns; {'; '.join(told)}; "
        f"{', '.join(contacts)} need only a target and --model"
    )


def split_by_model(
    table: Table, model: str | None = None
) -> dict[str, tuple[NDArray[np.int64] | slice, Table]]:
    """The rows of each model, in the order in which these occur.

    Every row names its model in the column `model`; without that the file is of one. In
    a file of several a row leaves blank what only the others read: a number there was
    meant to be read, and would be lost. Columns that none of them reads may hold
    anything.

    Args:
        table: The file.
        model: The model, or several with a plus between them, that a file without a
            column `model` is of; None infers it.

    Returns:
        By model its rows, and these with the columns that have a meaning.

    Raises:
        InputError: If a row names no model, or one that there is not, or has a value
            of another.
    """
    if "model" not in table:
        return {infer_model(table, model): (slice(None), table)}
    names = table.texts("model")
    first: dict[str, int] = {}
    label = np.array([first.setdefault(name, row) for row, name in enumerate(names)])
    for name, row in first.items():
        if name not in MEASUREMENT_MODELS:
            raise table.cell_error(
                f"unknown measurement model{nearest(name, MEASUREMENT_MODELS)}"
                if name
                else "the row names no measurement model",
                "model",
                row,
                ", ".join(MEASUREMENT_MODELS),
            )
    found = {name: np.flatnonzero(label == row) for name, row in first.items()}
    if len(found) == 1:
        return {names[0]: (slice(None), table)}
    read = {name: _read_by(name) for name in found}
    anybody = frozenset().union(*read.values())
    result: dict[str, tuple[NDArray[np.int64] | slice, Table]] = {}
    for name, rows in found.items():
        own = table.rows(rows, reserved())
        _check_blank(own, name, anybody - read[name])
        result[name] = rows, _without_blank(own, set(needed(name)))
    return result


def _one_of(table: Table, names: Sequence[str]) -> str:
    """The only one of several models that a file may be of."""
    fitting = [name for name in names if _fits(table, name, names)]
    if len(fitting) == 1:
        return fitting[0]
    if fitting:
        raise table.error(
            f"the columns allow {' and '.join(fitting)}; name the model of each row in "
            "a column 'model'"
        )
    needs = "; ".join(
        f"{name} needs {_columns_of(name)}"
        + " and a target" * (declared(name).contact and _requires_target(name))
        for name in names
    )
    raise table.error(f"the columns allow none of {', '.join(names)}: {needs}")


def _fits(table: Table, name: str, names: Sequence[str]) -> bool:
    """Whether a file may be of a model, as far as its columns tell.

    A model that measures less than another gives way to it: position to pose, and
    contacts to all.
    """
    columns = set(needed(name))
    if declared(name).contact:
        others = {column for other in names for column in needed(other)}
        there = any(column in table for column in others)
        return not there and (not _requires_target(name) or "target" in table)
    if any(column in table for column in ORIENTED):
        fuller = [n for n in names if declared(n).oriented and columns <= {*needed(n)}]
        gives_way = bool(fuller) and name not in fuller
    else:
        gives_way = declared(name).oriented
    return not gives_way and all(column in table for column in columns)


def _requires_target(name: str) -> bool:
    return declared(name).naming.required == "every"


def _columns_of(name: str) -> str:
    """The columns that a model needs, in words."""
    columns = ", ".join(needed(name)) or "nothing measured"
    return columns + " and an orientation" * declared(name).oriented


def _read_by(name: str) -> frozenset[str]:
    """Columns that a model reads where it finds them, beside those that all do."""
    oriented = ORIENTED if declared(name).oriented else frozenset[str]()
    return oriented | {*needed(name), *(f"sigma_{c}" for c in components(name))}


def _without_blank(table: Table, keep: Set[str]) -> Table:
    """A table without the measured columns and sigmas that are blank throughout."""
    optional = (measured() | sigmas()) - keep
    columns = {
        name: column
        for name, column in table.columns.items()
        if name not in optional or not column.blank().all()
    }
    return replace(table, columns=columns)


def _check_blank(table: Table, model: str, names: frozenset[str]) -> None:
    """Refuse values that the model of these rows does not read."""
    for name in table.columns:
        if name not in names:
            continue
        blank = table.columns[name].blank()
        if not blank.all():
            raise table.cell_error(
                f"the row measures '{model}', which has no {name}",
                name,
                int(np.argmin(blank)),
                "a blank cell; what else was measured stands in a row of its own",
            )


POSITIONS = 0.95
"""Part of the time after which joint positions are read."""


def read_parts(
    table: Table,
    chain: Chain,
    sources: Sequence[JointSource],
    joints: Mapping[str, JointMap],
    model: str | None,
    notice: Callable[[str], None] | None,
    progress: Progress | None,
) -> list[Measurements]:
    """Measurements of one file, one of each model."""
    q = read_positions(table, chain, sources)
    if progress is not None:
        progress(POSITIONS)
    spare = spare_columns(table, chain, joints)
    parts = []
    used = {"model", "payload", "set", "target"}
    for name, (rows, own) in split_by_model(table, model).items():
        part, columns = _read_part(own, chain, name, q[rows], spare)
        parts.append(part)
        used |= columns
    ignored = table.ignored([name for name in spare if name not in used])
    if ignored and notice is not None:
        notice(ignored)
    return parts


def _read_part(
    table: Table, chain: Chain, model: str, q: Floats, spare: Sequence[str]
) -> tuple[Measurements, set[str]]:
    """Measurements of one model, and the columns that hold them."""
    value_columns, values = read_values(table, model, spare)
    check_targets(table, model)
    if "x" in value_columns:
        check_spread(table, chain, values[:, :3])
    start = np.zeros((0, 0))
    if declared(model).relative:
        row_of = find_starts(table, values[:, 0], q)
        rows = np.flatnonzero(row_of != np.arange(len(row_of)))
        table, start = table.rows(rows, table.columns), q[row_of[rows]]
        q, values = q[rows], values[rows]
    sigma_columns, sigma = read_sigma(table, model)
    part = Measurements(
        joints=chain.joints,
        q=q,
        model=model,
        values=values,
        sigma=sigma,
        target=table.texts("target") if "target" in table else (),
        payload=table.texts("payload") if "payload" in table else (),
        start=start,
        validate=_read_set(table),
        lines=table.lines,
        files=(table.file,) * len(q),
    )
    return part, {*value_columns, *sigma_columns.values()}


def check_places(rows: Measurements, sockets: Collection[str]) -> None:
    """Refuse places that some rows leave open, and sockets of one configuration."""
    names = [name.rpartition(AT)[2] for name in rows.target]
    row, reason, allowed = None, "", None
    naming = declared(rows.model).naming
    if naming.required == "all or none" and any(names) and not all(names):
        row = names.index("")
        reason = f"the row names no {naming.noun}, others do"
    elif naming.configurations > 1:
        label = rows.groups().tolist()
        seen = {name: k for name, k in zip(names, label, strict=True)}
        several = {
            name for name, k in zip(names, label, strict=True) if seen[name] != k
        }
        lonely = [name for name in seen if name not in several | set(sockets)]
        if lonely:
            row = names.index(lonely[0])
            reason = f"the {naming.noun} '{lonely[0]}' has one configuration only"
            allowed = f"two configurations or more in every {naming.noun}"
    if row is not None:
        raise InputError(
            reason,
            file=rows.files[row],
            line=int(rows.lines[row]),
            column="target",
            value=rows.target[row],
            allowed=allowed,
        )


def _read_set(table: Table) -> NDArray[np.bool_]:
    """True for the rows of the validation set, shape (N,)."""
    if "set" not in table:
        return np.zeros(len(table.lines), bool)
    names = table.texts("set")
    for row, name in enumerate(names):
        if name not in ("train", "validate"):
            raise table.cell_error("unknown set", "set", row, "train, validate")
    return np.array([name == "validate" for name in names])
