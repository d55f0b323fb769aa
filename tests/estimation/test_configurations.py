"""Random configurations at which an instrument can measure, or a tool touches."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import calib_pin
from calib_pin.errors import InputError
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.nominal import (
    TOUCHING,
    asked,
    brought_to_contact,
    observable_configurations,
)
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import BlockKey, Measurements
from calib_pin.setup import (
    CameraSetup,
    FrameSetup,
    PlaneSetup,
    PointSetup,
    Setup,
    SphereSetup,
)
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


def drawn(problem: Problem, theta: np.ndarray, count: int) -> Measurements:
    rng = np.random.default_rng(0)
    return observable_configurations(problem, problem.only.key, theta, count, rng)


def zero(problem: Problem) -> Floats:
    return np.zeros(len(problem.parameters))


@pytest.mark.parametrize("model", CONTACTS)
def test_contacts_are_closed(model: str) -> None:
    """Of the robot as it is, errors and all, within the limits."""
    problem = problem_of(model)
    theta = 0.01 * np.random.default_rng(1).normal(size=len(problem.parameters))
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
    none, rng = zero(problem), np.random.default_rng(0)
    at = [observable_configurations(problem, key, none, 11, rng) for key in keys]
    assert [some.key for some in at] == keys
    assert set(at[0].target) == {"a", "b"}
    assert set(at[1].target) == {"a@table", "b@table", "a@wall", "b@wall"}
    assert np.abs(exact_at(problem, none, *at).errors(none)).max() < 1e-12


def test_a_gap_that_is_left() -> None:
    """How exact a contact is: the tool stops short of it, or presses."""
    problem = problem_of("plane-contact")
    none, rng = zero(problem), np.random.default_rng(0)
    at = drawn(problem, none, 12)
    gap = 1e-3 * rng.normal(size=(12, 1))
    moved, touches = brought_to_contact(problem, none, at, gap)
    assert touches.all() and np.abs(moved - at.q).max() < 0.05
    found = exact_at(problem, none, replace(at, q=moved)).errors(none)
    np.testing.assert_allclose(found, gap[:, 0], rtol=0, atol=1e-12)


def test_places_out_of_reach(
    refused: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of two sockets the other has all rows; one alone is refused."""
    monkeypatch.setattr("calib_pin.estimation.nominal.DRAWS", 30)
    monkeypatch.setattr("calib_pin.estimation.nominal.PATIENCE", 5)
    sockets = {"near": SETUP.sockets["s/0"], "far": PointSetup((5.0, 0.0, 0.0))}
    problem = problem_of("fixed-point", Setup(sockets=sockets, tool_frame=TOOL))
    at = drawn(problem, zero(problem), 6)
    assert Counter(at.target) == {"near": 6}
    gap = exact_at(problem, zero(problem), at).errors(zero(problem))
    assert np.abs(gap).max() < TOUCHING
    alone = Setup(sockets={"far": sockets["far"]}, tool_frame=TOOL)
    problem = problem_of("fixed-point", alone)
    with refused(InputError, reason="0 of 5"):
        drawn(problem, zero(problem), 5)


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
        q = np.array([[0.4], [-0.7], [0.0]])
        at = asked(problem, problem.only.key, q, ("p",) * 3)
        found, touches = brought_to_contact(problem, zero(problem), at)
        # At zero the rim moves along the plane, which no step can change.
        assert touches.tolist() == [reached, reached, False]
        assert np.isfinite(found).all()


def test_frames_that_a_setup_leaves_out_are_asked_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A camera with an image of one pixel sees nothing."""
    monkeypatch.setattr("calib_pin.estimation.nominal.DRAWS", 3)
    camera = CameraSetup("world", (900.0, 900.0), (640.0, 480.0), size=(1.0, 1.0))
    setup = Setup(camera=camera, targets={"m": PointSetup((0.0, 0.0, 0.0))})
    ahead = FrameSetup((0.0, 0.0, 9.0))
    for stated, reason in (
        (setup, "give frames.base and frames.tool (first guess"),
        (replace(setup, base_frame=ahead), "give frames.tool (first guess"),
        (replace(setup, base_frame=ahead, tool_frame=TOOL), "only 0 of 5"),
    ):
        problem = problem_of("camera", stated)
        with pytest.raises(InputError) as caught:
            drawn(problem, zero(problem), 5)
        assert caught.value.reason.startswith(reason)
        assert "only 0 of 5" in caught.value.reason
