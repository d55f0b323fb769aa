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
    BaseModel,
    ConfigDict,
    Field,
    PlainValidator,
    model_validator,
)

from calib_pin.errors import OptionError
from calib_pin.io.columns import ANGLE, LENGTH
from calib_pin.io.yaml_tree import as_number
from calib_pin.measurement_models import MEASUREMENT_MODELS
from calib_pin.parameterizations import PARAMETERIZATIONS
from calib_pin.setup import FrameSetup, JointMap, PlaneSetup, Setup, SolverSetup
from calib_pin.solve import SOLVERS
from calib_pin.solvers import DifferentialEvolution

__all__ = ["LATER", "SetupFile", "known_keys"]

LATER = ("targets", "distances", "gravity", "payloads", "obstacles", "region")
"""Documented keys that this version does not know yet."""

SMALLEST = 1e-12
"""Smallest standard deviation that can be meant [m, rad]."""

WHOLE = ("population_size", "maxiter")
"""Options that are whole numbers."""

STEEPEST = 1e6
"""Largest length of a normal, and the inverse of the smallest."""


def _number(value: object) -> float:
    # Numbers in quotes are numbers too, so that no one has to know YAML's rules.
    number = as_number(value) if isinstance(value, str) else value
    if isinstance(number, bool) or not isinstance(number, float | int):
        raise ValueError("a number")
    try:
        number = float(number)
    except OverflowError:  # A JSON file may hold integers of any length.
        number = math.inf
    if not math.isfinite(number):
        raise ValueError("a finite number")
    return number


def _positive(value: object) -> float:
    number = _number(value)
    if number <= 0.0:
        raise ValueError("a positive number")
    if number < SMALLEST:
        raise ValueError(f"a number of at least {SMALLEST:g}")
    return number


def _nonzero(value: object) -> float:
    number = _number(value)
    if number == 0.0:
        raise ValueError("a number other than 0")
    return number


def _solver(value: object) -> str:
    if value not in SOLVERS:
        raise ValueError(", ".join(SOLVERS))
    return str(value)


def _evolution(option: str) -> Callable[[object], Any]:
    """Validator of one option of differential evolution, which knows its limits."""

    def check(value: object) -> Any:
        # Numbers in quotes are numbers too, so that no one has to know YAML's rules.
        number = as_number(value) if isinstance(value, str) else None
        plain: Any = value if number is None else number
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
    number = _number(value)
    if number not in (1.0, -1.0):
        raise ValueError("1, -1")
    return int(number)


def _text(value: object) -> str:
    if not isinstance(value, str) or not value.strip():
        raise ValueError("text (in quotes if it looks like something else)")
    return value


def _flag(value: object) -> bool:
    if not isinstance(value, bool):
        raise ValueError("true, false")
    return value


def _numbers(value: object, allowed: str) -> tuple[float, float, float]:
    if not isinstance(value, list) or len(value) != 3:
        raise ValueError(allowed)
    try:
        x, y, z = map(_number, value)
    except ValueError:
        raise ValueError(allowed) from None
    return x, y, z


def _position(value: object) -> tuple[float, float, float]:
    allowed = "three finite numbers in m, such as [0, 0, 0.1]"
    position = _numbers(value, allowed)
    if max(map(abs, position)) > LENGTH.largest:
        raise ValueError(allowed)
    return position


def _angles(value: object) -> tuple[float, float, float]:
    allowed = "three finite numbers in rad, such as [0, 0, 1.57]"
    angles = _numbers(value, allowed)
    if max(map(abs, angles)) > ANGLE.largest:
        raise ValueError(allowed)
    return angles


def _normal(value: object) -> tuple[float, float, float]:
    allowed = "three finite numbers that are not all 0, such as [0, 0, 1]"
    normal = _numbers(value, allowed)
    if not 1.0 / STEEPEST <= math.hypot(*normal) <= STEEPEST:
        raise ValueError(allowed)
    return normal


def _offset(value: object) -> float:
    number = _number(value)
    if abs(number) > LENGTH.largest * STEEPEST:
        raise ValueError("the offset f of n . p + f = 0, in m where n has length 1")
    return number


def _bound(value: object) -> float | tuple[float, float]:
    allowed = "a positive number, or [lower, upper] with lower < upper"
    try:
        if not isinstance(value, list):
            return _positive(value)
        lower, upper = map(_number, value)
    except ValueError:
        raise ValueError(allowed) from None
    if not lower < upper:
        raise ValueError(allowed)
    return lower, upper


