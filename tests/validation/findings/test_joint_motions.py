"""Motions of joints, lost motion and ripples are found in any fit, and nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.fit import fit_model
from calib_pin.kinematics.chains import Chains
from calib_pin.observations import Conditions, Observations
from calib_pin.setup import FrameSetup, Setup
from calib_pin.validation.findings import joint_motions
from calib_pin.validation.findings.alternatives import explain, setup_lines
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.joint_motions import (
    approach,
    approach_order,
    joint_motion,
    large_motions,
    periodogram,
    ripples,
)
from tests.shared import chain_of, joint, simulated, urdf_of

ARM = calib_pin.load_chain("space6")
TOOL = FrameSetup((0.05, 0.08, 0.12))
SETUP = Setup()


def case_of(rows, setup=SETUP, chain=ARM):
    data = rows if isinstance(rows, Observations) else Observations.of(rows)
    return Case.of(fit_model(chain, data, setup, 0))


@pytest.fixture(scope="module")
def measured(erring):
    def make(model="position", count=50, setup=SETUP):
        setup = replace(setup, tool_frame=TOOL)
        rows = erring(ARM, setup, 3, model, count=count).only
        files = ("a.csv",) * len(rows)
        return replace(rows, lines=np.arange(2, len(rows) + 2), files=files)

    return make


@pytest.fixture(scope="module")
def rows(measured):
    return measured()


def changed(rows, joint, change):
    """Measurements of which the column of a joint is read otherwise."""
    q = rows.q.copy()
    q[:, joint] = change(q)
    return replace(rows, q=q)


def cause(case):
    """The motion of joints that is found, with a fit or the nominal robot."""
    return joint_motion(case) or explain(case, (large_motions,))


def lines_of(case, part="joints"):
    """Its setup lines."""
    return setup_lines(case, cause(case).faults)[part]


def test_starts_of_relative_distances_have_the_gear(measured) -> None:
    rows = measured("relative-distance", 80)
    q, start = rows.q.copy(), rows.start.copy()
    q[:, 2] /= 1.02
    start[:, 2] /= 1.02
    found = joint_motion(case_of(replace(rows, q=q, start=start)))
    assert found.faults[0].code == "joint-gear"


def test_a_gear_that_the_fit_has_is_no_fault(rows) -> None:
    wrong = changed(rows, 2, lambda q: q[:, 2] / 1.01)
    setup = replace(SETUP, parameters=("placement", "transmission"))
    assert joint_motion(case_of(wrong, setup)) is None


@pytest.mark.parametrize("each", [False, True])
def test_joints_that_were_still_moving(each: bool) -> None:
    """All arrive 6 deg after they were read, or the farthest and the others with it."""
    arrived = ARM.random_configurations(50, np.random.default_rng(5))
    way = np.diff(arrived, axis=0, prepend=arrived[:1])
    far = np.abs(way) if each else np.abs(way).max(axis=1, keepdims=True)
    q = arrived - np.minimum(np.radians(6.0) / np.maximum(far, 1e-9), 1.0) * way
    job, _ = simulated("position", SETUP, 0, 1.0, 5, robot=ARM, q=q, noise=1e-4)
    found = joint_motion(case_of(replace(job.data.only, q=arrived)))
    (fault,) = found.faults
    said = f"{'every joint' if each else 'the farthest'} has 6 deg to go"
    assert fault.code == "lag" and said in fault.words
    assert found.after < 1e-3


def test_a_stated_base_that_is_turned_is_no_offset_of_the_first_joint(measured) -> None:
    known = replace(SETUP, base_frame=FrameSetup(estimate=False))
    rows = measured("pose", setup=known)
    wrong = changed(rows, 0, lambda q: q[:, 0] - np.radians(40.0))
    assert cause(case_of(wrong, known)) is None


def test_a_gear_that_no_robot_has(rows) -> None:
    wrong = changed(rows, 5, lambda q: q[:, 5] / 1.5)
    gear = lines_of(case_of(wrong))[ARM.joints[5]]["gear"]
    assert gear == pytest.approx(1.5, rel=0.02)


RAIL = urdf_of(
    joint("rail", "a b", "0 0 0", "1 0 0", "prismatic", "0 2"),
    joint("j1", "b c", "0 0 0.3", limits="-2 2"),
    joint("j2", "c d", "0.4 0 0", "0 1 0", limits="-2 2"),
)


@pytest.mark.parametrize("factor", [np.degrees(1.0), np.radians(1.0)])
def test_a_rail_whose_column_is_converted_as_an_angle(erring, factor) -> None:
    chain = chain_of(RAIL)
    rows = erring(chain, SETUP, 3, count=40).only
    wrong = Observations.of(replace(rows, q=rows.q * [factor, 1.0, 1.0]))
    lines = lines_of(Case.of_robot(Chains.of(chain), wrong, SETUP))
    assert lines["rail"]["gear"] == pytest.approx(1.0 / factor, rel=0.02)


PA10 = calib_pin.load_chain("pa10")
PLACEMENT = Setup(tool_frame=FrameSetup((0.1, 0.05, 0.15), estimate=True))


@pytest.fixture(scope="module")
def loose(erring):
    """Makes measurements of a robot with lost motion of some joints [rad]."""

    def make(lost):
        setup = replace(PLACEMENT, parameters=("placement", "hysteresis"))
        changes = {f"{PA10.joints[j]}.hysteresis.backlash": v for j, v in lost.items()}
        rows = erring(PA10, setup, 3, changes=changes, count=60, noise=3e-5).only
        # As from a file that does not state the sides.
        return replace(rows, conditions=replace(rows.conditions, source="order"))

    return make


def lost_in(rows):
    return next(approach(case_of(rows, PLACEMENT, PA10)), None)


def test_lost_motion_is_told_by_joint(loose) -> None:
    lost = {1: 2e-3, 2: 5e-4, 4: 1e-3}
    found = lost_in(loose(lost))
    names = {PA10.joints[j]: size for j, size in lost.items()}
    assert set(found.evidence["joints"].split(", ")) == set(names)
    for name, size in names.items():
        # Half of the smallest is a tenth of a millimeter here, beside the noise.
        assert abs(found.evidence[name] - size) < 1e-4


def test_lost_motion_of_all_joints_is_no_early_reading(loose) -> None:
    """As if each was read a quarter of a milliradian before it arrived."""
    rows = loose(dict.fromkeys(range(7), 5e-4))
    assert joint_motion(case_of(rows, PLACEMENT, PA10)) is None
    assert len(lost_in(rows).evidence["joints"].split(", ")) > 3


def test_lost_motion_of_several_sizes_is_no_early_reading(loose) -> None:
    """Of the nominal robot, where far larger errors hide it, as of a fit."""
    case = case_of(loose({0: 8e-3, 1: 4e-3, 2: 6e-3, 5: 5e-3}), PLACEMENT, PA10)
    assert not [m for m in large_motions(case) if "as arrived" in m.words]
    assert joint_motion(case) is None


def test_lost_motion_that_is_estimated_is_not_sought(loose) -> None:
    rows = loose({1: 2e-3, 2: 1e-3})
    setup = replace(PLACEMENT, parameters=("placement", "hysteresis"))
    result = calib_pin.calibrate(PA10, rows, setup, validate=False)
    codes = {f.code: f.severity for f in result.findings}
    assert "backlash" not in codes and codes["approach-by-order"] == "info"
    stated = replace(rows, conditions=replace(rows.conditions, source="columns"))
    assert not [*approach_order(case_of(stated, PLACEMENT, PA10))]


def test_no_lost_motion_where_no_side_is_known(loose) -> None:
    rows = loose({1: 2e-3})
    assert lost_in(rows) is not None
    assert lost_in(replace(rows, conditions=Conditions())) is None


@pytest.fixture(scope="module")
def rippling(erring):
    """Makes the ripples of a robot with waves of some joints, noise of 20 um."""

    def make(seed, waves):
        tool = FrameSetup((0.0, 0.0, 0.1), estimate=True)
        ratios = {"joint_2": 80.0, "joint_4": 101.0}
        names = ("placement", "transmission")
        setup = Setup(parameters=names, gear_ratios=ratios, tool_frame=tool)
        rows = erring(ARM, setup, seed, changes=waves, count=120, noise=2e-5)
        return list(ripples(case_of(rows, Setup(tool_frame=tool))))

    return make


def test_ripples_of_two_joints_are_told_apart(rippling) -> None:
    names = ("joint_2.transmission.motor_sin2", "joint_4.transmission.motor_cos")
    (finding,) = rippling(1, dict.fromkeys(names, 2e-4))
    assert set(finding.setup["gear_ratios"]) == {"joint_2", "joint_4"}
    assert finding.setup["gear_ratios"]["joint_4"] == 101.0


def test_low_waves_are_no_ripples(rippling) -> None:
    """Eccentric wheels have parameters of their own."""
    names = [f"{joint}.transmission.sin1" for joint in ARM.joints]
    assert not rippling(0, dict.fromkeys(names, 2e-4))


def test_more_than_all_squares_are_left_by_chance(measured) -> None:
    """Of exact measurements rounding is left, and one wave may leave none of it."""
    fit = case_of(measured()).fit
    assert (
        joint_motions.chance_of(fit, 1e280) == 1.0 > joint_motions.chance_of(fit, 0.9)
    )


def test_the_periodogram_is_least_squares() -> None:
    rng = np.random.default_rng(0)
    q, motion, r = rng.uniform(-2.0, 2.0, 40), rng.normal(size=40), rng.normal(size=40)
    frequencies = 5.0 + 0.37 * np.arange(150)
    expected = []
    for frequency in frequencies:
        waves = np.column_stack([np.sin(frequency * q), np.cos(frequency * q)])
        A = motion[:, None] * waves
        expected.append(float(r @ A @ np.linalg.lstsq(A, r, rcond=None)[0]))
    found = periodogram(q, motion, r, frequencies)
    np.testing.assert_allclose(found, expected, rtol=1e-9)
