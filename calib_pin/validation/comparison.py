"""Two calibrations of one robot: what moved between them, beyond their uncertainty.

Of the change of the tool poses in the measurement frame, `T_A(q)` to `T_B(q)`, one
motion of the instrument and one of the tool explain as much as they can; the rest is of
the robot. Parameters do not enter, so that it does not matter which of them hold what a
frame can absorb: with another base, another first joint is the same robot.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import InputError
from calib_pin.estimation.evidence import Finding
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.validation.calibrated_model import CalibratedChain, CalibratedModel
from calib_pin.validation.findings.calibrations import different_robots
from calib_pin.validation.result import (
    CalibrationResult,
    Coefficient,
    CoupledGroup,
    Printed,
    ToolAccuracy,
    frames_of,
)
from calib_pin.validation.tip_drift import NEGLIGIBLE, TipDrift, tip_drift

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

DESCRIBED = 1.2
"""Errors left of a fit, in stated standard deviations, up to which they are noise."""

ORIENTED = ("orientation", "pixel")
"""Quantities that depend on how the tool is turned, whatever point of it is seen."""

SAME = 1e-9
"""Largest difference between places of one nominal robot [m, rad], and
least standard deviation of a difference [SI]: of noise-free data only rounding."""

ENDS = ("chain starts at", "chain ends at", "joints are")
"""Properties by which a chain is the same one, in words."""


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
    first: float = field(metadata={"key": "a"})
    second: float = field(metadata={"key": "b"})
    sigma: float
    terms: tuple[Coefficient, ...] = ()

    @property
    def change(self) -> float:
        """The second value minus the first."""
        return self.second - self.first

    @property
    def significance(self) -> float:
        """Size of the change in standard deviations."""
        return abs(self.change) / self.sigma


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
        drifts: How far the tips are apart, by the name of the chain in the first.
    """

    first: CalibrationResult
    second: CalibrationResult
    same_nominal: bool
    differences: tuple[Difference, ...]
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
        equal = robot_parameters(first) == robot_parameters(second)
        return self.same_nominal and equal and learned[0] == learned[1]

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
        sizes = [stated_noise(record) for record in (self.first, self.second)]
        noise = all(size is not None and size <= DESCRIBED for size in sizes)
        return self.same_parameters and not self.same_rows and noise

    @property
    def chain(self) -> str:
        """Name of the chain whose tip has drifted most, by what noise explains."""
        return max(self.drifts, key=lambda name: self.drifts[name].ratio)

    @property
    def drift(self) -> TipDrift:
        """How far the tips of this chain are apart."""
        return self.drifts[self.chain]

    @property
    def identical(self) -> bool:
        """Whether the tips are at the same places, whatever noise explains."""
        return all(max(drift.sizes) <= NEGLIGIBLE for drift in self.drifts.values())

    @property
    def drifted(self) -> bool | None:
        """Whether the drift is more than noise explains; None if that is unknown."""
        return None if self.drift.explained is None else self.drift.ratio > EXPLAINED


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
    chains = partners(first.model, second.model)
    if not chains:
        raise _incomparable(first, second)
    quantities = ({error.name for error in record.errors} for record in (first, second))
    oriented = all(not names.isdisjoint(ORIENTED) for names in quantities)
    drifts = {}
    for name, other in chains.items():
        pair = (first, name), (second, other)
        base, tool = np.any([_free_ends(*each) for each in pair], axis=0).tolist()
        models = (record.model.of(chain) for record, chain in pair)
        drift = tip_drift(*models, base=base, tool=tool, seed=seed)
        tips = [record.accuracies.get(n, ToolAccuracy()).tip for record, n in pair]
        noise = [t.of_robot if base and tool else t.rms for t in tips if t is not None]
        explained = None
        if len(noise) == len(tips):
            position, orientation = map(math.hypot, *noise)
            explained = position, orientation
        drifts[name] = replace(drift, explained=explained, oriented=oriented)
    same = same_nominal(first.model, second.model)
    mine, theirs = (_known_sums(record) if same else {} for record in (first, second))
    differences = list[Difference]()
    for a, b in ((mine[key], theirs[key]) for key in mine if key in theirs):
        # The same sum of the same terms, whatever their order.
        there = dict(b.terms)
        weights = np.array([(c, there[name]) for name, c in a.terms])
        if np.allclose(weights[:, 0], weights[:, 1], rtol=1e-6, atol=1e-9):
            sigma = max(math.hypot(a.sigma or 0.0, b.sigma or 0.0), SAME)
            values = a.value, b.value, sigma, a.terms if len(a.terms) > 1 else ()
            differences.append(Difference(a.expression, a.unit, *values))
    differences.sort(key=lambda d: -d.significance)
    return Comparison(first, second, same, tuple(differences), drifts)


