"""JSON of plain data: one writer and one reader for all documents.

Dataclasses, named tuples, mappings, tuples and numbers are written, and read back, as
they are declared; arrays are written as lists. A field may state another key,
`metadata={"key": ...}`, and records that have a name may be a mapping by it,
`metadata={"by": "name"}`. JSON knows neither infinity nor NaN: such numbers are null,
and `infinite` at the end of a document names those that are infinite, so that all
numbers come back exactly.
"""

from __future__ import annotations

import json
import math
import re
import sys
import types
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import MISSING, Field, fields, is_dataclass
from functools import cache
from pathlib import Path
from reprlib import repr
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from calib_pin.errors import CalibPinError, InputError

_T = TypeVar("_T")

Json = dict[str, Any]

INFINITE = "infinite"
"""Key of the infinite numbers, by their paths."""

VERSION = 1
"""Version of our formats, the only one that is read."""

LARGEST = 1e6
"""Largest number that a value, a position or an offset can be [m, rad, px]."""

MISTAKES = (ArithmeticError, AttributeError, LookupError, TypeError, ValueError)
"""Errors that data raise which are not as they should be."""

NUMBERS = re.compile(r"\[\n[^\[\]{}\"]*\]")
"""A list of numbers: no text holds a line break."""


def encode(document: Mapping[str, Any]) -> bytes:
    """The JSON text of a document; lists of numbers stand on one line each."""
    lost: dict[str, str] = {}

    def finite(value: Any, path: str) -> Any:
        if not isinstance(value, float) or math.isfinite(value):
            return value
        if math.isinf(value):
            lost[path] = str(value)
        return None

    found = _changed(document, finite)
    if lost:
        found[INFINITE] = lost
    text = json.dumps(found, indent=1, allow_nan=False, ensure_ascii=False)
    text = NUMBERS.sub(lambda found: f"[{' '.join(found[0][1:-1].split())}]", text)
    # Lone surrogates, of file names that are not UTF-8, become JSON's own escapes.
    return text.encode("utf-8", "backslashreplace") + b"\n"


def decode(data: bytes) -> Any:
    """The content of a JSON text, with its infinite numbers.

    Raises:
        ValueError: If it is no such text.
        RecursionError: If it is nested too deeply.
    """
    document = json.loads(data.decode("utf-8-sig"))
    lost = document.get(INFINITE) if isinstance(document, dict) else None
    if not isinstance(lost, dict):
        return document

    def restored(value: Any, path: str) -> Any:
        known = value is None and lost.get(path) in ("inf", "-inf")
        return float(lost[path]) if known else value

    return _changed(document, restored)


def _changed(value: Any, change: Callable[[Any, str], Any], path: str = "") -> Any:
    """Plain data with all that is neither mapping nor list changed, by its path."""
    if isinstance(value, Mapping):
        # A path is a JSON pointer.
        names = {key: str(key).replace("~", "~0").replace("/", "~1") for key in value}
        return {
            str(key): _changed(item, change, f"{path}/{names[key]}")
            for key, item in value.items()
        }
    if isinstance(value, list | tuple):
        return [_changed(v, change, f"{path}/{k}") for k, v in enumerate(value)]
    return change(value, path)


def format_keys(name: str) -> Json:
    """The first keys of a document of a format."""
    return {"format": name, "version": VERSION}


def decoded(data: bytes, what: str, name: str, file: str | Path) -> Json:
    """The document of one of our formats that a file holds.

    Args:
        data: Bytes of the file.
        what: Name of the format in messages.
        name: Name of the format; version 1 is the only one that can be read.
        file: The file.

    Raises:
        InputError: If it is anything else.
    """
    try:
        document = decode(data)
    except (ValueError, RecursionError) as error:
        reason = f"not a {what}, or truncated: {getattr(error, 'msg', error)}"
        line = getattr(error, "lineno", None)
        raise InputError(reason, file=file, line=line) from error
    if not isinstance(document, dict) or document.get("format") != name:
        raise InputError(f"not a {what} of calib-pin", file=file)
    version = document.get("version")
    if type(version) is not int or version != VERSION:
        reason = f"a {what} of another version"
        raise InputError(reason, file=file, value=version, allowed=str(VERSION))
    return document


