"""The paired test of gains, PRESS against refits, and predicted variances."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

import calib_pin
from calib_pin.estimation.evidence import Gain
from calib_pin.estimation.fit import fit
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.nominal import register
from calib_pin.estimation.problem import Problem, error_table
from calib_pin.estimation.registration import registered as start_of
from calib_pin.estimation.solve import least_squares
from calib_pin.estimation.statistics.distributions import student_tail
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations
from calib_pin.setup import FrameSetup, Setup
from calib_pin.validation.gains import gains
from calib_pin.validation.left_out import press_check
from calib_pin.validation.model_errors import ModelErrors, predicted_variance

SETUP = Setup(parameters=("joint-offset",), tool_frame=FrameSetup((0.05, 0.08, 0.1)))


def measured(count: int, model: str = "pose") -> Problem:
    problem = nominal_problem(calib_pin.load_chain("space6"), model, SETUP)
    rows = calib_pin.simulate(
        problem,
        np.zeros(len(problem.parameters)),
        np.random.default_rng(0),
        count=count,
        noise=1e-4,
    )
    return replace(problem, data=rows)


def part(before: Floats, after: Floats, variance: float = 1e-8) -> ModelErrors:
    positions = np.arange(len(before))
    return ModelErrors(positions, before, after, np.full(before.shape, variance))


def test_numbers_of_a_gain() -> None:
    problem = measured(8)
    rng = np.random.default_rng(1)
    before, after = 3e-4 * rng.normal(size=(8, 6)), 2e-4 * rng.normal(size=(8, 6))
    label = np.array([0, 0, 1, 2, 2, 2, 3, 4])
    found = gains("set", problem, [part(before, after)], label)
    assert [(g.method, g.quantity) for g in found] == [
        ("set", "all"),
        ("set", "position"),
        ("set", "orientation"),
    ]
    _, position, _ = found
    sizes = np.linalg.norm(before[:, :3], axis=1) - np.linalg.norm(after[:, :3], axis=1)
    means = np.array([sizes[label == k].mean() for k in range(5)])
    error = means.std(ddof=1) / np.sqrt(5)
    assert position.configurations == 5
    assert position.mean == pytest.approx(means.mean())
    assert position.deviation == pytest.approx(error)
    assert position.better == pytest.approx(student_tail(means.mean() / error, 4))
    assert position.better + position.worse == pytest.approx(1.0)
    assert position.ratio == pytest.approx(np.sqrt(np.mean(after[:, :3] ** 2) / 1e-8))


def test_rows_that_are_set_aside_do_not_count() -> None:
    problem = measured(6)
    before, after = np.full((6, 6), 2e-4), np.full((6, 6), 1e-4)
    after[2] = 1.0
    weight = np.array([1.0, 1.0, 0.0, 1.0, 1.0, 1.0])
    label = np.arange(6)
    some = replace(problem, data=problem.data.weighted(weight))
    for g in gains("set", some, [part(before, after)], label):
        assert g.configurations == 5 and g.mean > 0.0 and g.ratio == pytest.approx(1.0)
    nothing = replace(problem, data=problem.data.weighted(np.zeros(6)))
    assert gains("set", nothing, [part(before, after)], label) == ()


def test_what_cannot_be_predicted_settles_it() -> None:
    problem = measured(4)
    finite, lost = np.full((4, 6), 1e-4), np.full((4, 6), 1e-4)
    lost[1] = np.inf
    label = np.arange(4)

    def first(before: Floats, after: Floats) -> Gain:
        return gains("set", problem, [part(before, after)], label)[0]

    assert first(finite, lost).worse == 0.0
    assert first(lost, finite).better == 0.0
    both = first(lost, lost)
    assert both.mean == 0.0 and both.better == both.worse == 0.5


NOISE = 5e-5


def simulated(
    count: int,
    seed: int = 0,
    model: str = "position",
    repeats: int = 1,
    noise: float = NOISE,
) -> tuple[Problem, Floats, Observations]:
    """A problem of `space6`, its true errors and rows that state their noise."""
    problem = nominal_problem(calib_pin.load_chain("space6"), model, SETUP)
    rng = np.random.default_rng(seed)
    truth = calib_pin.draw_errors(problem.parameters, rng)
    rows = calib_pin.simulate(
        problem, truth, rng, count=count, noise=noise, repeats=repeats
    )
    return problem, truth, rows


def fitted_to(problem: Problem, rows: Observations) -> Fit:
    return fit(replace(problem, data=rows), np.random.default_rng(0))


@pytest.mark.parametrize(("model", "repeats"), [("position", 1), ("pose", 3)])
def test_press_of_refits(model: str, repeats: int) -> None:
    problem, _, rows = simulated(12, model=model, repeats=repeats, noise=0.1 * NOISE)
    fitted = fitted_to(problem, rows)
    labels = rows.groups()
    found = press_check(fitted, labels)
    # Errors of an expected size hold what positions tell poorly, here and there.
    known, _, moved = fitted.held
    assert (known.expected is not None) == (model == "position")
    basis = known.parameters.scales[:, None] * moved
    for label in range(4):
        left = labels == label
        rest = replace(known, data=rows.rows(~left))
        theta = least_squares(rest, fitted.theta, basis).x
        there = replace(fitted.problem, data=rows.rows(left))
        # The errors are of 1e-5; curvature enters with their square, 1e-10, times the
        # leverage: ten times the noise leaves a hundred times as much.
        np.testing.assert_allclose(
            found.after[left], error_table(there, theta), rtol=0, atol=1e-8
        )
        rest = start_of(rest, np.zeros(len(theta)))
        registered = register(rest, np.zeros(len(theta)))
        nominal = replace(registered[0], data=rows.rows(left))
        np.testing.assert_allclose(
            found.before[left],
            error_table(nominal, registered[1].x),
            rtol=0,
            atol=2e-5,
        )


def test_predicted_variance_is_that_of_new_errors() -> None:
    """Sum of squares by its expectation over 10 fits of 10 configurations each."""
    problem, truth, _ = simulated(10)
    ratios = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        train, new = (
            calib_pin.simulate(problem, truth, rng, count=count, noise=NOISE)
            for count in (10, 20)
        )
        fitted = fitted_to(problem, train)
        there = replace(fitted.problem, data=new)
        variance = predicted_variance(fitted, there, fitted.theta)
        assert (variance > there.sigma**2).all()
        ratios.append(np.mean(there.errors(fitted.theta) ** 2) / np.mean(variance))
    # Errors of one fit share its 24 unknowns, so that a ratio scatters by 0.35.
    assert np.mean(ratios) == pytest.approx(1.0, abs=4 * 0.35 / np.sqrt(10))


@dataclass(frozen=True)
class Points:
    """Measured values y at x, shape (N,) each, of standard deviation 0.5."""

    x: Floats
    y: Floats

    def __len__(self) -> int:
        return len(self.x)

    def rows(self, index: Any) -> Points:
        return Points(self.x[index], self.y[index])


@dataclass(frozen=True)
class Line:
    """What PRESS asks of a problem, for a line through points."""

    data: Points
    parameters = ("offset", "slope")

    @property
    def layout(self) -> Line:
        return self

    @property
    def row(self) -> NDArray[np.int64]:
        return np.arange(len(self.data))

    @property
    def sigma(self) -> Floats:
        return np.full(len(self.data), 0.5)

    def linearize_rows(self, theta: Floats) -> tuple[Floats, Floats]:
        J = np.column_stack([np.ones(len(self.data)), self.data.x]) / 0.5
        return J @ theta - self.data.y / 0.5, J

    def errors(self, theta: Floats) -> Floats:
        return 0.5 * self.linearize_rows(theta)[0]


def test_press_is_exact_where_the_problem_is_linear() -> None:
    """Of a line through points, with a prior on its slope."""
    rng = np.random.default_rng(0)
    x = rng.normal(size=9)
    line = Line(Points(x, 1.0 + 2.0 * x + 0.1 * rng.normal(size=9)))
    r, J = line.linearize_rows(np.zeros(2))
    prior = np.array([[0.0, 1.0 / 0.3]])

    def solved(kept: Any) -> tuple[Floats, Floats]:
        A = np.concatenate([J[kept], prior])
        C = np.linalg.inv(A.T @ A)
        return -C @ J[kept].T @ r[kept], C

    theta, C = solved(slice(None))
    labels = np.array([0, 0, 1, 1, 1, 2, 3, 3, 3])
    factor = np.linalg.cholesky(C)
    errors, variance = press(
        cast(Problem, line), theta, line.linearize_rows(theta), factor, labels
    )
    for label in range(4):
        left = labels == label
        theta, C = solved(~left)
        np.testing.assert_allclose(errors[left], line.errors(theta)[left], rtol=1e-9)
        expected = 0.25 * (1.0 + np.sum(J[left] @ C * J[left], axis=1))
        np.testing.assert_allclose(variance[left], expected, rtol=1e-9)