def faults(comparison: Comparison) -> tuple[Finding, ...]:
    """Why tips are so far apart, if hardly any robot has such a drift."""
    models = comparison.first.model, comparison.second.model
    size = comparison.drift.position.rms
    return different_robots(*models, comparison.same_nominal, size)


def chained(first: CalibrationResult, second: CalibrationResult) -> bool:
    """Whether the second calibration began with the first one."""
    begun, created = second.recalibration, first.provenance.created
    return begun is not None and created in {s.created for s in begun.steps} - {""}


def shared_files(first: CalibrationResult, second: CalibrationResult) -> bool:
    """Whether a measurement file stands in both."""
    return bool(_hashes(first) & _hashes(second))


def _hashes(result: CalibrationResult) -> frozenset[str]:
    return frozenset(filter(None, result.provenance.hashes))


def stated_noise(result: CalibrationResult) -> float | None:
    """Errors that are left, in stated standard deviations; None for assumed ones."""
    statistics = result.statistics
    known = statistics.stated_sigma and not math.isnan(statistics.sigma0)
    return statistics.sigma0 if known else None


def robot_parameters(result: CalibrationResult) -> frozenset[str]:
    """Names of the parameters that belong to the robot, not to a measurement."""
    return frozenset(p.name for p in result.model.given if not p.nuisance)


def robot_groups(result: CalibrationResult) -> tuple[CoupledGroup, ...]:
    """Linear combinations without a term of base, tool or instrument.

    The others deviate from where these were registered, each time anew.
    """
    known = robot_parameters(result)
    return tuple(g for g in result.groups if {term[0] for term in g.terms} <= known)


def _known_sums(record: CalibrationResult) -> dict[frozenset[str], CoupledGroup]:
    """The parameters and sums of a robot that a calibration knows, by their terms."""
    robot, sums = robot_parameters(record), list[CoupledGroup]()
    for p in record.parameters:
        if p.name in robot:
            alone = (Coefficient(p.name, 1.0),)
            sums.append(CoupledGroup(0, p.name, p.unit, p.value, p.sigma, alone))
    known = (s for s in (*sums, *robot_groups(record)) if s.sigma is not None)
    return {frozenset(dict(s.terms)): s for s in known}


def partners(first: CalibratedModel, second: CalibratedModel) -> dict[str, str]:
    """Names of the chains of one robot, and of the same chains in another."""
    others = {_ends(term.error.chain): name for name, term in second.by_chain.items()}
    mine = {name: _ends(term.error.chain) for name, term in first.by_chain.items()}
    return {name: others[ends] for name, ends in mine.items() if ends in others}


def _ends(chain: Chain) -> tuple[str, str, str]:
    """The identity of a chain in words, see `ENDS`."""
    pairs = zip(chain.joints, chain.revolute, strict=True)
    joints = (f"{joint} ({'turns' if turns else 'slides'})" for joint, turns in pairs)
    return chain.base, chain.tip, ", ".join(joints)


def _incomparable(first: CalibrationResult, second: CalibrationResult) -> InputError:
    """Why the tips of two robots have nothing in common."""
    ends = (_ends(record.model.of().chain) for record in (first, second))
    properties = zip(ENDS, *ends, strict=True)
    what, mine, theirs = next(p for p in properties if p[1] != p[2])
    known = first.provenance.file or "the first"
    reason = f"cannot be compared with {known}: its {what} {theirs}, there {mine}"
    return InputError(reason, file=second.provenance.file or None)


def same_nominal(first: CalibratedModel, second: CalibratedModel) -> bool:
    """Whether the nominal robots are the same, whatever else their URDFs hold."""
    if first.chains.robot.source == second.chains.robot.source:
        return True
    # Joint corrections depend on the masses as well.
    return (first.geometric and second.geometric) and all(
        np.abs(_geometry(first.of(a)) - _geometry(second.of(b))).max() <= SAME
        for a, b in partners(first, second).items()
    )


def _geometry(calibrated: CalibratedChain) -> Floats:
    """The axes of a nominal chain, and where its joints and ends are."""
    chain = calibrated.chain
    poses = *chain.placements, chain.tip_placement, *chain.ends
    return np.vstack([chain.axes, *(pose.homogeneous[:3].T for pose in poses)])


def _free_ends(record: CalibrationResult, chain: str) -> list[bool]:
    """Whether anything at base and tool of a chain or its instruments was estimated."""
    free = np.array([p.status != "fixed" for p in record.parameters])
    ends = [False, False]
    for term in record.model.terms.values():
        if term.key.chain == chain:
            own = len(term.error.screws)
            instrument = term.parameters[own:], free[term.of_instrument]
            pairs = zip(*instrument, strict=False)
            outer = {p.outer for p, estimated in pairs if estimated}
            for k, (_, index) in enumerate(frames_of(term)):
                ends[k] |= bool(free[index].any()) or (k == 0) in outer
    return ends
