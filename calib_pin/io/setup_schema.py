"""What a setup file may contain, for pydantic.

Every check raises a `ValueError` whose message is what is allowed instead. pydantic is
slow to import; import this module where a file is read.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any

from pydantic import (
    AfterValidator,
    Field,
    PlainValidator,
)

from calib_pin.errors import OptionError
from calib_pin.estimation.robust.weights import LOSSES
from calib_pin.estimation.solve import SOLVERS
from calib_pin.io.instrument_schema import (
    AnchorSection,
    CameraSection,
    DistanceSection,
    NoiseSection,
    PlaneSection,
    PointSection,
    SphereSection,
)
from calib_pin.io.schema_values import (
    Angles,
    Flag,
    Number,
    Position,
    Positive,
    Section,
    Text,
    number,
    numbers,
    positive,
)
from calib_pin.io.workspace_schema import (
    REGION,
    Limits,
    ObstacleSection,
    RangerSection,
    RegionSection,
)
from calib_pin.io.yaml_tree import as_number
from calib_pin.measurement_models import MEASUREMENT_MODELS
from calib_pin.observations import PLUS
from calib_pin.parameterizations import PARAMETERIZATIONS
from calib_pin.residual_models import RESIDUAL_MODELS
from calib_pin.setup import (
    AnchorSetup,
    CameraSetup,
    DistanceSetup,
    FrameSetup,
    JointMap,
    Payload,
    PlaneSetup,
    PointSetup,
    RangerSetup,
    Setup,
    SolverSetup,
    SphereSetup,
)
from calib_pin.solvers import DifferentialEvolution

__all__ = ["SetupFile", "known_keys"]

WHOLE = ("population_size", "maxiter")
"""Options that are whole numbers."""

HEAVIEST = 1e5
"""Largest mass of a payload [kg]; more comes from a mistaken unit."""

STRONGEST = 100.0
"""Largest acceleration of gravity [m/s^2]."""


def _nonzero(value: object) -> float:
    plain = number(value)
    if plain == 0.0:
        raise ValueError("a number other than 0")
    return plain


def _mass(value: object) -> float:
    allowed = f"a mass in kg, more than 0 and at most {HEAVIEST:g}"
    try:
        plain = positive(value)
    except ValueError:
        raise ValueError(allowed) from None
    if plain > HEAVIEST:
        raise ValueError(allowed)
    return plain


def _gravity(value: object) -> tuple[float, float, float]:
    allowed = (
        "three finite numbers in m/s^2, such as [0, 0, -9.81], at most "
        f"{STRONGEST:g} long"
    )
    x, y, z = numbers(value, 3, allowed)
    if not math.hypot(x, y, z) <= STRONGEST:
        raise ValueError(allowed)
    return x, y, z


def _solver(value: object) -> str:
    if value not in SOLVERS:
        raise ValueError(", ".join(SOLVERS))
    return str(value)


def _loss(value: object) -> str:
    if value not in LOSSES:
        raise ValueError(", ".join(LOSSES))
    return str(value)


def _evolution(option: str) -> Callable[[object], Any]:
    """Validator of one option of differential evolution, which knows its limits."""

    def check(value: object) -> Any:
        # Numbers in quotes are numbers too, so that no one has to know YAML's rules.
        written = as_number(value) if isinstance(value, str) else None
        plain: Any = value if written is None else written
        if isinstance(plain, float) and plain.is_integer() and option in WHOLE:
            plain = int(plain)
        if isinstance(plain, float) and not math.isfinite(plain):
            raise ValueError("a finite number")
        try:
            DifferentialEvolution(**{option: plain})
        except OptionError as error:
            raise ValueError(error.allowed) from None
        return plain

    return check


def _sign(value: object) -> int:
    plain = number(value)
    if plain not in (1.0, -1.0):
        raise ValueError("1, -1")
    return int(plain)


def _bound(value: object) -> float | tuple[float, float]:
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


def _model(value: object) -> str:
    names = value.split(PLUS) if isinstance(value, str) else []
    known = set(names) <= set(MEASUREMENT_MODELS)
    if not names or not known or len(set(names)) < len(names):
        raise ValueError(
            f"{', '.join(MEASUREMENT_MODELS)}, or several of them with a {PLUS} "
            "between, each at most once"
        )
    return PLUS.join(names)


def _parameterization(value: object) -> str:
    if not isinstance(value, str) or value not in PARAMETERIZATIONS:
        raise ValueError(", ".join(PARAMETERIZATIONS))
    return value


def _learned(value: object) -> str:
    if not isinstance(value, str) or value not in RESIDUAL_MODELS:
        raise ValueError(", ".join(RESIDUAL_MODELS))
    return value


def _distinct(names: list[str]) -> list[str]:
    if not names or len(set(names)) < len(names):
        raise ValueError("at least one name and each at most once")
    return names


Gravity = Annotated[tuple[float, float, float], PlainValidator(_gravity)]
Bound = Annotated[float | tuple[float, float], PlainValidator(_bound)]
Parameterizations = Annotated[
    list[Annotated[str, PlainValidator(_parameterization)]], AfterValidator(_distinct)
]


class FrameSection(Section):
    """`frames.base` or `frames.tool`."""

    xyz: Position | None = None
    rpy: Angles | None = None
    estimate: Flag | None = None


class FramesSection(Section):
    """`frames`."""

    base: FrameSection = FrameSection()
    tool: FrameSection = FrameSection()


class JointSection(Section):
    """A member of `joints`."""

    joint: Text
    sign: Annotated[int, PlainValidator(_sign)] = 1
    gear: Annotated[float, PlainValidator(_nonzero)] = 1.0
    offset: Number = 0.0
    coupled: dict[str, Number] = Field(default_factory=dict)


class PayloadSection(Section):
    """A member of `payloads`."""

    mass: Annotated[float, PlainValidator(_mass)]
    com: Position


class SolverSection(Section):
    """`solver`."""

    name: Annotated[str, PlainValidator(_solver)] = SolverSetup().name
    strategy: Annotated[str, PlainValidator(_evolution("strategy"))] | None = None
    population_size: (
        Annotated[int, PlainValidator(_evolution("population_size"))] | None
    ) = None
    mutation: Annotated[float, PlainValidator(_evolution("mutation"))] | None = None
    recombination: (
        Annotated[float, PlainValidator(_evolution("recombination"))] | None
    ) = None
    maxiter: Annotated[int, PlainValidator(_evolution("maxiter"))] | None = None
    target: Annotated[float, PlainValidator(_evolution("target"))] | None = None
    tol: Annotated[float, PlainValidator(_evolution("tol"))] | None = None
    atol: Annotated[float, PlainValidator(_evolution("atol"))] | None = None
    init: Annotated[str, PlainValidator(_evolution("init"))] | None = None

    def setup(self) -> SolverSetup:
        """The same as plain data."""
        options = self.model_dump(exclude_none=True, exclude={"name"})
        return SolverSetup(self.name, options)


class SetupFile(Section):
    """A whole setup file."""

    base: Text | None = None
    tip: Text | None = None
    model: Annotated[str, PlainValidator(_model)] | None = None
    parameters: Parameterizations = Field(
        default_factory=lambda: list(Setup.parameters)
    )
    learned: Annotated[str, PlainValidator(_learned)] | None = None
    frames: FramesSection = FramesSection()
    planes: dict[str, PlaneSection] = Field(default_factory=dict)
    targets: dict[str, PointSection] = Field(default_factory=dict)
    sockets: dict[str, PointSection] = Field(default_factory=dict)
    spheres: dict[str, SphereSection] = Field(default_factory=dict)
    anchors: dict[str, AnchorSection] = Field(default_factory=dict)
    camera: CameraSection | None = None
    distances: list[DistanceSection] = Field(default_factory=list)
    joints: dict[str, JointSection] = Field(default_factory=dict)
    gravity: Gravity = Setup.gravity
    payloads: dict[str, PayloadSection] = Field(default_factory=dict)
    gear_ratios: dict[str, Annotated[float, PlainValidator(_nonzero)]] = Field(
        default_factory=dict
    )
    fixed: list[Text] = Field(default_factory=list)
    bounds: dict[str, Bound] = Field(default_factory=dict)
    prior: dict[str, Positive] = Field(default_factory=dict)
    noise: NoiseSection = NoiseSection()
    solver: SolverSection = SolverSection()
    loss: Annotated[str, PlainValidator(_loss)] = Setup.loss
    obstacles: list[ObstacleSection] = Field(default_factory=list)
    region: RegionSection | None = None
    limits: dict[str, Limits] = Field(default_factory=dict)
    ranger: RangerSection = RangerSection()

    def setup(self) -> Setup:
        """The same as plain data."""
        return Setup(
            base=self.base,
            tip=self.tip,
            model=self.model,
            parameters=tuple(self.parameters),
            learned=self.learned,
            base_frame=FrameSetup(**dict(self.frames.base)),
            tool_frame=FrameSetup(**dict(self.frames.tool)),
            planes={name: PlaneSetup(**dict(p)) for name, p in self.planes.items()},
            targets={name: PointSetup(**dict(p)) for name, p in self.targets.items()},
            sockets={name: PointSetup(**dict(s)) for name, s in self.sockets.items()},
            spheres={name: SphereSetup(**dict(s)) for name, s in self.spheres.items()},
            anchors={name: AnchorSetup(**dict(a)) for name, a in self.anchors.items()},
            camera=None if self.camera is None else CameraSetup(**dict(self.camera)),
            distances=tuple(DistanceSetup(**dict(d)) for d in self.distances),
            joints={name: JointMap(**dict(j)) for name, j in self.joints.items()},
            gravity=self.gravity,
            payloads={name: Payload(**dict(p)) for name, p in self.payloads.items()},
            gear_ratios=self.gear_ratios,
            fixed=tuple(self.fixed),
            bounds=self.bounds,
            prior=self.prior,
            noise=self.noise.model_dump(exclude_none=True),
            solver=self.solver.setup(),
            loss=self.loss,
            obstacles=tuple(section.setup() for section in self.obstacles),
            region=None if self.region is None else self.region.setup(),
            limits=self.limits,
            ranger=RangerSetup(**dict(self.ranger)),
        )


def known_keys(path: Sequence[str | int]) -> list[str]:
    """The keys that may stand where an unknown one does.

    Args:
        path: Path of the unknown key.
    """
    sections: Mapping[str | int, type[Section]] = {
        "frames": FramesSection if len(path) == 2 else FrameSection,
        "planes": PlaneSection,
        "targets": PointSection,
        "sockets": PointSection,
        "spheres": SphereSection,
        "anchors": AnchorSection,
        "camera": CameraSection,
        "distances": DistanceSection,
        "joints": JointSection,
        "payloads": PayloadSection,
        "noise": NoiseSection,
        "solver": SolverSection,
        "obstacles": ObstacleSection,
        "region": RegionSection,
        "ranger": RangerSection,
    }
    if len(path) == 1:
        return list(SetupFile.model_fields)
    inner = path[0] == "region" and len(path) == 3
    section = REGION[path[1]] if inner else sections[path[0]]
    return list(section.model_fields)
