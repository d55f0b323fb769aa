"""Robots in MuJoCo's files, as a URDF: what is corrected is exported, not edited."""

from __future__ import annotations

from pathlib import Path

from calib_pin.errors import RobotError
from calib_pin.io.children import answer
from calib_pin.io.urdf_bytes import parse_document

SUFFIXES = (".xml", ".mjcf", ".sdf")
"""Of files that may be something else than a URDF."""


def urdf_of(source: bytes, path: Path, name: str) -> tuple[bytes, tuple[str, ...]]:
    """The URDF of a robot in another language, and remarks on it.

    Args:
        source: The bytes of the file.
        path: The file.
        name: Its name for messages.

    Returns:
        The bytes themselves if they are not of another language.

    Raises:
        RobotError: If the file cannot be used.
    """
    if path.suffix.lower() not in SUFFIXES:
        return source, ()
    root = parse_document(source, name).root.tag
    if root == "sdf":
        reason = "is SDF, which this Pinocchio does not read; convert it to a URDF"
        raise RobotError(reason, file=name)
    if root != "mujoco":
        return source, ()
    found = answer("mjcf_child.py", {"file": str(path)}, name)
    return found["urdf"].encode(), (found["remark"],)
