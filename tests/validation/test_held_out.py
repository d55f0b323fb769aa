"""Left-out and held-out measurements, beside fits of the others; gains of these."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

import calib_pin
from benchmarks.exact import exact_problem
from calib_pin.errors import InputError
from calib_pin.estimation import problem as problems
from calib_pin.estimation.evidence import Gain
from calib_pin.estimation.fit import fit, fit_model
from calib_pin.estimation.fitted import Fit, with_prior
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.identifiability import nuisance_basis
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.solve import least_squares
from calib_pin.estimation.statistics.distributions import student_tail
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import BlockKey, Observations
from calib_pin.setup import DistanceSetup, FrameSetup, PointSetup, Setup
from calib_pin.validation.held_out import (
    HeldOut,
    check,
    cross_validate,
    gains,
    left_out,
    press_check,
)
from calib_pin.validation.model_errors import (
    ModelErrors,
    Registered,
    model_errors,
    predicted_variance,
)
from calib_pin.validation.splits import Grouping, folds
from tests.shared import simulated
from tests.validation.test_splits import jogged

SETUP = Setup(parameters=("joint-offset",), tool_frame=FrameSetup((0.05, 0.08, 0.1)))
LEARNED = replace(SETUP, parameters=("placement",), learned="gaussian-process")
CHAIN = calib_pin.load_chain("space6")


def fit_of(
    model: str,
    count: int,
    repeats: int = 1,
    kinds: tuple[str, ...] = ("joint-offset",),
    prior: Mapping[str, float] | None = None,
) -> Fit:
    """A fit of rows of a robot with errors of some kinds, 5e-5 of noise each."""
    setup = replace(SETUP, parameters=kinds)
    job, _ = simulated(model, setup, count, 1.0, noise=5e-5, repeats=repeats)
    rows, rng = job.data, np.random.default_rng(0)
    # Readings of one configuration may differ by less than configurations do.
    shift = 5e-5 * rng.normal(size=(count * repeats, rows.only.values.shape[1]))
    shift = shift[np.unique(rows.groups(), return_index=True)[1]][rows.groups()]
    rows = Observations.of(replace(rows.only, values=rows.only.values + shift))
    return fit_model(CHAIN, rows, replace(SETUP, prior=prior or {}), 0)


def without(fitted: Fit, mask: NDArray[np.bool_]) -> tuple[Floats, Floats, Floats]:
    """Errors before and after, and their variances, by a fit in the same directions."""
    held, _, moved = with_prior(fitted)
    data, problem, scales = held.data, fitted.problem, held.parameters.scales
    rest = replace(held, data=data.rows(~mask))
    theta = least_squares(rest, fitted.theta, scales[:, None] * moved).x
    fun, jac = replace(problem, data=data.rows(~mask)).linearize(theta)
    result = replace(fitted.result, x=theta, fun=fun, jac=jac)
    known = replace(problem, data=data.rows(~mask))
    less = replace(fitted, problem=known, result=result)
    before = least_squares(known, fitted.before, nuisance_basis(known.parameters)).x
    there = replace(problem, data=data.rows(mask))
    variance = predicted_variance(less, Registered(there, theta))
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
    fitted = fit_of(model, count, repeats, kinds, prior)
    assert not prior or with_prior(fitted)[0].expected is not None
    assert "transmission" not in kinds or fitted.effects is not None
    label = fitted.problem.data.groups()
    masks = [np.isin(label, (0, 1)), label % 3 == 2]
    for mask, found in zip(masks, left_out(fitted, masks), strict=True):
        assert found is not None
        before, after, variance = without(fitted, mask)
        np.testing.assert_array_equal(found.positions, np.flatnonzero(mask))
        sigma = np.sqrt(variance)
        assert np.abs((found.after - after) / sigma).max() < 0.01
        assert np.abs(found.before - before).max() < 0.01 * np.abs(before).max()
        np.testing.assert_allclose(found.variance, variance, rtol=0.02)


def test_one_step_for_every_configuration() -> None:
    """What PRESS says of all of them at once is what each says when left out."""
    fitted = fit_of("pose", 10, 3)
    label = fitted.problem.data.groups()
    found = press_check(fitted, label)
    masks = [label == k for k in range(10)]
    for mask, one in zip(masks, left_out(fitted, masks), strict=True):
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
    return simulated("fixed-point", setup, 60, 3.0, seed=1, noise=5e-5)[0].data


def test_sockets_of_a_place_are_where_its_rows_put_them(
    in_sockets: Observations,
) -> None:
    """And their distance is there to be found."""
    rows = in_sockets
    back = np.array([name.startswith("back") for name in rows.target])
    whole = fit_model(CHAIN, rows, IN_SOCKETS, 0)
    grouping = Grouping.of(rows, IN_SOCKETS)
    masks = folds(grouping, whole, 0)
    assert grouping.validation_name(len(masks)) == "leave-one-place-out"
    np.testing.assert_array_equal(np.sum(masks, axis=0), 1)
    assert any((mask == back).all() for mask in masks)
    # The others know nothing of them.
    assert left_out(whole, [back]) == [None]
    (found,) = cross_validate(whole, rows, [back], 0)
    assert set(found.registered) == {"back/0", "back/1"}
    (distance,) = found.distances
    assert distance.between == ("back/0", "back/1") and not distance.fitted
    assert abs(distance.found - 0.05) < 1e-4 < abs(distance.nominal - 0.05)


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
    monkeypatch.setattr("calib_pin.validation.held_out.BENT", 0.0)
    first = np.arange(len(in_sockets)) < 5
    assert left_out(every, [first]) == [None]
    (part,) = cross_validate(every, in_sockets, [first], 0)
    assert not part.reason and np.abs(part.after).max() < 3e-4


def test_very_many_are_left_out_by_sums(monkeypatch: pytest.MonkeyPatch) -> None:
    def found() -> ModelErrors:
        fitted = fit_of("position", 40)
        label = fitted.problem.data.groups()
        (one,) = left_out(replace(fitted, effects=None), [label % 4 == 1])
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


# Where something was learned.


def test_parts_promise_what_new_measurements_have() -> None:
    waves = replace(LEARNED, parameters=("placement", "transmission"), learned=None)
    (problem, _), (other, _) = (
        simulated("position", waves, count, 0.5, 3, again=again, noise=1e-5)
        for count, again in ((80, None), (300, 9))
    )
    chain, rows, fresh = problem.chains[""], problem.data, other.data
    model = fit_model(chain, rows, LEARNED, 0)
    assert model.learned is not None
    masks = folds(Grouping.of(rows, LEARNED), model, 0)
    parts = [part for part in left_out(model, masks, 0) if part is not None]
    assert sorted(ModelErrors.joined(parts).positions) == list(range(80))
    plain = replace(model, learned=None)
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


def test_a_part_with_all_of_a_target_takes_a_fit() -> None:
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


def measured(count: int, model: str = "pose") -> Problem:
    return simulated(model, SETUP, count, noise=1e-4)[0]


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


def test_predicted_variance_is_that_of_new_errors() -> None:
    """Sum of squares by its expectation over 10 fits of 10 configurations each."""
    problem = nominal_problem(calib_pin.load_chain("space6"), "position", SETUP)
    truth = calib_pin.draw_errors(problem.parameters, np.random.default_rng(0))
    ratios = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        train, new = (
            calib_pin.simulate(problem, truth, rng, count=count, noise=NOISE)
            for count in (10, 20)
        )
        fitted = fit(replace(problem, data=train), np.random.default_rng(0))
        there = replace(fitted.problem, data=new)
        variance = predicted_variance(fitted, Registered(there, fitted.theta))
        assert (variance > there.sigma**2).all()
        ratios.append(np.mean(there.errors(fitted.theta) ** 2) / np.mean(variance))
    # Errors of one fit share its 24 unknowns, so that a ratio scatters by 0.35.
    assert np.mean(ratios) == pytest.approx(1.0, abs=4 * 0.35 / np.sqrt(10))


def rows_of(
    count: int, seed: int = 1, model: str = "position", repeats: int = 1
) -> Observations:
    """Rows of one robot; the seed chooses its configurations and the noise."""
    how = {"again": seed, "noise": 5e-5, "repeats": repeats}
    return simulated(model, SETUP, count, 1.0, 7, **how)[0].data


def fitted_to(rows: Observations) -> Fit:
    return fit_model(CHAIN, rows, SETUP, 0)


def test_a_copy_of_what_was_fitted_checks_nothing() -> None:
    rows, new = rows_of(30), rows_of(12, seed=2)
    model = fitted_to(rows)
    found = check(model, rows, 0, validation=rows, method="file")
    assert (found.parts, found.method) == ((), "none")
    assert [f.code for f in found.findings] == ["repeated-validation"]
    assert {g.method for g in found.gains} == {"press"}
    # Some of it does not spoil the rest.
    mixed = Observations.of(rows.rows(np.arange(5)), new)
    found = check(model, rows, 0, validation=mixed, method="file")
    (part,) = found.parts
    np.testing.assert_array_equal(part.positions, np.arange(5, 17))
    assert found.gains[0].configurations == 12
    few = Observations.of(rows, new.rows(np.arange(4)))
    # Few are used, and are too few for a verdict.
    found = check(model, rows, 0, validation=few)
    assert (found.method, found.gains[0].configurations) == ("set", 4)


def test_set_aside_rows_stay_out() -> None:
    """Out of the fits of the folds, and out of every accuracy."""
    rows = rows_of(40).only
    values = rows.values.copy()
    values[[3, 20]] += 0.05
    weight = np.ones(40)
    weight[[3, 20]] = 0.0
    spoiled = Observations.of(replace(rows, values=values, weight=weight))
    found = check(fitted_to(spoiled), spoiled, 0)
    assert found.method == "5-fold"
    positions = np.concatenate([part.positions for part in found.parts])
    assert sorted(positions) == list(range(40))
    counted = np.concatenate([part.positions for part in found.counted])
    assert sorted(counted) == sorted(set(range(40)) - {3, 20})
    after = np.concatenate([part.after for part in found.counted])
    assert np.abs(after).max() < 3e-4
    assert {g.configurations for g in found.gains} == {38}


def test_without_validation_there_is_the_hat_matrix() -> None:
    rows = rows_of(30)
    model = fitted_to(rows)
    found = check(model, rows, 0, parts=())
    assert (found.parts, found.method) == ((), "none")
    assert [g.method for g in found.gains] == ["press", "press"]
    checked = check(model, rows, 0)
    folded, _, pressed, _ = checked.gains
    # The same question, asked of one row at a time and of six: without these, the
    # twelve unknowns of base and tool have 72 values in place of 87.
    assert pressed.mean == pytest.approx(folded.mean, rel=0.2)
    assert 0.8 < folded.ratio < 1.2 and 0.8 < pressed.ratio < 1.2


def along_lines() -> Observations:
    """Positions on straight lines from one random configuration to the next."""
    problem = nominal_problem(CHAIN, "position", SETUP)
    rng = np.random.default_rng(5)
    truth, q = calib_pin.draw_errors(problem.parameters, rng), jogged(rng, 12)
    data = exact_problem(problem, truth, q, ("",) * len(q)).data.only
    noise = 5e-5 * rng.normal(size=data.values.shape)
    return Observations.of(replace(data, values=data.values + noise))


def test_a_path_is_folded_by_stretch() -> None:
    rows = along_lines()
    found = check(fitted_to(rows), rows, 0)
    assert found.method == "5-fold by stretch"
    for part in found.parts:
        # Whole stretches: few places where the next row belongs to another part.
        assert np.count_nonzero(np.diff(part.positions) > 1) < 8
    assert 5 <= found.gains[0].configurations < 30
    result = calib_pin.calibrate(CHAIN, rows, SETUP, holdout=0.25)
    assert result.held_out is not None
    left = np.isin(rows.q[:, 0], result.held_out.rows.q[:, 0])
    assert np.count_nonzero(np.diff(left.astype(int))) < 16


def moved(rows: Observations, by: float) -> Observations:
    values = rows.only.values + by * np.array([0.6, -0.5, 0.62])
    return Observations.of(replace(rows.only, values=values))


@pytest.mark.parametrize("seed", [4, 10, 11])
def test_a_robot_that_is_not_known_there_is_no_instrument_that_moved(seed: int) -> None:
    """Measured in one corner of joint space, a robot errs in another by its own."""
    setup = replace(SETUP, parameters=("placement",))
    problem, rng = (
        nominal_problem(CHAIN, "position", setup),
        np.random.default_rng(seed),
    )
    truth = calib_pin.draw_errors(problem.parameters, rng)
    here, there = rng.uniform(-1.2, 1.2, (2, 6))

    def at(corner: Floats, count: int) -> Observations:
        q = corner + rng.uniform(-0.35, 0.35, (count, 6))
        return calib_pin.simulate(problem, truth, rng, q=q, noise=5e-5)

    rows, elsewhere, again = at(here, 30), at(there, 12), at(here, 12)
    model = fit_model(CHAIN, rows, setup, 0)

    def told(new: Observations) -> list[str]:
        found = check(model, rows, 0, validation=new, method="file").findings
        return [finding.code for finding in found if finding.code == "moved-instrument"]

    assert not told(elsewhere)
    assert told(moved(again, 3e-4))


def test_a_model_with_no_row_to_fit_is_refused() -> None:
    points, poses = rows_of(30), rows_of(10, seed=2, model="pose").only
    poses = replace(
        poses,
        validate=np.ones(10, bool),
        files=("poses.csv",) * 10,
        lines=np.arange(2, 12),
    )
    both = Observations.of(points, poses)
    with pytest.raises(InputError, match="'pose'") as error:
        calib_pin.calibrate(CHAIN, both, SETUP)
    assert (error.value.file, error.value.line) == ("poses.csv", 2)


STATIONS = {
    "floor": FrameSetup((1.0, 2.0, 0.3), (0.1, 0.2, 0.3)),
    "bench": FrameSetup((-2.0, 1.0, 0.3), (0.1, 0.2, 2.3)),
    "door": FrameSetup((-2.0, -3.0, 0.3), (0.1, 0.2, -2.3)),
}


def from_station(name: str, count: int, seed: int = 1) -> Observations:
    """Positions of the same robot by an instrument that stands elsewhere."""
    keys = [BlockKey("position", station=station) for station in STATIONS]
    setup, key = replace(SETUP, stations=STATIONS), keys[list(STATIONS).index(name)]
    how = {"again": seed, "noise": 5e-5, "key": key}
    return simulated(keys, setup, count, 1.0, 7, **how)[0].data


def two_stations() -> Observations:
    return Observations.of(from_station("floor", 25), from_station("bench", 15, 2))


def test_a_new_station_is_registered_on_itself() -> None:
    """And nothing else: neither the robot nor the tool."""
    rows, new = from_station("floor", 40), from_station("door", 15, 3)
    setup = replace(SETUP, base_frame=replace(STATIONS["floor"], estimate=True))
    alone = calib_pin.calibrate(CHAIN, rows, setup, validate=False)
    result = calib_pin.calibrate(CHAIN, rows, setup, validation=new)
    np.testing.assert_array_equal(result.model.theta, alone.model.theta)
    assert (result.validation.located, result.findings) == (("station door",), ())
    assert [g.method for g in result.statistics.gains] == ["file"] * 2 + ["press"] * 2
    assert 0.7 < result.statistics.gains[0].ratio < 1.3
    assert result.held_out is not None
    door = result.held_out
    # As if the instrument had never moved, but for six of 45 values.
    same = calib_pin.calibrate(
        CHAIN, rows, setup, validation=from_station("floor", 15, 3)
    ).held_out
    assert same is not None
    np.testing.assert_allclose(door.points, same.points, rtol=0, atol=1e-12)
    for own, floor in ((door.before, same.before), (door.after, same.after)):
        assert np.sqrt(np.mean(own**2)) < 1.05 * np.sqrt(np.mean(floor**2))
    assert np.abs(door.after).max() < 3e-4 < 2e-3 < np.abs(door.before).max()
    found = calib_pin.evaluate(result.model, new)
    assert (found.registered, found.located) == (False, ("station door",))
    after = result.errors[0].validation_after
    assert after is not None and found.errors[0][2] == after


def test_a_station_that_is_known_is_not_registered() -> None:
    setup = replace(SETUP, stations={"door": replace(STATIONS["door"], estimate=False)})
    new = from_station("door", 15, 3)
    result = calib_pin.calibrate(CHAIN, two_stations(), setup, validation=new)
    assert result.validation.located == () and result.held_out is not None
    # It stands where it is said to, by 0.7 mm wrongly.
    assert np.abs(result.held_out.after).max() > 5e-4


def test_only_the_station_that_was_moved_is_registered_anew() -> None:
    rows, seen = two_stations(), from_station("bench", 10, 4)
    new = from_station("floor", 15, 3)
    model = fitted_to(rows)

    def checked(*parts: Observations) -> HeldOut:
        every = Observations.of(*parts)
        return check(model, rows, 0, validation=every, method="file")

    plain, found = checked(seen, new), checked(seen, moved(new, 0.3))
    assert plain.findings == ()
    (finding,) = found.findings
    assert finding.code == "moved-instrument" and "'floor'" in finding.message
    assert found.gains[0].better < 1e-6
    # Six of 45 values went into the stand.
    after, before = (
        np.sqrt(np.mean(one.parts[1].after ** 2)) for one in (found, plain)
    )
    assert 0.8 < after / before < 1.02
    np.testing.assert_array_equal(found.parts[0].after, plain.parts[0].after)
    positions = np.concatenate([part.positions for part in found.parts])
    np.testing.assert_array_equal(positions, np.arange(25))
    assert 0.7 < found.gains[0].ratio < 1.3
    # Too few from there are left out; the others still check the fit.
    found = checked(seen, moved(new.rows(np.arange(2)), 0.3))
    np.testing.assert_array_equal(found.parts[0].positions, np.arange(10))


def test_validation_that_cannot_be_is_refused() -> None:
    """A new station that is hardly seen, a tool that was not fitted."""
    rows, model = two_stations(), fitted_to(two_stations())
    few = replace(
        from_station("door", 1, 3).only, files=("door.csv",), lines=np.array([2])
    )
    both = Observations.of(from_station("bench", 10, 4), few)
    with pytest.raises(InputError, match="door") as error:
        check(model, rows, 0, validation=both)
    assert (error.value.file, error.value.line) == ("door.csv", 2)
    probe = Observations.of(replace(from_station("floor", 15, 3).only, tool="probe"))
    with pytest.raises(InputError, match="'probe'"):
        check(model, rows, 0, validation=probe)
