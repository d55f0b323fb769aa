"""The statements of a user beside the robot and the measurements.

Every key of a setup file is declared here once, with its type, its limits and their
unit (see `values`), its default and its meaning. The reader of files and the reference
in docs/ follow from the declarations.
"""

from __future__ import annotations

import math
import re
from calendar import monthrange
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field
from itertools import product
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray

from calib_pin.setup.arguments import Brief, settle
from calib_pin.setup.population import JointPrior as JointPrior
from calib_pin.setup.population import PopulationPrior as PopulationPrior
from calib_pin.setup.values import (
    LARGEST_ANGLE,
    LARGEST_ERROR,
    LARGEST_LENGTH,
    LARGEST_TURN,
    MOST,
    REST,
    SMALLEST,
    Check,
    Family,
    OneOf,
    Pair,
    Section,
    Text,
    Triple,
    Value,
    Written,
)

Rules = Iterator[tuple[bool, str]]
"""Whether keys fit together, and what is allowed instead."""


DISTINCT = Check(
    lambda names: 0 < len(names) == len(set(names)),
    "at least one entry, and each at most once",
)
NOT_ZERO = Check(
    lambda factor: abs(factor) >= 1e-6,
    "a number from 1e-6 to 1e6, or the negative of one",
)
DIRECTED = Check(
    lambda vector: math.hypot(*vector) >= 1e-6,
    "three numbers that are not all 0, such as [0, 0, 1]",
)

Length = Annotated[float, Value("m", SMALLEST, LARGEST_LENGTH)]
Span = Annotated[float, Value("m", SMALLEST, 20.0)]
Edge = Annotated[float, Value("m", SMALLEST, 2.0)]
Travel = Annotated[float, Value("m", SMALLEST, 0.1)]
Error = Annotated[float, Value("m", SMALLEST, LARGEST_ERROR)]
Turn = Annotated[float, Value("rad", SMALLEST, LARGEST_TURN)]
Position = Annotated[Triple, Value("m", -LARGEST_LENGTH, LARGEST_LENGTH)]
Angles = Annotated[Triple, Value("rad", -LARGEST_ANGLE, LARGEST_ANGLE)]
Direction = Annotated[Triple, Value("", -1e6, 1e6), DIRECTED]
Range = Annotated[
    Pair, Value("m", 0.0, LARGEST_LENGTH, rising=True, shorter={1: lambda r: (0.0, r)})
]
Factor = Annotated[float, Value("", -1e6, 1e6), NOT_ZERO]
Conversion = Annotated[float, Value("", 1e-6, 1e6)]
Count = Annotated[int, Value("", 1, MOST)]
Many = Annotated[int, Value("", 1, 10_000_000)]
Sigmas = Mapping[str, Annotated[float, Value("SI", SMALLEST)]]


def empty(**metadata: str) -> Any:
    """A field that is an empty mapping by default."""
    return field(default_factory=dict, metadata=metadata)


# --- references of measurements: frames, planes, points, spheres, cameras -----------

WORLD = "world"
"""Name of the chain of what stands still: targets on posts, in the base link."""

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

Distortion = tuple[float, float, float, float, float]


def _more(*numbers: float) -> Sequence[float]:
    return (*numbers, 0.0, 0.0, 0.0)[:5]


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
    estimate: bool | None = None


class ToolSetup(FrameSetup):
    """A tool: its pose in the tip frame, or its known pose on another tool.

    Attributes:
        on: Tool that carries this one, in whose frame the pose is then known; None for
            a tool at the tip.
    """

    on: Text | None = None

    def _rules(self) -> Rules:
        fixed = self.on is None or not self.estimate
        yield fixed, "estimate: true only without on, whose pose is known"


class ChainSetup(Section):
    """A chain of the robot's tree.

    Attributes:
        tip: Link at which the chain ends.
        base: Link at which it starts; None for that of the whole setup.
    """

    tip: Text
    base: Text | None = None

    def _rules(self) -> Rules:
        yield self.base != self.tip, "two different links as base and tip"


