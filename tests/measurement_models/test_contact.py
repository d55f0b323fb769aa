"""Points that touch planes and spheres."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.errors import InputError
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import measurement_model
from calib_pin.measurement_models.contact import PlaneContact, SphereContact
from calib_pin.measurement_models.references import Plane, Sphere
from calib_pin.observations import Measurements
from calib_pin.setup import PlaneSetup, PointSetup, Setup, SphereSetup
from tests.measurement_models.test_contact_registration import poses
from tests.shared import rows_of

TIP = np.array([0.05, -0.03, 0.12])
TABLE = PlaneSetup((0.0, 0.1, 1.0), -0.4)
WALL = PlaneSetup((1.0, 0.1, 0.3), -0.5)
BALL = SphereSetup((0.5, 0.2, 0.4), 0.15)


def data_of(model: str, count: int, *names: str) -> Measurements:
    return rows_of(model, np.zeros((count, 0)), *names)


def touching(points: Floats) -> Floats:
    """Poses of a tip whose point is at places, turned at random."""
    return poses(points, TIP, np.random.default_rng(0))


def on_plane(plane: PlaneSetup, count: int, seed: int = 1) -> Floats:
    rng = np.random.default_rng(seed)
    n = np.array(plane.normal)
    p = rng.uniform(-1.0, 1.0, (count, 3))
    return np.asarray(p - np.outer((p @ n + plane.offset) / (n @ n), n))


def on_sphere(sphere: SphereSetup, count: int, seed: int = 2) -> Floats:
    e = np.random.default_rng(seed).normal(size=(count, 3))
    assert sphere.xyz is not None and sphere.radius is not None
    e /= np.linalg.norm(e, axis=1)[:, None]
    return np.asarray(sphere.xyz + sphere.radius * e)


# The rows.


def test_height_above_a_plane_by_hand() -> None:
    plane = Plane("table", np.array([0.6, 0.0, 0.8]), -1.0)
    model = PlaneContact(sites=(plane,))
    T = np.tile(np.eye(4), (3, 1, 1))
    T[:, :3, 3] = [[0.0, 5.0, 1.25], [1.0, 0.0, 1.0], [0.0, 0.0, 0.0]]
    data = data_of(model.name, 3, "")
    height = model.residual(T, np.zeros(3), data)
    np.testing.assert_allclose(height[:, 0], [0.0, 0.4, -1.0], atol=1e-13)
    # Turned and shifted as by `Plane.turned`.
    instrument = np.array([0.2, -0.1, 0.3])
    normal, offset, _ = plane.turned(instrument)
    expected = T[:, :3, 3] @ normal + offset
    np.testing.assert_allclose(
        model.residual(T, instrument, data)[:, 0], expected, atol=1e-13
    )


def test_height_above_a_sphere_by_hand() -> None:
    """The radius of a probe's ball counts to that of the sphere."""
    model = SphereContact(sites=(Sphere("s", np.array([1.0, 0.0, 0.0]), 2.0),))
    T = np.tile(np.eye(4), (3, 1, 1))
    T[:, :3, 3] = [[1.0, 3.0, 4.0], [1.0, 0.0, -2.0], [0.5, 0.0, 0.0]]
    data = data_of(model.name, 3, "s")
    height = model.residual(T, np.zeros(4), data)
    np.testing.assert_allclose(height[:, 0], [3.0, 0.0, -1.5], atol=1e-13)
    height = model.residual(T, np.array([0, 0, 0, 0.1]), data)
    np.testing.assert_allclose(height[:, 0], [2.9, -0.1, -1.6], atol=1e-13)
    height = model.residual(T, np.array([-0.5, 0, 0, 0]), data)
    assert height[2, 0] == -2.0


def test_measurements_of_several_sites_keep_their_own() -> None:
    """Parameters of a plane move its rows and no others."""
    model = measurement_model("plane-contact", Setup(planes={"a": TABLE, "b": WALL}))
    T = touching(np.random.default_rng(0).normal(size=(6, 3)))
    data = data_of("plane-contact", 6, "b", "a", "a")
    instrument = np.array([0.1, 0.2, 0.3, 0.0, 0.0, 0.0])
    moved = model.residual(T, instrument, data) - model.residual(
        T, 0.0 * instrument, data
    )
    of_a = np.array([name == "a" for name in data.target])
    assert np.abs(moved[of_a]).min() > 1e-3 and not moved[~of_a].any()
    assert [p.unit for p in model.parameters] == ["rad", "rad", "m"] * 2


@pytest.mark.parametrize("model", ["plane-contact", "sphere-contact"])
def test_rows_of_something_unknown(model: str) -> None:
    setup = Setup(planes={"a": TABLE, "b": WALL}, spheres={"a": BALL, "b": BALL})
    F, data = touching(np.zeros((2, 3))), data_of(model, 2, "a", "c")
    data = replace(data, files=())  # As a program has them.
    with pytest.raises(InputError, match=r"row 1: .*'c'"):
        measurement_model(model, setup).register(F, data, None, None)


