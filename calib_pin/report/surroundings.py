"""Instruments and targets around a robot and on its tool, as shapes.

Each shape hangs on a link of the nominal robot: the base of its chain, or the tip for
what the tool carries.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from calib_pin.estimation.terms import Term
from calib_pin.kinematics.shapes import Color, Shape, ball, box, cylinder
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.pinhole import Camera
from calib_pin.measurement_models.references import Anchor, Plane, Point, Sphere
from calib_pin.observations import AT, BlockKey, Labels, Observations

DARK: Color = (0.25, 0.28, 0.32)
WHITE: Color = (0.97, 0.97, 0.97)
STATION: Color = (0.80, 0.47, 0.65)
CAMERA: Color = (0.90, 0.62, 0.0)
SOCKET: Color = (0.0, 0.62, 0.45)
PLANE: Color = (0.34, 0.71, 0.91)
"""Of the palette of Okabe and Ito, like all groups of things."""

AXES: tuple[Color, ...] = ((0.84, 0.37, 0.0), (0.0, 0.62, 0.45), (0.0, 0.45, 0.70))
"""Of the axes x, y and z of a measurement frame."""

LARGE = 1.2
"""Size of a robot beside which signs have their full size [m]."""

CLEAR = 0.35
"""Opacity of a surface that is touched: the robot behind it is seen."""

SQUARES = 6
"""Squares of a drawn board along its longer side; no real board is copied."""

PATCH = 0.15
"""Half of the extent of a plane of which no touched point is known [m]."""

RIM = 1.12
"""Extent of a plane's patch by that of the points on it."""


@dataclass(frozen=True)
class Thing:
    """Something that the robot is measured with.

    Attributes:
        kind: `station` (a measurement frame), `camera`, `board`, `socket`, `sphere`,
            `anchor` or `plane`.
        name: Its name; may be empty.
        origin: Where it is in its link, shape (3,) [m].
        shapes: What it looks like.
    """

    kind: str
    name: str
    origin: Floats
    shapes: tuple[Shape, ...]

    @property
    def link(self) -> str:
        """The link that it hangs on."""
        return self.shapes[0].link


Touched = Mapping[BlockKey, tuple[Labels, Floats]]
"""Targets of measurements by block, and their tool points in the base, (n, 3) [m]."""


def touched_by(rows: Observations, points: Floats) -> Touched:
    """Targets and tool points of measurements, (N, 3) [m] in their base links."""
    pairs = zip(rows.keys, rows.slices, strict=True)
    return {key: (rows.target[own], points[own]) for key, own in pairs}


def surroundings(
    terms: Mapping[BlockKey, Term], touched: Touched, reach: float
) -> list[Thing]:
    """All that is known of what stands around, each once.

    Args:
        terms: The terms of all blocks, about what has been found of frames and
            instruments.
        touched: Measurements, which tell how large planes are to be drawn; may be
            empty.
        reach: Size of the robot [m]: what has no size of its own is drawn by it.
    """
    size = float(np.clip(reach / LARGE, 0.15, 1.0))
    found: dict[tuple[str, str], Thing] = {}
    for key, term in terms.items():
        targets, points = touched.get(key, (Labels.of(()), np.zeros((0, 3))))
        sites = _touched(term, targets, points, size)
        for thing in (*_instruments(term, size), *sites):
            found.setdefault((thing.kind, thing.name), thing)
    return list(found.values())


def _instruments(term: Term, size: float) -> Iterator[Thing]:
    """The station of a block, or its camera with the board that it looks at."""
    chain, frames = term.error.chain, term.frames
    references = term.measurement.references
    stands = chain.base, term.error.base.inverse().homogeneous
    carried = chain.tip, term.error.tool.homogeneous
    cameras = [r for r in references if isinstance(r, Camera)]
    if term.measurement.declaration.external and not cameras:
        yield Thing(
            "station", frames.station, stands[1][:3, 3], _station(*stands, size)
        )
    for camera in cameras:
        ends = (stands, frames.station), (carried, frames.tool)
        (own, name), (other, of) = ends[::-1] if camera.mount == "hand" else ends
        yield Thing("camera", name, own[1][:3, 3], _camera(*own, size))
        marks = [r.xyz for r in references if isinstance(r, Point)]
        xyz = np.array([place for place in marks if place is not None]).reshape(-1, 3)
        if len(xyz) > 2:
            middle = _at(other[1], 0.5 * (xyz.min(0) + xyz.max(0)))
            yield Thing("board", of, middle[:3, 3], _board(other[0], middle, xyz))


