"""Noise of each quantity, and pure error and lack of fit from repetitions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation import problem as problem_module
from calib_pin.estimation import unit_weights
from calib_pin.estimation.directions import half_covariance
from calib_pin.estimation.evidence import VarianceComponent
from calib_pin.estimation.fit import fit
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.solve import Solver
from calib_pin.estimation.statistics.variance_components import variance_components
from calib_pin.estimation.unit_weights import balanced, bounded
from calib_pin.kinematics.spatial import Floats, so3_exp, to_quaternion
from calib_pin.observations import BlockKey, Observations
from calib_pin.setup import DistanceSetup, FrameSetup, PlaneSetup, PointSetup, Setup

TOOL = FrameSetup((0.05, 0.08, 0.12), (0.2, -0.3, 0.1), estimate=True)
CHAIN = calib_pin.load_chain("space6")
OFFSETS = Setup(parameters=("joint-offset",), tool_frame=TOOL)


class Solve:
    """Fits in given units, counted."""

    def __init__(self) -> None:
        self.calls = 0

    def __call__(self, problem: Problem, solver: Solver | None = None) -> Fit:
        self.calls += 1
        return bounded(problem, Solver(problem, np.random.default_rng(0)))

    def balanced(self, problem: Problem) -> Fit:
        """Fits by turns with estimates of the units, each of them from the start."""
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(unit_weights, "bounded", self)
            patch.setattr(
                unit_weights,
                "fit_in_units",
                lambda fitted, units: self(replace(fitted.problem, units=units)),
            )
            return balanced(problem, Solver(problem, np.random.default_rng(0)))


def poses(
    seed: int, noise: tuple[float, float], *, sigma: float | None, count: int = 60
) -> Problem:
    """Poses of a robot with offsets, noise of position [m] and orientation [rad]."""
    problem = nominal_problem(CHAIN, "pose", OFFSETS)
    rng = np.random.default_rng(seed)
    truth = calib_pin.draw_errors(problem.parameters, rng)
    rows = calib_pin.simulate(problem, truth, rng, count=count, noise=0.0).only
    values = rows.values.copy()
    values[:, :3] += noise[0] * rng.normal(size=(count, 3))
    x, y, z, w = np.moveaxis(values[:, 3:], 1, 0)
    R = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    turned = np.moveaxis(R, 2, 0) @ so3_exp(noise[1] * rng.normal(size=(count, 3)))
    values[:, 3:] = to_quaternion(turned)
    stated = None if sigma is None else np.full((count, 6), sigma)
    data = Observations.of(replace(rows, values=values, sigma=stated))
    return replace(problem, data=data)


def found(fitted: Fit) -> tuple[VarianceComponent, ...]:
    return variance_components(*fitted.held)


@pytest.mark.parametrize("sigma", [None, 1e-4])
@pytest.mark.parametrize("noise", [(5e-4, 2e-5), (2e-5, 5e-4)])
def test_position_and_orientation_are_balanced(
    noise: tuple[float, float], sigma: float | None
) -> None:
    """Given 0.1 mm and 0.1 mrad, five times too small and too large."""
    solve, estimates = Solve(), []
    for seed in range(5):
        fitted = solve.balanced(poses(seed, noise, sigma=sigma))
        components = found(fitted)
        estimates.append([c.estimate for c in components])
        assert all(c.contradicted == (sigma is not None) for c in components)
        assert fitted.sigma0 == pytest.approx(1.0, rel=1e-3)
    # 170 redundancies each, 5 seeds: 2.4 % is one deviation of the mean.
    np.testing.assert_allclose(np.mean(estimates, axis=0), noise, rtol=0.08)
    assert solve.calls <= 15


def test_what_is_stated_stands_where_it_is_right() -> None:
    solve, rejected = Solve(), []
    for seed in range(12):
        fitted = solve.balanced(poses(seed, (1e-4, 1e-4), sigma=1e-4))
        components = found(fitted)
        rejected += [c.contradicted for c in components]
        for c in components:
            assert c.contradicted == (c.factor != 1.0)
            assert c.contradicted == (not c.interval[0] <= 1e-4 <= c.interval[1])
            assert c.contradicted or c.unmodeled == 0.0
    # Of 24, more than 4 are rejected by chance at 5 % once in a hundred.
    assert sum(rejected) <= 4
    assert solve.calls == 12 + sum(a or b for a, b in np.reshape(rejected, (12, 2)))


def test_what_is_stated_too_small_is_unmodeled_error() -> None:
    fitted = Solve().balanced(poses(4, (5e-4, 1e-4), sigma=1e-4))
    position, _ = found(fitted)
    assert position.contradicted and position.interval[0] < 5e-4 < position.interval[1]
    assert position.unmodeled == pytest.approx(np.sqrt(24.0) * 1e-4, rel=0.15)
    # Nothing tells it from noise where that is only assumed.
    assumed = found(Solve().balanced(poses(4, (5e-4, 1e-4), sigma=None)))
    assert [c.unmodeled for c in assumed] == [None, None]


def test_one_quantity_is_fitted_once() -> None:
    problem = nominal_problem(CHAIN, "position", OFFSETS)
    rng = np.random.default_rng(0)
    truth = calib_pin.draw_errors(problem.parameters, rng)
    rows = calib_pin.simulate(problem, truth, rng, count=40, noise=3e-4).only
    problem = replace(problem, data=Observations.of(replace(rows, sigma=None)))
    plain, solve = Solve()(problem), Solve()
    fitted = solve.balanced(problem)
    assert solve.calls == 1
    np.testing.assert_array_equal(fitted.theta, plain.theta)
    # The prior on offsets of 1 mrad says next to nothing of errors of 0.1 mrad.
    assert fitted.problem.units == pytest.approx([plain.sigma0], rel=1e-5)
    assert found(fitted)[0].estimate == pytest.approx(1e-4 * fitted.problem.units[0])
    # As if it had been fitted in these units.
    again = Solve()(replace(problem, units=fitted.problem.units))
    deviations = np.sqrt(np.diag(again.covariance))
    assert (np.abs(fitted.theta - again.theta) <= 1e-5 * deviations + 1e-12).all()
    found_too = np.sqrt(np.diag(fitted.covariance))
    np.testing.assert_allclose(found_too, deviations, rtol=1e-5)
    assert fitted.problem.cost(fitted.theta) == pytest.approx(fitted.result.cost)


def test_exact_measurements_divide_by_nothing() -> None:
    for noise in ((0.0, 0.0), (1e-4, 0.0), (0.0, 1e-4)):
        fitted = Solve().balanced(poses(1, noise, sigma=None))
        assert np.isfinite(fitted.covariance).all()
        units = fitted.problem.units if len(fitted.problem.units) else np.ones(6)
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
    ratios = []
    for seed in range(6):
        keys = BlockKey("position"), BlockKey("plane-distance")
        problem = nominal_problem(CHAIN, keys, setup)
        rng = np.random.default_rng(seed)
        truth = calib_pin.draw_errors(problem.parameters, rng)
        rows = calib_pin.simulate(problem, truth, rng, count=200, noise=0.0)
        noisy = [
            replace(b, values=b.values + noise * rng.normal(size=b.values.shape))
            for b, noise in zip(rows.blocks, (5e-4, 2e-5), strict=True)
        ]
        rows = Observations(tuple(noisy))
        fitted = Solve().balanced(replace(problem, data=rows))
        ratios.append([c.estimate for c in found(fitted)])
    np.testing.assert_allclose(np.median(ratios, axis=0), [5e-4, 2e-5], rtol=0.1)


def test_few_values_keep_the_given_ratio() -> None:
    """Two rows of one target determine its place and leave one redundancy at most."""
    problem = poses(0, (3e-4, 3e-4), sigma=None, count=3)
    fitted = Solve().balanced(problem)
    components = found(fitted)
    assert all(np.isfinite(c.factor) and c.factor > 0.0 for c in components)


def test_units_that_change_little_carry_a_fit_on() -> None:
    """From where it stands, to where it would come to from the start."""
    problem = poses(0, (3e-4, 5e-5), sigma=None)
    fitted = fit(problem, np.random.default_rng(0))
    slow = Solve().balanced(problem)
    np.testing.assert_allclose(fitted.problem.units, slow.problem.units, rtol=1e-3)
    deviations = np.sqrt(np.diag(slow.covariance))
    assert (np.abs(fitted.theta - slow.theta) <= 1e-3 * deviations + 1e-12).all()
    # It is whitened by the units that it has.
    cost = fitted.problem.cost(fitted.theta)
    assert fitted.result.cost == pytest.approx(cost)
    least = fitted.problem.cost(fitted.before)
    register = fitted.problem.cost(slow.before)
    assert least == pytest.approx(register, rel=1e-6)


@pytest.mark.slow
def test_very_many_rows_say_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = poses(2, (3e-4, 5e-5), sigma=None)
    few = found(Solve().balanced(problem))
    monkeypatch.setattr(problem_module, "MANY", 1)
    fitted = Solve().balanced(replace(problem))
    assert fitted.problem.many
    many = found(fitted)
    for a, b in zip(few, many, strict=True):
        assert b.estimate == pytest.approx(a.estimate, rel=1e-3)
        assert b.redundancy == pytest.approx(a.redundancy, rel=1e-3)


def test_a_posterior_is_no_wider_than_its_prior() -> None:
    """Without sigma columns priors keep their own deviations."""
    setup = replace(OFFSETS, prior={"*.joint-offset.*": 1e-4})
    problem = nominal_problem(CHAIN, "position", setup)
    rng = np.random.default_rng(1)
    rows = calib_pin.simulate(
        problem, np.zeros(len(problem.parameters)), rng, count=20, noise=2e-3
    ).only
    problem = replace(problem, data=Observations.of(replace(rows, sigma=None)))
    fitted = Solve().balanced(problem)
    half = half_covariance(
        fitted.result.jac, fitted.directions.basis, problem.parameters
    )
    deviations: Floats = np.sqrt(np.sum(half**2, axis=1))
    tied = np.isfinite(problem.parameters.priors)
    assert tied.sum() == 6
    assert (deviations[tied] <= 1e-4 * (1.0 + 1e-9)).all()
    # Scaled by sigma0 they were up to twenty times as wide.
    assert fitted.problem.units[0] == pytest.approx(20.0, rel=0.3)


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
    assert right.pure_test is not None and right.pure_test > 0.01
    assert wrong.pure_test is not None and wrong.pure_test < 1e-9


def test_noise_alone_lacks_nothing() -> None:
    """Of 24, more than 4 are below 5 % once in a hundred."""
    found = [component(seed, 1e-4, 0.0, 3).lack_of_fit for seed in range(24)]
    assert sum(p is not None and p < 0.05 for p in found) <= 4
    assert 0.3 < np.mean([p for p in found if p is not None]) < 0.7


def test_without_repetitions_nothing_is_told_apart() -> None:
    found = component(2, 1e-4, 0.0, 1)
    assert found.pure is None and found.lack_of_fit is None
    assert found.unmodeled is None and found.pure_test is None
