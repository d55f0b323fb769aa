"""Splits, validation, verdicts and evaluation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.errors import InputError, OptionError
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.kinematics.chains import Chains
from calib_pin.observations import BlockKey, Observations
from calib_pin.setup import DistanceSetup, FrameSetup, PlaneSetup, Setup, ToolSetup
from calib_pin.validation.calibrated_model import CalibratedModel

TOOL = FrameSetup((0.05, 0.1, 0.1), (0.3, 0.2, 0.1))
HAND = ToolSetup((0.05, 0.1, 0.1))


def measured(
    count: int, *, seed: int = 1, noise: float = 5e-5, size: float = 1.0
) -> tuple[calib_pin.Chain, calib_pin.Measurements]:
    """Positions of `space6` with drawn errors, without sigma columns."""
    chain = calib_pin.load_chain("space6")
    problem = nominal_problem(chain, "position", Setup(tool_frame=TOOL))
    rng = np.random.default_rng(seed)
    truth = size * calib_pin.draw_errors(problem.parameters, rng)
    rows = calib_pin.simulate(problem, truth, rng, count=count, noise=noise).only
    return chain, replace(rows, sigma=None)


def test_five_folds_by_default() -> None:
    chain, rows = measured(60)
    result = calib_pin.calibrate(chain, rows)
    assert (result.verdict, result.validation.method) == ("good", "5-fold")
    assert (len(result.fitted), result.validation.count) == (60, 60)
    (errors,) = result.errors
    assert errors.validation_before is not None
    assert errors.validation_after is not None
    assert errors.after.rms < errors.validation_after.rms < 0.2 * errors.before.rms


def test_rows_marked_for_validation_are_not_fitted() -> None:
    chain, rows = measured(60)
    marked = replace(rows, validate=np.arange(60) >= 40)
    first = calib_pin.calibrate(chain, marked)
    assert (first.validation.method, len(first.fitted), first.validation.count) == (
        "set",
        40,
        20,
    )
    # Whatever stands in those rows, the fit is the same.
    spoiled = rows.values.copy()
    spoiled[40:] += 0.01
    second = calib_pin.calibrate(chain, replace(marked, values=spoiled))
    assert np.array_equal(first.model.theta, second.model.theta)


def test_a_validation_file_takes_the_place_of_folds() -> None:
    chain, rows = measured(80)
    result = calib_pin.calibrate(
        chain, rows.rows(np.arange(50)), validation=rows.rows(np.arange(50, 80))
    )
    assert (result.validation.method, len(result.fitted), result.validation.count) == (
        "file",
        50,
        30,
    )


def test_holdout_sets_a_part_aside() -> None:
    chain, rows = measured(60)
    result = calib_pin.calibrate(chain, rows, holdout=0.25)
    assert result.validation.method == "holdout"
    assert (len(result.fitted), result.validation.count) == (45, 15)
    other = calib_pin.calibrate(chain, rows, holdout=0.25, seed=1)
    assert not np.array_equal(result.model.theta, other.model.theta)


def test_repetitions_never_stand_on_both_sides() -> None:
    chain, rows = measured(30)
    twice = rows.rows(np.repeat(np.arange(30), 2))
    result = calib_pin.calibrate(chain, twice, holdout=0.3)
    assert len(result.fitted) + result.validation.count == 60
    assert len(result.fitted) % 2 == result.validation.count % 2 == 0


@pytest.mark.parametrize("holdout", [0.0, 1.0, -0.5, np.nan])
def test_holdout_out_of_range(holdout: float) -> None:
    chain, rows = measured(20)
    with pytest.raises(OptionError, match="between 0 and 1"):
        calib_pin.calibrate(chain, rows, holdout=holdout)


def test_validation_rows_and_holdout_exclude_each_other() -> None:
    chain, rows = measured(20)
    with pytest.raises(OptionError, match="not both"):
        calib_pin.calibrate(chain, rows, validation=rows, holdout=0.2)


def test_nothing_left_to_fit() -> None:
    chain, rows = measured(20)
    with pytest.raises(InputError, match="no measurement is left"):
        calib_pin.calibrate(chain, replace(rows, validate=np.ones(20, bool)))


def test_fewer_values_than_the_structural_rank() -> None:
    chain, rows = measured(8)
    result = calib_pin.calibrate(chain, rows)
    assert result.verdict == "unchecked"
    assert "24 measured values cannot determine 27" in result.reason


def test_no_redundancy() -> None:
    chain, rows = measured(9, noise=0.0)
    result = calib_pin.calibrate(chain, rows)
    assert result.verdict == "unchecked"
    assert "nothing to check the fit with" in result.reason


def test_worse_on_unseen_rows() -> None:
    """A robot with the opposite errors is not served by the calibration."""
    chain, rows = measured(140)
    _, opposite = measured(140, size=-1.0)
    new = np.arange(140) >= 40
    result = calib_pin.calibrate(chain, rows.rows(~new), validation=opposite.rows(new))
    assert result.verdict == "untrusted"
    assert "worse than the nominal one: position" in result.reason


def test_too_few_rows_for_folds_are_not_validated() -> None:
    chain, rows = measured(10)
    result = calib_pin.calibrate(chain, rows)
    assert (result.validation.method, result.validation.count) == ("none", 0)
    assert result.errors[0].validation_after is None


def test_an_outlier_is_named() -> None:
    chain, rows = measured(60)
    values = rows.values.copy()
    values[17, 1] += 0.003
    result = calib_pin.calibrate(chain, replace(rows, values=values))
    assert [outlier.row for outlier in result.statistics.outliers] == [17]
    assert result.statistics.outliers[0].place == "row 17"


def test_stated_sigmas_stand_until_the_rows_contradict_them() -> None:
    chain, rows = measured(60)
    assumed, right, tenfold = (
        calib_pin.calibrate(
            chain,
            replace(rows, sigma=sigma),
            validate=False,
        )
        for sigma in (None, np.full((60, 3), 5e-5), np.full((60, 3), 5e-4))
    )
    assert (
        not assumed.statistics.stated_sigma
        and right.statistics.stated_sigma
        and tenfold.statistics.stated_sigma
    )
    # The true noise is a tenth of what is stated: chi-square shows it.
    assert tenfold.statistics.sigma0 == pytest.approx(0.1, rel=0.15)
    assert right.statistics.sigma0 == pytest.approx(1.0, rel=0.15)
    contradicted = [
        result.statistics.noise[0].contradicted for result in (right, tenfold)
    ]
    assert contradicted == [False, True]
    # The covariance follows the statement where it stands, else the rows.
    for result, expected in ((right, 1.0 / right.statistics.sigma0), (tenfold, 1.0)):
        pairs = zip(assumed.parameters, result.parameters, strict=True)
        ratios = [
            b.sigma / a.sigma
            for a, b in pairs
            if ".placement." in a.name and a.sigma and b.sigma
        ]
        assert len(ratios) > 10
        assert ratios == pytest.approx([expected] * len(ratios), rel=1e-3)


def test_bounded_parameters_are_named() -> None:
    chain, rows = measured(60)
    setup = Setup(bounds={"joint_3.placement.*": 1e-5})
    result = calib_pin.calibrate(chain, rows, setup, validate=False)
    assert result.solver.at_bounds
    assert all(
        name.startswith("joint_3.placement.") for name in result.solver.at_bounds
    )


def test_evaluate_registers_a_chain_but_not_a_model() -> None:
    chain, rows = measured(60)
    _, unseen = measured(60)
    result = calib_pin.calibrate(chain, rows)
    nominal = calib_pin.evaluate(chain, unseen)
    assert nominal.registered
    assert nominal.errors[0][2].rms == pytest.approx(result.errors[0].before.rms)
    frozen = calib_pin.evaluate(result.model, unseen)
    assert not frozen.registered
    assert frozen.errors[0][2].rms == pytest.approx(result.errors[0].after.rms)


def test_evaluate_after_the_instrument_has_moved() -> None:
    chain, rows = measured(60)
    model = calib_pin.calibrate(chain, rows).model
    R = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    moved = replace(rows, values=rows.values @ R.T + [5.0, -1.0, 0.3])
    lost = calib_pin.evaluate(model, moved).errors[0][2]
    found = calib_pin.evaluate(model, moved, registration=True).errors[0][2]
    assert lost.rms > 1.0
    assert found.rms == pytest.approx(
        calib_pin.evaluate(model, rows, registration=True).errors[0][2].rms, rel=1e-6
    )


def test_the_tool_carries_an_error_behind_the_last_joint() -> None:
    """A tip that is the last joint's own link has no origin for it in the URDF."""
    chain = calib_pin.load_chain("example:tiago_no_hand", tip="arm_7_link")
    assert chain.tip_joint is None
    problem = nominal_problem(chain, "pose", Setup(parameters=("dh",)))
    theta = problem.parameters.vector({"arm_7_joint.dh.alpha": 0.01})
    model = CalibratedModel.create(problem, theta)
    assert not model.urdf_corrections()
    assert model.of().tool_carries_tip
    assert np.linalg.norm(model.of().tool.rotation - np.eye(3)) > 0.01


