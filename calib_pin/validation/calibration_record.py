"""A calibration as its file tells of it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from calib_pin.estimation.evidence import TRUSTED
from calib_pin.validation.result import (
    CalibratedModel,
    CoupledGroup,
    ParameterEstimate,
    QuantityErrors,
)

__all__ = ["CalibrationRecord"]

DESCRIBED = 1.2
"""Errors left of a fit, in stated standard deviations, up to which they are noise."""

ORIENTED = ("orientation", "pixel")
"""Quantities that depend on how the tool is turned, whatever point of it is seen."""


@dataclass(frozen=True)
class CalibrationRecord:
    """A calibration as its file tells of it.

    Attributes:
        file: The file.
        model: The calibrated robot.
        verdict: One of `evidence.VERDICTS`.
        reason: Why, in one sentence; empty where there is nothing to say.
        parameters: Every parameter with its estimate.
        groups: Coupled groups.
        errors: Accuracy by quantity; NaN where the file lacks a number.
        validation: `set`, `file`, `holdout`, `5-fold`, or `none`.
        predicted: Error of the tip over the workspace that the noise of the rows
            leaves, root-mean-square of position [m] and orientation [rad]; None where
            the file does not say.
        predicted_robot: The same with what a displacement of base and tool can absorb
            taken away.
        noise: Errors that are left of the fitted rows, in standard deviations that
            the rows state; None where they state none.
        rows: Number of fitted rows.
        hashes: SHA-256 of the measurement files.
        created: When it was written, ISO 8601; empty where the file does not say.
    """

    file: str
    model: CalibratedModel
    verdict: str
    reason: str
    parameters: tuple[ParameterEstimate, ...]
    groups: tuple[CoupledGroup, ...]
    errors: tuple[QuantityErrors, ...]
    validation: str
    predicted: tuple[float, float] | None
    predicted_robot: tuple[float, float] | None
    noise: float | None
    rows: int
    hashes: tuple[str, ...]
    created: str

    @cached_property
    def of_robot(self) -> frozenset[str]:
        """Names of the parameters that belong to the robot, not to a measurement."""
        return frozenset(p.name for p in self.model.error.parameters if not p.nuisance)

    @cached_property
    def robot_groups(self) -> tuple[CoupledGroup, ...]:
        """Sums without a term of base, tool or instrument.

        The others deviate from where these were registered, each time anew.
        """
        return tuple(
            group
            for group in self.groups
            if {name for name, _ in group.terms} <= self.of_robot
        )

    @property
    def trusted(self) -> bool:
        """Whether it may be used."""
        return self.verdict in TRUSTED

    @property
    def described(self) -> bool:
        """Whether the errors left are the stated noise, and nothing more."""
        return self.noise is not None and self.noise <= DESCRIBED

    @property
    def oriented(self) -> bool:
        """Whether the rows tell how the tool is turned."""
        return any(error.name in ORIENTED for error in self.errors)

    @property
    def unknown_ends(self) -> tuple[bool, bool]:
        """Whether something at the base, and at the tool, was estimated."""
        free = {p.name for p in self.parameters if p.status != "fixed"}
        own = [p for p in self.model.measurement.parameters if p.name in free]
        return (
            any(n.startswith("base.frame.") for n in free) or any(p.outer for p in own),
            any(n.startswith("tool.frame.") for n in free)
            or any(not p.outer for p in own),
        )