class PlaneSetup(Section):
    """A plane `normal . p + offset = 0` in the base frame.

    Attributes:
        normal: Normal of any length but zero.
        offset: Offset, in the unit of `normal . p` (m for a unit normal).
        estimate: Whether normal and offset are estimated from these as a first guess.
    """

    normal: Direction
    offset: Annotated[float, Value("m", -1e8, 1e8)]
    estimate: bool = True


def _placed(at: PointSetup | SphereSetup | AnchorSetup) -> Rules:
    known = at.estimate is not False or at.xyz is not None
    yield known, "estimate: false only together with xyz"


class PointSetup(Section):
    """A reference point on the tool or of a board, or a socket that holds a ball.

    Attributes:
        xyz: Place [m], a first guess if estimated; None where none was given. Of a
            point on the tool in the tool frame, of all else in the measurement frame.
        estimate: Whether it is estimated; None to leave it to the measurement model:
            the points that a camera looks at are known, all others are estimated.
    """

    xyz: Position | None = None
    estimate: bool | None = None
    _rules = _placed


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
    radius: Edge | None = None
    estimate: bool = True
    estimate_radius: bool | None = None

    def _rules(self) -> Rules:
        yield from _placed(self)
        known = self.estimate_radius is not False or self.radius is not None
        yield known, "estimate_radius: false only together with radius"


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
    bias: Annotated[float, Value("m", -LARGEST_LENGTH, LARGEST_LENGTH)] = 0.0
    estimate: bool = True
    estimate_bias: bool = False
    _rules = _placed


class CameraSetup(Section):
    """A pinhole camera with Brown-Conrady distortion.

    Attributes:
        mount: `hand` if the camera is the tool and looks at points of the
            measurement frame, `world` if it stands still and looks at points of the
            tool.
        focal: Focal lengths f_x, f_y [px].
        center: Principal point c_x, c_y [px].
        distortion: k_1, k_2, p_1, p_2, k_3, or the first two or four of them.
        size: Width and height of the image [px]; None where it has no edge.
        estimate: Whether focal lengths, principal point and distortion are estimated.
        file: Only in a setup file: a `camera_info` of ROS, or a file of OpenCV as YAML,
            that states focal, center, distortion and size, as far as they are not
            stated here.
    """

    mount: Literal["hand", "world"]
    focal: Annotated[Pair, Value("px", 1.0, WIDEST)]
    center: Annotated[Pair, Value("px", -WIDEST, WIDEST)]
    distortion: Annotated[
        Distortion, Value("", -WIDEST, WIDEST, shorter=dict.fromkeys((2, 4), _more))
    ] = (0.0, 0.0, 0.0, 0.0, 0.0)
    size: Annotated[Pair, Value("px", SMALLEST, WIDEST)] | None = None
    estimate: bool = False
    file: Text | None = None


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

    type: Literal["charuco", "chessboard", "circles", "apriltag", "marker"]
    columns: Count
    rows: Count
    square: Edge
    marker: Edge | None = None
    dictionary: Annotated[str, OneOf(DICTIONARIES)] | None = None
    gap: Edge | None = None
    first: Annotated[int, Value("", 0, 999)] = 0
    legacy: bool = False

    def _rules(self) -> Rules:
        tags, charuco = self.type in TAGS, self.type == "charuco"
        several, gap = self.columns * self.rows > 1, self.gap is not None
        whole, bare = min(self.columns, self.rows) > 1, self.marker is None
        yield whole or tags, "2 or more columns and rows, but for apriltag and marker"
        yield gap == (tags and several), "gap for several tags (apriltag, marker) alone"
        yield (
            bare or charuco,
            "marker only for charuco; the edge of a tag is its square",
        )
        smaller = (self.marker or 0.0) < self.square
        yield smaller, "a marker that is smaller than the square"
        yield charuco or not self.legacy, "legacy only for charuco"
        named = tags or charuco or self.dictionary is None
        yield named, "dictionary only for charuco, apriltag and marker"

    @property
    def points(self) -> dict[str, PointSetup]:
        """Its known points.

        Corners and centers are numbered row by row from 0, which is the origin. Those
        of tag 7 are 7/0 to 7/3, clockwise from the upper left one; tags are numbered
        row by row, and corner 0 of the first is the origin.
        """
        fewer, tags = BOARDS[self.type], self.type in TAGS
        cells = product(range(self.rows - fewer), range(self.columns - fewer))
        edge, pitch = self.square, self.square + (self.gap or 0.0)
        name, first, shifts = "{}", 0, [(0.0, 0.0)]
        if tags:
            name, first = "{}/{}", self.first
            shifts += [(edge, 0.0), (edge, edge), (0.0, edge)]
        return {
            name.format(k, n): PointSetup((pitch * x + u, pitch * y + v, 0.0), False)
            for k, (y, x) in enumerate(cells, first)
            for n, (u, v) in enumerate(shifts)
        }


