"""References of measurements: frames, planes, points, spheres, cameras."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Annotated, ClassVar, Literal

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
    Positive,
    Text,
    Triple,
    Vector,
    number,
)

WORLD = "world"
"""Name of the chain of what stands still: targets on posts, in the base link."""

STEEPEST = 1e6
"""Largest length of a normal, and the inverse of the smallest."""

WIDEST = 1e5
"""Largest focal length, image, and coefficient of a distortion [px]."""

BOARDS = {"charuco": 1, "chessboard": 1, "circles": 0, "apriltag": 0, "marker": 0}
"""Types of boards, and by how much each row and column has fewer points than cells."""

TAGS = ("apriltag", "marker")
"""Types of boards whose points are the four corners of every tag."""

DICTIONARIES = (
    *(f"DICT_{k}X{k}_{n}" for k in (4, 5, 6, 7) for n in (50, 100, 250, 1000)),
    *("DICT_ARUCO_ORIGINAL", "DICT_APRILTAG_16h5", "DICT_APRILTAG_25h9"),
    *("DICT_APRILTAG_36h10", "DICT_APRILTAG_36h11"),
)
"""Dictionaries of markers, by the names of OpenCV."""

LAST = 999
"""Largest number of a marker in a dictionary."""

MOST_ANGLE = 1.571
"""Largest angle of planes, a right one with the digits that people write [rad]."""

LEAST_ANGLE = 0.02
"""Least angle between planes that may be stated [rad]: that of parallel ones is no
function with a derivative."""

Distortion = tuple[float, float, float, float, float]


def _index(value: object) -> int:
    plain = number(value)
    if not (0 <= plain <= LAST and plain.is_integer()):
        raise ValueError(f"a whole number from 0 to {LAST}")
    return int(plain)


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
    """A flat calibration board, printed as it is seen: x to the right, y down.

    Attributes:
        type: `charuco` or `chessboard`, whose points are the inner corners, `circles`,
            whose points are the centers, or a grid of tags, `apriltag` or `marker`
            (ArUco), whose points are the corners of all tags.
        columns: Squares, circles or tags along x, the direction of a row; 1 by 1 for a
            single tag.
        rows: Squares, circles or tags along y.
        square: Edge of a square or tag (of its black border), or distance of
            neighboring centers [m].
        marker: Edge of the markers in a charuco board [m], which only `detect` needs.
        dictionary: Dictionary of markers or tags; None for DICT_4X4_50, of `apriltag`
            DICT_APRILTAG_36h11.
        gap: Distance between neighboring tags [m]; only for several of them.
        first: Number of the first marker or tag in the dictionary.
        legacy: Whether a charuco board is of OpenCV before 4.6, whose first square is
            white where the number of rows is even.
    """

    type: Annotated[
        Literal["charuco", "chessboard", "circles", "apriltag", "marker"],
        OneOf(tuple(BOARDS)),
    ]
    columns: Count
    rows: Count
    square: Length
    marker: Length | None = None
    dictionary: Annotated[str | None, OneOf(DICTIONARIES)] = None
    gap: Length | None = None
    first: Annotated[
        int, Checked(_index, {"type": "integer", "minimum": 0, "maximum": LAST})
    ] = 0
    legacy: Flag = False

    def _check(self) -> None:
        tags, several = self.type in TAGS, self.columns * self.rows > 1
        if not tags and min(self.columns, self.rows) < 2:
            raise ValueError("2 or more columns and rows, but for apriltag and marker")
        if (self.gap is not None) != (tags and several):
            raise ValueError("gap for several tags (apriltag, marker), and only there")
        if self.marker is not None and self.type != "charuco":
            raise ValueError("marker only for charuco; the edge of a tag is its square")
        if self.marker is not None and self.marker >= self.square:
            raise ValueError("a marker that is smaller than the square")
        if self.legacy and self.type != "charuco":
            raise ValueError("legacy only for charuco")
        if self.dictionary is not None and self.type in ("chessboard", "circles"):
            raise ValueError("dictionary only for charuco, apriltag and marker")

    @property
    def points(self) -> dict[str, PointSetup]:
        """Its known points.

        Corners and centers are numbered row by row from 0, which is the origin. Those
        of tag 7 are 7/0 to 7/3, clockwise from the upper left one; tags are numbered
        row by row, and corner 0 of the first is the origin.
        """
        fewer = BOARDS[self.type]
        cells = product(range(self.rows - fewer), range(self.columns - fewer))
        places: dict[str, tuple[float, float]] = {}
        if self.type in TAGS:
            pitch, edge = self.square + (self.gap or 0.0), self.square
            for k, (row, column) in enumerate(cells, self.first):
                x, y = pitch * column, pitch * row
                around = ((x, y), (x + edge, y), (x + edge, y + edge), (x, y + edge))
                places |= {f"{k}/{n}": corner for n, corner in enumerate(around)}
        else:
            places = {
                str(k): (self.square * x, self.square * y)
                for k, (y, x) in enumerate(cells)
            }
        return {n: PointSetup((x, y, 0.0), False) for n, (x, y) in places.items()}


@dataclass(frozen=True)
class DistanceSetup(Section):
    """A known distance between two points or planes, which counts as a measurement.

    Attributes:
        between: Names of two sockets, spheres, fixed reference points or planes, or of
            two points of the tool. That of a point and a plane is along the normal, as
            is that of two planes, which are parallel, half-way between where both were
            measured.
        value: Distance [m].
        sigma: Its standard deviation [m].
    """

    between: Annotated[tuple[str, str], Checked(_between, TWO_NAMES)]
    value: Length
    sigma: Length = 1e-4

    key: ClassVar[str] = "distances"
    unit: ClassVar[str] = "m"


@dataclass(frozen=True)
class AngleSetup(DistanceSetup):
    """A known angle between two planes, which counts as a measurement.

    Attributes:
        between: Names of two planes.
        value: The smaller of both angles [rad].
        sigma: Its standard deviation [rad].
    """

    value: Annotated[
        float,
        Number(
            "rad",
            least=LEAST_ANGLE,
            most=MOST_ANGLE,
            words=f"an angle in rad from {LEAST_ANGLE} to {MOST_ANGLE}; planes that "
            "are parallel have a distance",
        ),
    ]
    sigma: Annotated[float, Positive("rad", 1.0, "an angle in rad, at most 1")] = 1e-4

    key: ClassVar[str] = "angles"
    unit: ClassVar[str] = "rad"
