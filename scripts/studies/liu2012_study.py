"""Liu, Ni, Liu, Xu 2012 (doi 10.1007/s11771-012-1095-1): a laser distance sensor.

A six-joint arm measures distances to an inclined plane; differential evolution with
several mutations finds its DH errors together with those of the plane. The nominal
table of the publication is lost: `space6` has the same structure with lengths of our
own. Its preset errors are lost too: here they are drawn, seed by seed.

Three motions are unobservable: a rotation of robot and plane about z of the base, a
shift along it, and a rotation about the beam. Errors of poses are therefore judged
after an alignment by these three, one of each for all poses of a set.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

import calib_pin
from calib_pin.estimation.fit import fit
from calib_pin.estimation.fitted import with_prior
from calib_pin.estimation.formulation import make_problem, nominal_problem
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.solve import PopulationCost
from calib_pin.kinematics.spatial import Floats, so3_log
from calib_pin.measurement_models.plane_distance import PlaneDistance
from calib_pin.measurement_models.references import Plane
from calib_pin.setup import SolverSetup
from calib_pin.solvers import (
    DifferentialEvolution,
    differential_evolution,
    gauss_newton,
)
from calib_pin.solvers.differential_evolution import STRATEGIES, TRADEOFF
from studies.shared import summary

MUTATIONS = tuple(name for name in STRATEGIES if name != "tradeoff")
"""`tradeoff` is one of the others, and not run twice."""

LEAST_SQUARES = "least squares"
"""Gauss-Newton in the same parameters, the optimum of an evolution."""


NONE: Floats = np.empty(0)
"""The history of a solution without an evolution."""


@dataclass(frozen=True)
class Settings:
    """The simulation and the search; lengths in m, angles in rad.

    Attributes:
        counts: Configurations that are measured, case by case.
        repeats: Readings per configuration, averaged.
        noise: Standard deviation of a reading.
        validation: Configurations for validation.
        size: Largest DH error.
        plane: Errors of n_x and n_z, with n_y and the offset as they are.
        start: Least largest distance error of the nominal robot; else drawn again.
        box: Half width of the search for DH errors.
        plane_box: The same for the plane's u, v and f.
        population: Members Np.
        mutation: Factor F.
        recombination: CR.
        generations: Limit G.
        target: The search ends at this sum of squared distance errors V, m^2.
        mutations: Mutations that are compared.
    """

    counts: tuple[int, ...] = (35, 100)
    repeats: int = 10
    noise: float = 0.2e-3
    validation: int = 20
    size: float = 3e-3
    plane: tuple[float, float] = (0.005, 0.01)
    start: float = 30e-3
    box: float = 10e-3
    plane_box: tuple[float, float, float] = (0.03, 0.03, 0.01)
    population: int = 150
    mutation: float = 0.6
    recombination: float = 0.9
    generations: int = 500
    target: float = 1e-10
    mutations: tuple[str, ...] = MUTATIONS


@dataclass(frozen=True)
class Validation:
    """Errors on the validation configurations, K each.

    Attributes:
        distance: Distances [m].
        position: Tool positions [m], aligned.
        orientation: Tool orientations [rad], aligned.
        position_found: Tool positions, not aligned [m].
        orientation_found: Tool orientations, not aligned [rad].
    """

    distance: Floats
    position: Floats
    orientation: Floats
    position_found: Floats
    orientation_found: Floats


@dataclass(frozen=True)
class Outcome:
    """A solution.

    Attributes:
        squares: Sum of squared distance errors [m^2].
        errors: Distance errors on the calibration configurations [m].
        validation: Errors on the validation configurations.
        history: Least sum of squares so far [m^2] after every 150 evaluations, or
            whatever the size of the population; empty without an evolution.
    """

    squares: float
    errors: Floats
    validation: Validation
    history: Floats

    @property
    def largest(self) -> float:
        """Largest distance error on the calibration configurations [m]."""
        return float(np.abs(self.errors).max())

    def numbers(self) -> dict[str, object]:
        """The numbers that are written."""
        return {
            "squares_m2": self.squares,
            "largest_distance_error_m": self.largest,
            "validation": {
                name: summary(values, "rad" if name.startswith("orient") else "m")
                for name, values in vars(self.validation).items()
            },
        }


@dataclass(frozen=True)
class Case:
    """One seed with one number of configurations.

    Attributes:
        before: The nominal robot.
        truth: The true robot.
        outcomes: Solutions by mutation, and by least squares.
        fits: Costs of `calib_pin.estimation.fit` by solver.
    """

    before: Outcome
    truth: Outcome
    outcomes: Mapping[str, Outcome]
    fits: Mapping[str, float]

    def __getitem__(self, name: str) -> Outcome:
        """A solution, or the `nominal` or `truth` robot."""
        robots = {"nominal": self.before, "truth": self.truth}
        return robots[name] if name in robots else self.outcomes[name]

    @property
    def difference(self) -> float:
        """Difference of chi-square, twice the cost, of hybrid and Gauss-Newton."""
        return 2.0 * abs(self.fits["hybrid"] - self.fits["gauss-newton"])

    def numbers(self) -> dict[str, object]:
        """The numbers that are written."""
        compared = {name: self[name].errors for name in ("nominal", TRADEOFF)}
        robots = {"nominal": self.before, "truth": self.truth}
        return {
            **robots,
            **self.outcomes,
            "distance_errors_m": compared,
            "fit_cost": self.fits,
        }


@dataclass(frozen=True)
class Seed:
    """All cases of one seed, of one robot.

    Attributes:
        redrawn: How often the errors were drawn again.
        cases: By number of configurations.
    """

    redrawn: int
    cases: Mapping[int, Case]


def plane_errors(plane: Plane, dn_x: float, dn_z: float) -> Floats:
    """Parameters (u, v, f) of a plane with other n_x and n_z.

    Args:
        plane: A plane.
        dn_x: Added to n_x of `n . p + f = 0`, where n_y is 1.
        dn_z: Added to n_z.
    """
    assert plane.normal is not None
    length = 1.0 / plane.normal[1]
    normal = plane.normal * length + [dn_x, 0.0, dn_z]
    offset = plane.offset * length / np.linalg.norm(normal)
    normal = normal / np.linalg.norm(normal)
    # Exp(u t_1) Exp(v t_2) n_0 = sin(v) t_1 + cos(v) (cos(u) n_0 - sin(u) t_2).
    t_1, t_2 = plane.tangents
    v = np.arcsin(t_1 @ normal)
    u = np.arctan2(-t_2 @ normal, plane.normal @ normal)
    return np.array([u, v, offset - plane.offset])


def study(settings: Settings, seed: int) -> Seed:
    """Simulate and solve all cases of one seed."""
    chain = calib_pin.load_chain("space6")
    setup = calib_pin.read_setup(calib_pin.robot_file("space6", "setup.yaml"))
    nominal = nominal_problem(chain, "plane-distance", setup)
    rng = np.random.default_rng(seed)
    tried = 0
    while True:
        truth = _truth(nominal, settings, rng)
        measure = partial(calib_pin.simulate, nominal, truth, rng)
        problems = {}
        for count in settings.counts:
            # The mean of independent readings, drawn at once.
            noise = settings.noise / np.sqrt(settings.repeats)
            rows = measure(count=count, noise=noise)
            problems[count] = make_problem(chain, rows, setup)
        zero = np.zeros(len(truth))
        starts = [np.abs(p.errors(zero)).max() for p in problems.values()]
        if min(starts) > settings.start:
            break
        tried += 1
    rows = calib_pin.simulate(nominal, truth, rng, count=settings.validation, noise=0)
    unseen = replace(nominal, data=rows)
    cases = {
        count: solve(problem, unseen, truth, settings, seed)
        for count, problem in problems.items()
    }
    return Seed(tried, cases)


def _truth(nominal: Problem, settings: Settings, rng: np.random.Generator) -> Floats:
    """True parameters: DH errors by chance, the plane as published, shape (P,)."""
    parameters, model = nominal.parameters, nominal.only.measurement
    assert isinstance(model, PlaneDistance)
    drawn = rng.uniform(-settings.size, settings.size, len(parameters))
    truth = np.where(parameters.free, drawn, 0.0)
    truth[-3:] = plane_errors(model.planes[0], *settings.plane)
    return truth


def solve(
    problem: Problem, unseen: Problem, truth: Floats, settings: Settings, seed: int
) -> Case:
    """Solve one case in every way.

    Args:
        problem: The measurements.
        unseen: The validation configurations, with exact distances.
        truth: True parameters, shape (P,).
        settings: How to search.
        seed: Seed of the searches.
    """
    judge = partial(_outcome, problem, unseen, truth)
    free = np.diag(problem.parameters.scales)[:, problem.parameters.free]
    nominal = np.zeros(len(truth))
    best = gauss_newton(problem.linearize, problem.cost, nominal, free)
    outcomes = {LEAST_SQUARES: judge(best.x)}
    for mutation in settings.mutations:
        # All begin with the same population.
        rng = np.random.default_rng([seed, len(problem.data)])
        outcomes[mutation] = judge(*_evolve(problem, mutation, settings, rng))
    fits = {}
    for name in ("gauss-newton", "hybrid"):
        solver = SolverSetup(name, {"maxiter": settings.generations})
        setup = replace(problem.setup, solver=solver)
        fitted = fit(replace(problem, setup=setup), np.random.default_rng(seed))
        # At its minimum two solutions are told apart by what both minimize.
        rows = with_prior(fitted)[1].fun
        fits[name] = 0.5 * float(rows @ rows)
    return Case(judge(nominal), judge(truth), outcomes, fits)


def _evolve(
    problem: Problem, mutation: str, settings: Settings, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Parameters (P,) and history (G + 1,) [m^2] of an evolution in all parameters."""
    free = problem.parameters.free
    costs = PopulationCost(problem, threads=1)

    def of_free(members: Floats) -> Floats:
        theta = np.zeros((len(members), len(free)))
        theta[:, free] = members
        return costs(theta)

    half = np.full(np.count_nonzero(free), settings.box)
    half[-3:] = settings.plane_box
    # Half the whitened sum of squares, in place of the sum of squares.
    whitened = 0.5 / problem.sigma[0] ** 2
    options = DifferentialEvolution(
        strategy=mutation,
        population_size=settings.population,
        mutation=settings.mutation,
        recombination=settings.recombination,
        maxiter=settings.generations,
        target=settings.target * whitened,
        tol=0.0,
    )
    found = differential_evolution(
        of_free, np.column_stack([-half, half]), rng, options
    )
    x = np.zeros(len(free))
    x[free] = found.x
    # Where the target was reached, nothing changes any more.
    rest = settings.generations + 1 - len(found.best_history)
    return x, np.pad(found.best_history, (0, rest), mode="edge") / whitened