class DistanceSetup(Section):
    """A known distance between two points, which counts as a measurement.

    Attributes:
        between: Names of two sockets, spheres or fixed reference points, or of two
            points of the tool.
        value: Distance [m].
        sigma: Its standard deviation [m].
    """

    between: Annotated[tuple[Text, Text], DISTINCT]
    value: Span
    sigma: Error = 1e-4


# --- the reading of files -----------------------------------------------------------

AXES = ("x", "y", "z")
"""Axes of a position, in the order of its values."""

SIGNED = tuple(sign + axis for axis in AXES for sign in ("", "-"))
"""Axes with their directions."""

STATED = {
    "quaternion": ("qx", "qy", "qz", "qw"),
    "rotation-vector": ("rx", "ry", "rz"),
    "roll-pitch-yaw": ("roll", "pitch", "yaw"),
}
"""The ways in which a file may state an orientation, and their columns."""

ORDERS = [a + b + c for a in "xyz" for b in "xyz" for c in "xyz" if a != b != c]

HELD = (
    "wxyz",
    "rotation-vector",
    *(f"{kind}-{order}" for kind in ("extrinsic", "intrinsic") for order in ORDERS),
    *(f"rpy-{order}" for order in ("xzy", "yxz", "yzx", "zxy")),
)
"""Orientations that such columns may hold instead."""


PERMUTED = Check(
    lambda names: sorted(name.removeprefix("-") for name in names) == [*AXES],
    "x, y and z in any order, each with or without a -",
)

PLACE = re.compile(r"(.*:)?0*[1-9][0-9]{0,15}")


def _places(value: Any) -> tuple[str, ...]:
    entries = value if isinstance(value, list | tuple) else [value]
    whole = [int(v) if isinstance(v, float) and v.is_integer() else v for v in entries]
    if not all(PLACE.fullmatch(str(place)) for place in whole):
        raise ValueError("lines, such as [12, 31] or [day1.csv:12]")
    return tuple(map(str, whole))


def _pairs(value: Any) -> tuple[tuple[str, ...], ...]:
    pairs = tuple(map(_places, value)) if isinstance(value, list | tuple) else ((),)
    if any(len(pair) != 2 for pair in pairs):
        raise ValueError("pairs of lines, such as [[12, 13]]")
    return pairs


Places = Annotated[tuple[str, ...], Written(list[int | str], _places)]


class ConvertedSetup(Section):
    """A part of the measurements that was written in another unit.

    Attributes:
        factor: Factor that brings their numbers to the unit of the column.
        lines: First and last line, or all lines one by one if `each` is true; left out
            for all measurements.
        each: Whether `lines` names every line.
        joints: Joints whose positions are converted; left out for the measured lengths.
    """

    factor: Conversion
    lines: Places = ()
    each: bool = False
    joints: tuple[Text, ...] = ()

    def _rules(self) -> Rules:
        fits = self.each or len(self.lines) in (0, 2)
        yield fits, "lines: [first, last], or each: true"


