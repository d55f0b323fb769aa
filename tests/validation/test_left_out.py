"""Errors of groups that are left out, beside those by a fit of the others."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

import calib_pin
from calib_pin.estimation import problem as problems
from calib_pin.estimation.directions import nuisance_basis
from calib_pin.estimation.fit import FittedModel, fit_model
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.solve import least_squares
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations
from calib_pin.setup import DistanceSetup, FrameSetup, PointSetup, Setup
from calib_pin.validation import left_out as module
from calib_pin.validation.held_out import (
    Linear,
    cross_validate,
    left_out,
    press,
    press_check,
)
from calib_pin.validation.model_errors import (
    ModelErrors,
    model_errors,
    predicted_variance,
)
from calib_pin.validation.splits import Grouping, folds

SETUP = Setup(parameters=("joint-offset",), tool_frame=FrameSetup((0.05, 0.08, 0.1)))
LEARNED = replace(SETUP, parameters=("placement",), learned="gaussian-process")
CHAIN = calib_pin.load_chain("space6")


def fitted_to(
    model: str,
    count: int,
    repeats: int = 1,
    kinds: tuple[str, ...] = ("joint-offset",),
    prior: Mapping[str, float] | None = None,
) -> Fit:
    """A fit of rows of a robot with errors of some kinds, 5e-5 of noise each."""
    setup = replace(SETUP, parameters=kinds)
    problem, rng = nominal_problem(CHAIN, model, setup), np.random.default_rng(0)
    truth = calib_pin.draw_errors(problem.parameters, rng)
    rows = calib_pin.simulate(
        problem, truth, rng, count=count, noise=5e-5, repeats=repeats
    )
    # Readings of one configuration may differ by less than configurations do.
    shift = 5e-5 * rng.normal(size=(count * repeats, rows.only.values.shape[1]))
    shift = shift[np.unique(rows.groups(), return_index=True)[1]][rows.groups()]
    rows = Observations.of(replace(rows.only, values=rows.only.values + shift))
    return fit_model(CHAIN, rows, replace(SETUP, prior=prior or {}), 0).fit


def model_of(fitted: Fit) -> FittedModel:
    return FittedModel(fitted, *fitted.problem.rebased(fitted.theta))


def without(fitted: Fit, mask: NDArray[np.bool_]) -> tuple[Floats, Floats, Floats]:
    """Errors before and after, and their variances, by a fit in the same directions."""
    held, _, moved = fitted.held
    data, problem, scales = held.data, fitted.problem, held.parameters.scales
    rest = replace(held, data=data.rows(~mask))
    theta = least_squares(rest, fitted.theta, scales[:, None] * moved).x
    fun, jac = replace(problem, data=data.rows(~mask)).linearize(theta)
    result = replace(fitted.result, x=theta, fun=fun, jac=jac)
    known = replace(problem, data=data.rows(~mask))
    less = replace(fitted, problem=known, result=result)
    before = least_squares(known, fitted.before, nuisance_basis(known.parameters)).x
    there = replace(problem, data=data.rows(mask))
    variance = predicted_variance(less, there, theta)
    tables = (there.errors(before), there.errors(theta), variance)
    first, second, third = (
        there.layout.table(flat, len(there.data)) for flat in tables
    )
    return first, second, third


@pytest.mark.parametrize(
    ("model", "count", "repeats", "kinds", "prior"),
    [
        ("position", 12, 1, ("joint-offset",), {"joint_2.*": 1e-3, "tool.*": 1e-3}),
        ("pose", 10, 3, ("joint-offset",), {}),
        ("position", 40, 2, ("joint-offset", "transmission"), {}),
    ],
)
def test_left_out_is_refitted(
    model: str,
    count: int,
    repeats: int,
    kinds: tuple[str, ...],
    prior: Mapping[str, float],
) -> None:
    """Within a tenth of a deviation it must be; it is within a hundredth."""
    fitted = fitted_to(model, count, repeats, kinds, prior)
    assert not prior or fitted.held[0].expected is not None
    assert "transmission" not in kinds or fitted.effects is not None
    label = fitted.problem.data.groups()
    masks = [np.isin(label, (0, 1)), label % 3 == 2]
    for mask, found in zip(masks, left_out(model_of(fitted), masks), strict=True):
        assert found is not None
        before, after, variance = without(fitted, mask)
        np.testing.assert_array_equal(found.positions, np.flatnonzero(mask))
        sigma = np.sqrt(variance)
        assert np.abs((found.after - after) / sigma).max() < 0.01
        assert np.abs(found.before - before).max() < 0.01 * np.abs(before).max()
        np.testing.assert_allclose(found.variance, variance, rtol=0.02)


def test_one_step_for_every_configuration() -> None:
    """What PRESS says of all of them at once is what each says when left out."""
    fitted = fitted_to("pose", 10, 3)
    label = fitted.problem.data.groups()
    found = press_check(fitted, label)
    masks = [label == k for k in range(10)]
    for mask, one in zip(masks, left_out(model_of(fitted), masks), strict=True):
        assert one is not None
        sigma = np.sqrt(one.variance)
        assert np.abs((found.after[mask] - one.after) / sigma).max() < 0.01
        off = np.abs(found.before[mask] - one.before).max()
        assert off < 0.01 * np.abs(one.before).max()


AT = {
    "front": ((0.6, 0.3, 0.4), (0.65, 0.3, 0.4)),
    "left": ((0.5, -0.2, 0.6), (0.5, -0.15, 0.6)),
    "back": ((-0.4, 0.4, 0.5), (-0.4, 0.4, 0.55)),
}
BALL = FrameSetup((0.05, 0.08, 0.1), (0.0, 0.0, 0.0), estimate=True)
FIFTY = tuple(DistanceSetup((f"{place}/0", f"{place}/1"), 0.05, 1e-5) for place in AT)
IN_SOCKETS = Setup(parameters=("joint-offset",), distances=FIFTY)


@pytest.fixture(scope="module")
def in_sockets() -> Observations:
    """A ball in two sockets at each of three places, 50 mm apart."""
    sockets = {
        f"{place}/{k}": PointSetup(xyz)
        for place, both in AT.items()
        for k, xyz in enumerate(both)
    }
    setup = replace(IN_SOCKETS, sockets=sockets, tool_frame=BALL)
    problem = nominal_problem(CHAIN, "fixed-point", setup)
    rng = np.random.default_rng(1)
    truth = 3.0 * calib_pin.draw_errors(problem.parameters, rng)
    return calib_pin.simulate(problem, truth, rng, count=60, noise=5e-5)


def test_sockets_of_a_place_are_where_its_rows_put_them(
    in_sockets: Observations,
) -> None:
    """And their distance is there to be found."""
    rows = in_sockets
    back = np.array([name.startswith("back") for name in rows.target])
    whole = fit_model(CHAIN, rows, IN_SOCKETS, 0)
    grouping = Grouping.of(rows, IN_SOCKETS)
    masks = folds(grouping, whole.fit, 0)
    assert grouping.validation_name(len(masks)) == "leave-one-place-out"
    np.testing.assert_array_equal(np.sum(masks, axis=0), 1)
    (mine,) = [k for k, mask in enumerate(masks) if (mask == back).all()]
    found = left_out(whole, masks)[mine]
    assert found is not None and not found.reason
    rest = fit_model(CHAIN, rows.rows(~back), IN_SOCKETS, 0, effects_of=whole.fit)
    refitted = model_errors(rest, rows.rows(back), np.flatnonzero(back))
    assert set(found.registered) == set(refitted.registered) == {"back/0", "back/1"}
    for errors in (found, refitted):
        (distance,) = errors.distances
        assert distance.between == ("back/0", "back/1") and not distance.fitted
        assert abs(distance.found - 0.05) < 1e-4 < abs(distance.nominal - 0.05)
    # Noise and sizes of errors are estimated from two places of three.
    sigma = np.sqrt(refitted.variance)
    assert np.abs((found.after - refitted.after) / sigma).max() < 0.1
    np.testing.assert_allclose(found.variance, refitted.variance, rtol=0.3)
    size = np.abs(refitted.before).max()
    assert np.abs(found.before - refitted.before).max() < 0.01 * size


def test_a_refit_where_one_step_cannot_tell(
    in_sockets: Observations, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A socket that is seen once says no more than where it is."""
    names = np.array(list(in_sockets.target))
    kept = names != "back/1"
    kept[np.flatnonzero(names == "back/1")[0]] = True
    rows = in_sockets.rows(kept)
    back = np.array([name.startswith("back") for name in rows.target])
    setup = replace(IN_SOCKETS, distances=FIFTY[:2])
    whole = fit_model(CHAIN, rows, setup, 0)
    assert left_out(whole, [back]) == [None]
    (part,) = cross_validate(whole, rows, [back], 0)
    assert "say no more than where it is" in part.reason and not len(part.positions)
    every = fit_model(CHAIN, in_sockets, IN_SOCKETS, 0)
    monkeypatch.setattr(module, "BENT", 0.0)
    first = np.arange(len(in_sockets)) < 5
    assert left_out(every, [first]) == [None]
    (part,) = cross_validate(every, in_sockets, [first], 0)
    assert not part.reason and np.abs(part.after).max() < 3e-4


