"""Random configurations at which an instrument can measure, or a tool touches."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.errors import InputError
from calib_pin.estimation.configurations import (
    TOUCHING,
    brought_to_contact,
    observable_configurations,
)
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.chain import Chain
from calib_pin.measurement_models.mixed import contact_rows
from calib_pin.setup import FrameSetup, PlaneSetup, PointSetup, Setup, SphereSetup
from calib_pin.simulation import exact_problem

ARM = calib_pin.load_chain("space6")
TOOL = FrameSetup((0.05, 0.08, 0.12), (0.2, -0.3, 0.1), estimate=True)
SETUP = Setup(
    tool_frame=TOOL,
    targets={"a": PointSetup((0.05, 0.0, 0.1)), "b": PointSetup((0.0, 0.04, 0.2))},
    sockets={"s/0": PointSetup((0.6, 0.3, 0.4)), "s/1": PointSetup((0.5, -0.2, 0.6))},
    planes={
        "table": PlaneSetup((0, 0.1, 1), -0.4),
        "wall": PlaneSetup((1, 0, 0.3), -0.5),
    },
    spheres={"ball": SphereSetup((0.5, 0.2, 0.4), 0.15)},
)
CONTACTS = ("fixed-point", "plane-contact", "sphere-contact")


def problem_of(model: str, setup: Setup = SETUP) -> Problem:
    return nominal_problem(ARM, model, setup)


def errors_of(problem: Problem, size: float = 0.01) -> np.ndarray:
    return size * np.random.default_rng(1).normal(size=len(problem.parameters))


@pytest.mark.parametrize("model", CONTACTS)
def test_contacts_are_closed(model: str) -> None:
    """Of the robot as it is, errors and all, within the limits."""
    problem = problem_of(model)
    theta = errors_of(problem)
    q, target = observable_configurations(problem, theta, 30, np.random.default_rng(0))
    assert (q >= ARM.lower).all() and (q <= ARM.upper).all()
    names = tuple(dict.fromkeys(problem.data.target))
    assert target == tuple(names[k % len(names)] for k in range(30))
    gap = exact_problem(problem, theta, q, target).errors(theta)
    assert np.abs(gap).max() < TOUCHING
    # They are not alike.
    assert len(np.unique(q.round(3), axis=0)) == 30
    assert q.std(axis=0).min() > 0.3


def test_rows_that_touch_and_rows_that_see() -> None:
    problem = problem_of("position+fixed-point+plane-contact")
    zero = np.zeros(len(problem.parameters))
    q, target = observable_configurations(problem, zero, 22, np.random.default_rng(0))
    touching = contact_rows(problem.measurement, target)
    assert [not name.startswith("position:") for name in target] == touching.tolist()
    assert 0 < touching.sum() < 22
    errors = exact_problem(problem, zero, q, target).masked_errors(zero)
    assert np.nanmax(np.abs(errors)) < 1e-12
    assert contact_rows(problem_of("sphere-contact").measurement, ("x", "y")).all()
    assert not contact_rows(problem_of("pose").measurement, ("", "")).any()


def test_what_need_not_touch_stays() -> None:
    problem = problem_of("position+plane-contact")
    zero, rng = np.zeros(len(problem.parameters)), np.random.default_rng(0)
    q = ARM.random_configurations(6, rng)
    kept = q.copy()
    target = ("position:a", "plane-contact:a@wall") * 3
    rows = contact_rows(problem.measurement, target)
    found, touches = brought_to_contact(problem, zero, q, target, rows)
    np.testing.assert_array_equal(q, kept)
    np.testing.assert_array_equal(found[::2], q[::2])
    assert (found[1::2] != q[1::2]).any(axis=1).all()
    assert touches[::2].all()


def test_a_gap_that_is_left() -> None:
    """How exact a contact is: the tool stops short of it, or presses."""
    problem = problem_of("plane-contact")
    zero, rng = np.zeros(len(problem.parameters)), np.random.default_rng(0)
    q, target = observable_configurations(problem, zero, 12, rng)
    gap = 1e-3 * rng.normal(size=(12, 1))
    every = np.ones(12, bool)
    moved, touches = brought_to_contact(problem, zero, q, target, every, gap)
    assert touches.all() and np.abs(moved - q).max() < 0.05
    found = exact_problem(problem, zero, moved, target).errors(zero)
    np.testing.assert_allclose(found, gap, rtol=0, atol=1e-12)


def test_configurations_beyond_the_limits_do_not_touch() -> None:
    """An arm of one joint that would have to turn too far."""
    problem = problem_of("plane-contact", replace(SETUP, targets={}))
    zero, rng = np.zeros(len(problem.parameters)), np.random.default_rng(0)
    q = ARM.random_configurations(40, rng)
    target = ("table", "wall") * 20
    every = np.ones(40, bool)
    found, touches = brought_to_contact(problem, zero, q, target, every)
    within = ((found >= ARM.lower) & (found <= ARM.upper)).all(axis=1)
    gap = np.abs(exact_problem(problem, zero, found, target).errors(zero)).max(axis=1)
    np.testing.assert_array_equal(touches, within & (gap < TOUCHING))
    assert 0 < touches.sum() < 40


def test_places_out_of_reach() -> None:
    far = {"s": PointSetup((5.0, 0.0, 0.0))}
    problem = problem_of("fixed-point", Setup(sockets=far, tool_frame=TOOL))
    zero = np.zeros(len(problem.parameters))
    message = "only 0 of 5 configurations that can be brought into contact"
    with pytest.raises(InputError, match=message):
        observable_configurations(problem, zero, 5, np.random.default_rng(0))


def test_targets_that_are_hardly_seen_leave_their_rows_to_others() -> None:
    """One of two sockets is out of reach: the other has all rows."""
    sockets = {"near": SETUP.sockets["s/0"], "far": PointSetup((5.0, 0.0, 0.0))}
    problem = problem_of("fixed-point", Setup(sockets=sockets, tool_frame=TOOL))
    zero = np.zeros(len(problem.parameters))
    q, target = observable_configurations(problem, zero, 6, np.random.default_rng(0))
    assert Counter(target) == {"near": 6}
    gap = exact_problem(problem, zero, q, target).errors(zero)
    assert np.abs(gap).max() < TOUCHING


def test_the_same_seed_gives_the_same_configurations() -> None:
    problem = problem_of("sphere-contact")
    zero = np.zeros(len(problem.parameters))
    first, again = (
        observable_configurations(problem, zero, 8, np.random.default_rng(3))[0]
        for _ in range(2)
    )
    np.testing.assert_array_equal(first, again)


def test_a_stretched_arm_cannot_be_brought_there(
    urdf_of: Callable[..., str], chain_of: Callable[..., Chain]
) -> None:
    """A wheel with a point on its rim, and a plane that it just misses."""
    chain = chain_of(urdf_of({"name": "j", "parent": "a", "child": "b"}))
    rim = FrameSetup((1.0, 0.0, 0.0))
    for offset, reached in ((-0.99, True), (-1.01, False)):
        planes = {"p": PlaneSetup((1.0, 0.0, 0.0), offset)}
        setup = Setup(planes=planes, tool_frame=rim)
        problem = nominal_problem(chain, "plane-contact", setup)
        zero = np.zeros(len(problem.parameters))
        q = np.array([[0.4], [-0.7], [0.0]])
        every = np.ones(3, bool)
        found, touches = brought_to_contact(problem, zero, q, ("p",) * 3, every)
        # At zero the rim moves along the plane, which no step can change.
        assert touches.tolist() == [reached, reached, False]
        assert np.isfinite(found).all()
