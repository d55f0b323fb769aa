"""The schema of setup files, from the declarations of `calib_pin.setup`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any, Self

from calib_pin.errors import OptionError
from calib_pin.estimation.robust.weights import LOSSES
from calib_pin.estimation.solve import SOLVERS
from calib_pin.measurement_models import MEASUREMENT_MODELS
from calib_pin.parameterizations import PARAMETERIZATIONS
from calib_pin.residual_models import RESIDUAL_MODELS
from calib_pin.setup import (
    ConditionSetup,
    FitSetup,
    Frames,
    FrameSetup,
    MeasurementSetup,
    PlanSetup,
    RobotSetup,
    Section,
    Setup,
    SolverSetup,
    StudySetup,
)
from calib_pin.setup.constraints import LENIENT, Constraint, Keys, Names, meanings
from calib_pin.setup.values import Positive
from calib_pin.solvers.differential_evolution import (
    INITS,
    STRATEGIES,
    DifferentialEvolution,
)
from calib_pin.units import as_number

if TYPE_CHECKING:
    from pydantic import TypeAdapter


@dataclass(frozen=True)
class EvolutionOption(Constraint):
    """An option of differential evolution, which knows its limits.

    Attributes:
        name: Field of `DifferentialEvolution`.
        kind: Its type.
    """

    name: str
    kind: str

    def check(self, value: object) -> Any:
        """The option."""
        # Numbers in quotes are numbers too, so that no one has to know YAML's rules.
        written = as_number(value) if isinstance(value, str) else None
        plain: Any = value if written is None else written
        if isinstance(plain, float) and plain.is_integer() and self.kind == "int":
            plain = int(plain)
        if isinstance(plain, float) and not math.isfinite(plain):
            raise ValueError("a finite number")
        try:
            DifferentialEvolution(**{self.name: plain})
        except OptionError as error:
            raise ValueError(error.allowed) from None
        return plain

    def schema(self) -> dict[str, Any]:
        """The names or the type of the option, and its default."""
        kinds = {"int": "integer", "float": "number", "str": "string"}
        known = {"strategy": STRATEGIES, "init": INITS}.get(self.name)
        found = {"enum": list(known)} if known else {"type": kinds[self.kind]}
        default = getattr(DifferentialEvolution, self.name)
        # JSON has no infinity, which here stands for no target.
        return found if default == -math.inf else {**found, "default": default}


def solver_keys() -> dict[str, Constraint]:
    """Keys of `solver`: its name and the options of the evolution."""
    options = fields(DifferentialEvolution)
    evolution = {o.name: EvolutionOption(o.name, str(o.type)) for o in options}
    return {"name": Names(SOLVERS), **evolution}


BLURRED = 1e3
"""Largest standard deviation of a pixel [px]."""


def noise_keys() -> dict[str, Constraint]:
    """Keys of `noise`: the quantities of all measurement models."""
    words = f"a standard deviation in px, at most {BLURRED:g}"
    return {
        q.name: Positive("px", BLURRED, words) if q.unit == "px" else Positive(q.unit)
        for model in MEASUREMENT_MODELS.values()
        for q in model.declaration.quantities
    }


@dataclass(frozen=True)
class FrameKeys(Section):
    """The frames of a setup file.

    Attributes:
        frames: Frames at both ends of the chain: known, or estimated.
    """

    frames: Frames = field(default_factory=Frames)


@dataclass(frozen=True)
class SetupFile(
    StudySetup,
    PlanSetup,
    ConditionSetup,
    FitSetup,
    MeasurementSetup,
    FrameKeys,
    RobotSetup,
):
    """A setup file of calib-pin.

    The keys of a `Setup`, but for two that a file groups otherwise: it has both frames
    under `frames`, and the options of the evolution beside the name of the solver. The
    quantities of `noise` are known here alone.
    """

    noise: Annotated[Mapping[str, float], Keys(noise_keys)] = field(
        default_factory=dict
    )

    solver: Annotated[
        Mapping[str, Any],
        Keys(solver_keys, meanings(SolverSetup) | meanings(DifferentialEvolution)),
    ] = field(default_factory=dict)  # type: ignore[assignment]

    @classmethod
    def of(cls, setup: Setup) -> Self:
        """The file of a setup."""
        ends = (setup.base_frame, setup.tool_frame)
        frames = Frames(*(None if end == FrameSetup() else end for end in ends))
        solver = {"name": setup.solver.name, **setup.solver.evolution}
        return cls(
            **_shared(setup),
            frames=frames,
            solver={} if setup.solver == SolverSetup() else solver,
        )

    def setup(self) -> Setup:
        """The setup of the file."""
        options = dict(self.solver)
        name = options.pop("name", SolverSetup.name)
        return Setup(
            **_shared(self),
            base_frame=self.frames.base or FrameSetup(),
            tool_frame=self.frames.tool or FrameSetup(),
            solver=SolverSetup(name, options),
        )


def _shared(setup: Setup | SetupFile) -> dict[str, Any]:
    """The keys that a setup and its file have alike."""
    names = {f.name for f in fields(Setup)} & {f.name for f in fields(SetupFile)}
    return {name: getattr(setup, name) for name in names - {"solver"}}


@cache
def adapter() -> TypeAdapter[SetupFile]:
    """The reader of setup files that are plain data."""
    from pydantic import TypeAdapter

    return TypeAdapter(SetupFile)


def context(*, lenient: bool = False) -> dict[str, Any]:
    """The validation context: the names that there are.

    Args:
        lenient: Whether unknown keys are passed over.
    """
    return {
        "model": Names(MEASUREMENT_MODELS, joined="+"),
        "parameters": Names(PARAMETERIZATIONS),
        "learned": Names(RESIDUAL_MODELS),
        "loss": Names(LOSSES),
        LENIENT: lenient,
    }


def json_schema() -> dict[str, Any]:
    """The JSON schema of setup files, with the names that there are.

    A number has its `unit` beside its limits.
    """
    names = context()

    def filled(part: Any) -> Any:
        if isinstance(part, list):
            return [filled(item) for item in part]
        if not isinstance(part, dict):
            return part
        part = {key: filled(value) for key, value in part.items() if key != "title"}
        if part.get("default", ...) is None:  # A key that may be left out.
            del part["default"]
        choices = [c for c in part.pop("anyOf", ()) if c != {"type": "null"}]
        if len(choices) == 1:
            part = {**choices[0], **part}
        elif choices:
            part["anyOf"] = choices
        family = part.pop("registered", None)
        return part if family is None else {**names[family].schema(), **part}

    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Setup file of calib-pin",
        **filled(adapter().json_schema()),
    }


def known_keys(path: Sequence[str | int]) -> list[str]:
    """The keys that may stand where an unknown one does.

    Args:
        path: Path of the unknown key.
    """
    schema = json_schema()
    part = schema
    for step in path[:-1]:
        if isinstance(step, int):
            part = part["items"]
        else:
            part = part.get("properties", {}).get(step) or part["additionalProperties"]
        part = resolved(schema, part)
    return list(part["properties"])


def resolved(schema: dict[str, Any], part: dict[str, Any]) -> dict[str, Any]:
    """The definition that a part of the schema refers to, or the part itself."""
    name = str(part.get("$ref", "")).rpartition("/")[2]
    return dict(schema["$defs"][name]) if name else part
