"""Expands a xacro file; `children` calls it, in a process that has limits.

The package xacro hands the expressions of a file to Python's `eval`, and asks ROS for
packages: both are replaced here. In an expression a dot leads to the keys of mappings,
the functions of xacro's namespaces and a few methods, and to nothing else.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import xacro
from simpleeval import BASIC_ALLOWED_ATTRS, EvalWithCompoundTypes
from xacro import substitution_args

from calib_pin.errors import RobotError, enumerated, nearest, words_of
from calib_pin.io.packages import packages

METHODS: dict[type, set[str]] = {
    str: BASIC_ALLOWED_ATTRS[str] - {"format", "format_map"},
    list: {"count", "index"},
    dict: {"get", "items", "keys", "values"},
}
"""Methods of values, none of which changes them."""

GLOBAL: dict[str, Any] = xacro._global_symbols

# They know of classes, to which no expression needs to come.
for _name in ("isinstance", "issubclass", "repr", "type", "vars"):
    GLOBAL["python"].pop(_name, None)

_KNOWN = {**GLOBAL["python"], **GLOBAL}
FUNCTIONS = {name: value for name, value in _KNOWN.items() if callable(value)}
"""Functions that need no namespace."""


class Refused(Exception):
    """A fault of an expression, or of a file that is expanded."""


class Expression(EvalWithCompoundTypes):  # type: ignore[misc]
    """An evaluation in which a dot leads to few things."""

    def _eval_attribute(self, node: ast.Attribute) -> Any:
        owner = self._eval(node.value)
        if isinstance(owner, Mapping) and node.attr in owner:
            return owner[node.attr]
        for kind, names in METHODS.items():
            if isinstance(owner, kind) and node.attr in names:
                return getattr(owner, node.attr)
        raise Refused(f"there is no '{node.attr}' in it")


def evaluate(
    text: str, symbols: Mapping[str, Any], functions: Mapping[str, Callable[..., Any]]
) -> Any:
    """The value of an expression.

    Args:
        text: The text between the braces.
        symbols: Values by name.
        functions: Functions by name.

    Raises:
        Refused: If it cannot be evaluated.

    Examples:
        >>> evaluate("2 * r if kind == 'arm' else pi", {"r": 3, "kind": "arm"}, {})
        6
    """
    try:
        tree = ast.parse(text.strip(), mode="eval").body
        expression = Expression(functions=dict(functions), names=symbols)
        # The format of a value in a text may lead to its attributes.
        del expression.nodes[ast.JoinedStr], expression.nodes[ast.FormattedValue]
        value = expression.eval(text, tree)
        if not callable(value):
            return value
        reason = "it is a function and no value"
    except (MemoryError, OSError, RecursionError, xacro.XacroException):
        raise
    except Exception as error:
        reason = str(getattr(error, "msg", error))
    raise Refused(f"cannot evaluate '{text}': {reason}")


class Arguments(dict[str, str]):
    """Arguments of a xacro file, which keep what they were asked for."""

    def __init__(self, given: Mapping[str, str]) -> None:
        """Nothing was asked for yet."""
        super().__init__(given)
        self.asked: set[str] = set()

    def __contains__(self, name: object) -> bool:
        """Whether there is one of this name; the file knows it."""
        self.asked.add(str(name))
        return super().__contains__(name)

    def __getitem__(self, name: str) -> str:
        """The argument of a name; the file knows it."""
        if name not in self:
            raise Refused(f"argument '{name}' is missing: give {name}:=VALUE")
        return super().__getitem__(name)


def _install(folders: list[Path]) -> None:
    """Replace the parts of xacro that come from Python and from ROS.

    Args:
        folders: Folders that are packages or hold some.
    """

    def value(text: str, symbols: Mapping[str, Any], _: object = None) -> Any:
        return evaluate(text, symbols, FUNCTIONS)

    def substituted(text: str, context: object) -> str:
        """The value of `$(eval ...)`, which is roslaunch's."""
        raise Refused(f"$(eval {text}) is not evaluated; write ${{...}}")

    def find(name: str) -> str:
        """The folder of a package."""
        package = next(packages(name, folders), None)
        if package is None:
            hint = "name its folder, or that which holds it, with --package-dir"
            raise Refused(f"the package '{name}' is not found: {hint}")
        return str(package.absolute())

    def folder(*_: object) -> str:
        """The folder of the file that is read."""
        return str(Path(xacro.filestack[-1]).absolute().parent)

    for module, name, replacement in (
        (xacro, "safe_eval", value),
        (substitution_args, "_eval", substituted),
        (substitution_args, "_eval_find", find),
        (substitution_args, "_eval_dirname", folder),
    ):
        if not hasattr(module, name):
            raise Refused(f"this version of xacro has no {name}")
        setattr(module, name, replacement)


def read(
    file: str, arguments: Mapping[str, str], folders: list[str]
) -> tuple[str, str]:
    """The URDF in a xacro file, and no remark.

    Args:
        file: The file.
        arguments: Values of its arguments by name.
        folders: Folders that are packages or hold some.

    Raises:
        RobotError: If it cannot be expanded, with the file and macro that is wrong.
    """
    try:
        _install([*map(Path, folders)])
        beside, known = Path(file).parent, Arguments(arguments)
        for name, word in arguments.items():
            # A file that the user names is in the working folder.
            path = Path(word)
            if path.suffix and path.is_file() and not (beside / word).exists():
                known[name] = str(path.absolute())
        xacro.init_stacks(file)
        document = xacro.parse(None, file)
        xacro.process_doc(document, mappings=known, verbosity=0)
        for name in (name for name in arguments if name not in known.asked):
            has = f"; it has {enumerated(sorted(known.asked))}" if known.asked else ""
            hint = nearest(name, known.asked)
            raise Refused(f"has no argument '{name}'{hint}{has}")
        return str(document.toprettyxml(indent="  ")), ""
    except Exception as error:
        failure: Any = error
    while isinstance(getattr(failure, "exc", None), BaseException):
        failure = failure.exc  # Without what xacro adds to it.
    memory = isinstance(failure, MemoryError)
    reason = "it needs too much memory" if memory else words_of(failure)
    reason = f"xacro cannot expand it: {reason}"
    if xacro.macrostack:  # It, or the call of it, is wrong.
        macro = xacro.macrostack[-1]
        place = Path(str(macro.history[-1][-1])).name
        reason += f", in macro '{macro.body.getAttribute('name')}' ({place})"
    raise RobotError(reason, file=(xacro.filestack or [file])[-1])
