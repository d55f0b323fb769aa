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
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.solve import Solver
from calib_pin.estimation.statistics.variance_components import (
    KNOWN,
    Components,
    ErrorBlock,
    Variances,
    candidates,
    estimate_variances,
    unplaced,
)
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Conditions, Observations
from calib_pin.setup import (
    FrameSetup,
    Payload,
    Setup,
)
from tests.shared import chain_of, joint, simulated, urdf_of

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
    setup = replace(OFFSETS, noise=sizes)
    problem, _ = simulated("pose", setup, count, 1.0, seed, noise=None)
    stated = None if sigma is None else np.full((count, 6), sigma)
    data = Observations.of(replace(problem.data.only, sigma=stated))
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


def test_few_values_that_happen_to_agree_are_no_smaller_noise() -> None:
    """Three degrees of freedom scatter by a sixth of what is stated, and true."""
    _, lucky = fitted(poses(54, (1e-4, 1e-4), sigma=1e-4, count=4)).noise
    assert lucky.estimate < 0.2e-4
    assert not lucky.contradicted and lucky.factor == 1.0


def test_one_quantity_is_fitted_once(monkeypatch: pytest.MonkeyPatch) -> None:
    problem, _ = simulated("position", OFFSETS, 40, 1.0, noise=3e-4)
    rows = replace(problem.data.only, sigma=None)
    problem = replace(problem, data=Observations.of(rows))
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


SETUP = Setup(parameters=("joint-offset",), tool_frame=FrameSetup((0.05, 0.08, 0.12)))


def component(
    seed: int, noise: float, shared: float, repeats: int, *, stated: float | None = None
) -> VarianceComponent:
    """Of positions with noise, and with errors that repetitions have in common."""
    how = {"noise": noise, "repeats": repeats}
    problem, _ = simulated("position", SETUP, 40, 1.0, seed, **how)
    rows, rng = problem.data.only, np.random.default_rng(seed)
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


END = FrameSetup((0.05, 0.08, 0.12), (0.2, -0.3, 0.1))


def problem_of(robot: str, setup: Setup | None = None, payload: str = "") -> Problem:
    chain = calib_pin.load_chain(robot)
    setup = replace(setup or Setup(), tool_frame=END)
    problem = nominal_problem(chain, "position", setup)
    rows = replace(
        problem.data.only, conditions=Conditions((payload,) * len(problem.data))
    )
    return replace(problem, data=Observations.of(rows))


def names(problem: Problem) -> list[str]:
    found = candidates(problem)
    if found is None:
        return []
    return list(found.names)


def test_what_is_estimated_is_no_random_effect() -> None:
    assert len(names(problem_of("pa10"))) == 7 * 5
    gears = replace(Setup(), parameters=("placement", "transmission"))
    assert {name.split(".")[1] for name in names(problem_of("pa10", gears))} == {
        "compliance"
    }
    both = replace(Setup(), parameters=("transmission", "compliance"))
    assert names(problem_of("pa10", both)) == []


def test_places_of_joints_are_missing_beside_offsets_alone() -> None:
    for names_of, missing in (
        (("joint-offset",), 1),
        (("link-transform",), 0),
        ((), 0),
    ):
        assert len(unplaced(replace(Setup(), parameters=names_of))) == missing


def test_what_has_no_mass_does_not_give() -> None:
    assert {name.split(".")[1] for name in names(problem_of("space6"))} == {
        "transmission"
    }
    carried = Setup(payloads={"p": Payload(5.0, (0.0, 0.0, 0.0))})
    assert any(n.endswith("k") for n in names(problem_of("space6", carried)))
    # Of what these rows carry nothing is known.
    assert not any(n.endswith("k") for n in names(problem_of("pa10", payload="p")))


@pytest.mark.parametrize("model", ["position", "fixed-point", "relative-distance"])
def test_rows_are_those_of_the_parameters(model: str) -> None:
    """A column is the residual that its effect adds, by central differences."""
    from benchmarks.recovery import CASES

    setup = CASES[model].setup
    true, _ = simulated(model, replace(setup, parameters=("transmission",)), 12)
    plain = replace(nominal_problem(CHAIN, model, setup), data=true.data)
    effects = candidates(plain)
    assert effects is not None
    X = effects.rows(plain, np.zeros(len(plain.parameters)))
    for k, name in enumerate(effects.names):
        moved = np.zeros(len(true.parameters))
        moved[true.parameters.names.index(name)] = effects.sizes[k]
        change = 0.5 * (true.errors(moved) - true.errors(-moved)) / true.sigma
        # The amplitude of 3e-4 rad is the step: its square is left.
        np.testing.assert_allclose(X[:, k], change, atol=1e-5)


def test_a_leader_outside_of_the_chain_has_no_effects() -> None:
    driven = '<mimic joint="drive" multiplier="0.5"/>'
    fork = urdf_of(
        joint("elbow", "base arm", "0.2 0 0.1"),
        joint("wrist", "arm hand", "0.3 0 0", "0 1 0", more=driven),
        joint("drive", "base wheel"),
    )
    chain = chain_of(fork, tip="hand")
    found = names(nominal_problem(chain, "position", Setup(tool_frame=END)))
    assert found and {name.split(".")[0] for name in found} == {"elbow"}


