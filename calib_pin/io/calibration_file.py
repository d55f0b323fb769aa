"""A `calibration.json` as a file that somebody may have damaged or edited.

Whatever is wrong with it becomes one line that names the file.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from reprlib import repr
from typing import Any

from calib_pin.errors import CalibPinError, InputError
from calib_pin.io.files import read_bytes
from calib_pin.io.json_text import Json, decode, require_format
from calib_pin.units import DISPLAY
from calib_pin.validation.result import Accuracy, QuantityErrors

FORMAT, VERSION = "calib-pin/calibration", 1
"""What is read; the newest version."""

LARGEST = 1e6
"""Largest number that a value, a position or an offset can be [m, rad, px]."""


def read_document(
    path: str | Path, read: Callable[[str | Path], bytes] = read_bytes
) -> Json:
    """What a `calibration.json` holds.

    Args:
        path: The file.
        read: Gives its bytes.

    Raises:
        InputError: If the file is not such a document or of a later version.
    """
    try:
        document = decode(read(path))
    except RecursionError as error:
        raise InputError("not a calibration of calib-pin", file=path) from error
    except ValueError as error:
        line = getattr(error, "lineno", None)
        reason = f"not a calibration: {getattr(error, 'msg', error)}"
        raise InputError(reason, file=path, line=line) from error
    return require_format(document, "calibration", FORMAT, VERSION, path)


@contextmanager
def reading(path: str | Path) -> Iterator[None]:
    """Turn what goes wrong with the parts of a document into one line.

    Raises:
        InputError: If a part is missing or is not what it should be.
    """
    try:
        yield
    except KeyError as error:
        reason = f"damaged or edited calibration: {error} is missing"
        raise InputError(reason, file=path) from error
    except (CalibPinError, TypeError, ValueError, AttributeError) as error:
        reason = f"damaged or edited calibration: {error}"
        raise InputError(reason, file=path) from error


def stated_errors(document: Json) -> tuple[tuple[QuantityErrors, str], ...]:
    """Accuracy by quantity, each with how it was validated.

    Raises:
        KeyError, TypeError, ValueError, AttributeError: See `reading`.
    """
    result = []
    for name, entry in document["errors"].items():
        training, validation = entry["training"], entry["validation"]
        unit = text(entry["unit"])
        if unit not in DISPLAY:
            raise ValueError(f"{repr(unit)} is no unit of '{name}'")
        unseen = (validation["before"], validation["after"])
        errors = QuantityErrors(
            name=name,
            unit=unit,
            before=_accuracy(training["before"]),
            after=_accuracy(training["after"]),
            validation_before=None if unseen[0] is None else _accuracy(unseen[0]),
            validation_after=None if unseen[1] is None else _accuracy(unseen[1]),
        )
        result.append((errors, text(validation["method"])))
    return tuple(result)


def _accuracy(entry: Mapping[str, Any]) -> Accuracy:
    """Sizes of errors; files may lack what came later, and JSON has no infinity."""
    found = entry["mean"], entry["rms"], entry.get("p95"), entry["max"]
    mean, rms, p95, largest = (
        math.nan if value is None else numbers([value], 1)[0] for value in found
    )
    return Accuracy(mean, rms, p95, largest)


def text(value: object) -> str:
    """A name.

    Raises:
        ValueError: If it is none, or empty.
    """
    if not isinstance(value, str) or not value:
        raise ValueError(f"{repr(value)} stands in the place of a name")
    return value


def numbers(values: Sequence[object], count: int) -> list[float]:
    """Finite numbers of a known count.

    Raises:
        ValueError: If there are more or fewer, or one is no such number.
    """
    if len(values) != count:
        raise ValueError(f"{len(values)} numbers stand in the place of {count}")
    for value in values:
        number = isinstance(value, float | int) and not isinstance(value, bool)
        # Python reads NaN, Infinity and numbers of any length, JSON knows none.
        if not number or not abs(value) < LARGEST:  # type: ignore[arg-type]
            raise ValueError(f"{repr(value)} stands in the place of a number")
    return [float(value) for value in values]  # type: ignore[arg-type]
