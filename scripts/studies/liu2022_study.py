"""Liu Qian et al. 2022, Manned Spaceflight 28(6), 711-719: optimal configurations.

Tool poses at six configurations calibrate a seven-joint arm. The link errors have 34
identifiable linear combinations, for which 36 equations hardly suffice: it matters
which six. The publication picks them by hand, then by a particle swarm that lowers the
condition number of its 36 x 34 matrix, and takes one linear least-squares step.

The matrix is theirs: twists of the tool in the base frame, lengths in m, angles in rad,
and 34 of the 48 columns, one for each linear combination.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from time import process_time

import numpy as np

import calib_pin
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Indices, Measurements
from calib_pin.planning import search as planning
from calib_pin.planning.criteria import CRITERIA
from calib_pin.planning.rows import IdentificationRows, Pullback
from calib_pin.planning.workspace import Workspace
from calib_pin.solvers.particle_swarm import ParticleSwarm, particle_swarm
from studies import shared
from studies.liu2022_arm import (
    POSES,
    PUBLISHED,
    Arm,
    SpatialTwist,
    condition,
    conditions,
    singular_values,
)
from studies.tip_errors import TipErrors, tip_errors
from studies.trajectory import Trajectory, trapezoidal

OURS = "ours"
"""The set that we plan, without self-collision."""


@dataclass(frozen=True)
class Settings:
    """The search and the simulation; lengths in m, angles in rad.

    Attributes:
        draws: Random sets of configurations.
        candidates: Configurations from which our search starts.
        starts: Random sets of them from which it descends.
        swarms: Runs of the published search, with seeds of their own.
        particles: Particles of a swarm.
        iterations: Iterations of a swarm.
        noise: Standard deviation by quantity.
        start: First configuration of the trajectory.
        goal: Last configuration.
        velocity: Largest joint velocity [rad/s].
        acceleration: Largest joint acceleration [rad/s^2].
        period: Time between samples [s].
    """

    draws: int = 1000
    candidates: int = 1000
    starts: int = 20
    swarms: int = 4
    particles: int = 60
    iterations: int = 200
    noise: tuple[tuple[str, float], ...] = (
        ("position", 1e-4),
        ("orientation", float(np.radians(0.01))),
    )
    start: tuple[float, ...] = tuple(np.radians([10, -100, 80, 100, -80, 90, 5]))
    goal: tuple[float, ...] = tuple(np.radians([60, 30, 20, 20, 30, 75, 15]))
    velocity: float = 0.5
    acceleration: float = 0.5
    period: float = 0.05


def random_conditions(arm: Arm, count: int, rng: np.random.Generator) -> Floats:
    """Condition numbers of random sets of six within the limits, shape (count,)."""
    q = arm.problem.chains.random_configurations(count * POSES, rng)
    return conditions(arm, q.reshape(count, POSES, -1))


# --- search ------------------------------------------------------------------------


@dataclass(frozen=True)
class Search:
    """How a search went.

    Attributes:
        q: The best set, shape (6, 7) [rad].
        condition: Its condition number.
        evaluations: Evaluations of the matrix until each entry, shape (K,).
        best: Least condition number until then, shape (K,).
        seconds: Time of all, on one core.
    """

    q: Floats
    condition: float
    evaluations: Floats
    best: Floats
    seconds: float

    def numbers(self) -> dict[str, object]:
        """The numbers that are written."""
        return {"q_rad": self.q} | {k: x for k, x in vars(self).items() if k != "q"}


class Watched:
    """The published matrix with a record of its condition numbers.

    Args:
        rows: The rows.
    """

    nuisances, differentiable = 0, True

    def __init__(self, rows: IdentificationRows) -> None:
        """Begin with an empty record."""
        self._rows = rows
        self.conditions: list[float] = []

    def rows(self, q: Floats, aim: Indices) -> Floats:
        """Rows of configurations."""
        return self._rows.rows(q, aim)

    def linearize(self, q: Floats, aim: Indices) -> tuple[Floats, Pullback]:
        """Rows of one set with their derivative."""
        rows, pullback = self._rows.linearize(q, aim)
        s = np.linalg.svd(rows.reshape(-1, rows.shape[2]), compute_uv=False)
        self.conditions.append(float(s[0] / s[-1]))
        return rows, pullback


def optimize(settings: Settings, seed: int, *, avoid: bool = False) -> Search:
    """Our six configurations: the search of `calib-pin plan` on the published matrix.

    Exchange among candidates, then descents by the analytic gradient. The result is
    rounded to 0.01 degrees, like the published ones.

    Args:
        settings: How to search.
        seed: Seed of the candidates and the starts.
        avoid: Whether self-collision is avoided.
    """
    arm, rng, begun = Arm.load(), np.random.default_rng(seed), process_time()
    rows = Watched(arm.rows)
    workspace = Workspace.create(arm.problem, arm.collisions() if avoid else None)
    search = planning.Search(
        rows,
        workspace,
        CRITERIA["condition"],
        np.zeros((len(arm.kept), len(arm.kept))),
        workspace.candidates(settings.candidates, rng),
        POSES,
        rng,
        starts=settings.starts,
    )
    found = search.run("auto")
    seconds = process_time() - begun
    q = np.radians(np.round(np.degrees(found.q), 2))
    if not workspace.inside(q, found.aim).all():
        q = found.q
    return Search(
        q=q,
        condition=condition(arm, q),
        evaluations=np.arange(1.0, len(rows.conditions) + 1.0),
        best=np.minimum.accumulate(rows.conditions),
        seconds=seconds,
    )


def swarm(settings: Settings, seed: int) -> Search:
    """The published search: an improved particle swarm.

    Size and length of the published one are lost.
    """
    arm, size, begun = Arm.load(), [], process_time()

    def costs(members: Floats) -> Floats:
        size.append(len(members))
        return conditions(arm, members.reshape(len(members), POSES, -1))

    found = particle_swarm(
        costs,
        np.tile(arm.bounds, (POSES, 1)),
        np.random.default_rng(seed),
        ParticleSwarm(particles=settings.particles, iterations=settings.iterations),
    )
    history = found.best_history
    return Search(
        q=found.x.reshape(POSES, -1),
        condition=float(history[-1]),
        evaluations=np.cumsum(size, dtype=float)[: len(history)],
        best=history,
        seconds=process_time() - begun,
    )


# --- calibration -------------------------------------------------------------------


@dataclass(frozen=True)
class Noisy:
    """A calibration from noisy poses.

    Attributes:
        errors: Relative errors of the linear combinations, shape (33,).
        tip: Errors along the trajectory.
    """

    errors: Floats
    tip: TipErrors


@dataclass(frozen=True)
class Judgment:
    """The calibration from exact poses at six configurations.

    Attributes:
        q: The configurations, shape (6, 7) [rad].
        singular_values: Of the published matrix, shape (34,).
        linear: Relative errors of the linear combinations after one linear step, shape
            (33,).
        solved: The same after our calibration, of identifiable true errors.
        tip_linear: Errors along the trajectory after the linear step.
        tip_solved: The same after our calibration.
        verdict: Verdict of the calibration.
    """

    q: Floats
    singular_values: Floats
    linear: Floats
    solved: Floats
    tip_linear: TipErrors
    tip_solved: TipErrors
    verdict: str

    @property
    def condition(self) -> float:
        """Condition number of the published matrix."""
        return float(self.singular_values[0] / self.singular_values[-1])


def motion(settings: Settings) -> Trajectory:
    """The published trajectory."""
    return trapezoidal(
        settings.start,
        settings.goal,
        settings.velocity,
        settings.acceleration,
        settings.period,
    )


def nominal_errors(settings: Settings) -> TipErrors:
    """Errors of the nominal arm along the trajectory."""
    arm = Arm.load()
    return _along(arm, motion(settings).q, np.zeros_like(arm.preset))


def linear_step(arm: Arm, q: Floats) -> Floats:
    """Errors by one linear least-squares step from exact poses, shape (P,)."""
    data = arm.measure(q, arm.preset, {}, 0)
    nominal = arm.poses(q, np.zeros_like(arm.preset))
    residual = SpatialTwist().residual(nominal, np.zeros(0), data).reshape(-1)
    A = arm.rows.rows(q, np.zeros(len(q), int)).reshape(len(residual), -1)
    theta = np.zeros_like(arm.preset)
    theta[list(arm.kept)] = np.linalg.lstsq(A, -residual, rcond=None)[0]
    return theta


def judge(settings: Settings, q: Floats) -> Judgment:
    """Calibrate with exact poses at some configurations, shape (6, 7) [rad]."""
    arm, along = Arm.load(), motion(settings).q
    step = linear_step(arm, q)
    solved, verdict, _ = _calibrate(arm, arm.measure(q, arm.truth, {}, 0), along)
    _, _, tip_solved = _calibrate(arm, arm.measure(q, arm.preset, {}, 0), along)
    return Judgment(
        q=q,
        singular_values=singular_values(arm, q),
        linear=arm.relative_errors(step),
        solved=arm.relative_errors(solved),
        tip_linear=_along(arm, along, step),
        tip_solved=tip_solved,
        verdict=verdict,
    )


def with_noise(
    settings: Settings, sets: Mapping[str, Floats], seed: int
) -> dict[str, Noisy]:
    """Calibrate with noisy poses at several sets of configurations."""
    arm, along, result = Arm.load(), motion(settings).q, {}
    for name, q in sets.items():
        noisy = partial(arm.measure, q, noise=dict(settings.noise), seed=seed)
        theta, _, _ = _calibrate(arm, noisy(arm.truth), along)
        # Along the trajectory the preset arm counts, gauge or not.
        _, _, tip = _calibrate(arm, noisy(arm.preset), along)
        result[name] = Noisy(arm.relative_errors(theta), tip)
    return result


def _calibrate(
    arm: Arm, rows: Measurements, along: Floats
) -> tuple[Floats, str, TipErrors]:
    """Errors (P,), verdict, and errors of the preset arm's tool after a calibration."""
    chain, setup = arm.problem.chains, arm.problem.setup
    found = calib_pin.calibrate(chain, rows, setup, validate=False)
    theta = np.array([parameter.value for parameter in found.parameters])
    tip = tip_errors(arm.poses(along, arm.preset), found.model.of().poses(along))
    return theta, found.verdict, tip