def _model(value: object) -> str:
    if not isinstance(value, str) or value not in MEASUREMENT_MODELS:
        raise ValueError(", ".join(MEASUREMENT_MODELS))
    return value


def _parameterization(value: object) -> str:
    if not isinstance(value, str) or value not in PARAMETERIZATIONS:
        raise ValueError(", ".join(PARAMETERIZATIONS))
    return value


def _distinct(names: list[str]) -> list[str]:
    if not names or len(set(names)) < len(names):
        raise ValueError("at least one name and each at most once")
    return names


Number = Annotated[float, PlainValidator(_number)]
Positive = Annotated[float, PlainValidator(_positive)]
Text = Annotated[str, PlainValidator(_text)]
Flag = Annotated[bool, PlainValidator(_flag)]
Position = Annotated[tuple[float, float, float], PlainValidator(_position)]
Angles = Annotated[tuple[float, float, float], PlainValidator(_angles)]
Normal = Annotated[tuple[float, float, float], PlainValidator(_normal)]
Bound = Annotated[float | tuple[float, float], PlainValidator(_bound)]
Parameterizations = Annotated[
    list[Annotated[str, PlainValidator(_parameterization)]], AfterValidator(_distinct)
]


class _Section(BaseModel):
    """A mapping with known keys; a key without a value counts as not written."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _drop_empty(cls, data: Any) -> Any:
        if not isinstance(data, Mapping):
            return data
        return {
            key: value
            for key, value in data.items()
            if value is not None or key not in cls.model_fields
        }


class FrameSection(_Section):
    """`frames.base` or `frames.tool`."""

    xyz: Position | None = None
    rpy: Angles | None = None
    estimate: Flag | None = None


class FramesSection(_Section):
    """`frames`."""

    base: FrameSection = FrameSection()
    tool: FrameSection = FrameSection()


class PlaneSection(_Section):
    """A member of `planes`."""

    normal: Normal
    offset: Annotated[float, PlainValidator(_offset)]
    estimate: Flag = True


class JointSection(_Section):
    """A member of `joints`."""

    joint: Text
    sign: Annotated[int, PlainValidator(_sign)] = 1
    gear: Annotated[float, PlainValidator(_nonzero)] = 1.0
    offset: Number = 0.0
    coupled: dict[str, Number] = Field(default_factory=dict)


class NoiseSection(_Section):
    """`noise`."""

    position: Positive | None = None
    orientation: Positive | None = None
    distance: Positive | None = None


class SolverSection(_Section):
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


class SetupFile(_Section):
    """A whole setup file."""

    base: Text | None = None
    tip: Text | None = None
    model: Annotated[str, PlainValidator(_model)] | None = None
    parameters: Parameterizations = list(Setup().parameters)
    frames: FramesSection = FramesSection()
    planes: dict[str, PlaneSection] = Field(default_factory=dict)
    joints: dict[str, JointSection] = Field(default_factory=dict)
    fixed: list[Text] = Field(default_factory=list)
    bounds: dict[str, Bound] = Field(default_factory=dict)
    prior: dict[str, Positive] = Field(default_factory=dict)
    noise: NoiseSection = NoiseSection()
    solver: SolverSection = SolverSection()

    def setup(self) -> Setup:
        """The same as plain data."""
        return Setup(
            base=self.base,
            tip=self.tip,
            model=self.model,
            parameters=tuple(self.parameters),
            base_frame=FrameSetup(**dict(self.frames.base)),
            tool_frame=FrameSetup(**dict(self.frames.tool)),
            planes={name: PlaneSetup(**dict(p)) for name, p in self.planes.items()},
            joints={name: JointMap(**dict(j)) for name, j in self.joints.items()},
            fixed=tuple(self.fixed),
            bounds=self.bounds,
            prior=self.prior,
            noise=self.noise.model_dump(exclude_none=True),
            solver=self.solver.setup(),
        )


def known_keys(path: Sequence[str | int]) -> list[str]:
    """The keys that may stand where an unknown one does.

    Args:
        path: Path of the unknown key.
    """
    sections: Mapping[str | int, type[_Section]] = {
        "frames": FramesSection if len(path) == 2 else FrameSection,
        "planes": PlaneSection,
        "joints": JointSection,
        "noise": NoiseSection,
        "solver": SolverSection,
    }
    section = SetupFile if len(path) == 1 else sections[path[0]]
    return list(section.model_fields)
