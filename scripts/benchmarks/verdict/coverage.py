"""Coverage: intervals of estimates and of the tool, where the truth is known.

Of what is estimated, those identifiable combinations count that hold only parameters
of the robot: what base and tool absorb depends on where their frames are counted from.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

import calib_pin
from benchmarks.criterion import Criterion, Line, between, square
from benchmarks.verdict.jobs import Job, draw, stream
from benchmarks.verdict.truth import WORKSPACE, position_error
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.setup import Setup
from calib_pin.validation.result import CalibrationResult

NORMAL = 1.959964
"""Standard deviations within which 95 % of a normal distribution lie."""

SIZE = 0.3
"""Standard deviation of the true errors in their scales: where combinations are linear
in them to a tenth of their standard deviation."""

LENGTH = 1e-4
"""True standard deviation of lengths [m] and angles [rad]."""

UNMODELED = (5.0, 20.0)
"""Smallest and largest unmodeled error by the noise."""


@dataclass(frozen=True)
class Coverage:
    """Outcome of a fit.

    Attributes:
        number: Number of the job.
        kind: Its peculiarity.
        inside: Combinations whose 95 % interval holds the truth.
        total: Their number.
        ratio: Squared actual by predicted tool error over the workspace.
        problem: The error, if there is one.
    """

    number: int
    kind: str
    inside: int = 0
    total: int = 0
    ratio: float = np.nan
    problem: str = ""

    def __str__(self) -> str:
        """The outcome in one line."""
        return (
            f"job {self.number}: {self.kind}, {self.inside} of {self.total} inside, "
            f"actual by predicted {np.sqrt(self.ratio):.2f} {self.problem}"
        )


KINDS = {
    "unknown unit weight": "position",
    "priors": "position",
    "known distances": "fixed-point",
    "repeats": "pose",
    "far first guess": "point-distance",
    "unmodeled": "position",
}
"""Peculiarities, each with its measurement model."""


def run(number: int) -> Coverage:
    """A fit whose true errors have their expected size."""
    kind = list(KINDS)[number % len(KINDS)]
    rng = stream(number, 1)
    stated = kind in ("priors", "far first guess")
    # LENGTH is assumed where nothing is stated.
    length = LENGTH if stated else LENGTH * float(np.exp(rng.uniform(-1.0, 1.0)))
    job = draw(
        number, model=KINDS[kind], multiple=3, stated=stated, size=SIZE, noise=length
    )
    setup, repeats, q = job.setup, 1, None
    if kind == "priors":
        robot = (p for p in job.problem.parameters if p.free and not p.nuisance)
        setup = replace(setup, prior={p.name: SIZE * p.scale for p in robot})
    elif kind == "repeats":
        q = job.chain.random_configurations(job.count, rng)
        repeats = 4
    elif kind == "far first guess":
        setup = far(setup, rng)
    elif kind == "unmodeled":
        job = unmodeled(job, rng, length * float(rng.uniform(*UNMODELED)))
    try:
        rows = job.measured(rng, q=q, repeats=repeats)
        result = calib_pin.calibrate(job.chain, rows, setup, validate=False)
    except Exception as error:
        return Coverage(number, kind, problem=f"{type(error).__name__}: {error}")
    inside, total = covered(job, result)
    predicted = np.nan
    if result.accuracy.workspace is not None:
        predicted = result.accuracy.workspace.calibrated[0]
    elif result.accuracy.tip is not None:
        predicted = result.accuracy.tip.of_robot[0]
    at = job.chain.random_configurations(WORKSPACE, stream(number, 99))
    ratio = (position_error(job, result.model, at) / predicted) ** 2
    return Coverage(number, kind, inside, total, ratio)


def covered(job: Job, result: CalibrationResult) -> tuple[int, int]:
    """Combinations whose interval holds the truth, and all of them."""
    names = job.problem.parameters.names
    truth = dict(zip(names, job.theta.tolist(), strict=True))
    robot = {p.name for p in job.problem.parameters if not p.nuisance}
    inside = total = 0
    estimates = [
        (((p.name, 1.0),), p.value, p.sigma)
        for p in result.parameters
        if p.status == "identifiable"
    ]
    for terms, value, sigma in [
        *estimates,
        *((group.terms, group.value, group.sigma) for group in result.groups),
    ]:
        if sigma and robot.issuperset(name for name, _ in terms):
            true = sum(c * truth[name] for name, c in terms)
            inside += abs(value - true) < NORMAL * sigma
            total += 1
    return inside, total


def far(setup: Setup, rng: np.random.Generator) -> Setup:
    """Anchors that stand three decimeters from where they are said to be."""
    anchors = {}
    for name, anchor in setup.anchors.items():
        assert anchor.xyz is not None
        x, y, z = (a + 0.3 * rng.choice([-1.0, 1.0]) for a in anchor.xyz)
        anchors[name] = replace(anchor, xyz=(x, y, z))
    return replace(setup, anchors=anchors)


def unmodeled(job: Job, rng: np.random.Generator, size: float) -> Job:
    """A robot whose gears err, by so much at the tool (a component) [m]."""
    setup = replace(job.problem.setup, parameters=("placement", "transmission"))
    problem = nominal_problem(job.chain, job.model, setup)
    names = problem.parameters.names
    known = dict(zip(job.problem.parameters.names, job.theta.tolist(), strict=True))
    theta = np.array([known.get(name, 0.0) for name in names])
    gears = np.array([name.endswith(("sin2", "cos2")) for name in names])
    moved = replace(
        job,
        problem=problem,
        theta=np.where(gears, rng.normal(size=len(names)), 0.0) * 1e-3,
    )
    q = job.chain.random_configurations(WORKSPACE, rng)
    found = position_error(moved, None, q) / np.sqrt(3.0)
    return replace(moved, theta=theta + moved.theta * size / found)


def judge(found: Sequence[Coverage]) -> Iterator[Line]:
    """Coverage and predictions of every kind."""
    for kind in KINDS:
        some = [o for o in found if o.kind == kind]
        limits = (0.9, 0.98) if kind == "unmodeled" else (0.94, 0.96)
        done = [o for o in some if o.total]
        share, chance = _share(done)
        yield between(f"{kind}, 95 % intervals", share, *limits, chance)
        # A tenth of the error is a fifth of its square.
        wide = (0.7, 1.3) if kind == "unmodeled" else (0.8, 1.2)
        text = f"{kind}, mean square of actual by predicted tool error"
        yield square(text, [o.ratio for o in some], *wide)
        if problems := [o for o in some if o.problem]:
            shown = f"{len(problems)}, such as {problems[0]}"
            yield Line(f"{kind}, ended in an error", shown, "none", False)


def _share(done: Sequence[Coverage]) -> tuple[float, float]:
    """Part of the intervals that hold the truth, and its standard error over jobs."""
    if not done:
        return np.nan, 0.0
    shares = np.array([o.inside / o.total for o in done])
    return float(shares.mean()), float(shares.std() / np.sqrt(len(shares)))


CRITERION = Criterion(6, "Coverage", 1000 * len(KINDS), run, judge, least=60)
