"""Two calibrations of one robot: noise is no drift, and a drift is found and named."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import calib_pin
from calib_pin.errors import InputError
from calib_pin.io.urdf_tree import parse_robot
from calib_pin.kinematics.chain import Chain
from calib_pin.setup import FrameSetup, Setup
from calib_pin.validation.comparison import compare, shared_files
from calib_pin.validation.result import ToolAccuracy


@pytest.fixture(scope="module")
def chain() -> Chain:
    return calib_pin.load_chain("space6")


@pytest.fixture(scope="module")
def record(chain, recorded):
    """Calibrations of one robot, each made once."""

    @cache
    def make(seed, changes=(), parameters=("placement",)):
        # The robot is the same, however it is described.
        setup = Setup(parameters=parameters)
        return recorded(chain, "pose", seed, dict(changes), setup=setup, truth=Setup())

    return make


# --- noise alone -------------------------------------------------------------------


def test_noise_is_no_drift(record):
    found = compare(record(0), record(1))
    assert not (found.drifted or found.changed or found.identical)
    assert found.described and found.same_parameters
    significance = np.array([d.significance for d in found.differences])
    assert (np.diff(significance) <= 0.0).all()
    back = compare(record(1), record(0)).differences
    assert [-d.change for d in back] == [d.change for d in found.differences]
    # Differences of normal variables, some twenty of them.
    assert len(significance) > 15 and significance.max() < 4.5
    assert np.sqrt(np.mean(significance**2)) == pytest.approx(1.0, abs=0.5)
    # The frames absorb a part of what the noise of base and tool is counted for.
    assert 0.2 < found.drift.position.rms / found.drift.explained[0] < 1.5


def test_without_noise_tips_are_the_same(chain, recorded):
    A, B = (recorded(chain, "pose", seed, noise=0.0) for seed in (0, 1))
    found = compare(A, B)
    assert found.identical
    assert found.drifted is False
    assert found.moved == () and found.differences


# --- a drift -----------------------------------------------------------------------


def test_a_joint_offset_is_named_and_its_drift_is_true(chain, record):
    name = "joint_4.placement.rz"
    found = compare(record(0), record(1, changes=((name, 2e-3),)))
    assert found.drifted and found.changed
    first = found.differences[0]
    assert name in (first.name, *(term for term, _ in first.terms))
    assert first.change == pytest.approx(2e-3, abs=4.0 * first.sigma)
    assert first.significance > 50.0
    assert found.drift.position.rms > 3.0 * found.drift.explained[0]


def test_frames_that_are_known_absorb_nothing(chain, recorded):
    known = FrameSetup((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), estimate=False)
    setup = Setup(base_frame=known, tool_frame=known)
    A = recorded(chain, "pose", 0, setup=setup)
    B = recorded(chain, "pose", 1, {"joint_1.placement.rz": 2e-3}, setup=setup)
    found = compare(A, B)
    assert found.drift.absorbed == ()
    assert found.drifted
    assert found.drift.orientation.mean == pytest.approx(2e-3, rel=0.1)


# --- other models ------------------------------------------------------------------


def test_other_nominal_robots_are_compared_by_their_tips(chain, recorded, record):
    text = chain.robot.source.decode()
    spaced = Chain(parse_robot(text.encode() + b"\n", "b.urdf"), chain.base, chain.tip)
    assert compare(record(0), recorded(spaced, "pose", 1)).same_nominal
    moved = parse_robot(text.replace("0.85", "0.852").encode(), "c.urdf")
    other = Chain(moved, chain.base, chain.tip)
    found = compare(record(0), recorded(other, "pose", 1))
    assert not found.same_nominal and not found.same_parameters
    assert found.differences == ()
    assert found.drifted  # The nominal arm is longer, and so is the simulated one.
    assert found.drift.position.rms > 5e-4


# --- what is compared --------------------------------------------------------------


def test_sums_are_matched_by_their_terms(record):
    A, B = record(0), record(1)
    expected = compare(A, B).differences
    shuffled = tuple(
        replace(group, number=100 - group.number, terms=group.terms[::-1])
        for group in B.groups[::-1]
    )
    assert compare(A, replace(B, groups=shuffled)).differences == expected
    other = tuple(
        replace(g, terms=tuple((n, 1.01 * c) for n, c in g.terms)) for g in B.groups
    )
    found = compare(A, replace(B, groups=other))
    assert all(not d.terms for d in found.differences)


def test_files_that_do_not_say_what_noise_explains(record):
    found = compare(record(0), replace(record(1), accuracies={"": ToolAccuracy()}))
    assert found.drift.explained is None and found.drifted is None
    assert not found.identical


def of_files(result, hashes):
    """A calibration of files with these contents."""
    return replace(result, provenance=replace(result.provenance, hashes=hashes))


@pytest.mark.parametrize(
    ("first", "second", "same", "shared"),
    [
        ((), (), False, False),
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
    ("old", "new"), [("joint_6", "wrist"), ("base_link", "foot"), ("tool", "hand")]
)
def test_robots_that_cannot_be_compared(old, new, chain, recorded, record):
    text = chain.robot.source.decode().replace(f'"{old}"', f'"{new}"')
    other = Chain(parse_robot(text.encode(), "other.urdf"))
    with pytest.raises(InputError, match=rf"0.json: .*{new}.*{old}") as error:
        compare(record(0), recorded(other, "pose", 7))
    assert error.value.file == "7.json"


# --- frames that moved ---------------------------------------------------


def test_frames_that_stand_elsewhere_are_no_drift(chain, recorded) -> None:
    here = Setup(
        base_frame=FrameSetup((1.0, 0.2, 0.3), (0.1, 0.2, 0.3)),
        tool_frame=FrameSetup((0.05, 0.08, 0.12)),
    )
    there = Setup(
        base_frame=FrameSetup((0.8, -0.5, 0.3), (0.2, 0.1, 1.4)),
        tool_frame=FrameSetup((0.05, 0.02, 0.15), (0.3, -0.2, 0.5)),
    )
    A, B = (
        recorded(chain, "pose", seed, setup=Setup(), truth=truth)
        for seed, truth in enumerate((here, there))
    )
    found = compare(A, B)
    assert found.drifted is False and not found.changed
