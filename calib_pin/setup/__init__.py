"""The statements of a user beside the robot and the measurements.

Every key of a setup file is declared here once, with its type, its constraint (which
carries its unit), its default and its meaning. The reader of files, the JSON schema and
the reference in docs/ follow from the declarations.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

from calib_pin.setup.arguments import Brief, settle
from calib_pin.setup.conditions import (
    ConditionSetup,
    DriftSetup,
    Payload,
    ThermalSetup,
)
from calib_pin.setup.constraints import (
    Checked,
    Distinct,
    OrFile,
    Registered,
    Section,
    listed,
)
from calib_pin.setup.fleet import JobSetup, MonteCarloSetup
from calib_pin.setup.population import JointPrior, PopulationPrior
from calib_pin.setup.printing import ReportSetup
from calib_pin.setup.reading import (
    AXES,
    HELD,
    STATED,
    ConvertedSetup,
    OrientationSetup,
    ReadingSetup,
)
from calib_pin.setup.references import (
    WORLD,
    AnchorSetup,
    AngleSetup,
    BoardSetup,
    CameraSetup,
    ChainSetup,
    DistanceSetup,
    Frames,
    FrameSetup,
    PlaneSetup,
    PointSetup,
    SphereSetup,
    ToolSetup,
)
from calib_pin.setup.values import (
    LARGEST_ANGLE,
    Length,
    Number,
    OneOf,
    Pair,
    Positive,
    Text,
    Triple,
    Vector,
    number,
    positive,
)
from calib_pin.setup.workspace import Ball, Cone, Obstacle, RangerSetup, Region

__all__ = [
    "AXES",
    "HELD",
    "STATED",
    "WORLD",
    "AnchorSetup",
    "AngleSetup",
    "Ball",
    "BoardSetup",
    "CameraSetup",
    "ChainSetup",
    "ConditionSetup",
    "Cone",
    "ConvertedSetup",
    "DistanceSetup",
    "DriftSetup",
    "FrameSetup",
    "Frames",
    "JobSetup",
    "JointMap",
    "JointPrior",
    "LimitSetup",
    "MonteCarloSetup",
    "Obstacle",
    "OrientationSetup",
    "Payload",
    "PlaneSetup",
    "PointSetup",
    "PopulationPrior",
    "RangerSetup",
    "ReadingSetup",
    "Region",
    "ReportSetup",
    "RobotSetup",
    "Section",
    "Setup",
    "SolverSetup",
    "SphereSetup",
    "StudySetup",
    "ThermalSetup",
    "ToolSetup",
    "Triple",
]

STRONGEST = 100.0
"""Largest acceleration of gravity [m/s^2]."""


def _bound(value: object) -> float | Pair:
    allowed = "a positive number, or [lower, upper] with lower < upper"
    try:
        if not isinstance(value, list):
            return positive(value)
        lower, upper = map(number, value)
    except ValueError:
        raise ValueError(allowed) from None
    if not lower < upper:
        raise ValueError(allowed)
    return lower, upper


BOUND = {"anyOf": [Positive().schema(), listed({"type": "number"}, 2)], "unit": "SI"}
"""JSON schema of a bound."""

Factor = Annotated[
    float,
    Number(
        least=-1e6,
        most=1e6,
        apart=1e-6,
        words="a number from 1e-6 to 1e6, or the negative of one",
    ),
]


@dataclass(frozen=True)
class JointMap(Section):
    """How a file column becomes a joint position of the URDF.

    `position = sign * gear * (column + sum_c coupled[c] * column_c) + offset`.

    Attributes:
        joint: URDF joint.
        sign: 1 or -1.
        gear: Gear factor, not zero.
        offset: Offset in the URDF's unit [rad, m].
        coupled: Other file columns that are added, each with its factor.
    """

    joint: Text
    sign: Annotated[int, OneOf((1, -1))] = 1
    gear: Factor = 1.0
    offset: Annotated[float, Number("rad, m")] = 0.0
    coupled: Mapping[str, Annotated[float, Number()]] = field(default_factory=dict)


@dataclass(frozen=True)
class SolverSetup:
    """The solver of the least-squares problem.

    Attributes:
        name: `gauss-newton`, `two-step` (alternating least squares), `de`
            (differential evolution) or `hybrid` (differential evolution, then
            Gauss-Newton from its best member).
        evolution: Options of `solvers.DifferentialEvolution` by name; what is left out
            has its default. A file has them beside the name.
    """

    name: str = "gauss-newton"
    evolution: Mapping[str, str | float] = field(default_factory=dict)


@dataclass(frozen=True)
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
    chains: Mapping[str, ChainSetup] = field(default_factory=dict)
    model: Annotated[str, Registered("model")] | None = None
    parameters: Annotated[
        tuple[Annotated[str, Registered("parameters")], ...], Distinct()
    ] = ("placement",)
    learned: Annotated[str, Registered("learned")] | None = None


@dataclass(frozen=True)
class MeasurementSetup(Section):
    """The references of the measurements, and the columns of the joints.

    Attributes:
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
        distances: Known distances between such points and planes.
        angles: Known angles between planes.
        columns: What columns with foreign names are: ours to theirs, which may state
            the unit in square brackets.
        joints: Joint map by file column; empty where columns are URDF joint names.
        encoder_steps: Joint name or glob to the steps of its encoder per turn; offsets
            are then told in steps as well.
        reading: How files are to be read where they are not as their columns say.
    """

    stations: Mapping[str, FrameSetup] = field(default_factory=dict)
    tools: Mapping[str, ToolSetup] = field(default_factory=dict)
    planes: Mapping[str, PlaneSetup] = field(default_factory=dict)
    targets: Mapping[str, PointSetup] = field(default_factory=dict)
    sockets: Mapping[str, PointSetup] = field(default_factory=dict)
    spheres: Mapping[str, SphereSetup] = field(default_factory=dict)
    anchors: Mapping[str, AnchorSetup] = field(default_factory=dict)
    camera: CameraSetup | None = None
    board: BoardSetup | None = None
    distances: tuple[DistanceSetup, ...] = ()
    angles: tuple[AngleSetup, ...] = ()
    columns: Mapping[str, Text] = field(default_factory=dict)
    joints: Mapping[str, JointMap] = field(default_factory=dict)
    encoder_steps: Mapping[str, Annotated[float, Positive()]] = field(
        default_factory=dict
    )
    reading: ReadingSetup = field(default_factory=ReadingSetup)

    @property
    def known(self) -> tuple[DistanceSetup, ...]:
        """Everything that is known of places against one another."""
        return (*self.distances, *self.angles)


@dataclass(frozen=True)
class LimitSetup(Section):
    """Largest errors that the robot may have, for `accept`.

    Attributes:
        position: Of the position, AP [m].
        orientation: Of an angle of the orientation [rad].
        repeatability: Of the repeatability of positions, RP [m].
        distance: Of distances between poses, AD [m].
    """

    position: Annotated[float, Positive("m")] | None = None
    orientation: Annotated[float, Positive("rad")] | None = None
    repeatability: Annotated[float, Positive("m")] | None = None
    distance: Annotated[float, Positive("m")] | None = None


@dataclass(frozen=True)
class FitSetup(Section):
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

    gravity: Annotated[
        Triple,
        Vector(
            3,
            "three finite numbers in m/s^2, such as [0, 0, -9.81], at most "
            f"{STRONGEST:g} long",
            "m/s^2",
            norm=(0.0, STRONGEST),
        ),
    ] = (0.0, 0.0, -9.81)
    payloads: Mapping[str, Payload] = field(default_factory=dict)
    gear_ratios: Mapping[str, Factor] = field(default_factory=dict)
    fixed: tuple[Text, ...] = ()
    bounds: Mapping[str, Annotated[float | Pair, Checked(_bound, BOUND)]] = field(
        default_factory=dict
    )
    prior: Annotated[
        Mapping[str, float] | JointPrior,
        OrFile(
            Mapping[str, Annotated[float, Positive("SI")]],
            "the file of a fleet's prior, or a mapping of names to standard deviations",
        ),
    ] = field(default_factory=dict)
    noise: Mapping[str, Annotated[float, Positive()]] = field(default_factory=dict)
    solver: SolverSetup = SolverSetup()
    loss: Annotated[str, Registered("loss")] = "auto"
    limit: LimitSetup = field(default_factory=LimitSetup)
    report: ReportSetup = field(default_factory=ReportSetup)

    @property
    def prior_by_glob(self) -> Mapping[str, float]:
        """Prior standard deviations about zero by glob; none with a joint one."""
        return {} if isinstance(self.prior, JointPrior) else self.prior

    @property
    def heaviest(self) -> str:
        """Name of the heaviest payload; empty if there is none."""
        return max(self.payloads, key=lambda name: self.payloads[name].mass, default="")


@dataclass(frozen=True)
class PlanSetup(Section):
    """Where the robot may measure.

    Attributes:
        obstacles: Obstacles that the robot must not touch.
        region: Where the measured point may be; None for anywhere.
        limits: Joint name or glob to the lower and upper position within which
            measurements are planned [rad, m]; they narrow the limits of the URDF.
        ranger: The window in which a laser distance sensor measures.
        gauge: How far a gauge that is pushed in reads at most, either way. Simulated
            contacts are then off by as much and have a reading [m].
    """

    obstacles: tuple[Obstacle, ...] = ()
    region: Region | None = None
    limits: Mapping[
        str,
        Annotated[
            Pair,
            Vector(
                2,
                # Degrees would leave a joint as free as it was, without a word.
                "[lower, upper] in rad or m with lower < upper, at most "
                f"{LARGEST_ANGLE:.4g}",
                "rad, m",
                limit=LARGEST_ANGLE,
                rising=True,
            ),
        ],
    ] = field(default_factory=dict)
    ranger: RangerSetup = field(default_factory=RangerSetup)
    gauge: Length | None = None


@dataclass(frozen=True)
class StudySetup(Section):
    """Studies by simulation.

    Attributes:
        monte_carlo: How accurate robots of a type would be, for
            `fleet --monte-carlo`.
    """

    monte_carlo: MonteCarloSetup = field(default_factory=MonteCarloSetup)


@dataclass(frozen=True, repr=False)
class Setup(
    StudySetup, PlanSetup, ConditionSetup, FitSetup, MeasurementSetup, RobotSetup
):
    """Everything a setup file can state; the defaults are those of an empty file.

    Attributes:
        base_frame: Pose of the base link in the measurement frame, from the only
            station unless `stations` states it.
        tool_frame: Pose of the only tool (target, beam) in the tip frame, unless
            `tools` states it.
        file: Where all this was read from, for messages.
    """

    base_frame: FrameSetup = field(default_factory=FrameSetup)
    tool_frame: FrameSetup = field(default_factory=FrameSetup)
    file: str = field(default="", compare=False)

    __repr__ = Brief.__repr__

    def __post_init__(self) -> None:
        """Take what a file might state as well in its types.

        Raises:
            OptionError: If a value cannot be used.
        """
        settle(self)
