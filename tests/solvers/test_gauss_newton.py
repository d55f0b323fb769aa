"""The least-squares solver on functions; no robots here."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib_pin.kinematics.spatial import Floats
from calib_pin.solvers import LeastSquaresResult, Status, gauss_newton

DATA = Path(__file__).parents[1] / "data"


class Curve:
    """Something with a residual."""

    def residual(self, x: Floats) -> Floats:
        raise NotImplementedError

    def cost(self, x: Floats) -> float:
        r = self.residual(x)
        return 0.5 * float(r @ r)


class Linear(Curve):
    """`A x - b`."""

    def __init__(self, A: Floats, b: Floats) -> None:
        self.A, self.b = A, b

    def residual(self, x: Floats) -> Floats:
        return self.A @ x - self.b

    def linearize(self, x: Floats) -> tuple[Floats, Floats]:
        return self.residual(x), self.A

    def solve(self, **options: object) -> LeastSquaresResult:
        size = self.A.shape[1]
        return gauss_newton(
            self.linearize,
            self.cost,
            np.zeros(size),
            np.eye(size),
            **options,  # type: ignore[arg-type]
        )


class Rosenbrock(Curve):
    """`(10 (y - x^2), 1 - x)`: a bent valley."""

    def residual(self, x: Floats) -> Floats:
        return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]])

    def linearize(self, x: Floats) -> tuple[Floats, Floats]:
        return self.residual(x), np.array([[-20 * x[0], 10.0], [-1.0, 0.0]])


class Misra1a(Curve):
    """NIST StRD nonlinear regression, `y = b1 (1 - exp(-b2 x))`."""

    y, x = np.loadtxt(DATA / "misra1a.csv", delimiter=",", unpack=True)
    certified = np.array([2.3894212918e02, 5.5015643181e-04])
    deviations = np.array([2.7070075241e00, 7.2668688436e-06])

    def residual(self, b: Floats) -> Floats:
        return b[0] * (1 - np.exp(-b[1] * self.x)) - self.y

    def linearize(self, b: Floats) -> tuple[Floats, Floats]:
        decay = np.exp(-b[1] * self.x)
        return self.residual(b), np.column_stack([1 - decay, b[0] * self.x * decay])


def test_linear_problem_at_once() -> None:
    rng = np.random.default_rng(0)
    A, b = rng.normal(size=(20, 4)), rng.normal(size=20)
    result = Linear(A, b).solve()
    assert result.status is Status.CONVERGED
    assert result.nit <= 2  # The second step may mend rounding.
    assert result.x == pytest.approx(np.linalg.lstsq(A, b, rcond=None)[0], abs=1e-12)
    assert result.cost == pytest.approx(0.5 * np.sum((A @ result.x - b) ** 2))
    # Redundant columns share the step.
    a = A[:, :1]
    result = Linear(np.hstack([a, a, 0 * a]), 2.0 * a[:, 0]).solve()
    assert result.x == pytest.approx([1.0, 1.0, 0.0], abs=1e-12)


@pytest.mark.parametrize("start", [(-1.2, 1.0), (5.0, -3.0)])
def test_damping_follows_a_bent_valley(start: tuple[float, float]) -> None:
    valley = Rosenbrock()
    result = gauss_newton(valley.linearize, valley.cost, np.array(start), np.eye(2))
    assert result.status is Status.CONVERGED
    assert result.x == pytest.approx([1.0, 1.0], abs=1e-9)


@pytest.mark.parametrize("start", [(500.0, 1e-4), (250.0, 5e-4)])
def test_certified_values_and_deviations(start: tuple[float, float]) -> None:
    curve = Misra1a()
    scale = np.diag([100.0, 1e-4])
    result = gauss_newton(curve.linearize, curve.cost, np.array(start), scale)
    assert result.status is Status.CONVERGED
    assert result.x == pytest.approx(curve.certified, rel=1e-8)
    variance = 2 * result.cost / (len(curve.y) - 2)
    covariance = variance * np.linalg.inv(result.jac.T @ result.jac)
    assert np.sqrt(np.diag(covariance)) == pytest.approx(curve.deviations, rel=1e-7)


def test_directions_outside_the_basis_stay() -> None:
    rng = np.random.default_rng(0)
    problem = Linear(rng.normal(size=(20, 3)), rng.normal(size=20))
    start, basis = np.array([1.0, 2.0, 3.0]), np.eye(3)[:, :2]
    result = gauss_newton(problem.linearize, problem.cost, start, basis)
    assert result.x[2] == 3.0
    assert basis.T @ (problem.A.T @ result.fun) == pytest.approx([0, 0], abs=1e-11)
    # Without any, nothing moves.
    nothing = gauss_newton(problem.linearize, problem.cost, start, np.zeros((3, 0)))
    assert nothing.status is Status.CONVERGED
    assert nothing.x.tolist() == start.tolist()


def test_start_without_a_derivative() -> None:
    """A distance of zero has a cost."""
    flat = np.ones(2), np.full((2, 1), np.nan)
    found = gauss_newton(lambda x: flat, lambda x: 1.0, np.zeros(1), np.eye(1))
    assert (found.status, found.cost) == (Status.NOT_FINITE, 1.0)
    lost = np.array([np.nan]), np.ones((1, 1))
    found = gauss_newton(lambda x: lost, lambda x: np.nan, np.zeros(1), np.eye(1))
    assert found.status is Status.NOT_FINITE


def test_a_last_step_of_nothing_is_spared() -> None:
    """Where evaluations are dear; the result is that of the last linearization."""
    rng = np.random.default_rng(0)
    problem = Linear(rng.normal(size=(20, 3)), rng.normal(size=20))
    expected = np.linalg.lstsq(problem.A, problem.b)[0]
    dear, usual = (problem.solve(tolerance=1e-12, spare=s) for s in (True, False))
    for found in (dear, usual):
        assert found.status is Status.CONVERGED
        np.testing.assert_allclose(found.x, expected, rtol=0, atol=1e-12)
    assert dear.nfev == 2 < usual.nfev


def test_a_wrong_jacobian_stalls() -> None:
    problem = Linear(np.eye(2), np.array([1.0, 2.0]))
    result = gauss_newton(
        lambda x: (problem.residual(x), -problem.A),
        problem.cost,
        np.zeros(2),
        np.eye(2),
    )
    assert result.status is Status.STALLED


def test_full_steps_that_gain_nothing_worthwhile_end() -> None:
    """A large residual that bends away takes 95 % of every full step back."""

    def linearize(x):
        r = np.array([1.0 - 0.475 * x[0] ** 2, x[0]])
        return r, np.array([[-0.95 * x[0]], [1.0]])

    def cost(x):
        return 0.5 * float(np.sum(linearize(x)[0] ** 2))

    found = gauss_newton(linearize, cost, np.array([0.01]), np.eye(1), worthwhile=1e-5)
    assert found.status is Status.CONVERGED
    assert found.nit < 20