def _along(arm: Arm, q: Floats, theta: Floats) -> TipErrors:
    return tip_errors(arm.poses(q, arm.preset), arm.poses(q, theta))


@dataclass(frozen=True)
class Study:
    """All results.

    Attributes:
        nominal: Errors of the nominal arm along the trajectory.
        random: Condition numbers of random sets.
        ours: Our search.
        apart: Our search without self-collision.
        swarms: Runs of the published search.
        judged: Calibrations from exact poses, by set.
        noisy: Calibrations from noisy poses, seed by seed and by set.
    """

    nominal: TipErrors
    random: Floats
    ours: Search
    apart: Search
    swarms: Sequence[Search]
    judged: Mapping[str, Judgment]
    noisy: Sequence[Mapping[str, Noisy]]


def study(settings: Settings, seeds: int) -> Study:
    """Search and calibrate.

    Args:
        settings: The settings of search and simulation.
        seeds: Number of seeds of the noise; the swarms have no more.
    """
    arm = Arm.load()
    searches: list[Callable[[], Search]] = [
        partial(optimize, settings, 0),
        partial(optimize, settings, 0, avoid=True),
        *(partial(swarm, settings, k) for k in range(min(settings.swarms, seeds))),
    ]
    ours, apart, *swarms = shared.each(_run, searches, "search")
    sets = {name: arm.configurations(name) for name in PUBLISHED} | {OURS: apart.q}
    return Study(
        nominal=nominal_errors(settings),
        random=random_conditions(arm, settings.draws, np.random.default_rng(0)),
        ours=ours,
        apart=apart,
        swarms=swarms,
        judged={name: judge(settings, q) for name, q in sets.items()},
        noisy=shared.each(partial(with_noise, settings, sets), range(seeds), "seed"),
    )


def _run(search: Callable[[], Search]) -> Search:
    return search()
