"""Whether measurements tell how large a robot is."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import calib_pin
from benchmarks.exact import exact_at
from calib_pin.errors import InputError, OptionError
from calib_pin.estimation.formulation import make_problem, nominal_problem
from calib_pin.estimation.nominal import (
    TOUCHING,
    brought_to_contact,
    jacobian_at,
    observable_configurations,
    registered,
    scale_deviation,
    unmeasured,
)
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Measurements, Observations
from calib_pin.setup import (
    AnchorSetup,
    CameraSetup,
    DistanceSetup,
    FrameSetup,
    PlaneSetup,
    PointSetup,
    Setup,
    SphereSetup,
)
from tests.shared import chain_of, refused, simulated, urdf_of

ARM = calib_pin.load_chain("space6")
TOOL = FrameSetup((0.05, 0.08, 0.12), (0.2, -0.3, 0.1), estimate=True)
BASE = FrameSetup((1.5, -0.4, 0.3), (0.3, 0.2, 2.0), estimate=True)
FAR = FrameSetup((0.1, -0.2, 3.0), (0.3, -0.2, 0.4), estimate=True)
POINTS = {
    "a": PointSetup((0.05, 0.08, 0.12)),
    "b": PointSetup((-0.06, 0.03, 0.1)),
    "c": PointSetup((0.02, -0.07, 0.15)),
    "d": PointSetup((0.1, 0.1, -0.05)),
}
SOCKETS = {"s/0": PointSetup((0.6, 0.3, 0.4)), "s/1": PointSetup((0.5, -0.2, 0.6))}
TABLE = PlaneSetup((0, 0.1, 1), -0.4)
LEVELED = replace(TABLE, estimate=False)
BALL = SphereSetup((0.5, 0.2, 0.4), 0.15)
BALLOON = replace(BALL, estimate_radius=True)
CAMERA = CameraSetup("world", (900.0, 910.0), (640.0, 500.0))
TIED = (DistanceSetup(("s/0", "s/1"), 0.5, 1e-5),)
IN_SOCKETS: dict[str, Any] = {"sockets": SOCKETS, "tool_frame": TOOL}


def points(names: str, estimate: bool | None = None) -> dict[str, Any]:
    """Targets of these names."""
    return {"targets": {n: replace(POINTS[n], estimate=estimate) for n in names}}


def sockets(count: int, estimate: bool = True) -> dict[str, Any]:
    """The first of the sockets, and the tool whose ball rests there."""
    some = list(SOCKETS.items())[:count]
    found = {name: replace(socket, estimate=estimate) for name, socket in some}
    return {"sockets": found, "tool_frame": TOOL}


def touched(**changes: Any) -> dict[str, Any]:
    some = {"planes": {"a": TABLE}, "spheres": {"s": BALL}, "tool_frame": TOOL}
    return some | changes


def wires(*anchors: AnchorSetup) -> dict[str, Any]:
    named = {str(k): anchor for k, anchor in enumerate(anchors)}
    return {"anchors": named, "tool_frame": TOOL}


AT = (1.5, 0.2, 0.4)
CORNERS = [
    AnchorSetup(at, estimate=False) for at in (AT, (0, 2, 0), (0, 0, 2), (-1, 1, -1))
]
WALL, DOOR = PlaneSetup((1, 0.1, 0.3), -0.5), PlaneSetup((0.2, 1, 0.1), -0.3)
ROOM = {"a": TABLE, "b": WALL, "c": DOOR}
SEEN: dict[str, Any] = {"camera": CAMERA, "base_frame": FAR}


@pytest.mark.parametrize("apart", [0.0, 1e-4])
def test_axes_that_meet_have_no_lengths(apart: float) -> None:
    """A positioner of tilt and turn: what grows is how far away its base stands."""
    across = pin.SE3(pin.rpy.rpyToMatrix(0.0, 1.57, 0.0), np.array([apart, 0.0, 0.0]))
    tilt = {"name": "tilt", "parent": "base", "child": "frame"}
    turn = {"name": "turn", "parent": "frame", "child": "table", "placement": across}
    found = calib_pin.identify(chain_of(urdf_of(tilt, turn)), "pose")
    assert found.identifiability.robot_rank == 2
    assert found.identifiability.scale_observable


@pytest.mark.parametrize(
    ("model", "stated", "rank", "scaled"),
    [
        ("position", points("a"), 27, True),
        # Each unknown point more has three coordinates more.
        ("position", points("abc", True), 33, True),
        # All of the tool frame but a turn about the line through both of them.
        ("position", points("ab", False), 29, True),
        # As good as poses.
        ("position", points("abc", False), 30, True),
        ("plane-distance", {"planes": {"a": PlaneSetup((0, 1, 4.6), -0.69)}}, 26, True),
        # Turns about the anchor show nothing: three less than a position.
        ("point-distance", wires(AnchorSetup(AT)), 24, True),
        ("point-distance", wires(AnchorSetup(AT, 0.01, True, True)), 25, True),
        ("point-distance", wires(*CORNERS), 27, True),
        # Not where the base stands: six less than positions.
        ("relative-distance", {"tool_frame": TOOL}, 21, True),
        ("relative-distance", {"tool_frame": TOOL, **points("ab")}, 24, True),
        # 18 of the robot, 3 of the ball, 3 of the socket, but not the scale.
        ("fixed-point", sockets(1), 23, False),
        ("fixed-point", {**sockets(2), "distances": TIED}, 27, True),
        # The base stands where it stands: how far a known socket is, is a length.
        # A larger robot that stands elsewhere has its ball there too.
        ("fixed-point", sockets(1, False), 23, False),
        ("fixed-point", sockets(2, False), 26, True),
        ("plane-contact", touched(planes={"a": LEVELED}), 23, False),
        ("plane-contact", touched(planes=ROOM), 29, False),
        # The radius of a sphere is the length that a plane lacks.
        ("sphere-contact", touched(), 24, True),
        ("sphere-contact", touched(spheres={"s": BALLOON}), 24, False),
        # So is what lies between points that are known.
        ("camera", {**SEEN, "tool_frame": TOOL, **points("abcd")}, 30, True),
        ("camera", {**SEEN, **points("abcd", True)}, 35, False),
    ],
)
def test_ranks_and_scales(
    model: str, stated: dict[str, Any], rank: int, scaled: bool
) -> None:
    """Of contacts in contact: away from it, gaps would tell the scale."""
    found = calib_pin.identify(ARM, model, Setup(**stated))
    ranks = found.identifiability
    assert ranks.rank == ranks.structural_rank == rank and ranks.gap > 1e6
    assert ranks.scale_observable == scaled
    base = {p.status for p in found.parameters if p.name.startswith("base.")}
    # Other instruments measure in the frame of the robot.
    assert (base == {"fixed"}) == (model not in ("position", "camera"))


HELD = replace(TOOL, estimate=False)


@pytest.mark.parametrize(
    ("stated", "scaled"),
    [
        # A robot of which one length is known cannot grow.
        ({"fixed": ("joint_3.placement.x",)}, True),
        ({"prior": {"joint_3.placement.x": 1e-3}}, True),
        ({"parameters": ("joint-offset",), "tool_frame": HELD}, True),
        # Nothing of it is estimated, and nothing of it can be too large.
        ({"tool_frame": HELD, "fixed": ("*.placement.*",)}, True),
        # Angles are no lengths.
        ({"fixed": ("*.placement.r?",)}, False),
        # Where joint 1 stands is told by the sockets, which are free.
        ({"fixed": ("joint_1.placement.*",)}, False),
        ({"prior": {"joint_1.placement.*": 1e-3}}, False),
        ({"parameters": ("placement", "transmission")}, False),
    ],
)
def test_what_gives_sockets_their_scale(stated: dict[str, Any], scaled: bool) -> None:
    setup = Setup(**{**IN_SOCKETS, **stated})
    found = calib_pin.identify(ARM, "fixed-point", setup)
    assert found.identifiability.scale_observable == scaled


def deviation(**stated: Any) -> float:
    """Standard deviation of the logarithm of the size of a robot in two sockets."""
    setup = Setup(**{**IN_SOCKETS, **stated})
    problem = nominal_problem(ARM, "fixed-point", setup)
    zero, rng = np.zeros(len(problem.parameters)), np.random.default_rng(0)
    at = [observable_configurations(problem, problem.only.key, zero, 80, rng)]
    return scale_deviation(problem, zero, at, jacobian_at(problem, zero, at))


@pytest.mark.parametrize("sigma", [1e-6, 0.02])
def test_a_distance_is_as_good_as_its_sigma(sigma: float) -> None:
    """And no better than what the rows know of the sockets."""
    apart = float(np.linalg.norm([0.1, 0.5, -0.2]))
    known = (DistanceSetup(("s/0", "s/1"), apart, sigma),)
    # Forty rows in each socket tell its center to 0.1 mm / 6.3 in every direction.
    ends = np.sqrt(2.0 / 40.0) * 1e-4
    expected = np.hypot(sigma, ends) / apart
    assert deviation(distances=known) == pytest.approx(expected, rel=0.1)
    # Two centimeters in half a meter are no scale.
    setup = Setup(**IN_SOCKETS, distances=known)
    found = calib_pin.identify(ARM, "fixed-point", setup)
    assert found.identifiability.scale_observable == (sigma < 0.01)


def test_nothing_to_grow_and_nothing_to_tell() -> None:
    known = replace(TOOL, estimate=False)
    assert deviation(parameters=("joint-offset",), tool_frame=known) == 0.0
    assert deviation() > 1e3


def test_too_many_parameters(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("calib_pin.estimation.nominal.MOST", 48)
    calib_pin.identify(ARM, "position")
    with refused(OptionError, value=57):
        calib_pin.identify(ARM, "position", Setup(**points("abc")))


SETUP = Setup(
    tool_frame=TOOL,
    targets={"a": PointSetup((0.05, 0.0, 0.1)), "b": PointSetup((0.0, 0.04, 0.2))},
    sockets=SOCKETS,
    planes={"table": TABLE, "wall": WALL},
    spheres={"ball": BALL},
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


def test_places_out_of_reach(monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_a_stretched_arm_cannot_be_brought_there() -> None:
    """A wheel with a point on its rim, and a plane that it just misses."""
    chain = chain_of(urdf_of({"name": "j", "parent": "a", "child": "b"}))
    rim = FrameSetup((1.0, 0.0, 0.0))
    for offset, reached in ((-0.99, True), (-1.01, False)):
        planes = {"p": PlaneSetup((1.0, 0.0, 0.0), offset)}
        setup = Setup(planes=planes, tool_frame=rim)
        problem = nominal_problem(chain, "plane-contact", setup)
        q = np.array([[0.4], [-0.7], [0.0]])
        at = unmeasured(problem, problem.only.key, q, ("p",) * 3)
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


# Closed-form starts.


@pytest.mark.parametrize("order", [1, -1])
def test_frames_come_first_and_sites_after(order: int) -> None:
    """Sockets stand in the frame of a tracker, which is known when they are put."""
    setup = Setup(
        base_frame=BASE, tool_frame=TOOL, sockets=SOCKETS, planes={"table": TABLE}
    )
    counts = {"fixed-point": 12, "plane-contact": 12, "position": 15}
    rows = [simulated(name, setup, count)[0].data for name, count in counts.items()]
    problem = make_problem(ARM, Observations.of(*rows[::order]), Setup())
    assert any(term.measurement.missing for term in problem.terms.values())
    found = registered(problem, zero(problem))
    assert np.abs(found.errors(zero(found))).max() < 1e-9
    located = found.references
    xyz = located["sockets", "s/1"].xyz
    np.testing.assert_allclose(xyz, SOCKETS["s/1"].xyz, atol=1e-9)
    normal = np.array(TABLE.normal) / np.linalg.norm(TABLE.normal)
    np.testing.assert_allclose(located["planes", "table"].normal, normal, atol=1e-9)
    for term in found.terms.values():
        np.testing.assert_allclose(term.error.base.translation, BASE.xyz, atol=1e-9)
        np.testing.assert_allclose(term.error.tool.translation, TOOL.xyz, atol=1e-9)
