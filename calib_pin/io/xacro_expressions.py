"""Expressions of xacro files, evaluated without Python's `eval`.

What xacro does instead can be led out of: a generator has frames, and frames have the
builtin functions. Here the syntax tree is walked; what is not named here does not
exist. Values are numbers, strings, and lists and mappings of them, never functions.
A dot leads into mappings alone; names with two leading underscores mean nothing.
"""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import (
    Callable,
    ItemsView,
    Iterable,
    Iterator,
    KeysView,
    Mapping,
    ValuesView,
)
from typing import Any

LONGEST = 10_000
"""Characters of the longest expression, and elements that one operation makes."""

TEXT = 1_000_000
"""Characters of the longest text that is a value."""

STEPS = 200_000
"""Steps that an expression may take."""

BITS = 4096
"""Bits of the largest whole number."""

DATA = (bool, int, float, str, list, tuple, range, dict)
"""Types of values."""

UNARY: dict[type[ast.unaryop], Callable[[Any], Any]] = {
    ast.UAdd: operator.pos,
    ast.USub: operator.neg,
    ast.Not: operator.not_,
}
BINARY: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
    ast.Pow: operator.pow,
}
COMPARISONS: dict[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Is: operator.is_,
    ast.IsNot: operator.is_not,
    ast.In: lambda value, values: value in values,
    ast.NotIn: lambda value, values: value not in values,
}

MATH = {
    *("acos", "acosh", "asin", "asinh", "atan", "atan2", "atanh", "ceil", "copysign"),
    *("cos", "cosh", "degrees", "dist", "exp", "fabs", "floor", "fmod", "fsum"),
    *("hypot", "isclose", "isfinite", "isinf", "isnan", "log", "log10", "log1p"),
    *("log2", "pow", "radians", "remainder", "sin", "sinh", "sqrt", "tan", "tanh"),
    "trunc",
}
"""Functions of `math`; those that can take forever are not among them."""

CONSTANTS = {
    **{name: getattr(math, name) for name in ("pi", "e", "tau", "inf", "nan")},
    "True": True,
    "False": False,
}

METHODS: dict[type, set[str]] = {
    str: {
        *("capitalize", "count", "endswith", "find", "isdigit", "join", "lower"),
        *("lstrip", "replace", "rstrip", "split", "startswith", "strip", "title"),
        "upper",
    },
    list: {"count", "index"},
    dict: {"get", "items", "keys", "values"},
}
"""Methods of values, none of which changes them."""

FORMATS = re.compile(r"%[-+ #0]{0,3}\d{0,2}(\.\d{1,2})?[sdifgeExX%]")


MISTAKES = (ArithmeticError, AttributeError, LookupError, TypeError, ValueError)
"""Errors of Python that say what is wrong with the values of an expression."""


class Refused(Exception):
    """An expression that cannot be evaluated, with the reason."""


def _range(*ends: int) -> range:
    found = range(*ends)
    if len(found) > LONGEST:
        raise Refused(f"range() gives more than {LONGEST} numbers")
    return found


def _round(value: Any, *digits: int) -> Any:
    return round(value, *(min(max(count, -BITS), BITS) for count in digits))


def _set(values: Iterable[Any] = ()) -> list[Any]:
    return list(dict.fromkeys(values))  # In an order that is always the same.


FUNCTIONS: dict[str, Callable[..., Any]] = {
    **{name: getattr(math, name) for name in MATH},
    **{f"math.{name}": getattr(math, name) for name in MATH},
    **{
        prefix + function.__name__: function
        for prefix in ("", "python.")
        for function in (
            *(abs, all, any, bool, dict, divmod, enumerate, float, int, len, list),
            *(max, min, reversed, sorted, str, sum, tuple, zip),
        )
    },
    **{
        prefix + name: function
        for prefix in ("", "python.")
        for name, function in (("range", _range), ("round", _round), ("set", _set))
    },
}
"""All that can be called, beside what a file brings with it."""


