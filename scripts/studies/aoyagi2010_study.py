"""Aoyagi et al. 2010 (IROS, Mitsubishi PA10): a network for the errors beyond geometry.

A laser tracker measures a reflector on a seven-joint arm. Its geometry is calibrated
by least squares; joint compliance under gravity and gears leave errors well above the
noise, and a neural network learns them as corrections of the joint positions inside the
forward kinematics. A genetic algorithm selects the points by the observability
index O1 of Borm and Menq. All is judged on validation configurations.

The nominal table and the results of the publication are lost: `pa10` has the public
lengths, and its hidden errors are drawn here, seed by seed.

The noise floor is the error that noise alone leaves: a model of the right structure,
with errors of placement, transmission and compliance, is unbiased, so its least-squares
fit has the covariance of the Cramer-Rao bound. The floor is the mean distance of the
reflector by parameter errors of that covariance, over the validation configurations. It
depends on the measured points, and falls with the root of their number.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

import calib_pin
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.planning.criteria import CRITERIA, Information
from calib_pin.planning.planned_problem import identification
from calib_pin.planning.rows import IdentificationRows
from calib_pin.planning.suggestions import ASSUMED_TOOL
from calib_pin.planning.workspace import Workspace
from calib_pin.setup import FrameSetup, Setup
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.result import CalibrationResult
from calib_pin.validation.tool_accuracy import SAMPLES
from studies.shared import summary

MODELS = {
    "nominal": Setup(parameters=()),
    "geometric": Setup(parameters=("placement",)),
    "network": Setup(parameters=("placement",), learned="network"),
    "structure": Setup(parameters=("placement", "transmission", "compliance")),
}
"""Setups of the models; tracker and reflector are estimated in each."""

RANDOM, GENETIC = "random", "genetic"
"""The two ways to choose points."""

COMPLIANCE = (2e-5, 4e-5, 4e-5, 6e-5, 1e-4, 1e-4, 1e-4)
"""True compliance of every joint [rad/Nm]."""

TRACKER = FrameSetup(xyz=(1.5, -2.0, 0.5), rpy=(0.1, -0.2, 2.0))
"""True placement of the robot base in the tracker."""

REFLECTOR = FrameSetup(xyz=(0.06, -0.04, 0.03))
"""True position of the reflector on the tool, beside the last axis."""

DRAWS = 400
"""Draws of parameter errors behind a noise floor, for half a percent of precision."""


@dataclass(frozen=True)
class Settings:
    """The simulation and the selection; lengths in m, angles in rad.

    Attributes:
        counts: Numbers of points that are measured.
        genetic: Largest number of points that the genetic algorithm chooses; it takes
            a thousand candidates of which a thousand would be no choice.
        candidates: Candidates of the selection.
        verification: Number of validation configurations.
        noise: Standard deviation of every coordinate.
        length: Largest geometric error.
        angle: The same of angles.
        harmonics: Amplitudes of the first and the second harmonic of every joint.
    """

    counts: tuple[int, ...] = (40, 100, 300, 1000)
    genetic: int = 300
    candidates: int = 1000
    verification: int = 1000
    noise: float = 5e-6
    length: float = 2e-3
    angle: float = 3e-3
    harmonics: tuple[float, float] = (3e-4, 1e-4)


@dataclass(frozen=True)
class Selection:
    """A set of points chosen by the genetic algorithm for the nominal robot.

    Attributes:
        q: The points, shape (N, n) [rad].
        median: Median of O1 over random sets of the candidates.
        seconds: Time it took.
    """

    q: Floats
    median: float
    seconds: float


@dataclass(frozen=True)
class Case:
    """One robot measured at one set of points.

    Attributes:
        observability: O1 of the points.
        errors: Distances to the true positions at the validation configurations by
            model, shape (K,) each [m].
        floor: The noise floor [m].
        spread: Standard deviation, from one measurement of the same points to another,
            of the mean error that noise leaves [m].
        rank: Rank of the model of the right structure.
        outside: Part of the validation configurations so far from all measured ones
            that the correction of the network fades.
    """

    observability: float
    errors: Mapping[str, Floats]
    floor: float
    spread: float
    rank: int
    outside: float

    def mean(self, model: str) -> float:
        """Mean error of a model at the validation configurations [m]."""
        return float(self.errors[model].mean())

    def ratio(self, model: str) -> float:
        """Mean error of a model over the noise floor."""
        return self.mean(model) / self.floor

    @property
    def improvement(self) -> float:
        """Factor by which the network lowers the mean error of geometry alone."""
        return self.mean("geometric") / self.mean("network")

    def numbers(self) -> dict[str, float]:
        """The numbers that are written."""
        errors = {
            f"{model}_{key}": value
            for model, distances in self.errors.items()
            for key, value in summary(distances, "m").items()
        }
        return {
            "O1": self.observability,
            **errors,
            "noise_floor_m": self.floor,
            "noise_floor_spread_m": self.spread,
            "network_over_floor": self.ratio("network"),
            "structure_over_floor": self.ratio("structure"),
            "geometric_over_network": self.improvement,
            "structure_rank": self.rank,
            "outside_trained_region": self.outside,
        }


Cases = Mapping[int, Mapping[str, Case]]
"""Cases of one seed by number of points and by how they were chosen."""


@cache
def robot() -> Chain:
    """The nominal robot."""
    return calib_pin.load_chain("pa10")


def genetic_set(settings: Settings, count: int) -> Selection:
    """Select points with the largest O1 of the geometric model, before any is measured.

    Args:
        settings: The settings of the selection.
        count: Number N of points.
    """
    started = time.perf_counter()
    found = calib_pin.plan(
        robot(),
        "position",
        count,
        _geometric(settings),
        criterion="O1",
        method="ga",
        candidates=settings.candidates,
    )
    return Selection(found.q, found.random, time.perf_counter() - started)


def _geometric(settings: Settings) -> Setup:
    return Setup(parameters=("placement",), noise={"position": settings.noise})


def observability(settings: Settings, q: Floats) -> float:
    """O1 of the geometric model at some points, shape (N, n), as in planning."""
    rows = _rows(settings.noise)
    J = rows.rows(q, np.zeros(len(q), int)).reshape(-1, rows.basis.shape[1])
    found = Information.of(J.T @ J, rows.nuisances)
    assert found is not None
    return CRITERIA["O1"].value(found, len(q))


@cache
def _rows(noise: float) -> IdentificationRows:
    """The identification matrix, with the reflector at the tool assumed in planning."""
    nominal = nominal_problem(robot(), "position", _geometric(Settings(noise=noise)))
    part = nominal.only
    error = part.error.with_frames(part.error.base, ASSUMED_TOOL)
    problem = replace(nominal, terms={part.key: replace(part, error=error)})
    workspace = Workspace.create(problem)
    spread = workspace.candidates(SAMPLES, np.random.default_rng(0))
    _, rows, _ = identification(problem, workspace.aims, spread)
    return rows


def truth(settings: Settings, rng: np.random.Generator) -> tuple[Problem, Floats]:
    """The true robot, tracker and reflector: a problem without data, (P,) values.

    Args:
        settings: How large the errors are.
        rng: Random generator.
    """
    setup = Setup(
        parameters=MODELS["structure"].parameters,
        base_frame=TRACKER,
        tool_frame=REFLECTOR,
    )
    problem = nominal_problem(robot(), "position", setup)
    errors = dict(_errors(settings, rng))
    return problem, problem.parameters.vector(errors)


def _errors(
    settings: Settings, rng: np.random.Generator
) -> Iterator[tuple[str, float]]:
    """True errors by parameter name."""
    for joint, compliance in zip(robot().joints, COMPLIANCE, strict=True):
        for names, largest in (
            (("x", "y", "z"), settings.length),
            (("rx", "ry", "rz"), settings.angle),
        ):
            for name in names:
                yield f"{joint}.placement.{name}", rng.uniform(-largest, largest)
        for k, amplitude in enumerate(settings.harmonics, 1):
            phase = rng.uniform(0.0, 2.0 * np.pi)
            yield f"{joint}.transmission.sin{k}", amplitude * np.cos(phase)
            yield f"{joint}.transmission.cos{k}", amplitude * np.sin(phase)
        yield f"{joint}.compliance.k", compliance


def study(settings: Settings, selected: Mapping[int, Selection], seed: int) -> Cases:
    """Draw a robot, measure it at all sets of points, and judge all models.

    Args:
        settings: The settings of the simulation.
        selected: The genetic selections, by number of points.
        seed: Seed of the robot, the random points and the noise.
    """
    chain, rng = robot(), np.random.default_rng(seed)
    problem, theta = truth(settings, rng)
    unseen = chain.random_configurations(settings.verification, rng)
    true = problem.only.error.poses(unseen, problem.only.values(theta)[0])[:, :3, 3]
    # A smaller random set is the beginning of a larger one.
    drawn = chain.random_configurations(max(settings.counts), rng)
    cases: dict[int, dict[str, Case]] = {}
    for count in settings.counts:
        sets = {RANDOM: drawn[:count]}
        if count in selected:
            sets[GENETIC] = selected[count].q
        cases[count] = {}
        for name, q in sets.items():
            rows = calib_pin.simulate(problem, theta, rng, q=q, noise=settings.noise)
            fitted = {
                model: calib_pin.calibrate(chain, rows, setup, validate=False)
                for model, setup in MODELS.items()
            }
            floor, spread = noise_floor(fitted["structure"], unseen)
            cases[count][name] = Case(
                observability=observability(settings, q),
                errors={
                    model: _distances(result.model, unseen, true)
                    for model, result in fitted.items()
                },
                floor=floor,
                spread=spread,
                rank=fitted["structure"].identifiability.rank,
                outside=float(fitted["network"].model.of().outside(unseen).mean()),
            )
    return cases


def _distances(model: CalibratedModel, q: Floats, true: Floats) -> Floats:
    """Distances to the true positions, shape (K,) [m]."""
    predicted = model.of().poses(q)[:, :3, 3]
    return np.asarray(np.linalg.norm(predicted - true, axis=1))


def noise_floor(result: CalibrationResult, q: Floats) -> tuple[float, float]:
    """Mean error of the position that noise alone leaves, and its spread [m].

    The model is linear over errors as small as those that noise leaves, so it is enough
    to draw parameter errors of the fit's covariance. It scales with the stated
    standard deviations of the measurements, not with their residuals.

    Args:
        result: A fit of the right structure.
        q: Configurations, shape (K, n) [rad].

    Returns:
        The mean distance over configurations and draws, and the standard deviation over
        the draws of its mean over the configurations.
    """
    # The covariance is that of deviations from the registered frames.
    error = result.reference.only.error
    count = len(error.screws)
    _, J = error.jacobian(q, np.array([p.value for p in result.parameters[:count]]))
    J = J[:, :3]
    values, vectors = np.linalg.eigh(result.covariance[:count, :count])
    # Unobservable directions have a variance that is numerically zero.
    half = vectors * np.sqrt(np.maximum(values, 0.0))
    draws = np.random.default_rng(0).standard_normal((DRAWS, count)) @ half.T
    moved = (J.reshape(-1, count) @ draws.T).reshape(len(q), 3, DRAWS)
    means = np.linalg.norm(moved, axis=1).mean(axis=0)
    return float(means.mean()), float(means.std())
