"""Errors of fits against what is said of them, with gears that the model lacks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import pytest
from scipy.stats import multivariate_normal

import calib_pin
from calib_pin.estimation.fit import fit, with_effects
from calib_pin.estimation.fitted import (
    PARTS,
    Fit,
    Posterior,
    expected_sizes,
)
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.statistics.variance_components import Systematic
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations
from calib_pin.setup import FrameSetup, Setup

SETUP = Setup(tool_frame=FrameSetup((0.05, 0.08, 0.12), (0.2, -0.3, 0.1)))
MORE = ("placement", "transmission", "compliance")


@dataclass(frozen=True)
class Job:
    """A calibration of a robot with gears and compliance, and the true robot."""

    true: Problem
    theta: Floats
    fitted: Fit
    effects: Systematic | None
    posterior: Posterior

    def deviations(self, q: Floats) -> tuple[Floats, Floats]:
        """Errors of the tool's position, and their standard deviations, (N, 3)."""
        true, found = (
            poses(problem, theta, q)
            for problem, theta in (
                (self.true, self.theta),
                (self.fitted.problem, self.fitted.theta),
            )
        )
        missed = found[:, :3, 3] - true[:, :3, 3]
        squares = np.sum(twists(self.fitted, q)[:, :3] ** 2, axis=2)
        return np.einsum("nji,nj->ni", found[:, :3, :3], missed), np.sqrt(squares)


def poses(problem: Problem, theta: Floats, q: Floats) -> Floats:
    """Poses of the tool, shape (N, 4, 4)."""
    term = problem.only
    return term.error.poses(q, term.values(theta)[0])


def twists(found: Fit, q: Floats) -> Floats:
    """Deviations of the tool, shape (N, 6, r + S)."""
    term = found.problem.only
    _, J = term.error.jacobian(q, term.values(found.theta)[0])
    return found.posterior.twists(found.problem.rebased(found.theta)[0].only, q, J)


def job(seed: int, times: float, *, repeats: int = 1, noise: float = 2e-5) -> Job:
    """A PA10 measured with effects that displace the tool by so many deviations."""
    rng = np.random.default_rng(seed)
    chain = calib_pin.load_chain("pa10")
    plain = nominal_problem(chain, "position", SETUP)
    true = nominal_problem(chain, "position", replace(SETUP, parameters=MORE))
    known = set(plain.parameters.names)
    names = true.parameters.names
    drawn = calib_pin.draw_errors(plain.parameters, rng)
    values = dict(zip(plain.parameters.names, drawn, strict=True))
    geometry = np.array([values.get(name, 0.0) for name in names])
    effects = true.parameters.scales * rng.normal(size=len(names))
    away = [k for k, n in enumerate(names) if n in known or n.endswith("gain")]
    effects[away] = 0.0
    q = chain.random_configurations(50, rng)
    T = [poses(true, x, q) for x in (effects, 0 * effects)]
    size = np.sqrt(np.mean((T[0] - T[1])[:, :3, 3] ** 2))
    theta = geometry + times * noise / size * effects
    rows = calib_pin.simulate(
        true, theta, rng, count=150 // repeats, noise=noise, repeats=repeats
    )
    data = Observations.of(replace(rows.only, sigma=None))
    problem = replace(plain, data=data)
    fitted = with_effects(fit(problem, np.random.default_rng(0)))
    return Job(true, theta, fitted, fitted.effects, fitted.posterior)


@pytest.fixture(scope="module")
def found() -> Job:
    """A job with effects of ten deviations."""
    return job(0, 10.0)


def test_effects_are_found_and_their_noise_is_the_true_one(found: Job) -> None:
    assert found.effects is not None
    assert set(found.effects.kinds) == {"transmission", "compliance"}
    assert (found.effects.sizes > 0.0).all()
    unit = 1e-4 * found.fitted.problem.units[0]
    # 350 redundancies beside 31 parameters and 35 effects: three deviations are 11 %.
    assert unit * found.effects.noise[0] ** 0.5 == pytest.approx(2e-5, rel=0.12)