def test_identify_needs_a_plane() -> None:
    with pytest.raises(OptionError, match="give its 'planes'"):
        calib_pin.identify(calib_pin.load_chain("space6"), "plane-distance")


def test_same_seed_same_result() -> None:
    chain, rows = measured(60)
    first, second = (calib_pin.calibrate(chain, rows, seed=3) for _ in range(2))
    assert np.array_equal(first.covariance, second.covariance)
    assert first.parameters == second.parameters
    assert first.errors == second.errors


def test_repetitions_are_no_further_configurations() -> None:
    chain, rows = measured(8)
    result = calib_pin.calibrate(chain, rows.rows(np.repeat(np.arange(8), 5)))
    assert result.verdict == "unchecked"
    assert "24 measured values cannot determine 27" in result.reason


@pytest.mark.slow
def test_rows_of_something_else_are_not_trusted() -> None:
    chain, rows = measured(20)
    shuffled = rows.values[np.random.default_rng(0).permutation(20)]
    mixed_up = replace(rows, values=shuffled)
    result = calib_pin.calibrate(chain, mixed_up, validate=False)
    assert result.verdict == "untrusted"
    assert "check the base and tip links" in result.reason


def test_what_no_robot_explains_is_fitted_once() -> None:
    chain, rows = measured(40)
    shuffled = rows.values[np.random.default_rng(0).permutation(40)]
    mixed_up = replace(rows, values=shuffled)
    both = Setup(parameters=("joint-offset", "transmission"), tool_frame=TOOL)
    result = calib_pin.calibrate(chain, mixed_up, both)
    assert (result.verdict, result.validation.method) == ("untrusted", "none")
    assert result.urdf is not None and result.urdf.model is None
    assert result.urdf.reason == "the calibration is untrusted"
    # Rows that are given for it are looked at all the same.
    result = calib_pin.calibrate(chain, mixed_up, both, holdout=0.3)
    assert (result.verdict, result.validation.method) == ("untrusted", "holdout")


