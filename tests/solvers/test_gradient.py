"""Projected descent on smooth functions with known minima; no robots here."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy import optimize

from calib_pin.kinematics.spatial import Floats
from calib_pin.solvers import Status, projected_descent
from calib_pin.solvers.gradient import DescentResult

Smooth = Callable[[Floats], tuple[float, Floats]]

SQUARE = np.tile([-2.0, 2.0], (2, 1))


def rosenbrock(x: Floats) -> tuple[float, Floats]:
    v = x.ravel()
    bend, rest = v[1:] - v[:-1] ** 2, 1 - v[:-1]
    gradient = np.zeros_like(v)
    gradient[:-1] = -400 * v[:-1] * bend - 2 * rest
    gradient[1:] += 200 * bend
    return float(100 * bend @ bend + rest @ rest), gradient.reshape(x.shape)


def quadratic(size: int, seed: int = 0) -> Smooth:
    """Condition number 1e4; the minimum lies outside of the unit box."""
    rng = np.random.default_rng(seed)
    Q = np.linalg.qr(rng.normal(size=(size, size)))[0]
    A, b = (Q * np.logspace(0, -4, size)) @ Q.T, 0.3 * rng.normal(size=size)

    def function(x: Floats) -> tuple[float, Floats]:
        v = x.ravel()
        return float(0.5 * v @ A @ v - b @ v), (A @ v - b).reshape(x.shape)

    return function


def coupled(target: Floats, coupling: float) -> Smooth:
    """Points drawn to their targets, and their sum to that of the targets."""

    def function(x: Floats) -> tuple[float, Floats]:
        e = x - target
        total = e.sum(axis=0)
        value = 0.5 * np.sum(e * e) + 0.5 * coupling * total @ total
        return float(value), e + coupling * total

    return function


def random_points(bounds: Floats, count: int, seed: int) -> Floats:
    rng = np.random.default_rng(seed)
    return rng.uniform(bounds[:, 0], bounds[:, 1], (count, len(bounds)))


PROBLEMS = {
    "rosenbrock": (rosenbrock, np.tile([-0.5, 2.0], (2, 1)), 5),
    "rosenbrock at bounds": (rosenbrock, np.tile([-0.5, 0.8], (2, 1)), 5),
    "quadratic": (quadratic(70), np.tile([-100.0, 100.0], (7, 1)), 10),
    "quadratic at bounds": (quadratic(70), np.tile([-1.0, 1.0], (7, 1)), 10),
}


@pytest.mark.parametrize("name", PROBLEMS)
def test_as_low_as_scipy_with_about_as_many_evaluations(name: str) -> None:
    function, bounds, count = PROBLEMS[name]
    x0 = random_points(bounds, count, 0)

    def flat(v: Floats) -> tuple[float, Floats]:
        value, gradient = function(v.reshape(x0.shape))
        return value, gradient.ravel()

    # Where the last step gains 1e-13 of the value, up to 820, a thousand times as much
    # may be left to gain: 1e-7.
    start, visited = x0.copy(), list[Floats]()

    def watched(x: Floats) -> tuple[float, Floats]:
        visited.append(x.copy())
        return function(x)

    ours = projected_descent(watched, bounds, x0, tolerance=1e-13, max_iterations=1000)
    assert np.array_equal(x0, start)
    theirs = optimize.minimize(
        flat,
        x0.ravel(),
        jac=True,
        method="L-BFGS-B",
        bounds=np.tile(bounds, (count, 1)),
        options={"ftol": 1e-13, "gtol": 1e-9, "maxiter": 1000},
    )
    assert ours.status is Status.CONVERGED
    assert ours.fun == pytest.approx(theirs.fun, abs=1e-6)
    # Counts depend on the last bits of products; without curvature it takes tenfold.
    assert ours.nfev <= 3 * theirs.nfev
    assert ours.fun == function(ours.x)[0] == min(function(x)[0] for x in visited)
    assert ours.nfev == len(visited)
    assert all((bounds[:, 0] <= x).all() and (x <= bounds[:, 1]).all() for x in visited)


def test_units_of_components_and_who_owns_the_gradient_do_not_matter() -> None:
    scale, kept = np.array([1.0, 1024.0]), np.empty((3, 2))

    def scaled(x: Floats) -> tuple[float, Floats]:
        value, gradient = rosenbrock(x / scale)
        return value, gradient / scale

    def overwritten(x: Floats) -> tuple[float, Floats]:
        value, kept[:] = rosenbrock(x)
        return value, kept

    x0 = random_points(SQUARE, 3, 0)
    one = projected_descent(rosenbrock, SQUARE, x0)
    other = projected_descent(scaled, SQUARE * scale[:, None], x0 * scale)
    same = projected_descent(overwritten, SQUARE, x0)
    assert other.x == pytest.approx(one.x * scale, rel=1e-4)
    assert same.x == pytest.approx(one.x, rel=1e-4)


def test_a_flat_function_and_a_fixed_box_converge_at_once() -> None:
    x0 = np.zeros((2, 2))
    flat = projected_descent(lambda x: (3.0, np.zeros_like(x)), SQUARE, x0)
    fixed = projected_descent(rosenbrock, np.zeros((2, 2)), x0)
    here = projected_descent(
        coupled(np.ones((2, 2)), 1.0),
        SQUARE,
        x0,
        allowed=lambda x: (x == x0).all(axis=1),
    )
    for result in (flat, fixed, here):
        assert (result.status, result.nit, result.nfev) == (Status.CONVERGED, 0, 1)
        assert np.array_equal(result.x, x0)


TARGET = np.array([[1.0, 0.5], [1.0, -0.9], [0.2, 1.5], [-1.0, -1.0]])


def descend_beside_disc(center: list[float], coupling: float) -> DescentResult:
    """The descent; where it ends must be allowed and lower than its start."""

    def allowed(x: Floats) -> Floats:
        return np.linalg.norm(x - center, axis=1) >= 0.5

    x0 = np.array([[-1.0, -0.1], [-1.5, 1.2], [-1.0, 1.0], [1.0, 0.0]])
    function = coupled(TARGET, coupling)
    result = projected_descent(function, SQUARE, x0, allowed=allowed)
    assert allowed(result.x).all() and result.fun < function(x0)[0]
    assert result.status is Status.CONVERGED
    return result


def test_a_forbidden_disc_on_the_way() -> None:
    result = descend_beside_disc([0.0, 0.0], 0.5)
    # A full step leads over the disc.
    assert result.x == pytest.approx(TARGET, abs=1e-4)


@pytest.mark.parametrize("coupling", [0.0, 5.0])
def test_a_minimum_that_is_forbidden_to_one_point(coupling: float) -> None:
    result = descend_beside_disc([1.0, -0.9], coupling)
    distance = np.linalg.norm(result.x[1] - TARGET[1])
    assert 0.5 <= distance < 0.51  # At the edge.
    # The others are where they are best off with that one held up.
    gradient = coupled(TARGET, coupling)(result.x)[1]
    assert gradient[[0, 2, 3]] == pytest.approx(np.zeros((3, 2)), abs=1e-3)


@pytest.mark.parametrize("wall", [np.nan, np.inf, -np.inf])
def test_values_that_are_not_finite_turn_it_back(wall: float) -> None:
    def function(x: Floats) -> tuple[float, Floats]:
        value, gradient = coupled(np.ones((1, 2)), 0.0)(x)
        return (wall if x[0, 0] > 0.5 else value), gradient

    result = projected_descent(function, SQUARE, np.array([[-1.0, 0.0]]))
    assert np.isfinite(result.fun)
    assert result.x[0, 0] == pytest.approx(0.5, abs=0.01) and result.x[0, 0] <= 0.5
    steep = projected_descent(
        lambda x: (float(-x.sum()), np.where(x > 0.5, wall, -1.0)),
        SQUARE,
        np.zeros((1, 2)),
    )
    assert (steep.x <= 0.5).all() and np.isfinite(steep.fun)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_start_that_is_not_finite(value: float) -> None:
    result = projected_descent(lambda x: (value, 0 * x), SQUARE, np.ones((1, 2)))
    assert (result.status, result.nit, result.nfev) == (Status.NOT_FINITE, 0, 1)
    assert result.x.tolist() == [[1.0, 1.0]]


def test_a_wrong_gradient_stalls() -> None:
    def function(x: Floats) -> tuple[float, Floats]:
        value, gradient = rosenbrock(x)
        return value, -gradient

    result = projected_descent(function, SQUARE, np.zeros((2, 2)))
    assert result.status is Status.STALLED
    assert result.fun == rosenbrock(np.zeros((2, 2)))[0]


def test_the_limit_ends_it() -> None:
    x0 = np.zeros((4, 2))
    limited = projected_descent(rosenbrock, SQUARE, x0, max_iterations=3)
    assert (limited.status, limited.nit) == (Status.ITERATIONS, 3)
