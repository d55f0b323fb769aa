"""Variance components: two quantities whose standard deviations are stated wrong."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

import calib_pin
from benchmarks.criterion import Criterion, Line, between, missing
from benchmarks.verdict.jobs import BASE, NOISE, TOOL, draw, log_uniform, stream
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import BlockKey, Measurements, Observations
from calib_pin.setup import AnchorSetup, Setup

EACH = 100
"""Measurements of each instrument."""

WRONG = 5.0
"""By how much their standard deviations are stated wrong, either way."""

TRUTH = Setup(base_frame=BASE, tool_frame=TOOL)
"""True placements of a tracker and its target."""

WIRE = (1.5, 0.2, 0.4)
"""Anchor of a draw-wire encoder in the measurement frame [m]."""


@dataclass(frozen=True)
class Components:
    """Estimates of one job by quantity.

    Attributes:
        number: Number of the job.
        found: Name, estimated by true standard deviation, and whether its interval
            holds the true one.
        problem: The error, if there is one.
    """

    number: int
    found: tuple[tuple[str, float, bool], ...]
    problem: str = ""

    def __str__(self) -> str:
        """The outcome in one line."""
        return f"job {self.number}: {self.found} {self.problem}"


def run(number: int) -> Components:
    """A tracker and a draw-wire encoder, or the two quantities of a pose."""
    rng = stream(number, 1)
    job = draw(number, model="pose", stated=True)
    true = log_uniform(rng, NOISE, 2)
    factors = rng.permutation([WRONG, 1.0 / WRONG])
    keys: tuple[BlockKey, ...] = (BlockKey("pose"),)
    if number % 2:
        names = ("position", "orientation")
        setup, truth = Setup(), TRUTH
    else:
        names = ("position", "distance")
        keys = (BlockKey("position"), BlockKey("point-distance"))
        wire = {"wire": AnchorSetup(WIRE, 0.01, estimate_bias=True)}
        setup = Setup(anchors=wire)
        truth = replace(TRUTH, anchors=wire)
    noise = dict(zip(names, true.tolist(), strict=True))
    problem = nominal_problem(job.chain, keys, replace(truth, noise=noise))
    drawn = rng.normal(size=len(problem.parameters)) * problem.parameters.scales
    theta = np.where(problem.parameters.nuisance, 0.0, drawn)
    exact = calib_pin.simulate(problem, theta, rng, count=EACH * len(keys))
    wrong = zip(exact.blocks, np.split(factors, len(keys)), strict=True)
    rows = Observations(tuple(_stated_wrong(*pair) for pair in wrong))
    try:
        noise_found = calib_pin.calibrate(
            job.chain, rows, setup, validate=False
        ).statistics.noise
    except Exception as error:
        return Components(number, (), f"{type(error).__name__}: {error}")
    return Components(
        number,
        tuple(
            (c.quantity, c.estimate / noise[c.quantity], bool(low <= t <= high))
            for c in noise_found
            for t, (low, high) in [(noise[c.quantity], c.interval)]
        ),
    )


def _stated_wrong(block: Measurements, factors: Floats) -> Measurements:
    """Measurements of quantities of as many components, one factor for each."""
    assert block.sigma is not None
    each = block.sigma.shape[1] // len(factors)
    return replace(block, sigma=block.sigma * np.repeat(factors, each))


def judge(found: Sequence[Components]) -> Iterator[Line]:
    """How far estimates are off, and how often intervals hold the truth."""
    for name in ("position", "orientation", "distance"):
        some = [entry for o in found for entry in o.found if entry[0] == name]
        if not some:
            yield missing(f"{name}, found by true standard deviation")
            continue
        off = float(np.median([abs(ratio - 1.0) for _, ratio, _ in some]))
        yield between(f"{name}, median deviation of {len(some)}", off, -np.inf, 0.1)
    held = np.array([holds for o in found for _, _, holds in o.found])
    if len(held):
        chance = float(np.sqrt(0.05 * 0.95 / len(held)))
        yield between("intervals that hold the truth", held.mean(), 0.94, 0.96, chance)
    if problems := [o for o in found if o.problem]:
        shown = f"{len(problems)}, such as {problems[0].number}: {problems[0].problem}"
        yield Line("ended in an error", shown, "none", False)


CRITERION = Criterion(5, "Variance components", 1000, run, judge, least=40)
