"""Which measurement model a file, or each of its rows, is of."""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import OptionError, nearest
from calib_pin.io.measured_columns import (
    COMPONENTS,
    CONTACTS,
    MEASURED,
    NEEDED,
    ORIENTED,
    PIXELS,
    POSITION,
    RESERVED,
    SIGMAS,
)
from calib_pin.io.table import Table
from calib_pin.observations import PLUS

__all__ = ["check_model", "infer_model", "split_by_model"]


def check_model(model: str) -> None:
    """Check the name of a measurement model, or of several with a plus between them.

    Raises:
        OptionError: If there is no model of a name, or one is named twice.
    """
    names = model.split(PLUS)
    for name in names:
        if name not in COMPONENTS:
            raise OptionError(
                f"unknown measurement model '{name}'{nearest(name, COMPONENTS)}",
                allowed=", ".join(COMPONENTS),
            )
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
    pixels = [name in table for name in PIXELS]
    found = [
        what
        for what, there in (
            ("a position", oriented or any(name in table for name in POSITION)),
            ("a distance", "distance" in table),
            ("pixels", all(pixels)),
        )
        if there
    ]
    if len(found) > 1:
        both = "both " if len(found) == 2 else ""
        raise table.error(
            f"the file has {both}{' and '.join(found)}; name what is measured with "
            "--model, or row by row in a column 'model'",
            allowed=", ".join(COMPONENTS),
        )
    if found == ["a position"]:
        return "pose" if oriented else "position"
    if found == ["a distance"]:
        return "plane-distance"
    if any(pixels):
        return "camera"
    if "target" in table:
        raise table.error(
            "no measured columns, the rows only name targets; say what is measured "
            "with --model",
            allowed=", ".join(CONTACTS),
        )
    raise table.error(
        "no measured columns; position needs x, y, z; pose needs these and an "
        "orientation; the distances need distance; camera needs u, v; "
        f"{', '.join(CONTACTS)} need only a target and --model"
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
        if name not in COMPONENTS:
            raise table.cell_error(
                f"unknown measurement model{nearest(name, COMPONENTS)}"
                if name
                else "the row names no measurement model",
                "model",
                row,
                ", ".join(COMPONENTS),
            )
    found = {name: np.flatnonzero(label == row) for name, row in first.items()}
    if len(found) == 1:
        return {names[0]: (slice(None), table)}
    read = {name: _read_by(name) for name in found}
    anybody = frozenset().union(*read.values())
    result: dict[str, tuple[NDArray[np.int64] | slice, Table]] = {}
    for name, rows in found.items():
        own = table.rows(rows, RESERVED)
        _check_blank(own, name, anybody - read[name])
        result[name] = rows, _without_blank(own, set(NEEDED[name]))
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
        f"{name} needs {', '.join(NEEDED[name]) or 'nothing measured'}"
        + " and an orientation" * (name == "pose")
        + " and a target" * (name == "fixed-point")
        for name in names
    )
    raise table.error(f"the columns allow none of {', '.join(names)}: {needs}")


def _fits(table: Table, name: str, names: Sequence[str]) -> bool:
    """Whether a file may be of a model, as far as its columns tell.

    What measures less than another of the names gives way to it: position to pose, and
    contacts to all.
    """
    if name in CONTACTS:
        others = {column for other in names for column in NEEDED[other]}
        measured = any(column in table for column in others)
        return not measured and (name != "fixed-point" or "target" in table)
    oriented = any(column in table for column in ORIENTED)
    if name == "pose":
        other = not oriented
    else:
        other = oriented and name == "position" and "pose" in names
    return not other and all(column in table for column in NEEDED[name])


def _read_by(name: str) -> frozenset[str]:
    """Columns that a model reads where it finds them, beside those that all do."""
    oriented = ORIENTED if name == "pose" else frozenset[str]()
    return oriented | {*NEEDED[name], *(f"sigma_{c}" for c in COMPONENTS[name])}


def _without_blank(table: Table, keep: Set[str]) -> Table:
    """A table without the measured columns and sigmas that are blank throughout."""
    columns = {
        name: column
        for name, column in table.columns.items()
        if name not in (MEASURED | SIGMAS) - keep or not column.blank().all()
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