def _touched(
    term: Term, targets: Labels, points: Floats, size: float
) -> Iterator[Thing]:
    """Sockets, planes, spheres and anchors that the measurements of a block name."""
    stands, link = term.error.base.inverse().homogeneous, term.error.chain.base
    sites = [target.rpartition(AT)[2] for target in targets.names]
    for reference in term.measurement.references:
        if not reference.located or not reference.outer:
            continue
        named = np.array([site in (reference.name, "") for site in sites], bool)
        near = points[named[targets.codes]]
        if isinstance(reference, Plane):
            shape = _plane(link, reference, stands, near)
        elif not isinstance(reference, (Point, Sphere, Anchor)):
            continue
        elif isinstance(reference, Sphere):
            surface = ball(abs(reference.size or 0.0))
            shape = Shape(link, _at(stands, reference.xyz), surface, PLANE, CLEAR)
        elif isinstance(reference, Anchor):
            surface = box(np.full(3, 0.05 * size))
            shape = Shape(link, _at(stands, reference.xyz), surface, STATION)
        else:
            place = _at(_at(stands, reference.xyz), (0.0, 0.0, -0.02 * size))
            shape = Shape(link, place, cylinder(0.024 * size, 0.03 * size), SOCKET)
        name = term.frames.reference(reference)
        yield Thing(reference.kind, name, shape.placement[:3, 3], (shape,))


def _at(frame: Floats, xyz: ArrayLike | None) -> Floats:
    """A frame (4, 4) moved to a point that is stated in it, shape (3,) [m]."""
    place = frame.copy()
    place[:3, 3] += frame[:3, :3] @ np.asarray(xyz, float)
    return place


def _plane(link: str, plane: Plane, stands: Floats, near: Floats) -> Shape:
    """A patch of a plane as large as the points (n, 3) [m] on it are spread."""
    assert plane.normal is not None
    size = np.array([2.0 * PATCH, 2.0 * PATCH, 1e-3])
    place = _at(stands, -plane.offset * plane.normal)
    place[:3, :3] = stands[:3, :3] @ np.column_stack([*plane.tangents, plane.normal])
    if len(near):
        seen = (near - place[:3, 3]) @ place[:3, :2]
        low, high = seen.min(axis=0), seen.max(axis=0)
        size[:2] = RIM * (high - low) + 0.06
        place = _at(place, [*(0.5 * (low + high)), 0.0])
    return Shape(link, place, box(size), PLANE, CLEAR)


def _station(link: str, frame: Floats, size: float) -> tuple[Shape, ...]:
    """The axes of a measurement frame: nobody knows where its instrument stands."""
    shapes = [Shape(link, frame, ball(0.02 * size), DARK)]
    for k, color in enumerate(AXES):
        place = _at(frame, 0.1 * size * np.eye(3)[k])
        # The z axis of a cylinder becomes the axis k.
        place[:3, :3] = np.roll(frame[:3, :3], 2 - k, axis=1)
        shapes.append(Shape(link, place, cylinder(0.008 * size, 0.2 * size), color))
    return tuple(shapes)


def _camera(link: str, frame: Floats, size: float) -> tuple[Shape, ...]:
    """A box with a lens, which looks along the z axis of its optical frame."""
    lens, body = (_at(frame, (0.0, 0.0, z * size)) for z in (-0.0125, -0.045))
    return (
        Shape(link, body, box(size * np.array([0.08, 0.05, 0.04])), CAMERA),
        Shape(link, lens, cylinder(0.018 * size, 0.025 * size), DARK),
    )


def _board(link: str, middle: Floats, xyz: Floats) -> tuple[Shape, ...]:
    """A board with squares, as large as its points (n, 3) [m] are spread."""
    size = np.maximum(np.ptp(xyz, axis=0), 1e-3)
    thin = int(np.argmin(size))
    across, up = (k for k in range(3) if k != thin)
    step = float(size.max()) / SQUARES
    margin, square = np.full(3, 2.0 * step), np.full(3, step)
    margin[thin], square[thin] = 0.0, 2.0 * size[thin]
    shapes = [Shape(link, middle, box(size + margin), WHITE)]
    counts = np.maximum(np.round(size / step), 1.0)
    for k, j in np.ndindex(int(counts[across]), int(counts[up])):
        if (k + j) % 2 == 0:
            spot = np.zeros(3)
            spot[[across, up]] = step * (
                np.array([k, j]) + 0.5 - 0.5 * counts[[across, up]]
            )
            shapes.append(Shape(link, _at(middle, spot), box(square), DARK))
    return tuple(shapes)