class OrientationSetup(Section):
    """How the columns of an orientation are to be read, where their names are wrong.

    Attributes:
        columns: The columns that it is about, by what their names say; files with
            others are read as they are. Left out for all.
        hold: Their numbers: `wxyz` a quaternion in this order,
            `rotation-vector`, `intrinsic-zyx` or `extrinsic-zyx` angles in the order
            of these rotations about turned or fixed axes, `rpy-yxz` angles about x, y
            and z that are applied about fixed axes in the order y, x, z.
        factor: Factor that brings their angles to the unit of the column.
        inverse: Whether they hold the inverse of the rotation.
    """

    columns: Annotated[str, OneOf(tuple(STATED))] | None = None
    hold: Annotated[str, OneOf(HELD)] | None = None
    factor: Conversion = 1.0
    inverse: bool = False

    def _rules(self) -> Rules:
        fits = (self.hold == "wxyz") == (self.columns == "quaternion")
        yield (
            self.hold is None or (self.columns is not None and fits),
            "with 'hold' also 'columns': quaternion for wxyz, rotation-vector or "
            "roll-pitch-yaw for angles",
        )


class ReadingSetup(Section):
    """How measurement files are to be read where they are not as their columns say.

    All keys together are applied in the order in which they stand here.

    Attributes:
        orientation: How the columns of an orientation are to be read.
        inverted: Whether poses are those of the measurement frame in the tool.
        exchanged: Pairs of lines whose joint positions are exchanged.
        converted: Measurements in another unit.
        reversed: Whether the joint positions of every file stand in reversed order.
        shift: Lines by which the joint positions of a measurement stand below it.
        shift_configurations: The same by configurations: lines in turn at the same
            joint positions, those of an image say, go together.
        shift_from: Lines of files from which on these shifts count, as where a line was
            lost in some of the columns; those before stay as they are.
        lag: Joint name to the part of its last motion that it had still before it when
            it was measured.
        axes: What stands in the columns x, y and z of a position: `[y, x, z]` says
            that the first two are exchanged, `-z` that an axis is negated.
        scale: Factor of all measured lengths.
        opposite: Whether deviations of contacts have the opposite sign.
        drift: Displacement of measured positions, or of distances (one number), from
            the first to the last line of all files, which is taken out [m].
        moved: Lines from which on the instrument stood elsewhere.
        remounted: Lines from which on the tool was mounted elsewhere.
        without: Lines that are left out.
        sigmas: Whether the standard deviations of the files count.
    """

    orientation: OrientationSetup | None = None
    inverted: bool = False
    exchanged: Annotated[
        tuple[tuple[str, ...], ...], Written(list[tuple[int | str, int | str]], _pairs)
    ] = ()
    converted: tuple[ConvertedSetup, ...] = ()
    reversed: bool = False
    shift: Annotated[int, Value("", -1e6, 1e6)] = 0
    shift_configurations: Annotated[int, Value("", -1e6, 1e6)] = 0
    shift_from: Places = ()
    lag: Mapping[str, Annotated[float, Value("", -1.0, 1.0)]] = empty()
    axes: Annotated[tuple[Annotated[str, OneOf(SIGNED)], ...], PERMUTED] = AXES
    scale: Conversion = 1.0
    opposite: bool = False
    drift: Annotated[
        Triple,
        Value("m", -LARGEST_LENGTH, LARGEST_LENGTH, shorter={1: lambda d: (d, 0, 0)}),
    ] = (0.0, 0.0, 0.0)
    moved: Places = ()
    remounted: Places = ()
    without: Places = ()
    sigmas: bool = True


# --- conditions, payloads, printed reports ------------------------------------------

Temperature = Annotated[float, Value("degC", -100.0, 200.0)]
"""A temperature that a robot can have."""

