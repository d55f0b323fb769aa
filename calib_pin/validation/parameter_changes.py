"""Parameters and sums of two calibrations that can be compared."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from calib_pin.validation.result import (
    CalibrationResult,
    CoupledGroup,
    ParameterEstimate,
)

RESOLUTION = 1e-9
"""Least standard deviation of a difference [SI]: of noise-free data only rounding."""


@dataclass(frozen=True)
class Difference:
    """A parameter or a sum of parameters that two calibrations know.

    Attributes:
        name: Name of the parameter, or the sum as a formula.
        unit: Its unit.
        first: Value in the first calibration.
        second: Value in the second.
        sigma: Standard deviation of the difference of independent estimates.
        terms: Parameters of a sum with their coefficients; empty for a parameter.
    """

    name: str
    unit: str
    first: float
    second: float
    sigma: float
    terms: tuple[tuple[str, float], ...] = ()

    @property
    def change(self) -> float:
        """The second value minus the first."""
        return self.second - self.first

    @property
    def significance(self) -> float:
        """Size of the change in standard deviations."""
        return abs(self.change) / self.sigma


def robot_parameters(result: CalibrationResult) -> frozenset[str]:
    """Names of the parameters that belong to the robot, not to a measurement."""
    return frozenset(p.name for p in result.model.error.parameters if not p.nuisance)


def robot_groups(result: CalibrationResult) -> tuple[CoupledGroup, ...]:
    """Linear combinations without a term of base, tool or instrument.

    The others deviate from where these were registered, each time anew.
    """
    known = robot_parameters(result)
    return tuple(g for g in result.groups if {term[0] for term in g.terms} <= known)


def differences(
    first: CalibrationResult, second: CalibrationResult
) -> tuple[Difference, ...]:
    """What both know of the robot, most significant first.

    Parameters are matched by name and sums by their terms, whatever their number.
    """
    found = [*_parameters(first, second), *_sums(first, second)]
    return tuple(sorted(found, key=lambda d: d.significance, reverse=True))


def known_alone(record: CalibrationResult, other: CalibrationResult) -> tuple[str, ...]:
    """Robot parameters that are known here and not in another calibration."""
    known = {p.name for p in other.parameters if p.sigma is not None}
    alone = robot_parameters(record) - known
    return tuple(
        p.name for p in record.parameters if p.sigma is not None and p.name in alone
    )


def sums_alone(record: CalibrationResult, other: CalibrationResult) -> int:
    """Number of sums of robot parameters that are known here only."""
    return sum(_partner(group, other) is None for group in robot_groups(record))


def _parameters(
    first: CalibrationResult, second: CalibrationResult
) -> Iterator[Difference]:
    others = {p.name: p for p in second.parameters}
    both = robot_parameters(first) & robot_parameters(second)
    for mine in first.parameters:
        other = others.get(mine.name)
        if other is not None and mine.name in both:
            yield from _difference(mine.name, mine, other)


def _sums(first: CalibrationResult, second: CalibrationResult) -> Iterator[Difference]:
    for mine in robot_groups(first):
        other = _partner(mine, second)
        if other is not None:
            yield from _difference(mine.expression, mine, other, mine.terms)


def _difference(
    name: str,
    first: ParameterEstimate | CoupledGroup,
    second: ParameterEstimate | CoupledGroup,
    terms: tuple[tuple[str, float], ...] = (),
) -> Iterator[Difference]:
    """The difference of two estimates, where both have a standard deviation."""
    if first.sigma is not None and second.sigma is not None:
        sigma = max(math.hypot(first.sigma, second.sigma), RESOLUTION)
        yield Difference(name, first.unit, first.value, second.value, sigma, terms)


def _partner(group: CoupledGroup, record: CalibrationResult) -> CoupledGroup | None:
    """The sum of the same terms in another calibration."""
    mine = dict(group.terms)
    for other in robot_groups(record):
        theirs = dict(other.terms)
        if mine.keys() == theirs.keys() and all(
            math.isclose(mine[name], theirs[name], rel_tol=1e-6, abs_tol=1e-9)
            for name in mine
        ):
            return other
    return None
