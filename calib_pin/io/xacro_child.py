"""Expands a xacro file in a process of its own; `xacro_files.py` runs it as a script.

The package xacro hands the expressions of a file to Python's `eval`, asks ROS for
packages, and takes entities; all that is replaced here. JSON comes in: the file, its
arguments, the folders of packages. JSON goes out: the URDF, or the reason why there is
none and the file where it was found.
"""

from __future__ import annotations

import json
import os
import re
import stat
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from xml.dom import minidom
from xml.parsers import expat

import xacro
from xacro import substitution_args

from calib_pin.errors import enumerated, nearest
from calib_pin.io.limits import limit
from calib_pin.io.packages import packages
from calib_pin.io.xacro_expressions import Refused, evaluate

FILE = 1 << 24
"""Bytes of the largest file that is read."""

URDF = 1 << 26
"""Bytes of the largest URDF."""

FILES = 10_000
"""Most files that are read, each as often as it is included."""


class Arguments(dict[str, str]):
    """Arguments of a xacro file, which keep what they were asked for."""

    def __init__(self, given: Mapping[str, str]) -> None:
        """Nothing was asked for yet."""
        super().__init__(given)
        self.given = dict(given)
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


class Reader:
    """Takes the place of parts of xacro.

    Args:
        arguments: The arguments.
        folders: Folders that are packages or hold some.
    """

    def __init__(self, arguments: Arguments, folders: list[Path]) -> None:
        """Put it in their place."""
        self.arguments, self.folders, self.count = arguments, folders, 0
        self.load_yaml, self.place = xacro.load_yaml, xacro.abs_filename_spec
        namespace = {
            "load_yaml": self.yaml,
            "abs_filename": self.path,
            "dotify": xacro.YamlDictWrapper,
            "tokenize": lambda text, sep=",; ": [
                word for word in re.split(f"[{re.escape(sep)}]", text) if word
            ],
            "arg": arguments.__getitem__,
            "fatal": self.fatal,
            **dict.fromkeys(("error", "message", "print_location", "warning"), _silent),
        }
        plain = ("load_yaml", "abs_filename", "dotify")
        self.functions: dict[str, Callable[..., Any]] = {
            **{f"xacro.{name}": function for name, function in namespace.items()},
            **{name: namespace[name] for name in plain},
        }
        for module, name, own in (
            *((xacro, "safe_eval", self.value), (xacro, "parse", self.parse)),
            *((xacro, "abs_filename_spec", self.path), (xacro, "warning", _silent)),
            *((substitution_args, "_eval", self.substituted),),
            *((substitution_args, "_eval_find", self.find),),
            *((substitution_args, "_eval_dirname", _folder),),
        ):
            if not hasattr(module, name):
                raise Refused(f"this version of xacro has no {name}")
            setattr(module, name, own)

    def value(self, text: str, symbols: Mapping[str, Any], _: object = None) -> Any:
        """The value of an expression."""
        try:
            return evaluate(text, symbols, self.functions)
        except Refused as refused:
            written = text if len(text) < 80 else f"{text[:77]}..."
            raise Refused(f"cannot evaluate '{written}': {refused}") from None

    def substituted(self, text: str, _: object) -> str:
        """The value of `$(eval ...)`, as roslaunch has it."""
        args = {
            name: substitution_args.convert_value(self.arguments[name], "auto")
            for name in list(self.arguments)
        }
        symbols = {"true": True, "false": False, **args}
        functions = {
            "arg": lambda name: substitution_args.convert_value(
                self.arguments[name], "auto"
            ),
            "dirname": _folder,
            "find": self.find,
            "env": substitution_args._eval_env,
            "optenv": substitution_args._eval_optenv,
        }
        try:
            return str(evaluate(text, symbols, functions))
        except Refused as refused:
            raise Refused(f"cannot evaluate '{text}': {refused}") from None

    def find(self, name: str) -> str:
        """The folder of a package."""
        found = next(packages(name, self.folders), None)
        if found is None:
            raise Refused(
                f"the package '{name}' is not found: name its folder, or that which "
                "holds it, with --package-dir"
            )
        return str(found.absolute())

    def path(self, written: str) -> str:
        """The file of a name: beside the file that names it.

        What the user gave as an argument may also be there from the working folder.
        """
        beside = str(self.place(written))
        given = written in self.arguments.given.values()
        if given and not Path(beside).exists() and Path(written).exists():
            return str(Path(written).absolute())
        return beside

    def yaml(self, name: str) -> Any:
        """The data in a YAML file."""
        path = self.path(name)
        self.read(path)
        try:
            return self.load_yaml(path)
        except (Refused, RecursionError, MemoryError):
            raise
        except Exception as failure:
            raise Refused(f"{path} cannot be read: {failure}") from None

    def parse(self, _: object, filename: str) -> minidom.Document:
        """The tree of a XML file."""
        data = self.read(filename)
        parser = expat.ParserCreate()

        def refuse(*_: object) -> None:
            raise Refused("a DOCTYPE with its entities is not accepted in a xacro file")

        parser.StartDoctypeDeclHandler = refuse
        try:
            parser.Parse(data, True)
        except expat.ExpatError as error:
            kind = expat.ErrorString(error.code)
            raise Refused(
                f"it is not well-formed XML: {kind}, line {error.lineno}"
            ) from None
        return minidom.parseString(data)

    def read(self, name: str) -> bytes:
        """The bytes of a file, if they are not too many.

        A file that is not there is an OSError, which xacro knows as optional.
        """
        self.count += 1
        if self.count > FILES:
            raise Refused(f"more than {FILES} files are included")
        path = Path(name)
        try:
            status = path.stat()
        except (OSError, ValueError) as error:
            if len(xacro.filestack) > 1:
                xacro.filestack.pop()  # It is the file that names it which is wrong.
            reason = f"cannot read {name}: {getattr(error, 'strerror', error)}"
            raise xacro.XacroException(reason, exc=OSError("")) from None
        if not stat.S_ISREG(status.st_mode) or status.st_size > FILE:
            raise Refused(f"{name} is no file of at most {FILE >> 20} MB")
        return path.read_bytes()

    def fatal(self, *words: object) -> None:
        """End with a message of the file itself."""
        raise Refused(" ".join(map(str, words)))