LONGEST = 80
"""Letters of an entry, which have to fit beside its name on one page."""

DATE = re.compile(r"([12][0-9]{3})-([0-9]{2})-([0-9]{2})")


def _is_date(value: str) -> bool:
    match = DATE.fullmatch(value)
    year, month, day = map(int, match.groups()) if match else (1, 0, 0)
    return 1 <= month <= 12 and 1 <= day <= monthrange(year, month)[1]


PRINTED = Check(
    lambda value: value.isprintable() and len(value) <= LONGEST,
    f"text of at most {LONGEST} printable letters",
)
DAY = Check(_is_date, "a date, such as 2026-11-23")
Entry = Annotated[str, PRINTED]
Date = Annotated[str, DAY]


class Payload(Section):
    """A payload of the robot.

    Attributes:
        mass: Mass [kg].
        com: Center of mass in the tip frame [m].
    """

    mass: Annotated[float, Value("kg", SMALLEST, 1e5)]
    com: Annotated[Triple, Value("m", -10.0, 10.0)]


class ThermalSetup(Section):
    """How links grow with the temperature: for the parameters `thermal`, `warm-up`.

    Attributes:
        reference: Temperature at which the geometry holds [degC]; None for the mean of
            the measurements.
        switched_on: Times since which the robot grows warm [s]; empty for that of the
            first measurement.
        warm_up_time: Time in which it covers 63 % of the way from cold to warm [s];
            None for that which suits the measurements best.
    """

    reference: Temperature | None = None
    switched_on: tuple[Annotated[float, Value("s")], ...] = ()
    warm_up_time: Annotated[float, Value("s", SMALLEST)] | None = None


class DriftSetup(Section):
    """How instruments drift, for the parameters `instrument-drift`.

    What is not stated is found in the measurements.

    Attributes:
        spans: First and last time between which an instrument drifts [s], by the name
            of its station; `base` is that of the only one.
        shift: Standard deviation of what it has shifted by then along each axis [m]; 0
            where it does not shift.
        turn: The same of its turn about each axis [rad].
    """

    spans: Mapping[str, Annotated[Pair, Value("s", rising=True)]] = empty()
    shift: Annotated[float, Value("m", 0.0, LARGEST_ERROR)] | None = None
    turn: Annotated[float, Value("rad", 0.0, LARGEST_TURN)] | None = None


class ReportSetup(Section):
    """Entries of a printed report; what is left out is filled in by hand.

    Attributes:
        serial_number: Serial number of the robot.
        customer: For whom it was measured.
        operator: Who measured.
        instrument: The measuring instrument.
        temperature: Temperature of the robot [degC].
        load: Load on the flange at an acceptance test.
        speed: Speed of an acceptance test.
        date: Day of the report, year-month-day; None for today.
    """

    serial_number: Entry = ""
    customer: Entry = ""
    operator: Entry = ""
    instrument: Entry = ""
    temperature: Temperature | None = None
    load: Entry = ""
    speed: Entry = ""
    date: Date | None = None


# --- where the robot may measure ----------------------------------------------------


CORNERS = Check(
    lambda box: all(a < b for a, b in zip(*box, strict=True)),
    "[lower, upper], two corners such as [[0, 0, 0], [1, 0.5, 1]]",
)
ORDERED = Check(lambda limits: limits[0] <= limits[1], "[lower, upper] in rad or m")


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

    box: Annotated[Triple, Value("m", SMALLEST, LARGEST_LENGTH)] | None = None
    sphere: Length | None = None
    cylinder: Annotated[Pair, Value("m", SMALLEST, LARGEST_LENGTH)] | None = None
    mesh: Text | None = None
    scale: (
        Annotated[Triple, Value("", SMALLEST, shorter={1: lambda s: (s, s, s)})] | None
    ) = None
    xyz: Position = (0.0, 0.0, 0.0)
    rpy: Angles = (0.0, 0.0, 0.0)

    @property
    def kind(self) -> str:
        """The name of its shape."""
        return next(kind for kind in SHAPES if getattr(self, kind) is not None)

    def _rules(self) -> Rules:
        count = sum(getattr(self, kind) is not None for kind in SHAPES)
        yield count == 1, f"exactly one of {', '.join(SHAPES)}"
        scaled = self.scale is not None
        yield bool(self.mesh) or not scaled, "a scale only together with a mesh"