def test_very_many_are_left_out_by_sums(monkeypatch: pytest.MonkeyPatch) -> None:
    def found() -> ModelErrors:
        fitted = fitted_to("position", 40)
        label = fitted.problem.data.groups()
        (one,) = left_out(model_of(replace(fitted, effects=None)), [label % 4 == 1])
        assert one is not None
        return one

    few = found()
    monkeypatch.setattr(problems, "MANY", 100)
    many = found()
    np.testing.assert_array_equal(few.positions, many.positions)
    sigma = np.sqrt(few.variance)
    assert np.abs((few.after - many.after) / sigma).max() < 0.01
    assert np.abs(few.before - many.before).max() < 0.01 * np.abs(few.before).max()
    # All of them know the parameters better than three quarters of them do.
    assert (many.variance < few.variance).all()
    np.testing.assert_allclose(many.variance, few.variance, rtol=0.4)


@dataclass(frozen=True)
class Points:
    """Measured values y at x, shape (N,) each, of standard deviation 0.5."""

    x: Floats
    y: Floats

    def __len__(self) -> int:
        return len(self.x)


@dataclass(frozen=True)
class Line:
    """What PRESS asks of a problem, for a line through points."""

    data: Points

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
    F, fun = np.linalg.cholesky(C), line.linearize_rows(theta)[0]
    every = Linear(cast(Problem, line), theta, fun, J, F, J @ F, 1.0)
    errors, variance = press(every, labels)
    for label in range(4):
        left = labels == label
        theta, C = solved(~left)
        expected = 0.5 * line.linearize_rows(theta)[0][left]
        np.testing.assert_allclose(errors[left], expected, rtol=1e-9)
        expected = 0.25 * (1.0 + np.sum(J[left] @ C * J[left], axis=1))
        np.testing.assert_allclose(variance[left], expected, rtol=1e-9)


