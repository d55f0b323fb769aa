"""Packages of ROS, and the files in them that robots name."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path

_NAME = re.compile(rb"<name>\s*([\w.-]+)\s*</name>")


def locate_mesh(
    written: str, urdf: Path, package_dirs: Sequence[str | Path] = ()
) -> Path | None:
    """The file of a mesh, or None if there is none.

    Args:
        written: The name in the URDF: a path from its own folder, or `package://`.
        urdf: Path of the URDF.
        package_dirs: Folders that hold the packages of `package://` meshes; then come
            those of ROS and the folders above the URDF.
    """
    scheme, _, rest = written.rpartition("://")
    files: Iterable[Path] = (urdf.parent / rest,)
    if scheme in ("package", "model"):
        # Some write a third slash.
        package, _, inside = rest.lstrip("/").partition("/")
        folders = package_folders(urdf, package_dirs)
        files = (folder / inside for folder in packages(package, folders))
    return next((file.absolute() for file in files if file.is_file()), None)


def package_folders(
    robot: Path, package_dirs: Sequence[str | Path] = ()
) -> Iterator[Path]:
    """Folders that are packages or hold some, those that come first win.

    Args:
        robot: File of the robot.
        package_dirs: Folders that the user names.
    """
    of_ros = os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)
    for folder in (*package_dirs, *filter(None, of_ros)):
        yield from (Path(folder), Path(folder).absolute().parent)
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        if prefix:
            yield Path(prefix, "share")
    yield from robot.parents


def packages(name: str, folders: Iterable[Path]) -> Iterator[Path]:
    """The packages of some name.

    A folder is called like its package, or says in its `package.xml` how that is
    called: a repository that was cloned often has another name.

    Args:
        name: Name of the package.
        folders: Folders that are packages or hold some.
    """
    for folder in folders:
        if (folder / name).is_dir():
            yield folder / name
        with suppress(OSError):
            match = _NAME.search((folder / "package.xml").read_bytes())
            if match and match[1].decode() == name:
                yield folder
