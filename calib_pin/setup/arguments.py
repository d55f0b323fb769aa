"""Values by their annotations: taken where it is clear what they mean, else refused.

What is allowed stands in the annotations of functions and dataclasses, and holds for
arguments from Python as for the keys of files. A refusal is one line that names the
argument or key, and what is shown of a dataclass is one line as well.

A field of a record is a key of its file under its own name, or where
`metadata={"key": ...}` says: `verdict.status` within another key, the empty text among
the keys of its record, `REST` as all keys beside the others, None nowhere. Records that
have a name may be a mapping by it, `metadata={"by": "name"}`.
"""

from __future__ import annotations

import math
import re
import typing
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from enum import Enum
from functools import cache, wraps
from inspect import signature
from types import NoneType, UnionType
from typing import Any, NamedTuple, TypeVar, get_args, get_origin

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import VALUE, CalibPinError, OptionError, nearest
from calib_pin.setup.values import REST, Family, OneOf, Section, Value, Written

_Function = TypeVar("_Function", bound=Callable[..., Any])

Path = tuple[str | int, ...]
"""Keys and positions that lead to a value."""

KEYS = "a mapping of keys to values"
"""The type of a section, in words."""

_WORDS: Mapping[Any, str] = {
    str: "text (in quotes if it looks like something else)",
    bool: "true, false",
    int: "a whole number, 0 or more",
    float: "a finite number",
    NoneType: "None",
    Callable: "a function",
    Mapping: "a mapping of names to values",
}
_CLASSES = {
    bool: bool | np.bool_,
    int: int | np.integer,
    float: int | float | np.number,
}

_ARRAYS = {np.float64: ("fiu", "numbers"), np.bool_: ("b", "true and false")}
"""Kinds of numbers that an array takes, and their name; of others whole numbers."""

_OPTION = re.compile(r"(?<![\w-])--([a-z][a-z-]*)")

LARGEST = float(np.finfo(float).max)

UNKNOWN = (None, "Infinity", "-Infinity")
"""Stand in documents in the place of numbers that JSON does not know."""


class Refused(ValueError):
    """A value that cannot be used.

    Attributes:
        path: Where it stands.
        reason: What is wrong.
        allowed: What is allowed instead; None where there is nothing to say.
        shown: Whether the value itself tells more.
        value: The value.
    """

    value: Any = None

    def __init__(
        self, path: Path, allowed: str | None, what: str = "{} cannot have this value"
    ) -> None:
        """Name the place."""
        self.path, self.allowed, self.shown = path, allowed, what.endswith("value")
        self.reason = what.format(f"'{dotted(path)}'" if path else "the file")
        super().__init__(self.reason)


def unknown(path: Path, known: Iterable[str | int]) -> Refused:
    """The refusal of a key that is none of those that are known."""
    names = [str(name) for name in known if name != REST]
    hint = nearest(str(path[-1]), names)
    return Refused(path, ", ".join(names), f"unknown key {{}}{hint}")


def dotted(path: Sequence[str | int]) -> str:
    """A key path as in `frames.tool.xyz` and `fixed[0]`."""
    first, *rest = path
    steps = (f"[{step}]" if isinstance(step, int) else f".{step}" for step in rest)
    return f"{first}{''.join(steps)}"


class Brief:
    """A dataclass that shows what is not at its default, on one line."""

    def __repr__(self) -> str:
        """Fields with their values, of those that are long only what they are."""
        shown = []
        for f in fields(self):  # type: ignore[arg-type]
            value, make = getattr(self, f.name), f.default_factory
            default = f.default if make is MISSING else make()
            text = f"array {value.shape}" if hasattr(value, "shape") else repr(value)
            if text != repr(default):
                text = text if len(text) <= VALUE else f"<{type(value).__name__}>"
                shown.append(f"{f.name}={text}")
        return f"{type(self).__name__}({', '.join(shown)})"