def evaluate(
    expression: str,
    symbols: Mapping[str, Any],
    functions: Mapping[str, Callable[..., Any]],
) -> Any:
    """The value of an expression.

    Args:
        expression: The text between the braces.
        symbols: Values by name.
        functions: Functions beside those of this module, by name.

    Raises:
        Refused: If it cannot be evaluated.

    Examples:
        >>> evaluate("2 * r if kind == 'arm' else pi", {"r": 3, "kind": "arm"}, {})
        6
    """
    text = expression.strip()
    if len(text) > LONGEST:
        raise Refused(f"it has more than {LONGEST} characters")
    try:
        tree = ast.parse(text, mode="eval")
        return _Walk(symbols, {**FUNCTIONS, **functions}).value(tree.body)
    except Refused:
        raise
    except SyntaxError as error:
        raise Refused(error.msg) from None
    except RecursionError:
        raise Refused("it is too deep") from None
    except MemoryError:
        raise Refused("it needs too much memory") from None
    except KeyError as error:
        raise Refused(f"there is no key {error}") from None
    except MISTAKES as error:
        raise Refused(str(error)) from None


class _Walk:
    """One evaluation: a value for each kind of node, by the name of its class."""

    def __init__(
        self, symbols: Mapping[str, Any], functions: Mapping[str, Callable[..., Any]]
    ) -> None:
        self.symbols = symbols
        self.functions = functions
        self.own: dict[str, Any] = {}
        self.steps = 0

    def value(self, node: ast.AST) -> Any:
        """The value of a node."""
        self.steps += 1
        if self.steps > STEPS:
            raise Refused("it takes too many steps")
        method = getattr(self, f"_{type(node).__name__.lower()}", None)
        if method is None:
            raise Refused(f"has what no expression may have: {_named(node)}")
        return _plain(method(node))

    def _constant(self, node: ast.Constant) -> Any:
        if isinstance(node.value, bytes | complex) or node.value is ...:
            raise Refused(f"the constant {node.value!r} is neither number nor text")
        return node.value

    def _name(self, node: ast.Name) -> Any:
        name = _public(node.id)
        if name in self.own:
            return self.own[name]
        try:
            found = self.symbols[name]
        except KeyError:
            if name in CONSTANTS:
                return CONSTANTS[name]
            raise Refused(f"'{name}' is not defined") from None
        if callable(found) or name in ("math", "python", "xacro"):
            raise Refused(f"'{name}' is no value")
        return found

    def _attribute(self, node: ast.Attribute) -> Any:
        name = _public(node.attr)
        path = _dotted(node)
        if path in self.functions:
            raise Refused(f"'{path}' is no value")
        if path == f"math.{name}" and name in CONSTANTS:
            return CONSTANTS[name]
        owner = self.value(node.value)
        if isinstance(owner, Mapping) and name in owner:
            return owner[name]
        raise Refused(f"there is no '{name}' in it")

    def _subscript(self, node: ast.Subscript) -> Any:
        owner = self.value(node.value)
        if not isinstance(owner, str | list | tuple | range | Mapping):
            raise Refused("only lists, texts and mappings have elements")
        if not isinstance(node.slice, ast.Slice):
            return owner[self.value(node.slice)]
        ends = (node.slice.lower, node.slice.upper, node.slice.step)
        part = slice(*(None if end is None else self.value(end) for end in ends))
        return owner[part]

    def _unaryop(self, node: ast.UnaryOp) -> Any:
        if type(node.op) not in UNARY:
            raise Refused(f"has what no expression may have: {_named(node.op)}")
        return UNARY[type(node.op)](self.value(node.operand))

    def _binop(self, node: ast.BinOp) -> Any:
        if type(node.op) not in BINARY:
            raise Refused(f"has what no expression may have: {_named(node.op)}")
        left, right = self.value(node.left), self.value(node.right)
        _require_small(node.op, left, right)
        return BINARY[type(node.op)](left, right)

    def _boolop(self, node: ast.BoolOp) -> Any:
        every = isinstance(node.op, ast.And)
        found: Any = every
        for operand in node.values:
            found = self.value(operand)
            if bool(found) != every:
                break
        return found

    def _compare(self, node: ast.Compare) -> bool:
        left = self.value(node.left)
        for kind, operand in zip(node.ops, node.comparators, strict=True):
            right = self.value(operand)
            if not COMPARISONS[type(kind)](left, right):
                return False
            left = right
        return True

    def _ifexp(self, node: ast.IfExp) -> Any:
        return self.value(node.body if self.value(node.test) else node.orelse)

    def _list(self, node: ast.List) -> list[Any]:
        return [self.value(element) for element in node.elts]

    def _tuple(self, node: ast.Tuple) -> tuple[Any, ...]:
        return tuple(self.value(element) for element in node.elts)

    def _dict(self, node: ast.Dict) -> dict[Any, Any]:
        pairs = zip(node.keys, node.values, strict=True)
        if None in node.keys:
            raise Refused("has what no expression may have: **")
        return {self.value(key): self.value(value) for key, value in pairs if key}

    def _listcomp(self, node: ast.ListComp | ast.GeneratorExp) -> list[Any]:
        if len(node.generators) > 1 or not isinstance(
            node.generators[0].target, ast.Name
        ):
            raise Refused("only one simple 'for' is known")
        (loop,) = node.generators
        name, before = _public(loop.target.id), dict(self.own)  # type: ignore[attr-defined]
        found = []
        for element in _elements(self.value(loop.iter)):
            self.own[name] = _plain(element)
            if all(self.value(test) for test in loop.ifs):
                found.append(self.value(node.elt))
        self.own = before
        return found

    _generatorexp = _listcomp

    def _call(self, node: ast.Call) -> Any:
        path, target = _dotted(node.func), node.func
        names = [_public(word.arg) for word in node.keywords if word.arg is not None]
        if len(names) < len(node.keywords):
            raise Refused("has what no expression may have: **")
        if path in ("map", "python.map"):
            return self._map(node)
        given = [self.value(argument) for argument in node.args]
        named = dict(
            zip(names, (self.value(word.value) for word in node.keywords), strict=True)
        )
        if path in self.functions:
            return self.functions[path](*given, **named)
        if isinstance(target, ast.Attribute):
            name, owner = _public(target.attr), self.value(target.value)
            for kind, methods in METHODS.items():
                if isinstance(owner, kind) and name in methods:
                    if name in ("replace", "join"):
                        _require_few(name, owner, given)
                    return getattr(owner, name)(*given, **named)
        raise Refused(f"there is no function '{ast.unparse(target)}'")

    def _map(self, node: ast.Call) -> list[Any]:
        function = _dotted(node.args[0]) if len(node.args) == 2 else ""
        if function not in self.functions:
            raise Refused("map() takes the name of a function, and a list")
        return [
            self.functions[function](_plain(element))
            for element in _elements(self.value(node.args[1]))
        ]


