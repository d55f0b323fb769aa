"""What a user states about a calibration beside the robot and the measurements."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "AnchorSetup",
    "CameraSetup",
    "Cone",
    "DistanceSetup",
    "FrameSetup",
    "JointMap",
    "Obstacle",
    "Payload",
    "PlaneSetup",
    "PointSetup",
    "RangerSetup",
    "Region",
    "Setup",
    "SolverSetup",
    "SphereSetup",
    "Triple",
]

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class FrameSetup:
    """The base or the tool frame.

    Attributes:
        xyz: Position [m], a first guess if estimated; None where none was given.
        rpy: URDF fixed-axis angles [rad]; None where none were given.
        estimate: Whether the frame is estimated; None leaves it to the measurement
            model (position and pose estimate both frames, a ranger only the tool).
    """

    xyz: Triple | None = None
    rpy: Triple | None = None
    estimate: bool | None = None


@dataclass(frozen=True)
class PlaneSetup:
    """A plane `normal . p + offset = 0` in the base frame.

    Attributes:
        normal: Normal of any length but zero.
        offset: Offset, in the unit of `normal . p` (m for a unit normal).
        estimate: Whether normal and offset are estimated from these as a first guess.
    """

    normal: Triple
    offset: float
    estimate: bool = True


@dataclass(frozen=True)
class PointSetup:
    """A reference point on the tool or of a board, or a socket that holds a ball.

    Attributes:
        xyz: Place [m], a first guess if estimated; None where none was given. Of a
            point on the tool in the tool frame, of all else in the measuring frame.
        estimate: Whether it is estimated; None leaves it to the measurement model:
            the points that a camera looks at are known, all others are estimated.
    """

    xyz: Triple | None = None
    estimate: bool | None = None


@dataclass(frozen=True)
class SphereSetup:
    """A sphere in the measuring frame.

    Attributes:
        xyz: Center [m], a first guess if estimated; None where none was given.
        radius: Radius [m]; None where none was given.
        estimate: Whether the center is estimated.
        estimate_radius: Whether the radius is; None where it is if none was given.
    """

    xyz: Triple | None = None
    radius: float | None = None
    estimate: bool = True
    estimate_radius: bool | None = None


@dataclass(frozen=True)
class AnchorSetup:
    """A fixed point that distances are measured from: where a draw wire leaves.

    Attributes:
        xyz: Place in the measuring frame [m], a first guess if estimated; None where
            none was given.
        bias: What every reading has too much [m].
        estimate: Whether the place is estimated.
        estimate_bias: Whether the bias is.
    """

    xyz: Triple | None = None
    bias: float = 0.0
    estimate: bool = True
    estimate_bias: bool = False


@dataclass(frozen=True)
class CameraSetup:
    """A pinhole camera with Brown-Conrady distortion.

    Attributes:
        mount: `hand` if the camera is the tool and looks at points of the measuring
            frame, `world` if it stands still and looks at points of the tool.
        focal: Focal lengths f_x, f_y [px].
        center: Principal point c_x, c_y [px].
        distortion: k_1, k_2, p_1, p_2, k_3.
        size: Width and height of the image [px]; None where it has no edge.
        estimate: Whether focal lengths, principal point and distortion are estimated.
    """

    mount: Literal["hand", "world"]
    focal: tuple[float, float]
    center: tuple[float, float]
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    size: tuple[float, float] | None = None
    estimate: bool = False


@dataclass(frozen=True)
class DistanceSetup:
    """A known distance between two points, which counts as a measurement.

    Attributes:
        between: Names of two sockets, spheres or anchors, or of two points of the tool.
        value: Distance [m].
        sigma: Its standard deviation [m].
    """

    between: tuple[str, str]
    value: float
    sigma: float = 1e-4


@dataclass(frozen=True)
class JointMap:
    """How a file column becomes a joint position of the URDF.

    `position = sign * gear * (column + sum_c coupled[c] * column_c) + offset`.

    Attributes:
        joint: URDF joint.
        sign: 1 or -1.
        gear: Gear factor, not zero.
        offset: Offset in the URDF's unit [rad, m].
        coupled: Other file columns that are added, each with its factor.
    """

    joint: str
    sign: int = 1
    gear: float = 1.0
    offset: float = 0.0
    coupled: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Payload:
    """What the robot carries.

    Attributes:
        mass: Mass [kg].
        com: Center of mass in the tip frame [m].
    """

    mass: float
    com: Triple = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class SolverSetup:
    """How the least-squares problem is solved.

    Attributes:
        name: `gauss-newton`, `de` (differential evolution) or `hybrid` (differential
            evolution, then Gauss-Newton from its best member).
        evolution: Options of `solvers.DifferentialEvolution` by name; what is left out
            has its default.
    """

    name: str = "gauss-newton"
    evolution: Mapping[str, str | float] = field(default_factory=dict)


@dataclass(frozen=True)
class Obstacle:
    """Something solid that the robot must not touch.

    Attributes:
        kind: Its shape.
        size: Three edge lengths of a box along x, y and z; the radius of a sphere;
            radius and length of a cylinder, which stands along z [m]. Of a mesh: three
            factors that make its numbers meters.
        mesh: File of a mesh; empty for the other kinds.
        xyz: Position of its origin in the base link of the chain [m]; a box, a sphere
            and a cylinder have it in their middle.
        rpy: URDF fixed-axis angles in the base link [rad].
    """

    kind: Literal["box", "sphere", "cylinder", "mesh"]
    size: tuple[float, ...]
    mesh: str = ""
    xyz: Triple = (0.0, 0.0, 0.0)
    rpy: Triple = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Cone:
    """Field of view of an instrument.

    Attributes:
        apex: Where the instrument stands, in the base frame [m].
        axis: Direction it looks in, of any length but zero.
        angle: Half the opening angle [rad].
        range: Nearest and farthest distance from the apex [m].
    """

    apex: Triple
    axis: Triple
    angle: float
    range: tuple[float, float]

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
class Region:
    """Where the measured point may be, in the base frame.

    Several shapes together mean what they have in common; their surfaces count.

    Attributes:
        box: Lower and upper corner [m].
        sphere: Center and radius [m].
        cone: Field of view.
    """

    box: tuple[Triple, Triple] | None = None
    sphere: tuple[Triple, float] | None = None
    cone: Cone | None = None

    def contains(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Whether points lie in the region.

        Args:
            points: Points in the base frame, shape (N, 3) [m].

        Returns:
            True for those within, shape (N,).

        Example:
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
            center, radius = self.sphere
            within &= np.linalg.norm(points - center, axis=1) <= radius
        if self.cone is not None:
            within &= self.cone.contains(points)
        return within


@dataclass(frozen=True)
class RangerSetup:
    """The window in which a laser ranger measures.

    Attributes:
        range: Shortest and longest distance [m].
        incidence: Largest angle between the beam and the plane's normal, beyond which
            too little light comes back [rad].
    """

    range: tuple[float, float] = (0.0, 5.0)
    incidence: float = math.radians(70.0)


@dataclass(frozen=True)
class Setup:
    """Everything a setup file can state; the defaults are those of an empty file.

    Attributes:
        base: Link at which the chain starts; None for the root link.
        tip: Link at which the chain ends; None for the only leaf.
        model: Measurement model; None to infer it from the columns.
        parameters: Names of the parameterizations, combined in this order.
        learned: Residual model that learns what the parameters leave; None for none.
        base_frame: Pose of the base link in the measuring frame.
        tool_frame: Pose of the tool (target, beam) in the tip frame.
        planes: Planes by the name that rows give as their target.
        targets: Reference points on the tool by name.
        sockets: Sockets that hold a ball, by name.
        spheres: Spheres that are touched, by name.
        anchors: Fixed points that distances are measured from, by name.
        camera: The camera, where there is one.
        distances: Known distances between such points.
        joints: Joint map by file column; empty where columns are URDF joint names.
        gravity: Acceleration of gravity in the base link [m/s^2]; with a base that
            moves against the root of the robot, in the base at zero joint positions.
        payloads: What the robot carries, by name.
        gear_ratios: Joint name or glob to the turns of the motor per turn of the joint
            (rad/m for a joint that slides), where harmonics of the motor are sought.
        fixed: Globs of parameter names that are not estimated.
        bounds: Glob to the largest absolute value [SI], or to (lower, upper).
        prior: Glob to the prior standard deviation about zero [SI].
        noise: Standard deviation by quantity (`position`, `orientation`, `distance`,
            `contact`, `pixel`) used where the file has no sigma columns [SI].
        solver: How the fit is solved.
        loss: How measurements that do not fit count, see `robust.LOSSES`.
        obstacles: What the robot must not touch.
        region: Where the measured point may be; None for anywhere.
        limits: Joint name or glob to the lower and upper position within which
            measurements are planned [rad, m]; they narrow the limits of the URDF.
        ranger: The window in which a laser ranger measures.
        file: Where all this was read from, for messages.
    """

    base: str | None = None
    tip: str | None = None
    model: str | None = None
    parameters: tuple[str, ...] = ("placement",)
    learned: str | None = None
    base_frame: FrameSetup = FrameSetup()
    tool_frame: FrameSetup = FrameSetup()
    planes: Mapping[str, PlaneSetup] = field(default_factory=dict)
    targets: Mapping[str, PointSetup] = field(default_factory=dict)
    sockets: Mapping[str, PointSetup] = field(default_factory=dict)
    spheres: Mapping[str, SphereSetup] = field(default_factory=dict)
    anchors: Mapping[str, AnchorSetup] = field(default_factory=dict)
    camera: CameraSetup | None = None
    distances: tuple[DistanceSetup, ...] = ()
    joints: Mapping[str, JointMap] = field(default_factory=dict)
    gravity: Triple = (0.0, 0.0, -9.81)
    payloads: Mapping[str, Payload] = field(default_factory=dict)
    gear_ratios: Mapping[str, float] = field(default_factory=dict)
    fixed: tuple[str, ...] = ()
    bounds: Mapping[str, float | tuple[float, float]] = field(default_factory=dict)
    prior: Mapping[str, float] = field(default_factory=dict)
    noise: Mapping[str, float] = field(default_factory=dict)
    solver: SolverSetup = SolverSetup()
    loss: str = "auto"
    obstacles: tuple[Obstacle, ...] = ()
    region: Region | None = None
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    ranger: RangerSetup = RangerSetup()
    file: str = field(default="", compare=False)