SHAPES = ("box", "sphere", "cylinder", "mesh")
"""Shapes of obstacles, each a key of one."""


class Cone(Section):
    """Field of view of an instrument.

    Attributes:
        apex: Where the instrument stands, in the base frame [m].
        axis: Direction it looks in, of any length but zero.
        angle: Half the opening angle [rad].
        range: Nearest and farthest distance from the apex [m].
    """

    apex: Position
    axis: Direction
    angle: Annotated[float, Value("rad", SMALLEST, math.pi)]
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


class Ball(Section):
    """The inside of a sphere.

    Attributes:
        center: Center in the base frame [m].
        radius: Radius [m].
    """

    center: Position
    radius: Length


class Region(Section):
    """Where the measured point may be, in the base frame.

    Several shapes together mean what they have in common; their surfaces count.

    Attributes:
        box: Lower and upper corner [m].
        sphere: Inside of a sphere.
        cone: Field of view.
    """

    box: Annotated[tuple[Position, Position], CORNERS] | None = None
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

    def _rules(self) -> Rules:
        yield (
            any((self.box, self.sphere, self.cone)),
            ("at least one of box, sphere, cone"),
        )


class RangerSetup(Section):
    """The window in which a laser distance sensor measures.

    Attributes:
        range: Shortest and longest distance [m].
        incidence: Largest angle between the beam and the plane's normal, beyond which
            too little light comes back [rad].
    """

    range: Range = (0.0, 5.0)
    incidence: Annotated[float, Value("rad", SMALLEST, 1.57)] = math.radians(70.0)


# --- the robot, the fit, studies ----------------------------------------------------

Bound = (
    Annotated[float, Value("SI", SMALLEST)] | Annotated[Pair, Value("SI", rising=True)]
)
"""The largest absolute value, or the lower and the upper limit."""


class MonteCarloSetup(Section):
    """A study of simulated robots, whose instruments stand where the setup says.

    Attributes:
        robot: URDF or xacro file, bundled robot, or example:NAME.
        robots: Number of simulated robots.
        configurations: Numbers of configurations that are measured of each.
        plan: CSV file with configurations, of which the first ones are measured; None
            for random ones.
        parameters: Parameterizations of the errors that the robots have; empty for
            those that are fitted.
        errors: Glob to the standard deviation of true errors [SI]; where none applies
            it is the expected size, 1 mm and 1 mrad.
        repeats: Readings per configuration.
    """

    robot: Text | None = None
    robots: Many = 200
    configurations: Annotated[tuple[Many, ...], DISTINCT] = (12, 20, 30, 50)
    plan: Text | None = None
    parameters: Annotated[tuple[str, ...], Family("parameters")] = ()
    errors: Sigmas = field(default_factory=dict)
    repeats: Many = 1


class JointMap(Section):
    """How a file column becomes a joint position of the URDF.

    `position = sign * gear * (column + sum_c coupled[c] * column_c) + offset`.

    Attributes:
        joint: URDF joint.
        sign: 1 or -1.
        gear: Gear factor, not zero.
        offset: Offset in the URDF's unit [rad, m].
        coupled: Other file columns that are added before sign and gear, each with its
            factor.
    """

    joint: Text
    sign: Annotated[int, Value(), OneOf((1, -1))] = 1
    gear: Factor = 1.0
    offset: Annotated[float, Value("rad, m")] = 0.0
    coupled: Mapping[str, Annotated[float, Value()]] = empty()


def _whole(value: float) -> float:
    return int(value) if value.is_integer() else value