@pytest.mark.parametrize("times", [0.0, 10.0])
def test_predicted_errors_of_the_tool_are_the_true_ones(times: float) -> None:
    """Those at the configurations of a job move together: some jobs make a mean."""
    ratios = []
    for seed in range(3):
        one, rng = job(seed, times), np.random.default_rng(1)
        q = one.true.only.error.chain.random_configurations(40, rng)
        error, deviation = one.deviations(q)
        ratios.append(np.sum(error**2) / np.sum(deviation**2))
    assert 0.6 < np.sqrt(np.mean(ratios)) < 1.5


# Several blocks.


SIZES = np.array([0.5, 5.0])


def estimates(seed: int, count: int) -> tuple[Floats, Floats, Floats]:
    """Estimates of errors of two kinds that show together, and their variances."""
    rng = np.random.default_rng(seed)
    half = rng.normal(size=(count, 2 * (count // 2))) / np.sqrt(count)
    variances = rng.uniform(1e-4, 1e-3, count)
    errors = np.repeat(SIZES, count // 2) * rng.normal(size=half.shape[1])
    noise = np.sqrt(variances) * rng.normal(size=count)
    return half @ errors + noise, variances, half


def kinds(half: Floats) -> np.ndarray:
    return np.repeat([0, 1], half.shape[1] // 2)


@pytest.mark.parametrize("count", [2, 30])
def test_one_kind_against_a_grid(count: int) -> None:
    """The likeliest size, and the distribution of sizes that its parts stand for."""
    rng = np.random.default_rng(count)
    variances = 10.0 ** rng.uniform(-4.0, 0.0, count)
    values = np.sqrt(4.0 + variances) * rng.normal(size=count)
    sizes, parts = expected_sizes(
        values, variances, np.eye(count), 0 * np.arange(count)
    )
    grid = np.geomspace(1e-3, 1e3, 601)
    total = grid[:, None] ** 2 + variances
    terms = np.sum(np.log(total) + values**2 / total, axis=1)
    terms += 2.0 * (np.log(grid**2) + grid**-2.0)
    assert sizes[0] == pytest.approx(grid[np.argmin(terms)])
    below = np.cumsum(np.exp(0.5 * (terms.min() - terms)))
    middles = (np.arange(PARTS) + 0.5) / PARTS
    expected = grid[np.searchsorted(below, middles * below[-1])]
    # Chi-square has the curvature of the likelihood, not all of its shape.
    np.testing.assert_allclose(parts[0], expected, rtol=0.15)


def test_kinds_of_errors_have_sizes_of_their_own() -> None:
    """None of both can be changed alone, or with the other, for a higher evidence."""
    values, variances, half = estimates(3, 40)
    sizes, parts = expected_sizes(values, variances, half, kinds(half))
    np.testing.assert_allclose(sizes, SIZES, rtol=0.5)
    assert (parts[:, 0] < sizes).all() and (sizes < parts[:, -1]).all()

    def evidence(sizes: Floats) -> float:
        scaled = half * sizes[kinds(half)]
        cov = np.diag(variances) + scaled @ scaled.T
        told = multivariate_normal(cov=cov).logpdf(values)
        return float(told - np.sum(np.log(sizes**2) + sizes**-2.0))

    best = evidence(sizes)
    for factors in product((0.9, 1.0, 1.1), repeat=2):
        assert factors == (1.0, 1.0) or evidence(sizes * factors) < best


def test_exact_estimates_beside_large_errors_of_another_kind() -> None:
    """The covariance of both cannot be told from a singular one."""
    half = np.zeros((4, 2))
    half[:2, 0] = half[2:, 1] = 1.0
    values = 1e3 * half[:, 0] + 1e-5 * np.array([1.0, -1.0, 2.0, -1.0])
    every = np.hstack([half, 1e-5 * np.eye(4)])
    sizes, _ = expected_sizes(
        values, np.full(4, 1e-20), every, np.array([0, 0, 1, 1, 1, 1])
    )
    assert sizes[0] > 100.0 and 0.3 < sizes[1] < 3.0
