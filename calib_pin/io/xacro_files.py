"""Robots in xacro files, expanded as ROS does it, and without ROS."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path

from calib_pin.errors import OptionError
from calib_pin.io.children import answer
from calib_pin.io.packages import package_folders

SUFFIX = ".xacro"

ARGUMENT = re.compile(r"([^\W\d]\w*):=(.*)", re.DOTALL)
"""A word that is an argument of a xacro file, as ROS writes them."""

_GAP = re.compile(r"\s+(?=[^\W\d]\w*:=)")


def split_arguments(robot: str) -> tuple[str, dict[str, str]]:
    """The file in a user's word for a robot, and its arguments.

    Args:
        robot: The word.

    Examples:
        >>> split_arguments("my arm.urdf.xacro size:=10 name:=my arm")
        ('my arm.urdf.xacro', {'size': '10', 'name': 'my arm'})
    """
    file, *words = _GAP.split(robot)
    pairs = (ARGUMENT.fullmatch(word) for word in words)
    return file, {pair[1]: pair[2] for pair in pairs if pair}


def is_xacro(path: Path) -> bool:
    """Whether a file is to be expanded, by its name."""
    return path.suffix.lower() == SUFFIX


def expand_xacro(
    path: Path,
    arguments: Mapping[str, str],
    package_dirs: Sequence[str | Path] = (),
) -> bytes:
    """The URDF in a xacro file.

    Args:
        path: The file.
        arguments: Values of its arguments by name.
        package_dirs: Folders that are packages or hold some; then come those of ROS and
            the folders above the file.

    Raises:
        OptionError: If the extra is missing.
        RobotError: If it cannot be expanded.
    """
    if find_spec("xacro") is None:
        raise OptionError(
            "xacro files need the package xacro, which is missing: "
            "pip install 'calib-pin[ros]'",
            file=path,
        )
    folders = package_folders(path.absolute(), package_dirs)
    request = {
        "file": str(path),
        "arguments": dict(arguments),
        "folders": list(map(str, folders)),
    }
    text: str = answer("xacro_child.py", request, str(path))["urdf"]
    return text.encode()