def test_a_reversed_joint_is_not_trusted() -> None:
    chain, rows = measured(60)
    q = rows.q * [1, 1, -1, 1, 1, 1]
    result = calib_pin.calibrate(chain, replace(rows, q=q))
    assert result.verdict == "untrusted"
    assert result.reason.startswith("joint 'joint_3' is reversed: ")
    assert "joints: {joint_3: {joint: joint_3, sign: -1}}" in result.reason


def test_validation_rows_of_another_model() -> None:
    chain, rows = measured(20)
    poses = calib_pin.Measurements(chain.joints, rows.q, "pose", np.ones((20, 7)))
    with pytest.raises(InputError, match="cannot check 'position'"):
        calib_pin.calibrate(chain, rows, validation=poses)


def test_holdout_of_everything() -> None:
    chain, rows = measured(20)
    with pytest.raises(OptionError, match="leaves no measurement"):
        calib_pin.calibrate(chain, rows, holdout=0.9999)


def test_evaluation_of_too_few_rows() -> None:
    """Base and tool explain one row perfectly; that says nothing of the robot."""
    chain, rows = measured(20)
    few = calib_pin.evaluate(chain, rows.rows(np.arange(3)))
    assert few.verdict == "untrusted"
    assert "used up" in few.reason
    assert calib_pin.evaluate(chain, rows).verdict == "good"
    with pytest.raises(InputError, match="no measurements"):
        calib_pin.evaluate(chain, rows.rows(np.arange(0)))


