"""The numbers of an acceptance test by hand, and how often their intervals hold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.errors import InputError
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations
from calib_pin.setup import LimitSetup, Setup
from calib_pin.validation.acceptance import (
    FrameErrors,
    Interval,
    acceptance,
    bad_visits,
    cycles_in_order,
    judged,
    moved_after,
)
from calib_pin.validation.acceptance import tested as run
from tests.shared import simulated

X = np.array([[1.0, 0.0, 0.0], [1.2, 0.0, 0.0], [1.0, 0.3, 0.0], [1.2, 0.3, 0.4]])
C = np.array([1.0, 0.1, 0.0])


def test_a_pose_by_hand():
    test = acceptance(X, X - C, np.ones(4, int))
    (pose,) = test.poses
    assert (pose.pose, pose.visits, pose.directions) == (1, 4, None)
    # The mean is (1.1, 0.15, 0.1).
    assert pose.accuracy.value == pytest.approx(np.sqrt(0.01 + 0.0025 + 0.01))
    assert [c.value for c in pose.components] == pytest.approx([0.1, 0.05, 0.1])
    lengths = np.sqrt([0.0425, 0.0425, 0.0425, 0.1225])
    spread = np.sqrt(np.sum((lengths - lengths.mean()) ** 2) / 3)
    assert pose.repeatability.value == pytest.approx(lengths.mean() + 3 * spread)
    assert test.distances == () and test.drift is None


def test_a_distance_by_hand():
    attained = np.repeat(X, 2, axis=0)
    attained[1::2] += [[2.0, 0.0, 0.0], [2.1, 0.0, 0.0], [2.0, 0.0, 0.0], [2.3, 0, 0]]
    commanded = np.tile([C, C + np.array([2.0, 0.0, 0.0])], (4, 1))
    (pair,) = acceptance(attained, attained - commanded, np.tile([7, 3], 4)).distances
    assert (pair.poses, pair.cycles, pair.commanded) == ((3, 7), 4, 2.0)
    assert pair.accuracy.value == pytest.approx(0.1)
    assert pair.repeatability.value == pytest.approx(3 * np.sqrt(0.06 / 3))


def test_angles_directions_and_drift_by_hand():
    # P1 is reached from P2 and P3 in turn, and drifts along x.
    order = np.tile([0, 1, 0, 2], 9)
    deviations = np.zeros((36, 3))
    deviations[order == 0, 1] = np.tile([0.0, 3e-4], 9)
    deviations[order == 0, 0] = np.repeat([1e-3, 2e-3, 4e-3], 6)
    angles = np.where(np.arange(36)[:, None] % 8 < 4, 1e-3, 2e-3) * [1.0, 0.0, -2.0]
    test = acceptance(deviations, np.hstack([deviations, angles]), order)
    first = test.poses[0]
    # The first visit has none before it.
    of_third = deviations[np.flatnonzero(order == 0)[1::2]].mean(axis=0)
    of_second = deviations[np.flatnonzero(order == 0)[2::2]].mean(axis=0)
    assert first.directions == pytest.approx(np.linalg.norm(of_third - of_second))
    own = angles[order == 0]
    assert [a.value for a in first.angles] == pytest.approx(own.mean(axis=0))
    spread = 3 * own.std(axis=0, ddof=1)
    assert [a.value for a in first.angle_repeatability] == pytest.approx(spread)
    accuracy, _ = test.drift
    start, end = (np.hypot(x, 1.5e-4) for x in (1e-3, 4e-3))
    assert accuracy == pytest.approx(end - start)


def test_poses_need_visits():
    with pytest.raises(InputError, match="3"):
        acceptance(X, 0.0 * X, np.array([0, 0, 1, 1]))
    kept = acceptance(X, X - C, np.array([0, 0, 1, 0]))
    assert [pose.pose for pose in kept.poses] == [0]


def test_limits_are_judged_by_the_worst_pose():
    rng = np.random.default_rng(0)
    x = np.concatenate(
        [[m, 0.0, 0.0] + 1e-5 * rng.standard_normal((30, 3)) for m in (1e-4, 3e-4)]
    )
    test = acceptance(x, x, np.repeat([0, 1], 30))
    limit = LimitSetup(position=2e-4, repeatability=1e-4, distance=1e-3)
    found = {name: status for name, status, *_ in judged(test, limit)}
    assert found == {"AP": "fail", "RP": "pass", "AD": "pass"}
    near = LimitSetup(position=float(test.poses[1].accuracy.value))
    assert [status for _, status, *_ in judged(test, near)] == ["undecided"]
    assert [*judged(test, LimitSetup())] == []


@pytest.mark.parametrize(
    ("pose", "cycles"),
    [
        ([0, 1, 2, 0, 1, 2], [1, 1, 1, 2, 2, 2]),
        ([0, 1, 2, 0, 2, 0, 1, 2], [1, 1, 1, 2, 2, 3, 3, 3]),
        ([0, 1, 0, 1, 1], [1, 1, 2, 2, 3]),
        # Blocks, and poses in turn.
        ([0, 0, 1, 1], [1, 2, 1, 2]),
        ([0, 1, 1, 0], [1, 1, 2, 2]),
    ],
)
def test_order_tells_cycles(pose, cycles) -> None:
    assert cycles_in_order(np.array(pose)).tolist() == cycles


def test_a_missing_visit_moves_no_other_into_its_place() -> None:
    """A robot that drifts is as far from one pose to the other in every cycle."""
    pose, cycle = np.tile([0, 1], 20), np.repeat(np.arange(20), 2)
    x = np.zeros((40, 3))
    x[:, 0] = pose + 1e-3 * cycle
    kept = (pose == 0) | ~np.isin(cycle, [3, 4, 5])
    goal = np.array([[1.0, 0.0, 0.0]]) * pose[:, None]
    for given in (None, cycle[kept]):
        test = acceptance(x[kept], (x - goal)[kept], pose[kept], cycles=given)
        (pair,) = test.distances
        assert pair.cycles == 17
        assert pair.accuracy.value == pytest.approx(0.0, abs=1e-12)


def test_frames_that_are_uncertain_widen_intervals() -> None:
    """Of AP all, of AD what turns and stretches, and nothing of RP."""
    rng = np.random.default_rng(0)
    pose = np.repeat([0, 1], 30)
    goal = np.array([[1.0, 0.0, 0.0]]) * pose[:, None]
    x = goal + [1e-3, 0.0, 0.0] + 1e-6 * rng.standard_normal((60, 3))
    shift, stretch = np.eye(6)[:, :1], np.zeros((60, 6, 1))
    stretch[:, :, 0] = 1e-4 * np.eye(6)[0] * pose[:, None]
    plain = acceptance(x, x - goal, pose)
    found = [
        acceptance(x, x - goal, pose, frames=FrameErrors(effects))
        for effects in (np.tile(1e-4 * shift, (60, 1, 1)), stretch)
    ]
    half = 1.96e-4
    for test, pair in zip(found, (0.0, half), strict=True):
        ap, ad = test.poses[1].accuracy, test.distances[0].accuracy
        assert [ap.low, ap.high] == pytest.approx([1e-3 - half, 1e-3 + half], abs=1e-5)
        assert ad.high - ad.value == pytest.approx(pair, abs=1e-6)
        assert test.poses[1].repeatability.value == plain.poses[1].repeatability.value


def test_what_was_fitted_to_visits_leaves_a_bound() -> None:
    """A shift takes the mean error away; half the difference of two poses remains."""
    pose = np.repeat([0, 1], 10)
    rng = np.random.default_rng(0)
    goal = np.array([[1.0, 0.0, 0.0]]) * pose[:, None]
    x = goal + [0.0, 1e-3, 0.0] * (2 * pose - 1)[:, None]
    x = x + [5e-3, 0.0, 0.0] + 1e-6 * rng.standard_normal((20, 3))
    shift = FrameErrors(np.tile(np.eye(6)[:, :3], (20, 1, 1)), fitted="it was fitted")
    test = acceptance(x, x - goal, pose, frames=shift)
    # The truth may be any shift more, but never less than 1 mm at the worse pose.
    assert test.bound.low == pytest.approx(1e-3, rel=1e-2)
    assert "3 unknowns of 6 values" in test.untestable
    for limit, status in ((5e-4, "fail"), (2e-3, "undecided"), (1.0, "undecided")):
        (found,) = judged(test, LimitSetup(position=limit))
        assert found[1] == status
    some = shift._replace(effects=shift.effects[:10])
    one = acceptance(x[:10], (x - goal)[:10], pose[:10], frames=some)
    assert "from 2 poses on" in one.untestable and not one.bound.low > 0.0


def test_doubts_pass_nothing_and_a_move_fails_nothing() -> None:
    test = acceptance(X, X - C, np.zeros(4, int))
    for allowed, changes in ((9.0, {"doubts": ("why",)}), (1e-9, {"moved": True})):
        limit = LimitSetup(position=allowed, repeatability=allowed)
        found = [s for _, s, *_ in judged(replace(test, **changes), limit)]
        assert found == ["undecided", "undecided"]
    # What does not depend on the station fails wherever that stands.
    elsewhere = replace(test, elsewhere=True)
    found = [s for _, s, *_ in judged(elsewhere, limit)]
    assert found == ["undecided", "fail"]
    # A limit of what was not measured is not met.
    assert [s for _, s, *_ in judged(test, LimitSetup(distance=9.0))] == ["undecided"]


def visits(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Thirty cycles of five poses, each with a scatter of its own."""
    rng = np.random.default_rng(seed)
    pose = np.tile(np.arange(5), 30)
    scatter = 2e-5 * rng.standard_normal((5, 3, 3))
    x = rng.uniform(-0.4, 0.4, (5, 3))[pose]
    return x + np.einsum(
        "nij,nj->ni", scatter[pose], rng.standard_normal(x.shape)
    ), pose