SOLVERS = ("gauss-newton", "two-step", "de", "hybrid")
"""Names of the solvers."""

LOSSES = ("auto", "squared", "gnc")
"""Names of the losses."""


class SolverSetup(Section):
    """The solver of the least-squares problem.

    Attributes:
        name: `gauss-newton`, `two-step` (alternating least squares), `de`
            (differential evolution) or `hybrid` (differential evolution, then
            Gauss-Newton from its best member).
        evolution: Options of `solvers.DifferentialEvolution` by name; what is left out
            has its default. A file has them beside the name.
    """

    name: Annotated[str, Family("solver")] = "gauss-newton"
    evolution: Mapping[str, Annotated[float, Value(), _whole] | str] = empty(key=REST)


class LimitSetup(Section):
    """Largest errors that the robot may have, for `accept`.

    Attributes:
        position: Of the position, AP [m].
        orientation: Of an angle of the orientation [rad].
        repeatability: Of the repeatability of positions, RP [m].
        distance: Of distances between poses, AD [m].
    """

    position: Error | None = None
    orientation: Turn | None = None
    repeatability: Error | None = None
    distance: Error | None = None


class RobotSetup(Section):
    """The chain, and the errors that it is thought to have.

    Attributes:
        base: Link at which the chain starts; None for the root link.
        tip: Link at which the chain ends; None for the only leaf.
        chains: Further chains of the tree by the name that measurements give; a name
            that is not here is that of a link, the tip.
        model: Measurement model; None to infer it from the columns.
        parameters: Names of the parameterizations, combined in this order.
        learned: Residual model, learned from the remaining errors; None for none.
    """

    base: Text | None = None
    tip: Text | None = None
    chains: Mapping[str, ChainSetup] = empty()
    model: Annotated[str, Family("model", "+")] | None = None
    parameters: Annotated[tuple[str, ...], Family("parameters")] = ("placement",)
    learned: Annotated[str, Family("learned")] | None = None


class MeasurementSetup(RobotSetup):
    """The references of the measurements, and the columns of the joints.

    Attributes:
        base_frame: Pose of the base link in the measurement frame, from the only
            station unless `stations` states it.
        tool_frame: Pose of the only tool (target, beam) in the tip frame, unless
            `tools` states it.
        stations: Where an instrument stood, by the name that measurements give: each
            is a pose of the base link in the measurement frame.
        tools: Tools by the name that measurements give.
        planes: Planes by the name that measurements give as their target.
        targets: Reference points on the tool by name.
        sockets: Sockets that hold a ball, by name.
        spheres: Spheres that are touched, by name.
        anchors: Fixed points that distances are measured from, by name.
        camera: The camera, where there is one.
        board: The board that it looks at, instead of targets one by one: they are
            known, and named by their numbers, 0 1 2 ..., row by row.
        distances: Known distances between such points.
        columns: What columns with foreign names are: ours to theirs, which may state
            the unit in square brackets.
        joints: Joint map by file column; empty where columns are URDF joint names.
        encoder_steps: Joint name or glob to the steps of its encoder per turn; offsets
            are then told in steps as well.
        reading: How files are to be read where they are not as their columns say.
    """

    base_frame: FrameSetup = field(
        default=FrameSetup(), metadata={"key": "frames.base"}
    )
    tool_frame: FrameSetup = field(
        default=FrameSetup(), metadata={"key": "frames.tool"}
    )
    stations: Mapping[str, FrameSetup] = empty()
    tools: Mapping[str, ToolSetup] = empty()
    planes: Mapping[str, PlaneSetup] = empty()
    targets: Mapping[str, PointSetup] = empty()
    sockets: Mapping[str, PointSetup] = empty()
    spheres: Mapping[str, SphereSetup] = empty()
    anchors: Mapping[str, AnchorSetup] = empty()
    camera: CameraSetup | None = None
    board: BoardSetup | None = None
    distances: tuple[DistanceSetup, ...] = ()
    columns: Mapping[str, Text] = empty()
    joints: Mapping[str, JointMap] = empty()
    encoder_steps: Mapping[str, Annotated[float, Value("", SMALLEST)]] = empty()
    reading: ReadingSetup = ReadingSetup()


