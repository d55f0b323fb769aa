"""Two halves by turns reach what both together reach."""

from __future__ import annotations

import numpy as np
import pytest

from calib_pin.kinematics.spatial import Floats
from calib_pin.solvers import Status, alternation, gauss_newton


class Bent:
    """A residual of four unknowns, two by two, that explain nearly the same.

    Args:
        alike: How much the halves are, 0 for not at all, 1 for entirely.
        rest: Size of what cannot be explained.
    """

    def __init__(self, alike: float, rest: float = 0.1, seed: int = 0) -> None:
        rng = np.random.default_rng(seed)
        A = np.linalg.qr(rng.normal(size=(12, 6)))[0]
        angle = np.sqrt(1.0 - alike**2)
        self.A = np.column_stack([A[:, :2], alike * A[:, :2] + angle * A[:, 2:4]])
        self.b = self.A @ np.sinh([0.4, -0.3, 0.2, 0.5]) + rest * A[:, 4]

    def residual(self, x: Floats) -> Floats:
        return np.asarray(self.A @ np.sinh(x) - self.b)

    def linearize(self, x: Floats) -> tuple[Floats, Floats]:
        return self.residual(x), self.A * np.cosh(x)

    def cost(self, x: Floats) -> float:
        r = self.residual(x)
        return 0.5 * float(r @ r)


START = np.full(4, 0.1)
FIRST, SECOND = np.eye(4)[:, :2], np.eye(4)[:, 2:]


@pytest.mark.parametrize("alike", [0.0, 0.5, 0.99])
def test_the_joint_optimum(alike: float) -> None:
    curve = Bent(alike)
    joint = gauss_newton(curve.linearize, curve.cost, START, np.eye(4))
    found = alternation(curve.linearize, curve.cost, START, FIRST, SECOND)
    assert found.status is joint.status is Status.CONVERGED
    assert found.cost == pytest.approx(joint.cost, rel=1e-9)
    np.testing.assert_allclose(found.x, joint.x, rtol=0, atol=1e-5)
    np.testing.assert_array_equal(found.fun, curve.residual(found.x))
    np.testing.assert_array_equal(found.jac, curve.linearize(found.x)[1])
    assert found.nfev > found.nit > 0
    # Base and tool, then the robot: any two sets of directions in the unknowns.
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(4, 4)))[0]
    found = alternation(curve.linearize, curve.cost, START, turn[:, :1], turn[:, 1:])
    assert found.status is Status.CONVERGED
    np.testing.assert_allclose(found.x, joint.x, rtol=0, atol=1e-5)


def test_mixing_saves_rounds() -> None:
    """Plain turns get there as well where there are enough of them."""
    curve = Bent(0.95)
    mixed, plain = (
        alternation(curve.linearize, curve.cost, START, FIRST, SECOND, memory=memory)
        for memory in (10, 0)
    )
    assert plain.status is mixed.status is Status.CONVERGED
    assert plain.cost == pytest.approx(mixed.cost, rel=1e-9)
    assert mixed.nit < 20 < 60 < plain.nit


@pytest.mark.parametrize("which", [0, 1])
def test_one_half_alone(which: int) -> None:
    """Where the other has nothing to move, this is what a single solve finds."""
    curve, empty = Bent(0.5), np.zeros((4, 0))
    halves = [empty, empty]
    halves[which] = FIRST
    found = alternation(curve.linearize, curve.cost, START, *halves)
    alone = gauss_newton(curve.linearize, curve.cost, START, FIRST)
    assert found.status is Status.CONVERGED
    np.testing.assert_allclose(found.x, alone.x, rtol=0, atol=1e-8)
    np.testing.assert_array_equal(found.x[2:], START[2:])
    still = alternation(curve.linearize, curve.cost, START, empty, empty)
    assert (still.status, still.cost) == (Status.CONVERGED, curve.cost(START))
    np.testing.assert_array_equal(still.x, START)


def test_a_start_that_is_not_finite() -> None:
    curve, value = Bent(0.5), np.nan

    def linearize(x: Floats) -> tuple[Floats, Floats]:
        r, J = curve.linearize(x)
        return np.full_like(r, value), J

    found = alternation(linearize, lambda x: value, START, FIRST, SECOND)
    assert found.status is Status.NOT_FINITE
    np.testing.assert_array_equal(found.x, START)