NOISE = np.zeros(80, int)
rng = np.random.default_rng(2)
A, X = rng.normal(size=(80, 4)), rng.normal(size=(80, 10))
Y = 0.8 * rng.normal(size=80) + X @ (0.7 * rng.normal(size=10))


def components(*blocks: ErrorBlock, count: int, worth: float = 0.0) -> Components:
    known = np.full(count, worth)
    return Components(blocks, known, known)


def factors(y: Floats = Y) -> Components:
    """Noise and effects X, as factors of one covariance."""
    labels = np.append(NOISE, np.ones(10, int))
    block = ErrorBlock(np.column_stack([A, y]), labels, np.hstack([np.eye(80), X]))
    return components(block, count=2)


def unknowns(y: Floats = Y) -> Components:
    """The same with the effects as unknowns that have errors of their own."""
    rows = np.column_stack([A, X, y])
    effects = np.hstack([np.zeros((10, 4)), np.eye(10), np.zeros((10, 1))])
    blocks = ErrorBlock(rows, NOISE), ErrorBlock(effects, np.ones(10, int))
    return components(*blocks, count=2)


def dense(values: Floats) -> tuple[float, Floats, tuple[Floats, ...]]:
    """Restricted likelihood, P, and derivatives of the covariance by logarithms."""
    parts = values[0] * np.eye(80), values[1] * X @ X.T
    W = np.linalg.inv(sum(parts))
    H = A.T @ W @ A
    P = W - W @ A @ np.linalg.solve(H, A.T @ W)
    size = np.linalg.slogdet(H)[1] - np.linalg.slogdet(W)[1]
    return -0.5 * float(size + Y @ P @ Y), P, parts


def test_exact_measurements_inform_by_rounding_that_may_be_negative() -> None:
    """Of positions that never change no variance can be told; the step is finite."""
    sizes, information = np.ones(2), np.diag([-1e-30, 0.5])
    unknowns = np.zeros(0), np.zeros((0, 0))
    model = Variances(sizes, sizes, sizes, information, 0.0, *unknowns, ())
    assert all(np.isfinite(step).all() for step in model.steps(sizes / 2, 2 * sizes))


@pytest.mark.parametrize("model", [factors, unknowns])
def test_likelihood_gradient_and_information_are_those_of_dense_matrices(model) -> None:
    values = np.array([0.5, 0.9])
    found, (likelihood, P, parts) = Variances.at(model(), values), dense(values)
    assert found.likelihood == pytest.approx(likelihood)
    half = [P @ V @ P @ Y for V in parts]
    squares = [Y @ h for h in half]
    np.testing.assert_allclose(found.squares, squares)
    np.testing.assert_allclose(found.redundancies, [np.trace(P @ V) for V in parts])
    information = 0.5 * np.array([[g @ V @ P @ Y for V in parts] for g in half])
    np.testing.assert_allclose(found.information, information)


@pytest.mark.parametrize("model", [factors, unknowns])
def test_the_likelihood_is_at_its_maximum(model) -> None:
    found = estimate_variances(model(), np.ones(2))
    # There the rounds of MacKay stand still.
    np.testing.assert_allclose(found.squares, found.redundancies, rtol=1e-5)
    best = dense(found.values)[0]
    for factors_ in ((0.95, 1.0), (1.05, 1.0), (1.0, 0.9), (1.0, 1.1)):
        assert dense(found.values * factors_)[0] < best


def test_an_effect_that_is_not_there_vanishes() -> None:
    U = np.linalg.qr(np.hstack([A, X]))[0]
    rest = Y - U @ (U.T @ Y)
    found = estimate_variances(unknowns(rest), np.ones(2))
    assert found.values[1] < 1e-6 and np.isfinite(found.dof).all()
    # A bound stops it before.
    bounded = estimate_variances(factors(rest), np.ones(2), np.full(2, 0.01))
    assert bounded.values[1] == 0.01


def test_what_is_known_beforehand_counts_like_further_errors() -> None:
    nothing = components(
        ErrorBlock(np.zeros((1, 1)), np.array([KNOWN])), count=2, worth=3.0
    )
    found = estimate_variances(nothing, np.array([0.1, 7.0]))
    np.testing.assert_allclose(found.values, 1.0)
    np.testing.assert_allclose(found.dof, 3.0)
    more = Components(factors().blocks, np.array([0.0, 50.0]), np.array([0.0, 450.0]))
    assert estimate_variances(more, np.ones(2)).values[1] == pytest.approx(9.0, rel=0.4)


def test_variances_that_are_known_or_in_common() -> None:
    plain = components(ErrorBlock(np.column_stack([A, Y]), np.arange(80) % 4), count=4)
    found = estimate_variances(plain.relabeled(np.array([0, 1, 0, KNOWN])), np.ones(2))
    labels = np.array([0, 1, 0, KNOWN])[np.arange(80) % 4]
    again = components(ErrorBlock(np.column_stack([A, Y]), labels), count=2)
    np.testing.assert_allclose(
        found.values, estimate_variances(again, np.ones(2)).values
    )
    assert Variances.at(again, np.ones(2)).redundancies.sum() < 60.0