def as_array(name: str, value: object, *shape: int | str) -> NDArray[np.float64]:
    """Numbers as an array; a single row counts as an array of one row.

    Args:
        name: Name of the argument.
        value: The numbers.
        shape: Length of each axis, or a letter for any length.

    Raises:
        OptionError: If there are none, or they have another shape.
    """
    array = value
    if not isinstance(array, np.ndarray) or array.dtype != np.float64:
        array = parse(name, value, NDArray[np.float64])
    rows: NDArray[np.float64] = array[None] if array.ndim == len(shape) - 1 else array
    if rows.ndim != len(shape) or any(
        isinstance(n, int) and n != k for n, k in zip(shape, rows.shape, strict=True)
    ):
        allowed = f"the shape ({', '.join(map(str, shape))})"
        raise OptionError(f"'{name}' has the shape {array.shape}", allowed=allowed)
    return rows


def parse(name: str, value: object, hint: Any, *above: str | int) -> Any:
    """An argument as its annotation has it.

    Raises:
        OptionError: If it is nothing of the kind.
    """
    try:
        return Parser().parse(value, hint, (*above, name))
    except Refused as error:
        reason, value = error.reason, error.value
        raise OptionError(reason, value=value, allowed=error.allowed) from None


def settle(given: Any, *path: str | int) -> None:
    """Take the fields of a dataclass as their annotations have them.

    Raises:
        OptionError: If one is nothing of the kind.
    """
    kind: Any = type(given)
    for name, hint in _hints(kind).items():
        value = getattr(given, name)
        plain = type(value) is hint and not isinstance(value, Section)
        if not plain and value is not getattr(kind, name, MISSING):
            object.__setattr__(given, name, parse(name, value, hint, *path))


def checked(function: _Function) -> _Function:
    """Decorate a function, so that it takes arguments as its annotations have them."""

    @wraps(function)
    def call(*args: Any, **options: Any) -> Any:
        try:
            given, hints = signature(function).bind(*args, **options), _hints(function)
        except TypeError as error:
            raise TypeError(f"{function.__name__}() {error}") from None
        for name in given.arguments.keys() & hints.keys():
            given.arguments[name] = parse(name, given.arguments[name], hints[name])
        return function(*given.args, **given.kwargs)

    return call  # type: ignore[return-value]


def public(function: _Function) -> _Function:
    """Decorate a function of the package for those who call it from Python.

    It takes arguments as its annotations have them, and its errors name an argument,
    `tip=`, where the command has an option, `--tip`.
    """
    inner = checked(function)

    def argument(option: re.Match[str]) -> str:
        return f"{option[1].replace('-', '_')}="

    @wraps(function)
    def call(*args: Any, **options: Any) -> Any:
        try:
            return inner(*args, **options)
        except CalibPinError as error:
            error.args = tuple(_OPTION.sub(argument, str(text)) for text in error.args)
            raise

    return call  # type: ignore[return-value]


@cache
def _hints(of: Any) -> dict[str, Any]:
    hints = typing.get_type_hints(of, include_extras=True)
    return {k: hint for k, hint in hints.items() if get_origin(hint) != typing.ClassVar}


class Key(NamedTuple):
    """Where a field of a record stands in its file.

    Attributes:
        path: Keys that lead to it from the record.
        by: The field by which records are a mapping; empty where they are a list.
        default: Its default; `MISSING` where it has to be stated.
    """

    path: Path
    by: str
    default: Any


@cache
def keys_of(kind: Any) -> dict[str, Key]:
    """The keys of a dataclass or named tuple, by the names of its fields."""
    if hasattr(kind, "_fields"):
        defaults = kind._field_defaults
        return {n: Key((n,), "", defaults.get(n, MISSING)) for n in kind._fields}
    keys = dict[str, Key]()
    for f in fields(kind):
        if (dotted := f.metadata.get("key", f.name)) is not None:
            make, path = f.default_factory, tuple(filter(None, dotted.split(".")))
            default = f.default if make is MISSING else make()
            keys[f.name] = Key(path, f.metadata.get("by", ""), default)
    return keys


@cache
def _places(kind: Any) -> tuple[dict[Path, str], set[Path]]:
    """The fields of a record by their keys, and the keys that lead to those."""
    names = {key.path: name for name, key in keys_of(kind).items() if key.path}
    return names, {path[:k] for path in names for k in range(1, len(path))}