# Where something was learned.


def test_parts_promise_what_new_measurements_have(
    simulated: Callable[..., Any],
) -> None:
    waves = replace(LEARNED, parameters=("placement", "transmission"), learned=None)
    problem, truth = simulated("position", waves, 80, 0.5, seed=3, noise=1e-5)
    chain, rows = problem.chains[""], problem.data
    model = fit_model(chain, rows, LEARNED, 0)
    assert model.learned is not None
    masks = folds(Grouping.of(rows, LEARNED), model.fit, 0)
    parts = [part for part in left_out(model, masks, 0) if part is not None]
    assert sorted(ModelErrors.joined(parts).positions) == list(range(80))
    rng = np.random.default_rng(9)
    fresh = calib_pin.simulate(problem, truth, rng, count=300, noise=1e-5)
    plain = replace(model, problem=model.fit.problem, theta=model.fit.theta)
    found, new, without = (
        np.sqrt((errors.after**2).mean())
        for errors in (
            ModelErrors.joined(parts),
            model_errors(model, fresh, np.arange(300)),
            model_errors(plain, fresh, np.arange(300)),
        )
    )
    # A fold of five learns from four fifths, and 80 errors scatter by a tenth.
    assert 0.9 < found / new < 1.5 and new < 0.5 * without


def test_a_part_with_all_of_a_target_takes_a_fit(simulated: Callable[..., Any]) -> None:
    sockets = {"a": PointSetup((0.4, 0.1, 0.2)), "b": PointSetup((0.3, -0.2, 0.3))}
    kinds = ("joint-offset", "transmission")
    truth = replace(LEARNED, parameters=kinds, sockets=sockets, learned=None)
    problem, _ = simulated("fixed-point", truth, 60, 1.0, noise=1e-5)
    rows, setup = problem.data, replace(LEARNED, parameters=("joint-offset",))
    model = fit_model(problem.chains[""], rows, setup, 0)
    target = np.array(rows.only.target)
    every, some = target == "a", (target == "a") & (np.arange(60) < 30)
    first, second = left_out(model, [every, some], 0)
    assert first is None and second is not None
    np.testing.assert_array_equal(second.positions, np.flatnonzero(some))
