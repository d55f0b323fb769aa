"""Two calibrations of one robot: noise is no drift, and a drift is found and named."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import least_squares

import calib_pin
from calib_pin.errors import InputError
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.io.urdf_tree import parse_robot
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import se3_exp
from calib_pin.measurement_models import measurement_model
from calib_pin.setup import FrameSetup, PlaneSetup, PointSetup, Setup
from calib_pin.simulation import draw_errors
from calib_pin.validation.comparison import (
    Difference,
    compare,
    robot_groups,
    shared_files,
    unknown_ends,
)
from calib_pin.validation.result import ParameterEstimate
from calib_pin.validation.summaries import ToolAccuracy

SEEDS = 12


@pytest.fixture(scope="module")
def chain() -> Chain:
    return calib_pin.load_chain("space6")


@pytest.fixture(scope="module")
def record(chain, recorded):
    """Calibrations of one robot, each made once."""

    @cache
    def make(seed, model="pose", changes=(), parameters=("placement",)):
        setup = Setup(parameters=parameters)
        if parameters == ("placement",):
            return recorded(chain, model, seed, dict(changes))
        # The robot is the same, only described in another way.
        return recorded(chain, model, seed, setup=setup, truth=Setup())

    return make


# --- noise alone -------------------------------------------------------------------


@pytest.mark.parametrize("model", ["pose", "position"])
def test_noise_is_no_drift(model, record):
    found = [
        compare(record(2 * k, model), record(2 * k + 1, model))
        for k in range(SEEDS // 2)
    ]
    assert not any(c.drifted or c.changed or c.identical for c in found)
    assert all(c.described and c.same_parameters for c in found)
    significance = np.array([d.significance for c in found for d in c.differences])
    assert len(significance) > 80
    # Differences of normal variables: one in 370 lies beyond three.
    assert np.mean(significance > 3.0) < 0.03
    assert np.sqrt(np.mean(significance**2)) == pytest.approx(1.0, abs=0.2)
    # The frames absorb a part of what the noise of base and tool is counted for.
    ratios = [c.drift.position.rms / c.explained[0] for c in found]
    assert 0.4 < np.mean(ratios) < 1.0


def test_without_noise_tips_are_the_same(chain, recorded):
    A, B = (recorded(chain, "pose", seed, noise=0.0) for seed in (0, 1))
    found = compare(A, B)
    assert found.identical
    assert found.drifted is False
    assert found.moved == () and found.differences


# --- a drift -----------------------------------------------------------------------


OFFSETS = {
    "joint_2": "joint_2.placement.rz",
    "joint_4": "joint_4.placement.rz",
    "joint_5": "joint_5.placement.rz",
}


@pytest.mark.parametrize("joint", OFFSETS)
def test_a_joint_offset_is_named_and_its_drift_is_true(joint, chain, record):
    name = OFFSETS[joint]
    found = compare(record(0), record(1, changes=((name, 2e-3),)))
    assert found.drifted and found.changed
    first = found.differences[0]
    assert name in (first.name, *(term for term, _ in first.terms))
    assert first.change == pytest.approx(2e-3, abs=4.0 * first.sigma)
    assert first.significance > 50.0
    truth = true_drift(chain, {name: 2e-3}, found.drift.q)
    noise = found.explained[0]
    assert found.drift.position.rms == pytest.approx(truth, abs=2.0 * noise)
    assert truth > 3.0 * noise


def true_drift(chain, changes, q):
    """Drift of the simulated robot [m], rms, by Pinocchio and a solver of scipy."""
    problem = nominal_problem(chain, "pose", Setup())
    names = problem.parameters.names
    drawn = draw_errors(problem.parameters, np.random.default_rng(0))
    theta = {
        name: 0.0 if p.nuisance else float(value)
        for name, p, value in zip(names, problem.parameters, drawn, strict=True)
    }

    def tips(values):
        placements = []
        for joint, placement in zip(chain.joints, chain.placements, strict=True):
            for k, axis in enumerate(("x", "y", "z", "rx", "ry", "rz")):
                twist = values.get(f"{joint}.placement.{axis}", 0.0) * np.eye(6)[k]
                placement = placement * pin.exp6(pin.Motion(twist))
            placements.append(placement)
        return chain.poses(q, placements)

    A, B = tips(theta), tips({n: v + changes.get(n, 0.0) for n, v in theta.items()})

    def missing(x):
        R = se3_exp(np.append(x[6:], np.zeros(3)))
        return (se3_exp(x[:6]) @ B @ R - A)[:, :3, 3].ravel()

    solved = least_squares(missing, np.zeros(9), xtol=1e-12, ftol=1e-12)
    return np.sqrt(np.sum(solved.fun**2) / len(q))


def predicting(result, sizes):
    """A calibration whose noise explains other errors of the tip, rms [m] and [rad]."""
    position, orientation = (np.full(1, size) for size in sizes)
    tip = replace(
        result.accuracy.tip,
        position=position,
        orientation=orientation,
        of_robot=sizes,
    )
    return replace(result, accuracies={"": replace(result.accuracy, tip=tip)})


def test_a_change_that_noise_hides_at_the_tip(record):
    later = record(1, changes=(("joint_5.placement.rz", 2e-3),))
    # As with a base that is poorly known.
    found = compare(record(0), predicting(later, (1e-3, 2e-3)))
    assert found.drifted is False
    assert found.changed
    assert found.differences[0].name == "joint_5.placement.rz + joint_6.placement.ry"


def test_a_tracker_elsewhere_and_another_tool_are_no_drift(chain, recorded, record):
    base = FrameSetup((0.8, -0.5, 0.3), (0.2, 0.1, 1.4), estimate=True)
    tool = FrameSetup((0.05, 0.02, 0.15), (0.3, -0.2, 0.5), estimate=True)
    truth = Setup(base_frame=base, tool_frame=tool)
    found = compare(record(0), recorded(chain, "pose", 1, truth=truth))
    assert found.drifted is False and not found.changed
    assert found.moved == ()
    moved = {d.frame: d for d in found.displacements}
    for name, frame in (("base", base), ("tool", tool)):
        shift = np.linalg.norm(frame.xyz)
        angle = np.linalg.norm(pin.log3(pin.rpy.rpyToMatrix(*frame.rpy)))
        assert moved[name].shift == pytest.approx(shift, rel=5e-3)
        assert moved[name].turn == pytest.approx(angle, rel=5e-3)


def test_frames_that_are_known_absorb_nothing(chain, recorded):
    known = FrameSetup((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), estimate=False)
    setup = Setup(base_frame=known, tool_frame=known)
    A = recorded(chain, "pose", 0, setup=setup)
    B = recorded(chain, "pose", 1, {"joint_1.placement.rz": 2e-3}, setup=setup)
    found = compare(A, B)
    assert found.drift.absorbed == () and found.displacements == ()
    assert found.drifted
    assert found.drift.orientation.mean == pytest.approx(2e-3, rel=0.1)


@pytest.mark.parametrize(
    ("model", "section", "feature", "ends"),
    [
        ("position", "targets", PointSetup((0.0, 0.0, 0.1)), (False, True)),
        ("plane-distance", "planes", PlaneSetup((1.0, 0.0, 0.0), 1.0), (True, False)),
    ],
)
def test_what_is_estimated_of_the_instrument_stands_for_a_frame(
    model, section, feature, ends, chain, recorded
):
    known = FrameSetup((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), estimate=False)
    setup = Setup(base_frame=known, tool_frame=known)
    found = recorded(chain, "pose", 0, setup=setup)
    assert unknown_ends(found, "") == (False, False)
    named = replace(setup, **{section: {"thing": feature}})
    measurement = measurement_model(model, named, ["thing"])
    part = found.model.only
    seen = replace(part, measurement=measurement)
    (first, *_) = measurement.parameters
    entry = ParameterEstimate(first.name, first.unit, 0.0, None, "coupled", ())
    for status, expected in (("coupled", ends), ("fixed", (False, False))):
        record = replace(
            found,
            model=found.model.with_parts({part.key: seen}),
            parameters=(*found.parameters, replace(entry, status=status)),
        )
        assert unknown_ends(record, "") == expected


# --- other models ------------------------------------------------------------------


def test_positions_beside_poses(record):
    found = compare(record(0, "position"), record(1, "pose"))
    assert found.same_parameters and not found.oriented
    assert found.drifted is False
    assert {d.frame: d.turn for d in found.displacements}["tool"] is None
    assert found.alone[1] and found.differences


def test_placements_beside_dh(record):
    dh = record(1, parameters=("dh",))
    found = compare(record(0), dh)
    assert not found.same_parameters and not found.described
    assert found.drifted is False
    assert found.drift.position.rms < 2.0 * found.explained[0]
    assert found.differences == ()
    assert all(".dh." in name for name in found.alone[1])
    assert all(".placement." in name for name in found.alone[0])
    assert found.sums_alone[0] == len(robot_groups(record(0)))


def test_other_nominal_robots_are_compared_by_their_tips(chain, recorded, record):
    text = chain.robot.source.decode()
    spaced = Chain(parse_robot(text.encode() + b"\n", "b.urdf"), chain.base, chain.tip)
    assert compare(record(0), recorded(spaced, "pose", 1)).same_nominal
    moved = parse_robot(text.replace("0.85", "0.852").encode(), "c.urdf")
    other = Chain(moved, chain.base, chain.tip)
    found = compare(record(0), recorded(other, "pose", 1))
    assert not found.same_nominal and not found.same_parameters
    assert found.differences == () and found.alone == ((), ())
    assert found.drifted  # The nominal arm is longer, and so is the simulated one.
    assert found.drift.position.rms > 5e-4


# --- what is compared --------------------------------------------------------------


def test_sums_are_matched_by_their_terms(record):
    A, B = record(0), record(1)
    expected = compare(A, B).differences
    shuffled = tuple(
        replace(
            group,
            number=100 - group.number,
            terms=tuple((n, c * (1.0 + 1e-9)) for n, c in reversed(group.terms)),
        )
        for group in reversed(B.groups)
    )
    assert compare(A, replace(B, groups=shuffled)).differences == expected
    other = tuple(
        replace(g, terms=tuple((n, 1.01 * c) for n, c in g.terms)) for g in B.groups
    )
    found = compare(A, replace(B, groups=other))
    assert all(not d.terms for d in found.differences)
    assert found.sums_alone == (len(robot_groups(A)), len(robot_groups(B)))
    for group in robot_groups(A):
        assert not any(".frame." in name for name, _ in group.terms)
    assert 0 < len(robot_groups(A)) < len(A.groups)


def test_significance():
    difference = Difference("j.placement.x", "m", 1e-3, 4e-4, 2e-4)
    assert difference.change == pytest.approx(-6e-4)
    assert difference.significance == pytest.approx(3.0)


def test_differences_are_sorted_and_independent(record):
    A, B = record(0), record(1)
    found = compare(A, B)
    sizes = [d.significance for d in found.differences]
    assert sizes == sorted(sizes, reverse=True)
    (one,) = (d for d in found.differences if d.name == "joint_3.placement.rx")
    mine, other = (next(p for p in r.parameters if p.name == one.name) for r in (A, B))
    assert one.sigma == pytest.approx(np.hypot(mine.sigma, other.sigma))
    assert one.change == other.value - mine.value
    back = compare(B, A)
    assert [-d.change for d in back.differences] == [
        d.change for d in found.differences
    ]


def test_files_that_do_not_say_what_noise_explains(record):
    found = compare(record(0), replace(record(1), accuracies={"": ToolAccuracy()}))
    assert found.explained is None and found.drifted is None
    assert not found.identical


def of_files(result, hashes):
    """A calibration of files with these contents."""
    return replace(result, provenance=replace(result.provenance, hashes=hashes))


@pytest.mark.parametrize(
    ("first", "second", "same", "shared"),
    [
        ((), (), False, False),
        (("a",), ("a",), True, True),
        (("a", "b"), ("b", "a"), True, True),
        (("a", "b"), ("b",), False, True),
        (("a",), ("b",), False, False),
    ],
)
def test_rows_by_their_files(first, second, same, shared, record):
    pair = (of_files(record(k), h) for k, h in enumerate((first, second)))
    found = compare(*pair)
    assert found.same_rows == same
    assert shared_files(found.first, found.second) == shared


def test_fits_that_leave_more_than_noise_prove_nothing(record):
    A, B = record(0), record(1)
    assert compare(A, B).described
    for noise in (1.3, None):
        known = {"stated_sigma": noise is not None, "sigma0": noise or 1.0}
        other = replace(B, statistics=replace(B.statistics, **known))
        assert not compare(A, other).described


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"joint_6"', '"wrist"', r"joints are .*wrist .*, there .*joint_6"),
        ('"base_link"', '"foot"', "chain starts at foot, there base_link"),
        ('"tool"', '"hand"', "chain ends at hand, there tool"),
    ],
)
def test_robots_that_cannot_be_compared(old, new, message, chain, recorded, record):
    text = chain.robot.source.decode()
    assert old in text
    other = Chain(parse_robot(text.replace(old, new).encode(), "other.urdf"))
    with pytest.raises(InputError, match=rf"^7.json: cannot .* 0.json: .*{message}"):
        compare(record(0), recorded(other, "pose", 7))


def test_a_joint_that_slides_is_another_one(urdf_of, chain_of, recorded):
    def arm(kind):
        joints = [
            {"name": "a", "parent": "l0", "child": "l1", "axis": (0, 0, 1)},
            {
                **{"name": "b", "parent": "l1", "child": "l2", "axis": (0, 1, 0)},
                **{"type": kind, "placement": pin.SE3(np.eye(3), np.ones(3))},
            },
        ]
        return chain_of(urdf_of(*joints))

    pair = [recorded(arm(kind), "pose", 0) for kind in ("revolute", "prismatic")]
    with pytest.raises(InputError, match=r"b \(slides\), there a .*b \(turns\)"):
        compare(*pair)
