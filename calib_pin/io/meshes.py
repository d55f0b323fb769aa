"""The meshes that a URDF names: their files and their surfaces."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib_pin.errors import InputError
from calib_pin.io.urdf_tree import captured_stderr
from calib_pin.kinematics.spatial import Floats


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
    folders: Iterable[Path] = (urdf.parent,)
    if scheme in ("package", "model"):
        folders = (*_package_folders(package_dirs), *urdf.parents)
        rest = rest.lstrip("/")  # Some write a third slash.
    files = (folder / rest for folder in folders)
    return next((file.absolute() for file in files if file.is_file()), None)


def read_mesh(path: Path, scale: Sequence[float]) -> tuple[Floats, NDArray[np.int64]]:
    """The surface in a mesh file of any format that Pinocchio reads.

    Args:
        path: The file.
        scale: Factors of the coordinates, shape (3,).

    Returns:
        Vertices, shape (V, 3) [m], and the three vertices of every triangle, shape
        (F, 3).

    Raises:
        InputError: If the file cannot be read.
    """
    # Boxes along the axes are the quickest to build of what nobody asks for here.
    loader = pin.coal.MeshLoader(pin.coal.NODE_TYPE.BV_AABB)
    try:
        with captured_stderr():
            surface = loader.load(str(path), np.asarray(scale, float))
    except Exception as failure:  # Whatever C++ throws.
        raise InputError("the mesh cannot be read", file=path) from failure
    corners = map(surface.tri_indices, range(surface.num_tris))
    triangles = np.array([(t[0], t[1], t[2]) for t in corners], np.int64)
    return np.array(surface.vertices()), triangles.reshape(-1, 3)


def _package_folders(package_dirs: Sequence[str | Path]) -> Iterator[Path]:
    """Folders that hold packages; a package may also be named by itself."""
    of_ros = os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)
    for folder in (*package_dirs, *filter(None, of_ros)):
        yield from (Path(folder), Path(folder).absolute().parent)
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        if prefix:
            yield Path(prefix, "share")