def test_bad_and_exchanged_visits_are_found() -> None:
    x, pose = visits(0)
    assert bad_visits(x, pose) == [] and moved_after(x, pose) is None
    x[[51, 52]] = x[[52, 51]]
    x[[20, 90, 95]] += [3e-4, 0.0, 3e-4]  # Two of one pose hide each other.
    assert bad_visits(x, pose) == [20, 51, 52, 90, 95]


def test_a_moved_instrument_is_no_drift() -> None:
    x, pose = visits(1)
    turn = np.cross([0.0, 0.0, 4e-4], x)
    moved = x.copy()
    moved[77:] += turn[77:]
    assert moved_after(moved, pose) == pytest.approx(77, abs=1)
    warm = np.exp(-np.arange(150) / 40.0)[:, None]
    assert moved_after(x + warm * turn, pose) is None


def test_visits_without_scatter() -> None:
    test = acceptance(np.ones((3, 3)), np.ones((3, 3)), np.zeros(3, int))
    assert test.poses[0].repeatability == Interval(0.0, 0.0, 0.0)
    assert test.poses[0].accuracy.low == pytest.approx(np.sqrt(3.0))
    x, pose = visits(2)
    still = np.array([x[pose == k].mean(axis=0) for k in range(5)])[pose]
    assert bad_visits(still, pose) == [] and moved_after(still, pose) is None