@contextmanager
def reading(path: str | Path, what: str = "calibration") -> Iterator[None]:
    """Turn what goes wrong with the parts of a document into one line.

    Args:
        path: The file.
        what: Its name in the line.

    Raises:
        InputError: If a part is missing or is not what it should be.
    """
    try:
        yield
    except (CalibPinError, *MISTAKES) as error:
        missing = " is missing" if isinstance(error, KeyError) else ""
        reason = f"damaged or edited {what}: {error}{missing}"
        raise InputError(reason, file=path) from error


def plain(value: Any) -> Any:
    """Typed data as mappings, lists, texts and numbers."""
    if is_dataclass(value):
        return {_name(f): _plain_field(f, value) for f in fields(value)}
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        return plain(value._asdict())
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


def _plain_field(part: Field[Any], record: Any) -> Any:
    found, by = plain(getattr(record, part.name)), part.metadata.get("by")
    return found if by is None else {one.pop(by): one for one in found}


def typed(kind: type[_T], value: Any) -> _T:
    """Plain data as a declared type; unknown keys are ignored, null numbers are NaN.

    Args:
        kind: A type as a field declares it: a dataclass or a named tuple, whose data
            are a mapping by its keys, a tuple, a number, ...
        value: The data.

    Raises:
        KeyError: If a field that has no default is missing.
        TypeError, ValueError, AttributeError: If a value is not of its declared type.
    """
    result: _T = _typed(kind, value)
    return result


def _typed(kind: Any, value: Any) -> Any:
    origin, of = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        if value is None and type(None) in of:
            return None
        known = [one for one in of if one is not type(None)]
        # Of a number or a text, a text is what is no number.
        return _typed(
            str if isinstance(value, str) and str in known else known[0], value
        )
    if is_dataclass(kind) or hasattr(kind, "_fields"):
        return _record(kind, value)
    if origin is tuple:
        kinds = of[:1] * len(value) if of[1:] == (...,) else of
        if isinstance(value, str) or len(value) != len(kinds):
            raise ValueError(f"{repr(value)} stands in the place of a list")
        return tuple(map(typed, kinds, value))
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return {str(key): _typed(of[1], item) for key, item in value.items()}
    if origin is Literal and value not in of:
        raise ValueError(f"{repr(value)} is none of {', '.join(map(str, of))}")
    return value if kind is Any or origin is Literal else _scalar(kind, value)


def _record(kind: Any, value: Any) -> Any:
    hints = _hints(kind)
    if not is_dataclass(kind):
        return kind(*(_typed(hints[name], value[name]) for name in kind._fields))
    found = {}
    for part in fields(kind):
        key, by = _name(part), part.metadata.get("by")
        if (part.default, part.default_factory) == (MISSING, MISSING) or key in value:
            data = value[key]
            if by is not None:
                data = [{by: name, **record} for name, record in data.items()]
            found[part.name] = _typed(hints[part.name], data)
    return kind(**found)  # type: ignore[operator]


NAMES = {float: "a number", int: "a whole number", str: "a name", bool: "true or false"}


def _scalar(kind: Any, value: Any) -> Any:
    if kind is float and value is None:
        return math.nan
    fits = type(value) is kind
    if kind is float:
        # Python reads NaN and numbers of any length, JSON knows none.
        fits = type(value) in (int, float) and (
            abs(value) <= sys.float_info.max or abs(value) == math.inf
        )
    if not fits:
        raise ValueError(f"{repr(value)} stands in the place of {NAMES[kind]}")
    return kind(value)


def require_finite(value: Any) -> None:
    """Refuse plain data with numbers that nobody knows, or that nothing can have.

    Raises:
        ValueError: If there is null, or a number beyond `LARGEST`.
    """
    if isinstance(value, list):
        for item in value:
            require_finite(item)
    elif not isinstance(value, str | bool) and not abs(value) < LARGEST:
        raise ValueError(f"{repr(value)} stands in the place of a number")


@cache
def _hints(kind: Any) -> Mapping[str, Any]:
    return get_type_hints(kind)


def _name(part: Field[Any]) -> str:
    return str(part.metadata.get("key", part.name))