@dataclass(frozen=True)
class Parser:
    """Takes values as types have them.

    Attributes:
        families: Known names by the name of their family; others are not checked.
        document: Whether they are those of a JSON document that calib-pin wrote. It
            states every record as a mapping, and a number that is not known as null;
            what a later version has added is passed over, and limits of what a user
            may state are none of what was fitted.
    """

    families: Mapping[str, Collection[str]] = field(default_factory=dict)
    document: bool = False

    def parse(self, value: Any, hint: Any, path: Path = ()) -> Any:
        """The value as a type has it.

        Raises:
            Refused: If it is nothing of the kind.
        """
        try:
            return self._taken(value, hint, path)
        except Refused:
            raise
        except ValueError as error:
            refused = Refused(path, str(error))
            refused.value = "None" if value is None else value
            raise refused from None

    def _taken(self, value: Any, hint: Any, path: Path) -> Any:
        kind, inner = get_origin(hint) or hint, get_args(hint)
        if hasattr(kind, "__value__"):  # An alias, as `NDArray` is from numpy 2.5 on.
            return self._taken(value, kind.__value__[inner], path)
        if kind is typing.Annotated:
            return self._limited(value, inner[0], hint.__metadata__, path)
        if kind in (typing.Union, UnionType):
            if value is None and NoneType in inner:
                return None
            return self._one_of(value, [h for h in inner if h is not NoneType], path)
        if kind is np.ndarray:
            return _array(value, get_args(inner[1])[0], self.document)
        if kind is typing.Literal:
            return OneOf(inner)(value)
        section = isinstance(kind, type) and issubclass(kind, Section)
        declared = is_dataclass(kind) or hasattr(kind, "_fields")
        record = section or (declared and self.document)
        if record and isinstance(value, Mapping):
            return self.record(value, kind, path)
        # What a section extends is taken as well.
        if section and (isinstance(value, kind) or issubclass(kind, type(value))):
            settle(value, *path)
            return value
        if kind is Mapping and isinstance(value, Mapping):
            return {
                self.parse(k, inner[0], path): self.parse(item, inner[1], (*path, k))
                for k, item in value.items()
                if self.document or item is not None
            }
        if inner and kind not in _WORDS:
            return self._several(value, kind, inner, path)
        if getattr(kind, "_is_protocol", kind is Any):
            return value
        if self.document and issubclass(kind, Enum):
            return kind(value)
        if self.document and kind is float and value in UNKNOWN:
            return math.nan if value is None else float(value)
        fits = isinstance(value, _CLASSES.get(kind, kind))
        if fits and kind in (int, float):
            # JSON holds integers of any length, and Python reads NaN in it.
            fits = not isinstance(value, bool) and abs(value) <= LARGEST
            fits = fits and (kind is float or self.document or value >= 0)
        if not fits and not hasattr(value, getattr(kind, "acts", " ")):
            raise ValueError(KEYS if record else _WORDS.get(kind) or kind.__name__)
        return float(value) if self.document and kind is float else value

    def _limited(self, value: Any, kind: Any, marks: Iterable[Any], path: Path) -> Any:
        """A value within the limits of its annotation, see `values`."""
        for mark in marks:
            if isinstance(mark, Written):
                value = mark.function(value)
        limits = [mark for mark in marks if isinstance(mark, Value)]
        if limits and not self.document:
            result = limits[0].parse(value, kind)
        else:
            result = self.parse(value, kind, path)
        for mark in marks:
            if isinstance(mark, Family):
                self._require_known(result, mark, path)
            elif callable(mark):
                result = mark(result)
        return result

    def _require_known(self, value: Any, mark: Family, path: Path) -> None:
        """Refuse names that their family does not have, and those that repeat."""
        if (known := self.families.get(mark.name)) is None:
            return
        listed = isinstance(value, tuple)
        names = value if listed else value.split(mark.joined or None)
        wrong = [k for k, n in enumerate(names) if n not in known or n in names[:k]]
        if wrong or not names:
            several = [f"or several of them with a {mark.joined} between"]
            once = ["each at most once"] * (listed or bool(mark.joined))
            allowed = ", ".join([*known, *several * bool(mark.joined), *once])
            raise Refused((*path, *wrong[: listed * 1]), allowed)

    def _one_of(self, value: Any, hints: Sequence[Any], path: Path) -> Any:
        """A value of the first type that takes it, or what the nearest one allows."""
        refused = list[Refused]()
        for hint in hints:
            try:
                return self.parse(value, hint, path)
            except Refused as error:
                refused.append(error)
        deepest = max(refused, key=lambda error: len(error.path))
        if len(deepest.path) > len(path):
            raise deepest
        raise ValueError(" or ".join(dict.fromkeys(str(e.allowed) for e in refused)))

    def record(
        self, value: Mapping[str, Any], kind: Any, path: Path = (), **known: Any
    ) -> Any:
        """A dataclass or named tuple by its keys in a file.

        Args:
            value: The keys.
            kind: The type.
            path: Where it stands.
            known: Fields that are not read.

        Raises:
            Refused: If a key is missing, unknown, or not of its type.
        """
        entries, keys, hints = dict(known), keys_of(kind), _hints(kind)
        for name, key in keys.items():
            if not key.path and name not in known:
                entries[name] = self.parse(value, hints[name], path)
        for name, here, item in self._items(value, kind, path):
            key, hint = keys[name], hints[name]
            if key.path[-1] == REST:
                entry = self.parse(item, get_args(hint)[1], here)
                entries.setdefault(name, {})[here[-1]] = entry
            elif name not in entries:
                if key.by:
                    item = self.parse(item, Mapping[str, Mapping[str, Any]], here)
                    item = [{key.by: n, **record} for n, record in item.items()]
                entries[name] = self.parse(item, hint, here)
        for name, key in keys.items():
            if name not in entries and key.default is MISSING:
                raise Refused((*path, *key.path), None, "{} is missing")
        result = kind(**entries)
        for fits, allowed in result._rules() if isinstance(result, Section) else ():
            if not fits:
                raise ValueError(allowed)
        return result

    def _items(
        self, value: Mapping[str, Any], kind: Any, path: Path, above: Path = ()
    ) -> Iterator[tuple[str, Path, Any]]:
        """The fields below some keys of a record, in the order of the file.

        A key of a setup without a value counts as not written.

        Returns:
            Their names, with the place and the value of each.

        Raises:
            Refused: If a key is unknown.
        """
        names, groups = _places(kind)
        for key, item in value.items():
            place, here = (*above, key), (*path, key)
            name = names.get(place) or names.get((*above, REST))
            group = place in groups
            if self.document or item is not None:
                if name is not None:
                    yield name, here, item
                if group:
                    inner = self.parse(item, Mapping[str, Any], here)
                    yield from self._items(inner, kind, here, place)
            if name is None and not (group or self.document):
                depth = len(above)
                known = (p[depth] for p in names if p[:depth] == above)
                raise unknown(here, dict.fromkeys(known))

    def _several(self, value: Any, kind: Any, inner: Sequence[Any], path: Path) -> Any:
        """A sequence; a single value counts as a sequence of one."""
        if isinstance(value, Mapping):
            raise ValueError("a list in square brackets")
        one = isinstance(value, str) or not isinstance(value, Iterable)
        if one and self.document:
            raise ValueError("a list")
        values = (value,) if one else value if isinstance(value, Sequence) else [*value]
        hints = inner
        if kind is not tuple or inner[-1] is ...:
            hints = [inner[0]] * len(values)
        if len(values) != len(hints):
            raise ValueError(f"{len(hints)} values")
        places = [path if one else (*path, k) for k in range(len(values))]
        result = tuple(map(self.parse, values, hints, places))
        return result if kind is tuple or one else values


def _array(value: Any, kind: Any, document: bool) -> Any:
    kinds, what = _ARRAYS.get(kind, ("iu", "whole numbers"))
    with suppress(
        ValueError, TypeError, OverflowError
    ):  # Its rows may be of several lengths.
        array = np.array(value, float) if document else np.asarray(value)
        if array.dtype == object:  # A table of pandas is one of objects easily.
            array = np.array(array.tolist())
        whole = kinds == "iu" and array.dtype.kind == "f" and not (array % 1.0).any()
        fits = array.dtype.kind in kinds or not array.size or whole
        if fits and not np.ma.is_masked(value):
            return array.astype(kind, copy=False)
    raise ValueError(f"an array of {what}, none of them masked or missing")
