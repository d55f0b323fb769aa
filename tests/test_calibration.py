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
from calib_pin.setup import FrameSetup, Setup, ToolSetup
from tests.shared import refused

TOOL = FrameSetup((0.05, 0.1, 0.1), (0.3, 0.2, 0.1))
HAND = ToolSetup((0.05, 0.1, 0.1))


def measured(
    count: int, *, size: float = 1.0, tip: str | None = None
) -> tuple[calib_pin.Chain, calib_pin.Measurements]:
    """Positions of `space6` with drawn errors, without sigma columns."""
    chain = calib_pin.load_chain("space6", tip=tip)
    problem = nominal_problem(chain, "position", Setup(tool_frame=TOOL))
    rng = np.random.default_rng(1)
    truth = size * calib_pin.draw_errors(problem.parameters, rng)
    rows = calib_pin.simulate(problem, truth, rng, count=count, noise=5e-5).only
    return chain, replace(rows, sigma=None)


def test_rows_for_validation_are_not_fitted() -> None:
    """Whether the rows are marked or stand in a file of their own."""
    chain, rows = measured(60)
    marked = replace(rows, validate=np.arange(60) >= 40)
    first = calib_pin.calibrate(chain, marked)
    # Whatever stands in those rows, the fit is the same.
    spoiled = rows.values.copy()
    spoiled[40:] += 0.01
    second = calib_pin.calibrate(chain, replace(marked, values=spoiled))
    kept = np.arange(40)
    third = calib_pin.calibrate(
        chain, rows.rows(kept), validation=rows.rows(np.arange(40, 60))
    )
    for found, method in ((first, "set"), (second, "set"), (third, "file")):
        assert (found.validation.method, found.validation.count) == (method, 20)
        assert len(found.fitted) == 40
        assert np.array_equal(first.model.theta, found.model.theta)


def test_holdout_sets_a_part_aside() -> None:
    chain, rows = measured(30)
    twice = rows.rows(np.repeat(np.arange(30), 2))
    result = calib_pin.calibrate(chain, twice, holdout=0.25)
    assert result.validation.method == "holdout"
    assert 10 < result.validation.count < 20
    # Repetitions never stand on both sides.
    assert len(result.fitted) + result.validation.count == 60
    assert len(result.fitted) % 2 == result.validation.count % 2 == 0
    other = calib_pin.calibrate(chain, twice, holdout=0.25, seed=1)
    assert not np.array_equal(result.model.theta, other.model.theta)


@pytest.mark.parametrize("holdout", [0.0, 1.0, -0.5, np.nan, 0.9999])
def test_a_part_that_cannot_be_held_out(holdout: float) -> None:
    chain, rows = measured(20)
    with pytest.raises(OptionError):
        calib_pin.calibrate(chain, rows, holdout=holdout)


def test_rows_that_do_not_go_together() -> None:
    chain, rows = measured(20)
    with pytest.raises(OptionError):
        calib_pin.calibrate(chain, rows, validation=rows, holdout=0.2)
    with pytest.raises(InputError):
        calib_pin.calibrate(chain, replace(rows, validate=np.ones(20, bool)))
    poses = calib_pin.Measurements(chain.joints, rows.q, "pose", np.full((20, 7), 0.5))
    with pytest.raises(InputError, match="'pose'"):
        calib_pin.calibrate(chain, rows, validation=poses)
    joints, q = (*chain.joints, "hand"), np.column_stack([rows.q, rows.q[:, 0]])
    more = calib_pin.Measurements(joints, q, rows.model, rows.values)
    with refused(InputError, "hand", allowed=", ".join(chain.joints)):
        calib_pin.calibrate(chain, more)
    with refused(OptionError, value="link3"):
        calib_pin.calibrate(chain, rows, {"tip": "link3"})


@pytest.mark.parametrize("repeats", [1, 5])
def test_fewer_values_than_the_structural_rank(repeats: int) -> None:
    """Repetitions are no further configurations."""
    chain, rows = measured(8)
    again = rows.rows(np.repeat(np.arange(8), repeats))
    result = calib_pin.calibrate(chain, again)
    assert result.verdict == "unchecked"
    assert "24" in result.reason and "27" in result.reason