def _silent(*_: object, **__: object) -> str:
    """Print nothing of what a file, or xacro, would."""
    return ""


def _folder(*_: object) -> str:
    """The folder of the file that is read."""
    return str(Path(xacro.filestack[-1]).absolute().parent)


def expanded(file: str, given: Mapping[str, str], folders: list[Path]) -> str:
    """The text of the URDF.

    Raises:
        Exception: Of any kind, if there is none.
    """
    arguments = Arguments(given)
    Reader(arguments, folders)
    xacro.init_stacks(file)
    document = xacro.parse(None, file)
    xacro.process_doc(document, mappings=arguments, verbosity=0)
    if unknown := [name for name in given if name not in arguments.asked]:
        known = arguments.asked
        raise Refused(
            f"has no argument '{unknown[0]}'{nearest(unknown[0], known)}; it has "
            f"{enumerated(sorted(known))}"
            if known
            else f"has no arguments, and not '{unknown[0]}'"
        )
    text: str = document.toprettyxml(indent="  ")
    if len(text) > URDF:
        raise Refused(f"the URDF has more than {URDF >> 20} MB")
    return text


def reason(failure: BaseException) -> str:
    """Why a file cannot be expanded, without what xacro adds to it."""
    cause: BaseException | None = failure
    while isinstance(cause, xacro.XacroException) and isinstance(
        cause.exc, BaseException
    ):
        if isinstance(cause.exc, OSError):
            return str(cause).strip()
        cause = cause.exc
    if isinstance(cause, RecursionError):
        return "a macro or an expression calls itself without end"
    if isinstance(cause, MemoryError):
        return "it needs too much memory"
    if isinstance(cause, Refused):
        return str(cause)
    return " ".join(str(cause or failure).split()) or type(failure).__name__


def place() -> str:
    """The macro that is expanded: it, or the call of it, is wrong."""
    if not xacro.macrostack:
        return ""
    macro = xacro.macrostack[-1]
    file = Path(str(macro.history[-1][-1])).name
    return f", in macro '{macro.body.getAttribute('name')}' ({file})"


def main() -> None:
    """Answer one request."""
    limit()
    request = json.load(sys.stdin)
    # Nothing that the file prints is an answer.
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    found: dict[str, str]
    try:
        folders = [Path(folder) for folder in request["folders"]]
        found = {"urdf": expanded(request["file"], request["arguments"], folders)}
    except Exception as failure:
        found = {
            "reason": f"xacro cannot expand it: {reason(failure)}{place()}",
            "file": str((xacro.filestack or [request["file"]])[-1]),
        }
    json.dump(found, answers)
    answers.close()


if __name__ == "__main__":
    main()
