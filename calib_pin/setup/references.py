"""References of measurements: frames, planes, points, spheres, cameras."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Annotated, Literal

from calib_pin.setup.constraints import Checked, Section, listed
from calib_pin.setup.values import (
    LARGEST_LENGTH,
    Angles,
    Count,
    Flag,
    Length,
    Number,
    OneOf,
    Pair,
    Position,
    Text,
    Triple,
    Vector,
)

WORLD = "world"
"""Name of the chain of what stands still: targets on posts, in the base link."""

STEEPEST = 1e6
"""Largest length of a normal, and the inverse of the smallest."""

WIDEST = 1e5
"""Largest focal length, image, and coefficient of a distortion [px]."""

BOARDS = {"charuco": 1, "chessboard": 1, "circles": 0}
"""Types of boards, and by how much each row and column has fewer points than cells."""

Distortion = tuple[float, float, float, float, float]


def _between(value: object) -> tuple[str, str]:
    names = value if isinstance(value, list) else []
    text = all(isinstance(name, str) and name.strip() for name in names)
    if not text or len(names) != 2 or names[0] == names[1]:
        raise ValueError(
            "two different names, such as [front/0, front/1] (in quotes if they look "
            "like something else)"
        )
    return names[0], names[1]


Focal = Annotated[
    Pair,
    Vector(
        2,
        "[f_x, f_y], in px, 1 to 100000, such as [1200, 1200]",
        "px",
        least=1.0,
        limit=WIDEST,
    ),
]
Extent = Annotated[
    Pair,
    Vector(
        2, "[width, height], both positive and in px", "px", above=0.0, limit=WIDEST
    ),
]

TWO_NAMES = listed({"type": "string"}, 2) | {"uniqueItems": True}
"""JSON schema of the two ends of a distance."""


@dataclass(frozen=True)
class FrameSetup(Section):
    """The frame of a station or of a tool.

    Attributes:
        xyz: Position [m], a first guess if estimated; None where none was given.
        rpy: URDF fixed-axis angles [rad]; None where none were given.
        estimate: Whether the frame is estimated; None to leave it to the measurement
            model (position and pose estimate both frames, a laser distance sensor
            only the tool).
    """

    xyz: Position | None = None
    rpy: Angles | None = None
    estimate: Flag | None = None


@dataclass(frozen=True)
class ToolSetup(FrameSetup):
    """A tool: its pose in the tip frame, or its known pose on another tool.

    Attributes:
        on: Tool that carries this one, in whose frame the pose is then known; None for
            a tool at the tip.
    """

    on: Text | None = None

    def _check(self) -> None:
        if self.on is not None and self.estimate:
            raise ValueError("estimate: true only without on, whose pose is known")


@dataclass(frozen=True)
class ChainSetup(Section):
    """A chain of the robot's tree.

    Attributes:
        tip: Link at which the chain ends.
        base: Link at which it starts; None for that of the whole setup.
    """

    tip: Text
    base: Text | None = None

    def _check(self) -> None:
        if self.base == self.tip:
            raise ValueError("two different links as base and tip")


@dataclass(frozen=True)
class Frames(Section):
    """The frames at both ends of the chain.

    Attributes:
        base: Pose of the base link in the measurement frame, from the only station
            unless `stations` states it.
        tool: Pose of the only tool (target, beam) in the tip frame, unless `tools`
            states it.
    """

    base: FrameSetup | None = None
    tool: FrameSetup | None = None


@dataclass(frozen=True)
class PlaneSetup(Section):
    """A plane `normal . p + offset = 0` in the base frame.

    Attributes:
        normal: Normal of any length but zero.
        offset: Offset, in the unit of `normal . p` (m for a unit normal).
        estimate: Whether normal and offset are estimated from these as a first guess.
    """

    normal: Annotated[
        Triple,
        Vector(
            3,
            "three finite numbers that are not all 0, such as [0, 0, 1]",
            norm=(1.0 / STEEPEST, STEEPEST),
        ),
    ]
    offset: Annotated[
        float,
        Number(
            "m",
            least=-LARGEST_LENGTH * STEEPEST,
            most=LARGEST_LENGTH * STEEPEST,
            words="the offset f of n . p + f = 0, in m where n has length 1",
        ),
    ]
    estimate: Flag = True


@dataclass(frozen=True)
class PointSetup(Section):
    """A reference point on the tool or of a board, or a socket that holds a ball.

    Attributes:
        xyz: Place [m], a first guess if estimated; None where none was given. Of a
            point on the tool in the tool frame, of all else in the measurement frame.
        estimate: Whether it is estimated; None to leave it to the measurement model:
            the points that a camera looks at are known, all others are estimated.
    """

    xyz: Position | None = None
    estimate: Flag | None = None

    def _check(self) -> None:
        _check_place(self)


@dataclass(frozen=True)
class SphereSetup(Section):
    """A sphere in the measurement frame.

    Attributes:
        xyz: Center [m], a first guess if estimated; None where none was given.
        radius: Radius [m]; None where none was given.
        estimate: Whether the center is estimated.
        estimate_radius: Whether the radius is estimated; None to estimate it if none
            was given.
    """

    xyz: Position | None = None
    radius: Length | None = None
    estimate: Flag = True
    estimate_radius: Flag | None = None

    def _check(self) -> None:
        _check_place(self)
        if self.estimate_radius is False and self.radius is None:
            raise ValueError("estimate_radius: false only together with radius")


@dataclass(frozen=True)
class AnchorSetup(Section):
    """A fixed point that distances are measured from, such as a draw-wire encoder.

    Attributes:
        xyz: Place in the measurement frame [m], a first guess if estimated; None where
            none was given.
        bias: Excess of every reading [m].
        estimate: Whether the place is estimated.
        estimate_bias: Whether the bias is estimated.
    """

    xyz: Position | None = None
    bias: Annotated[
        float,
        Number(
            "m",
            least=-LARGEST_LENGTH,
            most=LARGEST_LENGTH,
            words=f"a length in m, at most {LARGEST_LENGTH:g} either way",
        ),
    ] = 0.0
    estimate: Flag = True
    estimate_bias: Flag = False

    def _check(self) -> None:
        _check_place(self)


def _check_place(section: PointSetup | SphereSetup | AnchorSetup) -> None:
    if section.estimate is False and section.xyz is None:
        raise ValueError("estimate: false only together with xyz")


@dataclass(frozen=True)
class CameraSetup(Section):
    """A pinhole camera with Brown-Conrady distortion.

    Attributes:
        mount: `hand` if the camera is the tool and looks at points of the
            measurement frame, `world` if it stands still and looks at points of the
            tool.
        focal: Focal lengths f_x, f_y [px].
        center: Principal point c_x, c_y [px].
        distortion: k_1, k_2, p_1, p_2, k_3.
        size: Width and height of the image [px]; None where it has no edge.
        estimate: Whether focal lengths, principal point and distortion are estimated.
    """

    mount: Annotated[Literal["hand", "world"], OneOf(("hand", "world"))]
    focal: Focal
    center: Annotated[
        Pair, Vector(2, "[c_x, c_y] in px, such as [639.5, 479.5]", "px", limit=WIDEST)
    ]
    distortion: Annotated[
        Distortion,
        Vector(
            5,
            "[k_1, k_2, p_1, p_2, k_3], or the first two or four of them",
            limit=WIDEST,
            shorter=(2, 4),
        ),
    ] = (0.0, 0.0, 0.0, 0.0, 0.0)
    size: Extent | None = None
    estimate: Flag = False


@dataclass(frozen=True)
class BoardSetup(Section):
    """A flat calibration board.

    Attributes:
        type: `charuco` or `chessboard`, whose points are the inner corners, or
            `circles`, whose points are the centers.
        columns: Squares or circles along x, the direction of a row.
        rows: Squares or circles along y.
        square: Edge of a square, or distance of neighboring centers [m].
    """

    type: Annotated[Literal["charuco", "chessboard", "circles"], OneOf(tuple(BOARDS))]
    columns: Count
    rows: Count
    square: Length

    @property
    def points(self) -> dict[str, PointSetup]:
        """Its known points, numbered row by row from 0, which is the origin."""
        fewer = BOARDS[self.type]
        cells = product(range(self.rows - fewer), range(self.columns - fewer))
        return {
            str(k): PointSetup((self.square * x, self.square * y, 0.0), False)
            for k, (y, x) in enumerate(cells)
        }


@dataclass(frozen=True)
class DistanceSetup(Section):
    """A known distance between two points, which counts as a measurement.

    Attributes:
        between: Names of two sockets, spheres or fixed reference points, or of
            two points of the tool.
        value: Distance [m].
        sigma: Its standard deviation [m].
    """

    between: Annotated[tuple[str, str], Checked(_between, TWO_NAMES)]
    value: Length
    sigma: Length = 1e-4