def test_priors_are_no_measurements() -> None:
    chain, rows = measured(5)
    setup = Setup(prior={"*.placement.*": 1e-3})
    result = calib_pin.calibrate(chain, rows, setup)
    assert result.verdict == "unchecked"
    assert "redundant values are too few to estimate the noise" in result.reason


def test_chi_square_counts_what_its_degrees_of_freedom_count() -> None:
    chain, rows = measured(60)
    stated = replace(rows, sigma=np.full((60, 3), 5e-5))
    setup = Setup(prior={"*.placement.*": 1e-3})
    result = calib_pin.calibrate(chain, stated, setup, validate=False)
    assert result.statistics.sigma0 == pytest.approx(
        np.sqrt(result.statistics.chi2 / result.statistics.dof)
    )
    assert result.statistics.sigma0 == pytest.approx(1.0, abs=0.2)


def test_one_bad_row_makes_no_outliers_of_the_others() -> None:
    chain, rows = measured(60)
    values = rows.values.copy()
    values[17, 1] += 0.02
    stated = replace(rows, values=values, sigma=np.full((60, 3), 5e-5))
    result = calib_pin.calibrate(chain, stated, validate=False)
    assert [outlier.row for outlier in result.statistics.outliers] == [17]


def test_a_plane_with_a_single_row_stops_no_validation() -> None:
    chain = calib_pin.load_chain("space6")
    known = FrameSetup(estimate=False)
    planes = {"a": (0.0, 1.0, 4.6), "b": (1.0, 0.3, 4.0)}
    setup = Setup(
        parameters=("dh",),
        base_frame=known,
        tool_frame=known,
        planes={name: PlaneSetup(n, -0.69) for name, n in planes.items()},
    )
    rng = np.random.default_rng(0)
    problem = nominal_problem(chain, "plane-distance", setup)
    rows = calib_pin.simulate(
        problem, np.zeros(len(problem.parameters)), rng, count=120, noise=1e-4
    )
    of_b = [k for k, name in enumerate(rows.target) if name == "b"]
    kept = np.setdiff1d(np.arange(120), of_b[1:])
    unknown = replace(setup, planes={})
    result = calib_pin.calibrate(chain, rows.rows(kept), unknown)
    assert result.validation.method == "none"


def test_distances_beyond_those_of_a_simulation() -> None:
    chain = calib_pin.load_chain("space6")
    known = FrameSetup(estimate=False)
    far = Setup(
        parameters=("dh",),
        base_frame=known,
        tool_frame=known,
        planes={"wall": PlaneSetup((0.2, 1.0, 0.3), -20.0)},
    )
    problem = nominal_problem(chain, "plane-distance", far)
    far_sighted = {
        key: replace(part, measurement=replace(part.measurement, reach=60.0))
        for key, part in problem.parts.items()
    }
    reaching = problem.with_parts(far_sighted)
    rng = np.random.default_rng(0)
    truth = calib_pin.draw_errors(problem.parameters, rng)
    rows = calib_pin.simulate(reaching, truth, rng, count=80, noise=1e-4)
    assert rows.only.values.min() > 10.0
    assert calib_pin.calibrate(chain, rows, far).verdict == "good"


