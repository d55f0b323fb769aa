"""Distances from an anchor, and from where the point of a tool has been."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import calib_pin
from benchmarks.exact import exact_problem
from calib_pin.errors import InputError, OptionError
from calib_pin.estimation.fit import fit_model
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.kinematics.spatial import Floats, invert
from calib_pin.measurement_models import measurement_model
from calib_pin.measurement_models.distance import PointDistance, RelativeDistance
from calib_pin.measurement_models.references import Anchor, Point
from calib_pin.setup import AnchorSetup, FrameSetup, Setup
from tests.shared import rows_of

ARM = calib_pin.load_chain("space6")
TIP = np.array([0.05, -0.03, 0.12])
AT = np.array([1.5, 0.2, 0.4])
TOOL = FrameSetup((0.05, 0.08, 0.12), (0.2, -0.3, 0.1), estimate=True)


def tips(count: int, seed: int = 0) -> Floats:
    return ARM.poses(ARM.random_configurations(count, np.random.default_rng(seed)))


# From an anchor.


def test_a_wire_by_hand() -> None:
    model = PointDistance(sites=(Anchor("w", np.array([1.0, 0.0, 0.0]), 0.5),))
    T = np.tile(np.eye(4), (2, 1, 1))
    T[:, :3, 3] = [[1.0, 3.0, 4.0], [1.0, 0.0, -2.0]]
    reading = model.predict(T, np.zeros(4), ("w", ""))
    np.testing.assert_allclose(reading[:, 0], [5.5, 2.5], atol=1e-13)
    reading = model.predict(T, np.array([0.0, 3.0, 0.0, 0.1]), ("w", "w"))
    np.testing.assert_allclose(reading[0, 0], 4.6, atol=1e-13)
    data = rows_of(model.name, np.array([[5.0], [3.0]]), "w")
    # Predicted minus measured.
    np.testing.assert_allclose(model.residual(T, np.zeros(4), data)[:, 0], [0.5, -0.5])


@pytest.mark.parametrize(
    ("bias", "estimate", "known"),
    [(0.0, False, False), (0.02, False, True), (0.02, True, False)],
)
def test_anchors_and_points_are_registered(
    bias: float, estimate: bool, known: bool
) -> None:
    F = tips(17)  # As many as unknowns of the linear equations.
    points = F[:, :3, :3] @ TIP + F[:, :3, 3]
    values = np.linalg.norm(points - AT, axis=1) + bias
    stated = 0.0 if estimate else bias
    setup = Setup(anchors={"w": AnchorSetup(None, stated, True, estimate)})
    model = measurement_model("point-distance", setup)
    tool = pin.SE3(np.eye(3), TIP) if known else None
    data = rows_of("point-distance", values[:, None], "w")
    found, base, found_tool = model.register(F, data, None, tool)
    assert base == pin.SE3.Identity()
    np.testing.assert_allclose(found_tool.translation, TIP, atol=1e-9)
    (anchor,) = found.references
    np.testing.assert_allclose(anchor.xyz, AT, atol=1e-9)
    assert anchor.size == pytest.approx(bias, abs=1e-9)
    assert [p.free for p in found.parameters] == [True] * 3 + [estimate]


def test_several_wires() -> None:
    """Each is registered by its own rows, the tool by the one that has most."""
    F, ends = tips(60), {"a": AT, "b": np.array([-0.8, 1.0, 0.5])}
    target = tuple("aab"[k % 3] for k in range(60))
    points = F[:, :3, :3] @ TIP + F[:, :3, 3]
    values = np.linalg.norm(points - [ends[name] for name in target], axis=1)
    data = rows_of("point-distance", values[:, None], *"aab")
    model = measurement_model("point-distance", Setup(), data.target)
    found, _, tool = model.register(F, data, None, None)
    np.testing.assert_allclose(tool.translation, TIP, atol=1e-9)
    for anchor in found.references:
        np.testing.assert_allclose(anchor.xyz, ends[anchor.name], atol=1e-9)
    with pytest.raises(InputError, match=r"m.csv:4: .*'c'"):
        found.register(F, replace(data, target=("a", "b", "c") * 20), None, None)


# From where the row starts.


def test_a_way_by_hand() -> None:
    """Poses are those of the tool in the tool at the start."""
    model = RelativeDistance()
    turned = pin.SE3(pin.exp3(np.array([0.0, 0.0, np.pi / 2])), np.array([3.0, 0, 4.0]))
    T = np.tile(turned.homogeneous, (2, 1, 1))
    way = model.predict(T, np.zeros(0), ("", "1"))
    np.testing.assert_allclose(way[:, 0], 5.0)
    # A point 1 m off the axis goes along a chord as well.
    model = RelativeDistance((Point("p", "target", np.array([1.0, 0, 0])),))
    T[:, :3, 3] = 0.0
    way = model.predict(T, np.zeros(3), ("p@1", "p@2"))
    np.testing.assert_allclose(way[:, 0], np.sqrt(2.0))
    way = model.predict(T, np.array([1.0, 0.0, 5.0]), ("p@1", "p@2"))
    np.testing.assert_allclose(way[:, 0], 2.0 * np.sqrt(2.0))


@pytest.mark.parametrize("names", [("",), ("1", "2"), ("p@1", "r@1", "p@2")])
def test_points_are_registered_by_their_ways(names: tuple[str, ...]) -> None:
    T = invert(tips(60, 1)) @ tips(60, 2)
    points = {"": TIP, "p": TIP, "r": np.array([-0.1, 0.2, 0.3])}
    target = tuple(names[k % len(names)] for k in range(60))
    t = np.array([points[name.rpartition("@")[0]] for name in target])
    ends = np.einsum("nij,nj->ni", T[:, :3, :3], t) + T[:, :3, 3]
    ways = np.linalg.norm(ends - t, axis=1, keepdims=True)
    data = rows_of("relative-distance", ways, *names)
    model = measurement_model("relative-distance", Setup(), target)
    found, base, tool = model.register(T, data, None, None)
    assert base == pin.SE3.Identity()
    if not found.references:
        np.testing.assert_allclose(tool.translation, TIP, atol=1e-9)
    for point in found.references:
        np.testing.assert_allclose(point.xyz, points[point.name], atol=1e-9)
    _, _, kept = model.register(T, data, None, pin.SE3(np.eye(3), TIP))
    np.testing.assert_array_equal(kept.translation, TIP)


def test_rows_are_relative_to_their_start() -> None:
    setup = Setup(base_frame=FrameSetup((1, 2, 3), (0.1, 0.2, 0.3)), tool_frame=TOOL)
    problem = nominal_problem(ARM, "relative-distance", setup)
    rng = np.random.default_rng(0)
    q, start = (ARM.random_configurations(5, rng) for _ in range(2))
    theta = problem.parameters.vector({"joint_2.placement.x": 1e-3})
    there = exact_problem(problem, theta, q, ("a",) * 5, start).data.only
    term = problem.only
    T_q, T_start = (term.error.poses(x, term.values(theta)[0]) for x in (q, start))
    expected = np.linalg.norm(T_q[:, :3, 3] - T_start[:, :3, 3], axis=1)
    np.testing.assert_allclose(there.values[:, 0], expected, rtol=1e-12)
    T = invert(T_start) @ T_q
    np.testing.assert_allclose(term.poses(theta, there), T, atol=1e-12)
    # Without starts, each row starts at the row before.
    rolled = exact_problem(problem, theta, q, ("a",) * 5)
    np.testing.assert_array_equal(rolled.data.only.start, q[[4, 0, 1, 2, 3]])
    with pytest.raises(OptionError):
        fit_model(ARM, rolled.data, Setup(learned="gaussian-process"), 0)
