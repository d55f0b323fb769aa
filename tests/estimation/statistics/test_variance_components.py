"""Noise of each quantity, and pure error and lack of fit from repetitions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.evidence import VarianceComponent
from calib_pin.estimation.fit import fit
from calib_pin.estimation.fitted import Fit, balanced, bounded
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.identifiability import half_covariance
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.solve import Solver
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import BlockKey, Observations
from calib_pin.setup import DistanceSetup, FrameSetup, PlaneSetup, PointSetup, Setup

TOOL = FrameSetup((0.05, 0.08, 0.12), (0.2, -0.3, 0.1), estimate=True)
CHAIN = calib_pin.load_chain("space6")
OFFSETS = Setup(parameters=("joint-offset",), tool_frame=TOOL)


def fitted(problem: Problem) -> Fit:
    return balanced(problem, Solver(problem, np.random.default_rng(0)))


def poses(
    seed: int, noise: tuple[float, float], *, sigma: float | None, count: int = 60
) -> Problem:
    """Poses of a robot with offsets, noise of position [m] and orientation [rad]."""
    sizes = dict(zip(("position", "orientation"), noise, strict=True))
    problem = nominal_problem(CHAIN, "pose", replace(OFFSETS, noise=sizes))
    rng = np.random.default_rng(seed)
    truth = calib_pin.draw_errors(problem.parameters, rng)
    rows = calib_pin.simulate(problem, truth, rng, count=count).only
    stated = None if sigma is None else np.full((count, 6), sigma)
    data = Observations.of(replace(rows, sigma=stated))
    return replace(nominal_problem(CHAIN, "pose", OFFSETS), data=data)


@pytest.mark.parametrize(
    ("noise", "sigma"), [((5e-4, 2e-5), None), ((2e-5, 5e-4), 1e-4)]
)
def test_position_and_orientation_are_balanced(
    noise: tuple[float, float], sigma: float | None
) -> None:
    """Given 0.1 mm and 0.1 mrad, five times too small and too large."""
    found = fitted(poses(0, noise, sigma=sigma))
    assert all(c.contradicted == (sigma is not None) for c in found.noise)
    assert found.sigma0 == pytest.approx(1.0, rel=1e-3)
    # 170 redundancies each: 5.4 % is one deviation.
    np.testing.assert_allclose([c.estimate for c in found.noise], noise, rtol=0.2)


def test_what_is_stated_is_tested() -> None:
    """Too small it is unmodeled error; each is rejected by chance once in twenty."""
    small, right = fitted(poses(4, (5e-4, 1e-4), sigma=1e-4)).noise
    assert small.contradicted and small.interval[0] < 5e-4 < small.interval[1]
    assert small.unmodeled == pytest.approx(np.sqrt(24.0) * 1e-4, rel=0.15)
    assert not right.contradicted and right.factor == 1.0 and right.unmodeled == 0.0
    assert right.interval[0] <= 1e-4 <= right.interval[1]
    # Nothing tells it from noise where that is only assumed.
    assumed = fitted(poses(4, (5e-4, 1e-4), sigma=None)).noise
    assert [c.unmodeled for c in assumed] == [None, None]
    both = fitted(poses(2, (1e-4, 1e-4), sigma=1e-4)).noise
    assert [c.factor for c in both] == [1.0, 1.0]


def test_one_quantity_is_fitted_once(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = nominal_problem(CHAIN, "position", OFFSETS)
    rng = np.random.default_rng(0)
    truth = calib_pin.draw_errors(problem.parameters, rng)
    rows = calib_pin.simulate(problem, truth, rng, count=40, noise=3e-4).only
    problem = replace(problem, data=Observations.of(replace(rows, sigma=None)))
    plain = bounded(problem, Solver(problem, np.random.default_rng(0)))
    monkeypatch.setattr("calib_pin.estimation.fitted.fit_in_units", None)
    found = fitted(problem)
    np.testing.assert_array_equal(found.theta, plain.theta)
    # The prior on offsets of 1 mrad says next to nothing of errors of 0.1 mrad.
    assert found.problem.units == pytest.approx([plain.sigma0], rel=1e-5)
    assert found.noise[0].estimate == pytest.approx(1e-4 * found.problem.units[0])
    assert found.problem.cost(found.theta) == pytest.approx(found.result.cost)


def test_few_and_exact_measurements_divide_by_nothing() -> None:
    """Two rows of one target determine its place and leave one redundancy at most."""
    few = fitted(poses(0, (3e-4, 3e-4), sigma=None, count=3)).noise
    assert all(np.isfinite(c.factor) and c.factor > 0.0 for c in few)
    for noise in ((1e-12, 1e-12), (1e-4, 1e-12), (1e-12, 1e-4)):
        found = fitted(poses(1, noise, sigma=None))
        assert np.isfinite(found.covariance).all()
        units = found.problem.units if len(found.problem.units) else np.ones(6)
        assert (units >= 0.99e-3 * units.max()).all()


def test_mixed_instruments_and_a_known_distance() -> None:
    """Of each part its own; the distance between sockets keeps its sigma."""
    setup = Setup(
        parameters=("joint-offset",),
        base_frame=FrameSetup(estimate=False),
        tool_frame=TOOL,
        planes={"wall": PlaneSetup((0.0, 0.0, 1.0), 2.0, estimate=True)},
        targets={"a": PointSetup((0.1, 0.0, 0.0)), "b": PointSetup((0.0, 0.1, 0.0))},
        distances=(DistanceSetup(("a", "b"), 0.1 * 2.0**0.5, 1e-5),),
    )
    keys, noise = (BlockKey("position"), BlockKey("plane-distance")), (5e-4, 2e-5)
    sizes = dict(zip(("position", "distance"), noise, strict=True))
    problem = nominal_problem(CHAIN, keys, replace(setup, noise=sizes))
    rng = np.random.default_rng(0)
    truth = calib_pin.draw_errors(problem.parameters, rng)
    rows = calib_pin.simulate(problem, truth, rng, count=200)
    data = Observations(tuple(replace(b, sigma=None) for b in rows.blocks))
    components = fitted(replace(nominal_problem(CHAIN, keys, setup), data=data)).noise
    # About 90 redundancies of the ranger: three deviations.
    np.testing.assert_allclose([c.estimate for c in components], noise, rtol=0.25)


def test_a_posterior_is_no_wider_than_its_prior() -> None:
    """Without sigma columns priors keep their own deviations."""
    setup = replace(OFFSETS, prior={"*.joint-offset.*": 1e-4})
    problem = nominal_problem(CHAIN, "position", setup)
    rng = np.random.default_rng(1)
    rows = calib_pin.simulate(
        problem, np.zeros(len(problem.parameters)), rng, count=20, noise=2e-3
    ).only
    problem = replace(problem, data=Observations.of(replace(rows, sigma=None)))
    found = fitted(problem)
    half = half_covariance(found.result.jac, found.directions.basis, problem.parameters)
    deviations: Floats = np.sqrt(np.sum(half**2, axis=1))
    tied = np.isfinite(problem.parameters.priors)
    assert tied.sum() == 6
    assert (deviations[tied] <= 1e-4 * (1.0 + 1e-9)).all()
    # Scaled by sigma0 they were up to twenty times as wide.
    assert found.problem.units[0] == pytest.approx(20.0, rel=0.3)


SETUP = Setup(parameters=("joint-offset",), tool_frame=FrameSetup((0.05, 0.08, 0.12)))


def component(
    seed: int, noise: float, shared: float, repeats: int, *, stated: float | None = None
) -> VarianceComponent:
    """Of positions with noise, and with errors that repetitions have in common."""
    problem = nominal_problem(CHAIN, "position", SETUP)
    rng = np.random.default_rng(seed)
    truth = calib_pin.draw_errors(problem.parameters, rng)
    rows = calib_pin.simulate(
        problem, truth, rng, count=40, noise=noise, repeats=repeats
    ).only
    each = shared * rng.normal(size=(40, 3))
    rows = replace(
        rows,
        values=rows.values + each[rows.groups()],
        sigma=None if stated is None else np.full((len(rows), 3), stated),
    )
    data = Observations.of(rows)
    (found,) = fit(replace(problem, data=data), np.random.default_rng(0)).noise
    return found


def test_pure_error_is_the_noise_whatever_the_model_lacks() -> None:
    found = component(0, 5e-5, 4e-4, 4)
    # 360 degrees of freedom: three deviations are 11 %.
    assert found.pure == pytest.approx(5e-5, rel=0.11)
    assert found.lack_of_fit is not None and found.lack_of_fit < 1e-9
    # 109 redundancies between configurations: three deviations are 20 %.
    assert found.unmodeled == pytest.approx(4e-4, rel=0.2)
    assert found.estimate == pytest.approx(np.hypot(4e-4, 5e-5), rel=0.2)
    assert found.interval[0] < 4.03e-4 < found.interval[1]


def test_repetitions_test_what_is_stated() -> None:
    right, wrong = (component(1, 5e-5, 0.0, 3, stated=s) for s in (5e-5, 2e-5))
    assert right.lack_of_fit is not None and right.lack_of_fit > 0.01
    assert right.pure_test is not None and right.pure_test > 0.01
    assert wrong.pure_test is not None and wrong.pure_test < 1e-9
    # Without repetitions nothing is told apart.
    alone = component(2, 1e-4, 0.0, 1)
    told = alone.pure, alone.lack_of_fit, alone.unmodeled, alone.pure_test
    assert told == (None,) * 4
