"""The measurement model of a file: the one that is asked for, or that columns allow."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib_pin.errors import OptionError
from calib_pin.io.columns import ELSEWHERE
from calib_pin.io.measured_columns import ORIENTED, needed
from calib_pin.io.table import Table
from calib_pin.measurement_models import MEASUREMENT_MODELS, declared

FEW = 4
"""Measurements from which an orientation that never moves is none."""


def asked_models(model: str | None) -> tuple[str, ...]:
    """The measurement models of an option: one, or several with a plus between them.

    Raises:
        OptionError: If there is no model of a name, or one is named twice.
    """
    names = () if model is None else tuple(model.split("+"))
    for name in names:
        declared(name)
    if len(set(names)) != len(names):
        raise OptionError("a measurement model is named twice", value=model)
    return names


def infer_model(table: Table, asked: Sequence[str] = ()) -> str:
    """The one model whose columns a file has.

    Args:
        table: The file.
        asked: The model that is asked for, which wins; of several the file has to be
            one, none allows all that columns tell apart.

    Raises:
        InputError: If there is none, or more than one.
    """
    if asked:
        return asked[0] if len(asked) == 1 else _one_of(table, asked)
    oriented = any(_moves(table, name) for name in ORIENTED if name in table)
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
        f"{', '.join(contacts)} need only a target and --model{ELSEWHERE}"
    )


def _moves(table: Table, name: str) -> bool:
    """Whether a column may be measured: no instrument repeats all of its digits."""
    numbers = table.columns[name].numbers
    return len(numbers) < FEW or bool(np.ptp(numbers) != 0.0)


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
