"""Two calibrations of one robot: what moved between them, beyond their uncertainty."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from calib_pin.compiled.threads import serial_blas
from calib_pin.estimation.evidence import Finding
from calib_pin.estimation.system import FRAME
from calib_pin.validation.counterparts import (
    partners,
    require_comparable,
    same_nominal,
)
from calib_pin.validation.findings.different_robots import different_robots
from calib_pin.validation.frame_drift import Displacement, displacements
from calib_pin.validation.result import (
    CalibrationResult,
    CoupledGroup,
    ParameterEstimate,
    Printed,
    Term,
)
from calib_pin.validation.summaries import ToolAccuracy
from calib_pin.validation.tip_drift import TipDrift, tip_drift

_Estimate = ParameterEstimate | CoupledGroup

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
    terms: tuple[Term, ...] = ()

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
    return frozenset(p.name for p in result.model.given if not p.nuisance)


def robot_groups(result: CalibrationResult) -> tuple[CoupledGroup, ...]:
    """Linear combinations without a term of base, tool or instrument.

    The others deviate from where these were registered, each time anew.
    """
    known = robot_parameters(result)
    return tuple(g for g in result.groups if {term[0] for term in g.terms} <= known)


def differences(
    first: CalibrationResult, second: CalibrationResult
) -> tuple[Difference, ...]:
    """Differences of what both know of the robot, most significant first.

    Parameters are matched by name and sums by their terms, whatever their number.
    """
    others = {p.name: p for p in second.parameters}
    both = robot_parameters(first) & robot_parameters(second) & others.keys()
    pairs: list[tuple[str, _Estimate, _Estimate | None, tuple[Term, ...]]] = [
        (p.name, p, others[p.name], ()) for p in first.parameters if p.name in both
    ]
    for group in robot_groups(first):
        pairs.append((group.expression, group, _partner(group, second), group.terms))
    found = []
    for name, a, b, terms in pairs:
        if b is not None and a.sigma is not None and b.sigma is not None:
            sigma = max(math.hypot(a.sigma, b.sigma), RESOLUTION)
            found.append(Difference(name, a.unit, a.value, b.value, sigma, terms))
    return tuple(sorted(found, key=lambda d: d.significance, reverse=True))


def _alone(
    record: CalibrationResult, other: CalibrationResult
) -> tuple[tuple[str, ...], int]:
    """Robot parameters, and number of their sums, that are known here only."""
    names = robot_parameters(record)
    names -= {p.name for p in other.parameters if p.sigma is not None}
    known = (p.name for p in record.parameters if p.sigma is not None)
    sums = sum(_partner(group, other) is None for group in robot_groups(record))
    return tuple(name for name in known if name in names), sums


def _partner(group: CoupledGroup, record: CalibrationResult) -> CoupledGroup | None:
    """The sum of the same terms in another calibration."""
    mine = dict(group.terms)
    for other in robot_groups(record):
        theirs = dict(other.terms)
        if mine.keys() == theirs.keys() and all(
            math.isclose(value, theirs[name], rel_tol=1e-6, abs_tol=1e-9)
            for name, value in mine.items()
        ):
            return other
    return None


BOUND = 3.0
"""Standard deviations within which estimates agree; one in 370 lies beyond by chance.

Among the about 50 of a robot that is one in every seven comparisons.
"""

CERTAIN = 5.0
"""Standard deviations beyond which a single parameter shows that the robot changed."""

EXPLAINED = 2.0
"""Drift that noise does not explain any more, as a multiple of what it explains.