@pytest.mark.parametrize(
    ("count", "setup"),
    [(9, Setup()), (5, Setup(prior={"*.placement.*": 1e-3}))],
    ids=["no redundancy", "priors are no measurements"],
)
def test_nothing_is_left_to_check_the_fit_with(count: int, setup: Setup) -> None:
    chain, rows = measured(count)
    result = calib_pin.calibrate(chain, rows, setup)
    assert result.verdict == "unchecked"
    # Nine rows are too few for folds.
    assert (result.errors[0].validation_after is None) == (count == 9)


def test_worse_on_unseen_rows() -> None:
    """A robot with the opposite errors is not served by the calibration."""
    chain, rows = measured(140)
    _, opposite = measured(140, size=-1.0)
    new = np.arange(140) >= 40
    result = calib_pin.calibrate(chain, rows.rows(~new), validation=opposite.rows(new))
    assert result.verdict == "untrusted"
    assert "position" in result.reason


def test_stated_sigmas_stand_until_the_rows_contradict_them() -> None:
    chain, rows = measured(60)
    assumed, right, tenfold = (
        calib_pin.calibrate(chain, replace(rows, sigma=sigma), validate=False)
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
    free = calib_pin.calibrate(chain, rows, validate=False)
    value = free.model.theta[free.model.given.index("joint_3.placement.x")]
    setup = Setup(bounds={"joint_3.placement.x": 0.9 * abs(float(value))})
    result = calib_pin.calibrate(chain, rows, setup, validate=False)
    assert list(result.solver.at_bounds) == ["joint_3.placement.x"]


def test_evaluate_registers_a_chain_but_not_a_model() -> None:
    """Unless it is asked for, where the instrument has moved."""
    chain, rows = measured(60)
    result = calib_pin.calibrate(chain, rows)
    nominal = calib_pin.evaluate(chain, rows)
    assert nominal.registered
    assert nominal.errors[0][2].rms == pytest.approx(result.errors[0].before.rms)
    frozen = calib_pin.evaluate(result.model, rows)
    assert not frozen.registered
    assert frozen.errors[0][2].rms == pytest.approx(result.errors[0].after.rms)
    R = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    moved = replace(rows, values=rows.values @ R.T + [5.0, -1.0, 0.3])
    lost = calib_pin.evaluate(result.model, moved).errors[0][2]
    assert lost.rms > 1.0
    here, there = (
        calib_pin.evaluate(result.model, data, registration=True).errors[0][2].rms
        for data in (rows, moved)
    )
    assert there == pytest.approx(here, rel=1e-6)


@pytest.mark.slow
def test_what_no_robot_explains_is_not_trusted() -> None:
    """Nor checked by further fits, but by rows that are given for it."""
    chain, rows = measured(20, tip="link_2")
    shuffled = rows.values[np.random.default_rng(0).permutation(20)]
    mixed_up = replace(rows, values=shuffled)
    setup = Setup(parameters=("joint-offset", "transmission"), tool_frame=TOOL)
    result = calib_pin.calibrate(chain, mixed_up, setup)
    assert (result.verdict, result.validation.method) == ("untrusted", "none")
    assert result.urdf is not None and result.urdf.model is None
    result = calib_pin.calibrate(chain, mixed_up, setup, holdout=0.3)
    assert (result.verdict, result.validation.method) == ("untrusted", "holdout")


def test_evaluation_of_too_few_rows() -> None:
    """Base and tool explain one row perfectly; that says nothing of the robot."""
    chain, rows = measured(20)
    assert calib_pin.evaluate(chain, rows.rows(np.arange(3))).verdict == "untrusted"
    assert calib_pin.evaluate(chain, rows).verdict == "good"
    with pytest.raises(InputError):
        calib_pin.evaluate(chain, rows.rows(np.arange(0)))


def test_a_partly_fixed_frame_is_about_the_setup() -> None:
    chain, rows = measured(60)
    setup = Setup(fixed=("base.frame.r*",))
    result = calib_pin.calibrate(chain, rows, setup, validate=False)
    assert np.allclose(result.model.of().error.base.rotation, np.eye(3), atol=1e-13)
    assert np.allclose(
        result.reference.of().error.base.homogeneous, np.eye(4), atol=1e-13
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
