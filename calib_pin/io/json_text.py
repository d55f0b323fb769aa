"""JSON of declared data: one writer and one reader for all documents.

A document is the fields of its dataclasses, written and read back as they are declared:
numbers, texts, enumerations, named tuples, mappings, tuples and arrays. A field stands
under its own name, or where `metadata={"key": ...}` says: `verdict.status` within
another key, the empty text among the keys of its record, None nowhere. Records that
have a name may be a mapping by it, `metadata={"by": "name"}`. JSON knows neither
infinity nor NaN: a number that is not known is null, an infinite one the text
`Infinity` or `-Infinity`.
"""

from __future__ import annotations

import json
import math
import re
import sys
import types
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import MISSING, Field, fields, is_dataclass
from enum import Enum
from functools import cache, reduce
from pathlib import Path
from reprlib import repr
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from calib_pin.errors import CalibPinError, InputError

_T = TypeVar("_T")

Json = dict[str, Any]

VERSION = 1
"""Version of our formats, as far as they state no other one."""

INFINITE = {"Infinity": math.inf, "-Infinity": -math.inf}

MISTAKES = (ArithmeticError, AttributeError, LookupError, TypeError, ValueError)
"""Errors that data raise which are not as they should be."""

NUMBERS = re.compile(r"\[\n[^\[\]{}\"]*\]")
"""A list of numbers: no text holds a line break."""

NAMES = {float: "a number", int: "a whole number", str: "a name", bool: "true or false"}


def encode(document: object) -> bytes:
    """The JSON text of a document; lists of numbers stand on one line each."""
    text = json.dumps(plain(document), indent=1, allow_nan=False, ensure_ascii=False)
    text = NUMBERS.sub(lambda found: f"[{' '.join(found[0][1:-1].split())}]", text)
    # Lone surrogates, of file names that are not UTF-8, become JSON's own escapes.
    return text.encode("utf-8", "backslashreplace") + b"\n"


def format_keys(name: str) -> Json:
    """The first keys of a document of a format."""
    return {"format": name, "version": VERSION}


def decoded(
    data: bytes, what: str, name: str, file: str | Path, version: int = VERSION
) -> Json:
    """The document of one of our formats that a file holds.

    Args:
        data: Bytes of the file.
        what: Name of the format in messages.
        name: Name of the format.
        file: The file.
        version: The only version that can be read.

    Raises:
        InputError: If it is anything else.
    """
    try:
        document = json.loads(data.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        reason = f"not a {what}, or truncated: {getattr(error, 'msg', error)}"
        line = getattr(error, "lineno", None)
        raise InputError(reason, file=file, line=line) from error
    if not isinstance(document, dict) or document.get("format") != name:
        raise InputError(f"not a {what} of calib-pin", file=file)
    found = document.get("version")
    if (type(found), found) != (int, version):
        reason = f"a {what} of another version: update calib-pin, or calibrate again"
        raise InputError(reason, file=file, value=found, allowed=str(version))
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
    """Declared data as mappings, lists, texts and numbers that JSON knows."""
    if isinstance(value, float):
        if math.isfinite(value):
            return float(value)
        return None if math.isnan(value) else f"{'-' * (value < 0.0)}Infinity"
    if hasattr(value, "_asdict"):
        return plain(value._asdict())
    if is_dataclass(value):
        return merged(*(_written(f, getattr(value, f.name)) for f in fields(value)))
    if isinstance(value, np.ndarray | np.generic):
        listed = value.tolist()
        return listed if np.isfinite(value).all() else plain(listed)
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    return [*map(plain, value)] if isinstance(value, list | tuple) else value


def _written(part: Field[Any], value: Any) -> Json:
    """A field as the document that holds nothing else."""
    if (path := _path(part)) is None:
        return {}
    found = plain(value)
    if (by := part.metadata.get("by")) is not None:
        found = {one.pop(by): one for one in found}
    result: Json = reduce(lambda inner, key: {key: inner}, reversed(path), found)
    return result


def merged(*documents: Mapping[str, Any]) -> Json:
    """Documents in one, mappings within them as well; of two values the later one."""
    result: Json = {}
    for document in documents:
        for key, value in document.items():
            there = result.get(key)
            both = isinstance(value, dict) and isinstance(there, dict)
            result[key] = merged(there, value) if both and there else value
    return result


def typed(kind: type[_T], value: Any, **known: Any) -> _T:
    """Plain data as a declared type; unknown keys are ignored, null numbers are NaN.

    Args:
        kind: A type as a field declares it: a dataclass or a named tuple, whose data
            are a mapping by its keys, a tuple, a number, ...
        value: The data.
        known: Fields of a dataclass that are not read.

    Raises:
        KeyError: If a field that has no default is missing.
        TypeError, ValueError, AttributeError: If a value is not of its declared type.
    """
    result: _T = _typed(kind, value, known)
    return result


def _typed(kind: Any, value: Any, known: Mapping[str, Any] = {}) -> Any:
    origin, of = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        if value is None and type(None) in of:
            return None
        # Of a number or a text, a text is what is no number.
        text = isinstance(value, str) and str in of and value not in INFINITE
        return _typed(str if text else of[of[0] is type(None)], value)
    if is_dataclass(kind):
        return _record(kind, value, known)
    if hasattr(kind, "_fields"):
        hints = _hints(kind)
        return kind(*(_typed(hints[name], value[name]) for name in kind._fields))
    if origin is tuple:
        kinds = of[:1] * len(value) if of[1:] == (...,) else of
        if isinstance(value, str) or len(value) != len(kinds):
            raise ValueError(f"{repr(value)} stands in the place of a list")
        return tuple(map(_typed, kinds, value))
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return {str(key): _typed(of[1], item) for key, item in value.items()}
    if origin is np.ndarray:
        return np.array(value, float)
    if origin is Literal and value not in of:
        raise ValueError(f"{repr(value)} is none of {', '.join(map(str, of))}")
    if kind is Any or origin is Literal:
        return value
    return kind(value) if issubclass(kind, Enum) else _scalar(kind, value)


def _record(kind: Any, value: Any, known: Mapping[str, Any]) -> Any:
    found, hints = dict(known), _hints(kind)
    for part in fields(kind):
        path, data = _path(part), value
        if path is None or part.name in known:
            continue
        try:
            for key in path:
                data = data[key]
        except KeyError:
            if part.default is part.default_factory is MISSING:
                raise
            continue
        if by := part.metadata.get("by"):
            data = [{by: name, **record} for name, record in data.items()]
        found[part.name] = _typed(hints[part.name], data)
    return kind(**found)


def _scalar(kind: Any, value: Any) -> Any:
    if kind is float and (value is None or (type(value) is str and value in INFINITE)):
        return math.nan if value is None else INFINITE[value]
    fits = type(value) is kind
    if kind is float:
        # Python reads NaN and numbers of any length, JSON knows none.
        fits = type(value) in (int, float) and abs(value) <= sys.float_info.max
    if not fits:
        raise ValueError(f"{repr(value)} stands in the place of {NAMES[kind]}")
    return kind(value)


_hints = cache(get_type_hints)


def _path(part: Field[Any]) -> list[str] | None:
    """The keys to a field from its record; none if it stands there, None nowhere."""
    stated = part.metadata.get("key", part.name)
    return None if stated is None else [*filter(None, stated.split("."))]
