"""Surfaces out of mesh files of any format, whatever may be wrong with them."""

from __future__ import annotations

import json
import subprocess
from contextlib import suppress
from pathlib import Path
from threading import Timer
from time import monotonic
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib_pin.errors import InputError
from calib_pin.io.children import started
from calib_pin.io.files import read_bytes
from calib_pin.io.journal import sha256
from calib_pin.io.urdf_tree import FARTHEST
from calib_pin.kinematics.spatial import Floats

LARGEST = 1 << 27
"""Bytes of the largest mesh file."""

TRIANGLES = 1_000_000
"""Triangles of the largest mesh: collision geometry takes half a kilobyte of each."""

SECONDS, SECONDS_PER_MEGABYTE = 5.0, 1.0
"""Time for a mesh file, five times what large ones take [s]."""

START = 60.0
"""Time in which the process that reads has to be there [s]."""

KEPT = 100
"""Meshes that are remembered."""

STL = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
"""A triangle of a binary STL file."""


class Mesh(NamedTuple):
    """A surface.

    Attributes:
        vertices: Shape (V, 3) [m].
        triangles: The vertices of every triangle, shape (F, 3).
    """

    vertices: Floats
    triangles: NDArray[np.int64]


_known: dict[tuple[str, str], Mesh | InputError] = {}


class MeshReader:
    """Reads the mesh files of a robot, in a `with` block.

    Files of other formats than binary STL are read in a process of their own, with
    limits of memory and time: the library that knows them can be made to crash.
    """

    def __init__(self) -> None:
        """Nothing starts before it is needed."""
        self._child: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Self:
        """The reader itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close it."""
        self.close()

    def close(self) -> None:
        """End the process, if there is one."""
        if self._child is not None:
            self._child.kill()
            self._child.communicate()
            self._child = None

    def read(self, path: Path, scale: ArrayLike = (1.0, 1.0, 1.0)) -> Mesh:
        """The surface in a mesh file.

        Args:
            path: The file.
            scale: Factors of the coordinates, shape (3,).

        Raises:
            InputError: If the file cannot be read or a surface in it cannot be used.
        """
        data = read_bytes(path, LARGEST)
        # A file may name others beside it: its content alone does not tell it apart.
        key = str(path), sha256(data)
        if key not in _known:
            if len(_known) >= KEPT:
                del _known[next(iter(_known))]
            try:
                mesh = _binary_stl(data) or self._foreign(path, len(data))
                _check(mesh, path)
                _known[key] = mesh
            except InputError as error:  # Next time it would take as long.
                _known[key] = error
        found = _known[key]
        if isinstance(found, InputError):
            raise found
        vertices, triangles = found
        with np.errstate(over="ignore", invalid="ignore"):
            scaled = vertices * np.asarray(scale, float)
        far = ~(np.abs(scaled) <= FARTHEST).all(axis=1)
        if far.any():
            written = " ".join(f"{x:.6g}" for x in scaled[far.argmax()])
            reason = f"has the vertex ({written}), not within {FARTHEST:g} m"
            raise InputError(reason, file=path)
        return Mesh(scaled, triangles)

    def _foreign(self, path: Path, size: int) -> Mesh:
        """The surface that the process of the library answers."""
        try:
            if self._child is None:
                self._child = started("mesh_child.py")
                _answer(self._child, START)
            assert self._child.stdin is not None
            with suppress(OSError):  # It is gone, as its answer will tell.
                self._child.stdin.write(json.dumps(str(path)).encode() + b"\n")
                self._child.stdin.flush()
            return _answer(self._child, SECONDS + SECONDS_PER_MEGABYTE * size / 1e6)
        except _Lost as lost:
            self.close()
            raise InputError(f"cannot be read: {lost}", file=path) from None
        except ValueError as error:
            raise InputError(f"cannot be read: {error}", file=path) from None


class _Lost(Exception):
    """The process does not answer any more."""


def _answer(child: subprocess.Popen[bytes], seconds: float) -> Mesh:
    """The answer of the process within some time.

    Raises:
        ValueError: With the reason, if it cannot read the file.
        _Lost: If it must be started again.
    """
    assert child.stdout is not None
    timer, end = Timer(seconds, child.kill), monotonic() + seconds
    timer.start()
    try:
        head = json.loads(child.stdout.readline(1 << 16))
        vertices, triangles = head.get("vertices", 0), head.get("triangles", 0)
        if max(vertices, triangles) <= 3 * TRIANGLES:
            data = child.stdout.read(24 * (vertices + triangles))
            points = np.frombuffer(data, "<f8", 3 * vertices)
            corners = np.frombuffer(data, "<i8", offset=points.nbytes)
            mesh = Mesh(points.reshape(vertices, 3), corners.reshape(triangles, 3))
        else:
            raise _Lost(f"it has more than {TRIANGLES} triangles")
    except ValueError:
        late = monotonic() >= end
        reason = f"it takes more than {seconds:.0f} s" if late else "it is damaged"
        raise _Lost(reason) from None
    finally:
        timer.cancel()
    if "reason" in head:
        raise ValueError(head["reason"])
    return mesh


def _binary_stl(data: bytes) -> Mesh | None:
    """The surface in a binary STL file; None if it is none."""
    if len(data) < 84 or len(data) != 84 + 50 * int.from_bytes(data[80:84], "little"):
        return None
    corners = np.frombuffer(data, STL, offset=84)["corners"].reshape(-1, 3)
    # Triangles share corners, in the order in which they first come.
    every, first, place = np.unique(
        corners.astype(float), axis=0, return_index=True, return_inverse=True
    )
    order = np.argsort(first)
    number = np.argsort(order)
    return Mesh(every[order], number[place.ravel()].reshape(-1, 3))


def _check(mesh: Mesh, path: Path) -> None:
    """Refuse a surface without triangles, or of too many or with wrong vertices."""
    vertices, triangles = mesh
    if not 1 <= len(triangles) <= TRIANGLES:
        reason = f"has {len(triangles)} triangles, not 1 to {TRIANGLES}"
        raise InputError(reason, file=path)
    if len(vertices) < 3:  # Of a single one, the library gives numbers of no meaning.
        raise InputError("has less than 3 different vertices", file=path)
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        raise InputError("has a face with a vertex that is not there", file=path)
