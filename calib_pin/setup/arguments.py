"""Arguments from Python: taken where it is clear what they mean, else refused.

What is allowed stands in the annotations of functions and dataclasses. A refusal is one
line that names the argument, and what is shown of a dataclass is one line as well.
"""

from __future__ import annotations

import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import MISSING, fields, replace
from functools import cache, wraps
from inspect import signature
from types import NoneType, UnionType
from typing import Any, TypeVar, get_args, get_origin

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import VALUE, OptionError

_Function = TypeVar("_Function", bound=Callable[..., Any])

_WORDS: Mapping[Any, str] = {
    str: "text",
    bool: "True, False",
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
_DTYPES: Mapping[Any, Any] = {
    NDArray[np.bool_]: bool,
    NDArray[np.int64]: np.int64,
    NDArray[np.float64]: float,
}
SECTION = "__pydantic_config__"
"""Attribute of the sections of a setup alone."""


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
        array = taken(name, value, NDArray[np.float64])
    rows: NDArray[np.float64] = array[None] if array.ndim == len(shape) - 1 else array
    if rows.ndim != len(shape) or any(
        isinstance(n, int) and n != k for n, k in zip(shape, rows.shape, strict=True)
    ):
        allowed = f"the shape ({', '.join(map(str, shape))})"
        raise OptionError(f"'{name}' has the shape {array.shape}", allowed=allowed)
    return rows


def taken(name: str, value: object, hint: Any) -> Any:
    """An argument as its annotation has it.

    Raises:
        OptionError: If it is nothing of the kind.
    """
    try:
        return _taken(value, hint)
    except ValueError as error:
        given = "None" if value is None else value
        reason = f"'{name}' cannot have this value"
        raise OptionError(reason, value=given, allowed=str(error)) from None


def settle(given: Any) -> None:
    """Take the fields of a dataclass as their annotations have them.

    Raises:
        OptionError: If one is nothing of the kind.
    """
    kind: Any = type(given)
    for name, hint in _hints(kind).items():
        value = getattr(given, name)
        found = value.dtype if isinstance(value, np.ndarray) else type(value)
        plain = found == _DTYPES.get(hint, hint) and not hasattr(value, SECTION)
        if found is tuple:  # Of names, mostly.
            plain = {*map(type, value)} == {*get_args(hint)[:1]}
        if not plain and value is not getattr(kind, name, MISSING):
            object.__setattr__(given, name, taken(name, value, hint))


def checked(function: _Function) -> _Function:
    """Decorate a function, so that it takes arguments as its annotations have them."""

    @wraps(function)
    def call(*args: Any, **options: Any) -> Any:
        given, hints = signature(function).bind(*args, **options), _hints(function)
        for name in given.arguments.keys() & hints.keys():
            given.arguments[name] = taken(name, given.arguments[name], hints[name])
        return function(*given.args, **given.kwargs)

    return call  # type: ignore[return-value]


@cache
def _hints(of: Any) -> dict[str, Any]:
    found = typing.get_type_hints(of, include_extras=True)
    return {k: hint for k, hint in found.items() if get_origin(hint) != typing.ClassVar}


def _taken(value: Any, hint: Any) -> Any:
    """The value as a type has it; a `ValueError` says what is allowed instead."""
    kind, inner = get_origin(hint) or hint, get_args(hint)
    if kind is typing.Annotated:
        for constraint in hint.__metadata__:
            # Some are known only where a file is read, and some are none.
            with suppress(NotImplementedError, AttributeError):
                if getattr(constraint, "rising", False):  # Programs may hold a joint.
                    constraint = replace(constraint, rising=False)
                return constraint.check(_listed(value))
        return _taken(value, inner[0])
    if kind in (typing.Union, UnionType):
        return _one_of(value, inner)
    if kind is np.ndarray:
        return _array(value, get_args(inner[1])[0])
    if kind is typing.Literal:
        fits, words = value in inner, ", ".join(map(str, inner))
    elif inner and kind not in _WORDS:
        return _several(value, kind, inner)
    elif getattr(kind, "_is_protocol", kind is Any):
        return value
    else:
        fits = isinstance(value, _CLASSES.get(kind, kind))
        words = _WORDS.get(kind) or kind.__name__
    if fits and kind in (int, float):
        fits = not isinstance(value, bool) and np.isfinite(value)
        fits = fits and (kind is float or value >= 0)
    fits = fits or hasattr(value, getattr(kind, "acts", " "))
    if hasattr(kind, SECTION):  # What a section extends is taken as well.
        fits |= issubclass(kind, type(value))
    if not fits:
        raise ValueError(words)
    if hasattr(value, SECTION):
        settle(value)
    if kind is Mapping:
        return {_taken(k, inner[0]): _taken(v, inner[1]) for k, v in value.items()}
    return value


def _one_of(value: Any, hints: Sequence[Any]) -> Any:
    reasons = dict[str, None]()
    for hint in hints:
        try:
            return _taken(value, hint)
        except ValueError as error:
            reasons[str(error)] = None
    raise ValueError(", ".join(reasons))


def _listed(value: Any) -> Any:
    """Lists in place of tuples and arrays, as a file has them."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return [*map(_listed, value)] if isinstance(value, list | tuple) else value


def _several(value: Any, kind: Any, inner: Sequence[Any]) -> Any:
    """A sequence; a single value counts as a sequence of one."""
    one = isinstance(value, str) or not isinstance(value, Iterable)
    values = (value,) if one else value if isinstance(value, Sequence) else [*value]
    hints = inner
    if kind is not tuple or inner[-1] is ...:
        hints = [inner[0]] * len(values)
    if len(values) != len(hints):
        raise ValueError(f"{len(hints)} values")
    found = tuple(map(_taken, values, hints))
    return found if kind is tuple or one else values


def _array(value: Any, kind: Any) -> Any:
    kinds = {np.float64: "fiu", np.bool_: "b"}.get(kind, "iu")
    with suppress(ValueError):  # Its rows may be of several lengths.
        array = np.asarray(value)
        if array.dtype.kind in kinds or not array.size:
            return array.astype(kind, copy=False)
    raise ValueError("an array of numbers")