def _public(name: str) -> str:
    """A name that may be used."""
    if name.startswith("__"):
        raise Refused(f"'{name}' begins with two underscores")
    return name


def _dotted(node: ast.AST) -> str:
    """A name with or without a namespace, as it is written; else nothing."""
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
        return f"{node.value.id}.{node.attr}"
    return ""


def _named(node: ast.AST) -> str:
    return type(node).__name__


def _elements(value: Any) -> Iterable[Any]:
    if not isinstance(value, str | list | tuple | range | dict):
        raise Refused("only lists, texts and mappings have elements")
    return value


def _plain(value: Any) -> Any:
    """A value, of which nothing can be called: iterators become lists."""
    if isinstance(value, Iterator | KeysView | ValuesView | ItemsView):
        value = list(value)
    if value is not None and not isinstance(value, DATA):
        raise Refused(f"something of the type {type(value).__name__} is no value")
    if isinstance(value, int) and value.bit_length() > BITS:
        raise Refused("a number is too large")
    if isinstance(value, str) and len(value) > TEXT:
        raise Refused("a text is too long")
    return value


def _require_small(kind: ast.operator, left: Any, right: Any) -> None:
    """Refuse operations whose result has no bound."""
    whole = isinstance(left, int) and isinstance(right, int)
    if isinstance(kind, ast.Pow) and whole and left.bit_length() * abs(right) > BITS:
        raise Refused("a number is too large")
    if isinstance(kind, ast.Mult):
        for some, count in ((left, right), (right, left)):
            many = isinstance(count, int) and not isinstance(some, int | float)
            if many and len(some) * count > LONGEST:
                raise Refused("a text or list is too long")
    text = isinstance(kind, ast.Mod) and isinstance(left, str)
    if text and "%" in FORMATS.sub("", left):
        raise Refused("a format is not one of the simple ones")


def _require_few(name: str, owner: Any, given: list[Any]) -> None:
    """Refuse texts that become longer than they may be."""
    words = [given[-1]] if name == "replace" else [owner]
    times = len(owner) + 1 if name == "replace" else len(given[0])
    if times * max(map(len, words)) > LONGEST:
        raise Refused("a text or list is too long")