def _outcome(
    problem: Problem,
    unseen: Problem,
    truth: Floats,
    x: Floats,
    history: Floats = NONE,
) -> Outcome:
    """Judge a solution x, shape (P,)."""
    errors = problem.errors(x)
    validation = _validation(unseen, truth, x)
    return Outcome(float(errors @ errors), errors, validation, history)


def _validation(unseen: Problem, truth: Floats, x: Floats) -> Validation:
    """Errors of a solution x, shape (P,), on the validation configurations."""
    true, found = (
        unseen.only.error.poses(unseen.data.q, unseen.only.values(theta)[0])
        for theta in (truth, x)
    )
    seen = aligned(found, true)
    return Validation(
        distance=np.abs(unseen.errors(x)),
        position=_position(seen, true),
        orientation=_orientation(seen, true),
        position_found=_position(found, true),
        orientation_found=_orientation(found, true),
    )


def _position(T: Floats, true: Floats) -> Floats:
    return np.asarray(np.linalg.norm((T - true)[:, :3, 3], axis=1))


def _orientation(T: Floats, true: Floats) -> Floats:
    R = true[:, :3, :3].transpose(0, 2, 1) @ T[:, :3, :3]
    return np.asarray(np.linalg.norm(so3_log(R), axis=1))


def aligned(T: Floats, true: Floats) -> Floats:
    """Poses aligned to the true ones by the unobservable motions.

    Rotated about and shifted along z of the base by the positions, then rotated about
    the beams by the orientations.

    Args:
        T: Tool poses in the base, shape (K, 4, 4).
        true: Those of the true robot.
    """
    p, p_true = T[:, :3, 3], true[:, :3, 3]
    sine = np.sum(p[:, 0] * p_true[:, 1] - p[:, 1] * p_true[:, 0])
    base = _turn(np.arctan2(sine, np.sum(p[:, :2] * p_true[:, :2])))
    base[2, 3] = np.mean(p_true[:, 2] - p[:, 2])
    turned = base @ T
    M = np.sum(true[:, :3, :3].transpose(0, 2, 1) @ turned[:, :3, :3], axis=0)
    return np.asarray(turned @ _turn(np.arctan2(M[0, 1] - M[1, 0], M[0, 0] + M[1, 1])))


def _turn(angle: float) -> Floats:
    """A rotation about z, shape (4, 4)."""
    c, s = np.cos(angle), np.sin(angle)
    result = np.eye(4)
    result[:2, :2] = [[c, -s], [s, c]]
    return result
