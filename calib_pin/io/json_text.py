"""JSON of declared data: one writer and one reader for all documents.

A document is the fields of its dataclasses, written and read back as they are declared:
numbers, texts, enumerations, named tuples, mappings, tuples and arrays, each field at
its key (see `setup.arguments`). JSON knows neither infinity nor NaN: a number that is
not known is null, an infinite one the text `Infinity` or `-Infinity`.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import is_dataclass
from enum import Enum
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np

from calib_pin.errors import CalibPinError, InputError
from calib_pin.setup.arguments import Key, Parser, Refused, keys_of
from calib_pin.setup.values import REST

_T = TypeVar("_T")

Json = dict[str, Any]

VERSION = 1
"""Version of our formats, as far as they state no other one."""

MISTAKES = (ArithmeticError, AttributeError, LookupError, TypeError, ValueError)
"""Errors that data raise which are not as they should be."""

NUMBERS = re.compile(r"\[\n[^\[\]{}\"]*\]")
"""A list of numbers: no text holds a line break."""


def encode(document: object) -> bytes:
    """The JSON text of a document; lists of numbers stand on one line each."""
    text = json.dumps(plain(document), indent=1, allow_nan=False, ensure_ascii=False)
    text = NUMBERS.sub(lambda match: f"[{' '.join(match[0][1:-1].split())}]", text)
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
    number = document.get("version")
    if (type(number), number) != (int, version):
        reason = f"a {what} of another version: update calib-pin, or calibrate again"
        raise InputError(reason, file=file, value=number, allowed=str(version))
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
        about: Json = {}
        if isinstance(error, Refused):
            about = {"value": error.value, "allowed": error.allowed}
        reason = f"damaged or edited {what}: {error}{missing}"
        raise InputError(reason, file=path, **about) from error


def plain(value: Any, *, brief: bool = False) -> Any:
    """Declared data as mappings, lists, texts and numbers that JSON knows.

    Args:
        value: The data.
        brief: Whether fields are left out that are at their defaults.
    """
    if isinstance(value, float):
        if math.isfinite(value):
            return float(value)
        return None if math.isnan(value) else f"{'-' * (value < 0.0)}Infinity"
    if is_dataclass(value) or hasattr(value, "_fields"):
        parts, kind = list[Json](), cast(Any, type(value))
        for name, key in keys_of(kind).items():
            item = getattr(value, name)
            if not (brief and (item is None or item == key.default)):
                parts.append(_field_document(key, plain(item, brief=brief)))
        return merged(*parts)
    if isinstance(value, np.ndarray | np.generic):
        listed = value.tolist()
        return listed if np.isfinite(value).all() else plain(listed)
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, Mapping):
        return {str(key): plain(item, brief=brief) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item, brief=brief) for item in value]
    return value


def _field_document(key: Key, value: Any) -> Json:
    """A field as the document that holds nothing else."""
    if key.by:
        value = {item.pop(key.by): item for item in value}
    for step in (step for step in reversed(key.path) if step != REST):
        value = {step: value}
    return cast(Json, value)


def merged(*documents: Mapping[str, Any]) -> Json:
    """Documents in one, mappings within them as well; of two values the later one."""
    result: Json = {}
    for document in documents:
        for key, value in document.items():
            old = result.get(key)
            both = isinstance(value, dict) and isinstance(old, dict)
            result[key] = merged(old, value) if both and old else value
    return result


def typed(kind: type[_T], value: Any, **known: Any) -> _T:
    """Plain data as a declared type; unknown keys are ignored, null numbers are NaN.

    Args:
        kind: A type as a field declares it: a dataclass or a named tuple, whose data
            are a mapping by its keys, a tuple, a number, ...
        value: The data.
        known: Fields of a dataclass that are not read.

    Raises:
        TypeError, ValueError, AttributeError: If a value is not of its declared type,
            or a field that has no default is missing.
    """
    parser, result = Parser(document=True), value
    result = parser.record(value, kind, **known) if known else parser.parse(value, kind)
    return cast(_T, result)
