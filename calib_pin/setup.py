"""What a user states about a calibration beside the robot and the measurements."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

__all__ = ["FrameSetup", "JointMap", "PlaneSetup", "Setup", "SolverSetup"]

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
class Setup:
    """Everything a setup file can state; the defaults are those of an empty file.

    Attributes:
        base: Link at which the chain starts; None for the root link.
        tip: Link at which the chain ends; None for the only leaf.
        model: Measurement model; None to infer it from the columns.
        parameters: Names of the parameterizations, combined in this order.
        base_frame: Pose of the base link in the measuring frame.
        tool_frame: Pose of the tool (target, beam) in the tip frame.
        planes: Planes by the name that rows give as their target.
        joints: Joint map by file column; empty where columns are URDF joint names.
        fixed: Globs of parameter names that are not estimated.
        bounds: Glob to the largest absolute value [SI], or to (lower, upper).
        prior: Glob to the prior standard deviation about zero [SI].
        noise: Standard deviation by quantity (`position`, `orientation`, `distance`)
            used where the file has no sigma columns [SI].
        solver: How the fit is solved.
        file: Where all this was read from, for messages.
    """

    base: str | None = None
    tip: str | None = None
    model: str | None = None
    parameters: tuple[str, ...] = ("placement",)
    base_frame: FrameSetup = FrameSetup()
    tool_frame: FrameSetup = FrameSetup()
    planes: Mapping[str, PlaneSetup] = field(default_factory=dict)
    joints: Mapping[str, JointMap] = field(default_factory=dict)
    fixed: tuple[str, ...] = ()
    bounds: Mapping[str, float | tuple[float, float]] = field(default_factory=dict)
    prior: Mapping[str, float] = field(default_factory=dict)
    noise: Mapping[str, float] = field(default_factory=dict)
    solver: SolverSetup = SolverSetup()
    file: str = field(default="", compare=False)