@pytest.mark.parametrize(("away", "count"), [(1.0, 12), (10.0, 8), (10.0, 30)])
def test_a_visit_that_is_far_away_has_all_of_the_scatter(away, count):
    attained = np.zeros((2 * count, 3))
    attained[5] = away
    assert bad_visits(attained, np.repeat([0, 1], count)) == [5]


@pytest.fixture(scope="module")
def calibration() -> tuple[Problem, Floats, calib_pin.CalibrationResult]:
    """A calibration of sixty positions, and the robot that was measured."""
    problem, truth = simulated("position", None, 60, 1.0, seed=1, noise=1e-4)
    return problem, truth, calib_pin.calibrate(problem.chains, problem.data)


@pytest.mark.parametrize(
    ("poses", "moved", "told"),
    [
        (1, 0.0, False),
        (1, 0.05, True),
        (2, 0.0, False),
        (5, 0.0, False),
        (5, 1e-3, True),
    ],
)
def test_one_pose_tells_no_station_from_an_error(calibration, poses, moved, told):
    """Another station would explain all of it, and the errors may be 5 times RP."""
    problem, truth, result = calibration
    rng = np.random.default_rng(207)
    q = np.tile(problem.only.error.chain.random_configurations(poses, rng), (10, 1))
    visited = calib_pin.simulate(problem, truth, rng, q=q, noise=1e-6).only
    visited = replace(visited, values=visited.values + moved * np.eye(3)[0])
    tests, _ = run(result, Observations.of(visited), result.model.setup)
    assert tests["calibrated"].elsewhere == told


def test_angles_hide_no_move_of_the_instrument() -> None:
    """Seven milliradians are no seven millimeters, beside which five are nothing."""
    setup = Setup(noise={"position": 1e-4, "orientation": 4e-3})
    problem, truth = simulated("pose", setup, 60, 1.0, seed=1, noise=None)
    result = calib_pin.calibrate(problem.chains, problem.data, setup, validate=False)
    rng = np.random.default_rng(2)
    q = np.tile(problem.chains.random_configurations(5, rng), (10, 1))
    visited = calib_pin.simulate(problem, truth, rng, q=q).only
    for moved in (0.0, 5e-3):
        there = replace(visited, values=visited.values + moved * np.eye(7)[0])
        tests, _ = run(result, Observations.of(there), setup)
        assert tests["calibrated"].elsewhere == (moved > 0.0)