def test_a_partly_fixed_frame_is_about_the_setup() -> None:
    chain, rows = measured(60)
    setup = Setup(fixed=("base.frame.r*",))
    result = calib_pin.calibrate(chain, rows, setup, validate=False)
    assert np.allclose(result.model.of().error.base.rotation, np.eye(3), atol=1e-15)
    assert np.allclose(
        result.reference.of().error.base.homogeneous, np.eye(4), atol=1e-15
    )


LEFT, RIGHT = "arm_left_7_link", "arm_right_7_link"


def two_arms() -> tuple[Chains, Observations]:
    """Positions of both hands of TALOS, which share a torso."""
    robot = calib_pin.load_chain("example:talos_reduced", tip=LEFT).robot
    chains = Chains(robot, names=(LEFT, RIGHT))
    keys = [BlockKey("position", arm, tool=arm) for arm in (LEFT, RIGHT)]
    setup = Setup(
        parameters=("joint-offset",), tools={arm: HAND for arm in chains.names}
    )
    problem = nominal_problem(chains, keys, setup)
    rng = np.random.default_rng(1)
    truth = calib_pin.draw_errors(problem.parameters, rng)
    parts = [
        calib_pin.simulate(problem, truth, rng, key=key, count=count, noise=5e-5)
        for key, count in zip(keys, (40, 30), strict=True)
    ]
    return chains, Observations.of(*parts)


def test_two_arms_with_one_torso() -> None:
    chains, data = two_arms()
    setup = Setup(parameters=("joint-offset",))
    result = calib_pin.calibrate(chains, data, setup)
    assert (result.verdict, result.validation.method) == ("good", "5-fold")
    assert list(result.accuracies) == [LEFT, RIGHT]
    assert result.accuracy is result.accuracies[LEFT]
    for accuracy in result.accuracies.values():
        assert accuracy.tip is not None and accuracy.workspace is not None
        assert 1e-6 < accuracy.tip.rms[0] < 2e-4
    assert result.held_out is not None
    assert result.held_out.rows.keys == data.keys
    # One arm alone is evaluated with the calibration of both.
    right = Observations(data.blocks[1:])
    (alone,) = calib_pin.evaluate(result.model, right).errors
    of_right = np.linalg.norm(result.fitted.after[40:], axis=1)
    assert alone[2].rms == pytest.approx(np.sqrt(np.mean(of_right**2)))
    nominal = calib_pin.evaluate(chains, data).errors[0][2]
    assert nominal.rms == pytest.approx(result.errors[0].before.rms)


def test_an_arm_that_was_not_fitted_is_refused() -> None:
    chains, data = two_arms()
    left, right = data.blocks
    setup = Setup(parameters=("joint-offset",))
    with pytest.raises(InputError, match=f"chain '{RIGHT}' with the tool '{RIGHT}' is"):
        calib_pin.calibrate(chains, left, setup, validation=right)


def test_ends_of_a_distance_that_several_stations_have() -> None:
    """The name of a socket alone does not say which one is meant."""
    chain = calib_pin.load_chain("space6")
    q = np.random.default_rng(0).uniform(-2.0, 2.0, (12, 6))
    rows = Observations.of(
        *(
            calib_pin.Measurements(
                chain.joints,
                q,
                "fixed-point",
                np.zeros((12, 0)),
                target=("left", "right") * 6,
                station=station,
            )
            for station in ("hall", "lab")
        )
    )
    distance = DistanceSetup(("left", "hall/right"), 0.1, 1e-5)
    setup = Setup(parameters=("joint-offset",), distances=(distance,))
    with pytest.raises(OptionError, match="names 'left', which no") as caught:
        calib_pin.calibrate(chain, rows, setup)
    assert caught.value.allowed == "hall/left, hall/right, lab/left, lab/right"