class FitSetup(MeasurementSetup):
    """Prior knowledge of the robot and its parameters, and the solver.

    Attributes:
        gravity: Acceleration of gravity in the base link [m/s^2]; with a base that
            moves against the root of the robot, in the base at zero joint positions.
        payloads: Payloads by name.
        gear_ratios: Joint name or glob to the turns of the motor per turn of the joint
            (rad/m for a prismatic joint), where harmonics of the motor are sought.
        fixed: Globs of parameter names that are not estimated.
        bounds: Glob to the largest absolute value [SI], or to (lower, upper).
        prior: Glob to the prior standard deviation about zero [SI], or the file of a
            prior that robots of the same type have given, relative to this file; that
            holds for all errors of the robot.
        noise: Standard deviation by quantity (`position`, `orientation`, `distance`,
            `contact`, `pixel`) used where the file has no sigma columns [SI].
        solver: Solver of the fit, and its options.
        loss: Loss function, which says how much outliers count.
        limit: Errors that the robot may have.
        report: Entries of printed reports.
    """

    gravity: Annotated[Triple, Value("m/s^2", -100.0, 100.0)] = (0.0, 0.0, -9.81)
    payloads: Mapping[str, Payload] = empty()
    gear_ratios: Mapping[str, Factor] = empty()
    fixed: tuple[Text, ...] = ()
    bounds: Mapping[str, Bound] = empty()
    prior: Sigmas | JointPrior = field(default_factory=dict)
    noise: Mapping[str, Annotated[float, Value("SI, px", SMALLEST, 1e3)]] = empty()
    solver: SolverSetup = SolverSetup()
    loss: Annotated[str, Family("loss")] = "auto"
    limit: LimitSetup = LimitSetup()
    report: ReportSetup = ReportSetup()

    @property
    def prior_by_glob(self) -> Mapping[str, float]:
        """Prior standard deviations about zero by glob; none with a joint one."""
        return {} if isinstance(self.prior, JointPrior) else self.prior

    @property
    def heaviest(self) -> str:
        """Name of the heaviest payload; empty if there is none."""
        return max(self.payloads, key=lambda name: self.payloads[name].mass, default="")


class Setup(FitSetup):
    """Everything a setup file can state; the defaults are those of an empty file.

    Attributes:
        thermal: How links grow with the temperature.
        drift: How instruments drift in the course of time.
        obstacles: Obstacles that the robot must not touch.
        region: Where the measured point may be; None for anywhere.
        limits: Joint name or glob to the lower and upper position within which
            measurements are planned [rad, m]; they narrow the limits of the URDF.
        ranger: The window in which a laser distance sensor measures.
        gauge: How far a gauge that is pushed in reads at most, either way. Simulated
            contacts are then off by as much and have a reading [m].
        monte_carlo: How accurate robots of a type would be, for
            `fleet --monte-carlo`.
        file: Where all this was read from, for messages.
    """

    thermal: ThermalSetup = ThermalSetup()
    drift: DriftSetup = DriftSetup()
    obstacles: tuple[Obstacle, ...] = ()
    region: Region | None = None
    limits: Mapping[
        str, Annotated[Pair, Value("rad, m", -LARGEST_ANGLE, LARGEST_ANGLE), ORDERED]
    ] = empty()
    ranger: RangerSetup = RangerSetup()
    gauge: Travel | None = None
    monte_carlo: MonteCarloSetup = MonteCarloSetup()
    file: str = field(default="", compare=False, metadata={"key": None})

    __repr__ = Brief.__repr__

    def __post_init__(self) -> None:
        """Take what a file might state as well in its types.

        Raises:
            OptionError: If a value cannot be used.
        """
        settle(self)