@pytest.mark.parametrize("model", ["plane-contact", "sphere-contact", "fixed-point"])
def test_a_reading_is_how_far_the_point_is_off(model: str) -> None:
    """What touches, and what a gauge reads at the same heights, has no residual."""
    at = {"a": PointSetup((0.5, 0.2, 0.4))}
    found = measurement_model(
        model, Setup(planes={"a": TABLE}, spheres={"a": BALL}, sockets=at)
    )
    T, data = touching(on_sphere(BALL, 5) * 1.001), data_of(model, 5, "a")
    zero = np.zeros(len(found.parameters))
    height = found.residual(T, zero, data)
    assert np.abs(height).max() > 1e-4 and found.width == 0
    read_off = replace(data, values=height)
    np.testing.assert_allclose(found.residual(T, zero, read_off), 0.0, atol=1e-15)
    # Away from the surface, or along the axes, is positive.
    out = replace(data, values=height + 0.01)
    np.testing.assert_allclose(found.residual(T, zero, out), -0.01, atol=1e-15)
    both = Measurements.concatenate([data, out])
    assert both.values.shape == (10, height.shape[1]) and not both.values[:5].any()


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_an_unknown_plane_faces_the_tool_that_reads(side: float) -> None:
    """Of one that is given the normal stays, whatever side it is on."""
    outward = side * np.array(TABLE.normal)
    rng, points = np.random.default_rng(3), on_plane(TABLE, 30)
    tilts = [pin.exp3(0.5 * rng.normal(size=3)) for _ in points]
    up = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), outward).matrix()
    long = np.array([0.0, 0.0, -0.3])
    F = np.array(
        [
            pin.SE3(up @ R, p - up @ R @ long).homogeneous
            for p, R in zip(points, tilts, strict=True)
        ]
    )
    data = rows_of("plane-contact", rng.uniform(-5e-4, 5e-4, (30, 1)), "a")
    tool = pin.SE3(np.eye(3), long)
    for planes in ({}, {"a": TABLE}):
        model = measurement_model("plane-contact", Setup(planes=planes), ("a",))
        (plane,) = model.register(F, data, None, tool)[0].references
        assert isinstance(plane, Plane) and plane.normal is not None
        expected = np.array(TABLE.normal) if planes else outward
        assert float(plane.normal @ expected) > 0.99


# Registration.


@pytest.mark.parametrize("known", [False, True])
def test_planes_and_the_point_that_touches_them(known: bool) -> None:
    """They stand in the measuring frame; the base is given."""
    # Twelve of one plane are enough.
    target = ("table",) * 12 + ("wall",) * 12
    base = pin.exp6(np.array([0.5, 0.2, -0.1, 0.3, -0.2, 0.8]))
    points = np.concatenate([on_plane(TABLE, 12), on_plane(WALL, 12)])
    F = base.inverse().homogeneous @ touching(points)
    data = data_of("plane-contact", 24, *target)
    tool = pin.SE3(np.eye(3), TIP) if known else None
    model = measurement_model("plane-contact", Setup(), ("table", "wall"))
    found, found_base, found_tool = model.register(F, data, base, tool)
    assert found_base == base
    np.testing.assert_allclose(found_tool.translation, TIP, atol=1e-11)
    for plane, stated in zip(found.references, (TABLE, WALL), strict=True):
        size = np.linalg.norm(stated.normal)
        normal, offset = np.array(stated.normal) / size, stated.offset / size
        np.testing.assert_allclose(plane.normal, normal, atol=1e-11)
        assert plane.offset == pytest.approx(offset, abs=1e-11)
    # What is given stands, and the point is found all the same.
    wrong = Setup(planes={"table": PlaneSetup((0.0, 0.0, 1.0), -0.3)})
    model = measurement_model("plane-contact", wrong)
    rows = data_of("plane-contact", 12, "")
    found, _, found_tool = model.register(F[:12], rows, base, None)
    assert found.references == model.references
    np.testing.assert_allclose(found_tool.translation, TIP, atol=1e-11)


@pytest.mark.parametrize(
    ("radius", "known"), [(None, True), (None, False), (0.15, False)]
)
def test_spheres_and_the_point_that_touches_them(
    radius: float | None, known: bool
) -> None:
    F = touching(on_sphere(BALL, 30))
    setup = Setup(spheres={"ball": SphereSetup(None, radius)})
    model = measurement_model("sphere-contact", setup)
    tool = pin.SE3(np.eye(3), TIP) if known else None
    data = data_of("sphere-contact", 30, "ball")
    found, _, found_tool = model.register(F, data, None, tool)
    np.testing.assert_allclose(found_tool.translation, TIP, atol=1e-10)
    (sphere,) = found.references
    np.testing.assert_allclose(sphere.xyz, BALL.xyz, atol=1e-10)
    assert sphere.size == pytest.approx(0.15, abs=1e-10)
    # A radius that is stated is known, one that is not is estimated.
    assert [p.free for p in found.parameters] == [True] * 3 + [radius is None]
