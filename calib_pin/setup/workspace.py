"""Constraints on configurations: obstacles, a region, the window of an instrument."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from calib_pin.setup.constraints import Checked, Section, listed
from calib_pin.setup.values import (
    LARGEST_LENGTH,
    SMALLEST,
    Angles,
    Length,
    Number,
    Pair,
    Position,
    Text,
    Triple,
    Vector,
)

_CORNER = Vector(3, "", "m", limit=LARGEST_LENGTH)


def _corners(value: object) -> tuple[Triple, Triple]:
    allowed = (
        "[lower, upper], two corners of three numbers in m, such as "
        "[[0.2, -0.5, 0.1], [1, 0.5, 1.2]]"
    )
    if not isinstance(value, list) or len(value) != 2:
        raise ValueError(allowed)
    try:
        (a, b, c), (x, y, z) = map(_CORNER.check, value)
    except ValueError:
        raise ValueError(allowed) from None
    if not (a < x and b < y and c < z):
        raise ValueError(allowed)
    return (a, b, c), (x, y, z)


CORNERS = listed(_CORNER.schema(), 2)
"""JSON schema of two corners."""

Range = Annotated[
    Pair,
    Vector(
        2,
        "the farthest distance in m, or [nearest, farthest]",
        "m",
        least=0.0,
        limit=LARGEST_LENGTH,
        rising=True,
        scalar=lambda farthest: [0.0, farthest],
    ),
]
Edges = Annotated[
    Triple,
    Vector(
        3,
        "three positive lengths in m, such as [1, 1, 0.02]",
        "m",
        above=0.0,
        limit=LARGEST_LENGTH,
    ),
]
Cylinder = Annotated[
    Pair,
    Vector(
        2,
        "[radius, length], both positive and in m",
        "m",
        above=0.0,
        limit=LARGEST_LENGTH,
    ),
]
Scale = Annotated[
    Triple,
    Vector(
        3,
        "a positive number, or three of them, such as 0.001 for a mesh in mm",
        least=SMALLEST,
        scalar=lambda factor: [factor] * 3,
    ),
]


@dataclass(frozen=True)
class Obstacle(Section):
    """Something solid that the robot must not touch: one of four shapes at a pose.

    Attributes:
        box: Edge lengths along x, y and z [m].
        sphere: Radius [m].
        cylinder: Radius and length of a cylinder along z [m].
        mesh: File of a mesh.
        scale: Factors that make the numbers of the mesh meters, or one for all three
            axes; only with a mesh, None for 1.
        xyz: Position of its origin in the base link of the chain [m]; a box, a sphere
            and a cylinder have it in their middle.
        rpy: URDF fixed-axis angles in the base link [rad].
    """

    box: Edges | None = None
    sphere: Length | None = None
    cylinder: Cylinder | None = None
    mesh: Text | None = None
    scale: Scale | None = None
    xyz: Position = (0.0, 0.0, 0.0)
    rpy: Angles = (0.0, 0.0, 0.0)

    @property
    def kind(self) -> str:
        """The name of its shape."""
        return next(kind for kind in SHAPES if getattr(self, kind) is not None)

    def _check(self) -> None:
        if sum(getattr(self, kind) is not None for kind in SHAPES) != 1:
            raise ValueError(f"exactly one of {', '.join(SHAPES)}")
        if self.scale is not None and self.mesh is None:
            raise ValueError("a scale only together with a mesh")


SHAPES = ("box", "sphere", "cylinder", "mesh")
"""Shapes of obstacles, each a key of one."""


@dataclass(frozen=True)
class Cone(Section):
    """Field of view of an instrument.

    Attributes:
        apex: Where the instrument stands, in the base frame [m].
        axis: Direction it looks in, of any length but zero.
        angle: Half the opening angle [rad].
        range: Nearest and farthest distance from the apex [m].
    """

    apex: Position
    axis: Annotated[
        Triple,
        Vector(
            3,
            "three finite numbers that are not all 0, such as [0, 0, 1]",
            norm=(math.ulp(0.0), math.nextafter(math.inf, 0.0)),
        ),
    ]
    angle: Annotated[
        float,
        Number(
            "rad",
            above=0.0,
            most=math.pi,
            words="half the opening angle in rad, above 0 and at most 3.14",
        ),
    ]
    range: Range

    def contains(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Whether points lie within, shape (N, 3) [m] -> (N,)."""
        ray = np.asarray(points) - self.apex
        along = ray @ np.array(self.axis)
        across = np.linalg.norm(np.cross(ray, self.axis), axis=1)
        distance = np.linalg.norm(ray, axis=1)
        near, far = self.range
        # Unlike the arc cosine, this is exact on the axis; the apex itself counts.
        seen = np.arctan2(across, along) <= self.angle
        return np.asarray(seen & (near <= distance) & (distance <= far))


@dataclass(frozen=True)
class Ball(Section):
    """The inside of a sphere.

    Attributes:
        center: Center in the base frame [m].
        radius: Radius [m].
    """

    center: Position
    radius: Length


@dataclass(frozen=True)
class Region(Section):
    """Where the measured point may be, in the base frame.

    Several shapes together mean what they have in common; their surfaces count.

    Attributes:
        box: Lower and upper corner [m].
        sphere: Inside of a sphere.
        cone: Field of view.
    """

    box: Annotated[tuple[Triple, Triple], Checked(_corners, CORNERS)] | None = None
    sphere: Ball | None = None
    cone: Cone | None = None

    def contains(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Whether points lie in the region.

        Args:
            points: Points in the base frame, shape (N, 3) [m].

        Returns:
            True for those within, shape (N,).

        Examples:
            >>> table = Region(box=((0.0, 0.0, 0.0), (1.0, 1.0, 0.5)))
            >>> table.contains(np.array([[0.5, 0.5, 0.2], [0.5, 0.5, 0.7]])).tolist()
            [True, False]
        """
        points = np.asarray(points, float)
        within = np.ones(len(points), bool)
        if self.box is not None:
            lower, upper = self.box
            within &= ((lower <= points) & (points <= upper)).all(axis=1)
        if self.sphere is not None:
            distance = np.linalg.norm(points - self.sphere.center, axis=1)
            within &= distance <= self.sphere.radius
        if self.cone is not None:
            within &= self.cone.contains(points)
        return within

    def _check(self) -> None:
        if self.box is None and self.sphere is None and self.cone is None:
            raise ValueError("at least one of box, sphere, cone")


@dataclass(frozen=True)
class RangerSetup(Section):
    """The window in which a laser distance sensor measures.

    Attributes:
        range: Shortest and longest distance [m].
        incidence: Largest angle between the beam and the plane's normal, beyond which
            too little light comes back [rad].
    """

    range: Range = (0.0, 5.0)
    incidence: Annotated[
        float,
        Number(
            "rad",
            above=0.0,
            below=math.pi / 2,
            words="an angle to the normal in rad, above 0 and below 1.57",
        ),
    ] = math.radians(70.0)
