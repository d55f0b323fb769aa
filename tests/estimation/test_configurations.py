"""Random configurations at which an instrument can measure, or a tool touches."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.errors import InputError
from calib_pin.estimation.configurations import (
    TOUCHING,
    asked,
    brought_to_contact,
    observable_configurations,
)
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.model import Configurations
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.chain import Chain
from calib_pin.observations import BlockKey
from calib_pin.setup import FrameSetup, PlaneSetup, PointSetup, Setup, SphereSetup
from calib_pin.simulation import exact_at

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


def drawn(problem: Problem, theta: np.ndarray, count: int) -> Configurations:
    rng = np.random.default_rng(0)
    return observable_configurations(problem, problem.only.key, theta, count, rng)


def anywhere(problem: Problem, target: Sequence[str]) -> Configurations:
    """Random configurations, which need not touch."""
    rng = np.random.default_rng(0)
    q = problem.chains.random_configurations(len(target), rng)
    return asked(problem, problem.only.key, q, target)


def errors_of(problem: Problem, size: float = 0.01) -> np.ndarray:
    return size * np.random.default_rng(1).normal(size=len(problem.parameters))


@pytest.mark.parametrize("model", CONTACTS)
def test_contacts_are_closed(model: str) -> None:
    """Of the robot as it is, errors and all, within the limits."""
    problem = problem_of(model)
    theta = errors_of(problem)
    at = drawn(problem, theta, 30)
    q = at.q
    assert (q >= ARM.lower).all() and (q <= ARM.upper).all()
    names = tuple(dict.fromkeys(problem.data.target))
    assert at.target == tuple(names[k % len(names)] for k in range(30))
    gap = exact_at(problem, theta, at).errors(theta)
    assert np.abs(gap).max() < TOUCHING
    # They are not alike.
    assert len(np.unique(q.round(3), axis=0)) == 30
    assert q.std(axis=0).min() > 0.3


def test_each_block_has_its_own() -> None:
    """Of several instruments on chains of one tree, joints of others move as well."""
    keys = [BlockKey("position"), BlockKey("plane-contact")]
    problem = nominal_problem(ARM, keys, SETUP)
    zero, rng = np.zeros(len(problem.parameters)), np.random.default_rng(0)
    at = [observable_configurations(problem, key, zero, 11, rng) for key in keys]
    assert [some.key for some in at] == keys
    assert set(at[0].target) == {"a", "b"}
    assert set(at[1].target) == {"a@table", "b@table", "a@wall", "b@wall"}
    assert np.abs(exact_at(problem, zero, *at).errors(zero)).max() < 1e-12


def test_a_gap_that_is_left() -> None:
    """How exact a contact is: the tool stops short of it, or presses."""
    problem = problem_of("plane-contact")
    zero, rng = np.zeros(len(problem.parameters)), np.random.default_rng(0)
    at = drawn(problem, zero, 12)
    gap = 1e-3 * rng.normal(size=(12, 1))
    moved, touches = brought_to_contact(problem, zero, at, gap)
    assert touches.all() and np.abs(moved - at.q).max() < 0.05
    found = exact_at(problem, zero, replace(at, q=moved)).errors(zero)
    np.testing.assert_allclose(found, gap[:, 0], rtol=0, atol=1e-12)


def test_configurations_beyond_the_limits_do_not_touch() -> None:
    """An arm of one joint that would have to turn too far."""
    problem = problem_of("plane-contact", replace(SETUP, targets={}))
    zero = np.zeros(len(problem.parameters))
    at = anywhere(problem, ("table", "wall") * 20)
    kept = at.q.copy()
    found, touches = brought_to_contact(problem, zero, at)
    np.testing.assert_array_equal(at.q, kept)
    within = ((found >= ARM.lower) & (found <= ARM.upper)).all(axis=1)
    gap = np.abs(exact_at(problem, zero, replace(at, q=found)).errors(zero))
    np.testing.assert_array_equal(touches, within & (gap < TOUCHING))
    assert 0 < touches.sum() < 40


def test_places_out_of_reach() -> None:
    far = {"s": PointSetup((5.0, 0.0, 0.0))}
    problem = problem_of("fixed-point", Setup(sockets=far, tool_frame=TOOL))
    zero = np.zeros(len(problem.parameters))
    message = "only 0 of 5 configurations that can be brought into contact"
    with pytest.raises(InputError, match=message):
        drawn(problem, zero, 5)


def test_targets_that_are_hardly_seen_leave_their_rows_to_others() -> None:
    """One of two sockets is out of reach: the other has all rows."""
    sockets = {"near": SETUP.sockets["s/0"], "far": PointSetup((5.0, 0.0, 0.0))}
    problem = problem_of("fixed-point", Setup(sockets=sockets, tool_frame=TOOL))
    zero = np.zeros(len(problem.parameters))
    at = drawn(problem, zero, 6)
    assert Counter(at.target) == {"near": 6}
    gap = exact_at(problem, zero, at).errors(zero)
    assert np.abs(gap).max() < TOUCHING


def test_the_same_seed_gives_the_same_configurations() -> None:
    problem = problem_of("sphere-contact")
    zero = np.zeros(len(problem.parameters))
    first, again = (drawn(problem, zero, 8) for _ in range(2))
    np.testing.assert_array_equal(first.q, again.q)


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
        at = asked(problem, problem.only.key, q, ("p",) * 3)
        found, touches = brought_to_contact(problem, zero, at)
        # At zero the rim moves along the plane, which no step can change.
        assert touches.tolist() == [reached, reached, False]
        assert np.isfinite(found).all()
