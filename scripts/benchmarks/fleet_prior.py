"""A prior from other robots of a type: what it saves the next one, and its intervals.

    scripts/benchmark fleet-prior                       # a tenth of the types
    scripts/benchmark fleet-prior --full                # all of them
    scripts/benchmark fleet-prior --job 4 --tell        # one type, told in full

A job is a type of UR10: errors that all its robots have, and how far each deviates from
them. 200 robots are calibrated with 30 positions each and give the prior; then 40 new
ones are calibrated with and without it. Kinds of types take turns; they differ in how
much alike their robots are, and in what disturbs the measurements.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

import calib_pin
from benchmarks.criteria import run_criteria
from benchmarks.criterion import Criterion, Line, between, square
from benchmarks.verdict.coverage import covered, unmodeled
from benchmarks.verdict.jobs import SEED, Job, draw, stream
from benchmarks.verdict.truth import WORKSPACE, position_error
from calib_pin.estimation.statistics.population_prior import prior_of_type
from calib_pin.kinematics.spatial import Floats
from calib_pin.setup import PopulationPrior, Setup
from calib_pin.validation.robot_state import robot_evidence

ROBOTS, COUNT = 200, 30
"""Robots of a fleet, and configurations of each."""

FEW = 12
"""Configurations of a robot that has a prior."""

NEXT = 40
"""Robots that are calibrated with the prior."""

COMMON = 1.0
"""Standard deviation of the errors that a type has, in the scales of parameters."""


@dataclass(frozen=True)
class Kind:
    """A kind of types.

    Attributes:
        spread: Median spread of an error, in its scale: 1 mm or 1 mrad.
        noise: Standard deviation of a coordinate [m].
        gears: Error of the tool by gears that the model does not have, a component [m].
    """

    spread: float
    noise: float
    gears: float = 0.0

    def __str__(self) -> str:
        """The kind in a few words."""
        gears = f", gears {1e3 * self.gears:g} mm" if self.gears else ""
        return f"spread {self.spread:g} mm, noise {1e3 * self.noise:g} mm{gears}"


KINDS = (
    Kind(0.05, 3e-4),
    Kind(0.1, 3e-4),
    Kind(0.1, 1e-4),
    Kind(0.3, 1e-4),
    Kind(0.3, 1e-4, 3e-4),
)
"""Kinds of types, by what they are alike beside what disturbs the measurements."""

ALIKE = 0.2
"""Spread by noise up to which a dozen configurations replace thirty."""


@dataclass(frozen=True)
class Way:
    """A way to calibrate the next robots.

    Attributes:
        count: Number of configurations.
        prior: Whether they have the prior.
        planned: Whether the configurations are planned with it, else random.
    """

    count: int
    prior: bool = False
    planned: bool = False

    def __str__(self) -> str:
        """The way in a few words."""
        planned = " planned" if self.planned else ""
        return f"{self.count}{planned}{' with the prior' if self.prior else ''}"


PLANNED, PRIOR, MOST = Way(FEW, True, True), Way(FEW, True), Way(COUNT)
WAYS = (PRIOR, PLANNED, Way(FEW), Way(18), MOST)
"""Ways that are compared."""


@dataclass(frozen=True)
class Next:
    """The next robots of a type, calibrated in one way.

    Attributes:
        errors: Tool errors over the workspace [m].
        predicted: Predicted ones [m].
        shares: Part of the 95 % intervals of each that hold the truth.
    """

    errors: list[float] = field(default_factory=list)
    predicted: list[float] = field(default_factory=list)
    shares: list[float] = field(default_factory=list)

    @property
    def rms(self) -> float:
        """Root mean square of the tool errors [m]."""
        return float(np.sqrt(np.mean(np.square(self.errors))))


@dataclass(frozen=True)
class Outcome:
    """Outcome of a type.

    Attributes:
        number: Number of the type.
        kind: Its kind.
        ways: The next robots by the way they are calibrated.
        spread: Found by true spread, of errors that half of the fleet tells, the
            median.
    """

    number: int
    kind: Kind
    ways: Mapping[Way, Next]
    spread: float

    def __str__(self) -> str:
        """The outcome in one line."""
        told = ", ".join(f"{n}: {1e3 * w.rms:.3f} mm" for n, w in self.ways.items())
        some = self.ways[PRIOR]
        return (
            f"type {self.number}: {self.kind}: {told}; {np.mean(some.shares):.3f} "
            f"inside; found by true spread {self.spread:.2f}"
        )


@dataclass(frozen=True)
class Type:
    """A type of robots.

    Attributes:
        number: Its number.
        kind: Its kind.
        mean: Errors of all its robots, shape (P,).
        spread: How far each deviates, shape (P,).
    """

    number: int
    kind: Kind
    mean: Floats
    spread: Floats

    @staticmethod
    def of(number: int) -> Type:
        """The type of a number."""
        kind = KINDS[number % len(KINDS)]
        parameters = _job(kind).problem.parameters
        rng, count = stream(number, 7), len(parameters)
        robot = parameters.free & ~parameters.nuisance
        sizes = np.where(robot, parameters.scales, 0.0)
        # Spreads of a type differ by a factor of two and more among its errors.
        several = kind.spread * np.exp(0.5 * rng.normal(size=count))
        mean = COMMON * sizes * rng.normal(size=count)
        return Type(number, kind, mean, several * sizes)

    def robot(self, rng: np.random.Generator) -> Job:
        """A robot of the type."""
        deviation = self.spread * rng.normal(size=len(self.spread))
        job = replace(_job(self.kind), theta=self.mean + deviation)
        return unmodeled(job, rng, self.kind.gears) if self.kind.gears else job


def _job(kind: Kind) -> Job:
    robot = "example:ur10_robot"
    return draw(0, robot=robot, model="position", stated=False, noise=kind.noise)


def _calibrated(
    job: Job, rng: np.random.Generator, count: int, setup: Setup, q: Floats | None
) -> calib_pin.CalibrationResult:
    """A calibration by random configurations, or by given ones."""
    rows = job.measured(rng, count=count, q=q)
    return calib_pin.calibrate(job.chain, rows, setup, validate=False)


def run(number: int, robots: int = ROBOTS, following: int = NEXT) -> Outcome:
    """A fleet of a type, and its next robots with and without its prior."""
    kind = Type.of(number)
    fleet = []
    for k in range(robots):
        rng = np.random.default_rng([SEED, number, 0, k])
        result = _calibrated(kind.robot(rng), rng, COUNT, Setup(), None)
        fleet.append(robot_evidence(result))
    prior = prior_of_type(fleet)
    planned = _planned(kind, prior)
    found: dict[Way, Next] = {way: Next() for way in WAYS}
    for k in range(following):
        job = kind.robot(np.random.default_rng([SEED, number, 1, k]))
        at = job.chain.random_configurations(WORKSPACE, stream(number, 8))
        for way in WAYS:
            # The same stream: few configurations are the first ones of many.
            rng = np.random.default_rng([SEED, number, 2, k])
            setup = Setup(prior=prior) if way.prior else Setup()
            q = planned if way.planned else None
            if q is None:
                q = job.chain.random_configurations(COUNT, rng)[: way.count]
            result = _calibrated(job, rng, way.count, setup, q)
            found[way] = _with(found[way], job, result, at)
    return Outcome(number, kind.kind, found, _spread(kind, prior))


def _planned(kind: Type, prior: PopulationPrior) -> Floats:
    """Configurations that are planned for all robots of a type, shape (FEW, n)."""
    job = _job(kind.kind)
    stated = job.problem.setup
    setup = Setup(
        base_frame=stated.base_frame, tool_frame=stated.tool_frame, prior=prior
    )
    return calib_pin.plan(job.chain, "position", FEW, setup).q


def _with(some: Next, job: Job, result: calib_pin.CalibrationResult, q: Floats) -> Next:
    """The next robots with another one."""
    inside, total = covered(job, result)
    workspace = result.accuracy.workspace
    return Next(
        [*some.errors, position_error(job, result.model, q)],
        [*some.predicted, np.nan if workspace is None else workspace.calibrated[0]],
        [*some.shares, inside / total],
    )


def _spread(kind: Type, prior: PopulationPrior) -> float:
    """Found by true spread, the median of what half of the fleet tells."""
    parameters = _job(kind.kind).problem.parameters
    ratios = [
        p.spread / kind.spread[parameters.index(p.name)]
        for p in prior.parameters
        if p.robots > 0.5 * prior.robots
    ]
    return float(np.median(ratios))


def judge(found: Sequence[Outcome]) -> Iterator[Line]:
    """Accuracy, coverage and predictions of every kind."""
    for kind in KINDS:
        some = [outcome for outcome in found if outcome.kind == kind]
        if not some:
            continue
        rms = {
            way: 1e3 * float(np.sqrt(np.mean([o.ways[way].rms ** 2 for o in some])))
            for way in WAYS
        }
        few = 1e-3 * kind.spread <= ALIKE * kind.noise
        yield Line(
            f"{kind}: tool error with {PRIOR}",
            f"{rms[PRIOR]:.3f} mm",
            "; ".join(f"{way}: {rms[way]:.3f} mm" for way in WAYS if way != PRIOR),
            rms[PRIOR] <= rms[MOST] if few else None,
        )
        shares = np.array([s for o in some for s in o.ways[PRIOR].shares])
        # The intervals of one robot are not independent, robots are.
        chance = float(shares.std() / np.sqrt(len(shares)))
        share = float(shares.mean())
        yield between(f"{kind}: 95 % intervals with {PRIOR}", share, 0.94, 0.96, chance)
        text = f"{kind}: mean square of actual by predicted tool error"
        squares = {way: _squares(some, way) for way in (PRIOR, Way(FEW))}
        if kind.gears:
            # So few configurations do not show gears, whose errors they have in common.
            found_by, without = (float(np.mean(part)) for part in squares.values())
            limit = f"{without:.2f} without the prior"
            yield Line(text, f"{found_by:.2f}", limit, found_by <= without)
        else:
            yield square(text, squares[PRIOR], 0.8, 1.2)
        spread = float(np.mean([o.spread for o in some]))
        yield between(f"{kind}: found by true spread", spread, 0.9, 1.1)


def _squares(some: Sequence[Outcome], way: Way) -> list[float]:
    """Squared actual by predicted tool errors of robots calibrated in one way."""
    return [
        (error / predicted) ** 2
        for outcome in some
        for error, predicted in zip(
            outcome.ways[way].errors, outcome.ways[way].predicted, strict=True
        )
    ]


CRITERIA = {"prior": Criterion(1, "Population prior", 50, run, judge, least=5)}


def main() -> None:
    """Run the types that the options name; exit status 1 if a criterion fails."""
    run_criteria("fleet-prior", CRITERIA, SEED)