The square of a drift is a weighted sum of squares of normal variables. Were it a single
one, one comparison in 20 would lie beyond by chance; with ten alike it is one in
100 000. Simulated pairs of one robot and new noise have a ratio of 1, and up to 1.8.
"""

NEGLIGIBLE = 1e-6
"""Drift that is none, whatever explains it [m, rad]."""

DESCRIBED = 1.2
"""Errors left of a fit, in stated standard deviations, up to which they are noise."""

ORIENTED = ("orientation", "pixel")
"""Quantities that depend on how the tool is turned, whatever point of it is seen."""


@dataclass(frozen=True, repr=False)
class Comparison(Printed):
    """Two calibrations of one robot.

    Attributes:
        first: One calibration.
        second: The other.
        same_nominal: Whether the nominal robots are the same. Otherwise parameters
            deviate from different robots and are not compared.
        differences: Differences of robot parameters known to both, the most significant
            first.
        alone: Names of the robot's parameters that have a standard deviation of their
            own in the first calibration only, and in the second only.
        sums_alone: Number of sums of the robot's parameters that only the first, and
            only the second, knows.
        displacements: How far base and tool stand from where they stood, where they
            are not the same.
        drifts: How far the tips are apart, by the name of the chain in the first.
    """

    first: CalibrationResult
    second: CalibrationResult
    same_nominal: bool
    differences: tuple[Difference, ...]
    alone: tuple[tuple[str, ...], tuple[str, ...]]
    sums_alone: tuple[int, int]
    displacements: tuple[Displacement, ...]
    drifts: Mapping[str, TipDrift]

    @property
    def moved(self) -> tuple[Difference, ...]:
        """Differences beyond `BOUND` standard deviations."""
        return tuple(d for d in self.differences if d.significance > BOUND)

    @property
    def changed(self) -> bool:
        """Whether a parameter or a sum differs beyond `CERTAIN` standard deviations."""
        return any(d.significance > CERTAIN for d in self.differences)

    @property
    def same_parameters(self) -> bool:
        """Whether both describe the errors of one nominal robot in the same way."""
        first, second = self.first, self.second
        learned = first.model.setup.learned, second.model.setup.learned
        alike = robot_parameters(first) == robot_parameters(second)
        return self.same_nominal and alike and learned[0] == learned[1]

    @property
    def same_rows(self) -> bool:
        """Whether both were fitted to the same measurement files."""
        same = _hashes(self.first) == _hashes(self.second)
        return same and shared_files(self.first, self.second)

    @property
    def described(self) -> bool:
        """Whether nothing but noise is left in either, so that only a move differs.

        Otherwise errors that no parameter describes are part of both, and at other
        configurations they are others.
        """
        return (
            self.same_parameters
            and not self.same_rows
            and described(self.first)
            and described(self.second)
        )

    @property
    def oriented(self) -> bool:
        """Whether orientations can be compared: the rows of both tell them."""
        return _oriented(self.first) and _oriented(self.second)

    @property
    def chain(self) -> str:
        """Name of the chain whose tip has drifted most, by what noise explains."""
        return max(self.drifts, key=self._size)

    @property
    def drift(self) -> TipDrift:
        """How far the tips of this chain are apart."""
        return self.drifts[self.chain]

    @property
    def explained(self) -> tuple[float, float] | None:
        """Drift that the noise of both explains, rms [m] and [rad]; None if unknown."""
        return self.explained_at(self.chain)

    @property
    def identical(self) -> bool:
        """Whether the tips are at the same places, whatever noise explains."""
        return all(self._identical(drift) for drift in self.drifts.values())

    @property
    def drifted(self) -> bool | None:
        """Whether the drift is more than noise explains; None if that is unknown."""
        if self.explained is None:
            return None
        return not self._identical(self.drift) and self._size(self.chain) > EXPLAINED

    def explained_at(self, chain: str) -> tuple[float, float] | None:
        """The same at the tip of a chain."""
        alone = len(self.drifts[chain].absorbed) == 2
        other = partners(self.first.model, self.second.model)[chain]
        pairs = (self.first, chain), (self.second, other)
        first, second = (_predicted(record, name, alone) for record, name in pairs)
        if first is None or second is None:
            return None
        return math.hypot(first[0], second[0]), math.hypot(first[1], second[1])

    def _identical(self, drift: TipDrift) -> bool:
        turned = self.oriented and drift.orientation.rms > NEGLIGIBLE
        return not turned and drift.position.rms <= NEGLIGIBLE

    def _size(self, chain: str) -> float:
        """Size of a drift by what noise explains; in meters if that is unknown."""
        drift, noise = self.drifts[chain], self.explained_at(chain)
        if noise is None:
            return drift.position.rms
        sizes = drift.position.rms, self.oriented * drift.orientation.rms
        return max(
            # Exact measurements explain nothing.
            size / max(least, 1e-300)
            for size, least in zip(sizes, noise, strict=True)
        )


@serial_blas
def compare(
    first: CalibrationResult, second: CalibrationResult, *, seed: int = 0
) -> Comparison:
    """Compare two calibrations of one robot.

    Args:
        first: One calibration.
        second: The other.
        seed: Seed of the configurations at which the tips are compared.

    Raises:
        InputError: If they are not of the same joints between the same links.
    """
    require_comparable(first, second)
    same = same_nominal(first.model, second.model)
    drifts = {}
    for name, other in partners(first.model, second.model).items():
        ends = zip(unknown_ends(first, name), unknown_ends(second, other), strict=True)
        base, tool = (any(pair) for pair in ends)
        drifts[name] = tip_drift(
            first.model.of(name),
            second.model.of(other),
            base=base,
            tool=tool,
            seed=seed,
        )
    nothing: tuple[tuple[str, ...], int] = (), 0
    here = _alone(first, second) if same else nothing
    there = _alone(second, first) if same else nothing
    found = Comparison(
        first=first,
        second=second,
        same_nominal=same,
        differences=differences(first, second) if same else (),
        alone=(here[0], there[0]),
        sums_alone=(here[1], there[1]),
        displacements=(),
        drifts=drifts,
    )
    blurred = 1.0
    if found.explained is not None and not found.identical:
        blurred = max(found._size(found.chain), 1.0)
    moved = displacements(first, second, found.oriented, seed, blurred)
    return replace(found, displacements=moved)


def faults(found: Comparison) -> tuple[Finding, ...]:
    """Why tips are so far apart, if hardly any robot has such a drift."""
    models = found.first.model, found.second.model
    return different_robots(*models, found.same_nominal, found.drift.position.rms)


def chained(first: CalibrationResult, second: CalibrationResult) -> bool:
    """Whether the second calibration began with the first one."""
    begun, created = second.recalibration, first.provenance.created
    return begun is not None and created in {s.created for s in begun.steps} - {""}


def shared_files(first: CalibrationResult, second: CalibrationResult) -> bool:
    """Whether a measurement file stands in both."""
    return bool(_hashes(first) & _hashes(second))


def _hashes(result: CalibrationResult) -> frozenset[str]:
    return frozenset(filter(None, result.provenance.hashes))


def described(result: CalibrationResult) -> bool:
    """Whether the errors left are the stated noise, and nothing more."""
    noise = stated_noise(result)
    return noise is not None and noise <= DESCRIBED


def stated_noise(result: CalibrationResult) -> float | None:
    """Errors that are left, in stated standard deviations; None for assumed ones."""
    statistics = result.statistics
    known = statistics.stated_sigma and not math.isnan(statistics.sigma0)
    return statistics.sigma0 if known else None


def _oriented(result: CalibrationResult) -> bool:
    """Whether the measurements tell how the tool is turned."""
    return any(error.name in ORIENTED for error in result.errors)


def _predicted(
    result: CalibrationResult, chain: str, alone: bool
) -> tuple[float, float] | None:
    """Predicted uncertainty of the tool point, rms [m] and [rad]; None if unknown.

    Alone is without a displacement of base and tool, which older files do not state.
    """
    tip = result.accuracies.get(chain, ToolAccuracy()).tip
    if tip is None:
        return None
    return tip.of_robot if alone and np.isfinite(tip.of_robot).all() else tip.rms


def unknown_ends(result: CalibrationResult, chain: str) -> tuple[bool, bool]:
    """Whether something at the base, and at the tool, of a chain was estimated."""
    free = {p.name for p in result.parameters if p.status != "fixed"}
    base = tool = False
    for part in result.model.parts.values():
        if part.key.chain == chain:
            count = len(part.error.screws)
            own = [p for p in part.parameters[count:] if p.name in free]
            ends = part.parameters[:FRAME], part.parameters[count - FRAME : count]
            first, last = (any(p.name in free for p in end) for end in ends)
            base |= first or any(p.outer for p in own)
            tool |= last or any(not p.outer for p in own)
    return base, tool
