"""The distance along a beam to one of several planes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.errors import InputError, OptionError
from calib_pin.kinematics.spatial import Floats, so3_exp
from calib_pin.measurement_models import measurement_model
from calib_pin.measurement_models.plane_distance import PlaneDistance
from calib_pin.measurement_models.references import Plane
from calib_pin.setup import PlaneSetup, RangerSetup, Setup
from tests.shared import refused, rows_of

RANGER = "plane-distance"
FLOOR = Plane("floor", np.array([0.0, 0.0, 1.0]), 1.0)
WALL = Plane("wall", np.array([0.6, 0.0, 0.8]), -2.0)


def beam(point: Any, direction: Any, roll: float = 0.0) -> Floats:
    """A tool pose at a point whose z axis has a direction."""
    R = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), np.array(direction))
    return np.asarray(
        pin.SE3(
            R.matrix() @ so3_exp(np.array([0.0, 0.0, roll])), np.array(point)
        ).homogeneous
    )


def beams(seed: int = 0, count: int = 30) -> Floats:
    rng = np.random.default_rng(seed)
    ends = rng.normal(size=(2, count, 3))
    return np.array(
        [beam(p, d, r) for p, d, r in zip(*ends, ends[0, :, 0], strict=True)]
    )


def test_distances() -> None:
    # The floor is z = -1.
    model = PlaneDistance((FLOOR,))
    T = np.array(
        [
            beam([0, 0, 0], [0.0, 0, -1]),
            beam([5, 7, 1], [0.0, 0, -1]),
            beam([0, 0, 0], [0.6, 0, -0.8]),
            beam([0, 0, 0], [0.0, 0, 1]),
            beam([0, 0, -1], [0.0, 0, 1]),
        ]
    )
    h = model.predict(T, np.zeros(3), ("",) * 5)
    np.testing.assert_allclose(h[:, 0], [1.0, 2.0, 1.25, -1.0, 0.0], atol=1e-13)


@pytest.mark.parametrize("normal", [*np.eye(3), -np.eye(3)[2], np.array([0.6, 0, 0.8])])
def test_a_turned_plane(normal: Floats) -> None:
    plane = Plane("p", normal, -0.5)
    t_1, t_2 = plane.tangents
    frame = np.array([t_1, t_2, normal])
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
    turned, offset, _ = plane.turned(np.array([0.3, -0.4, 0.2]))
    expected = so3_exp(0.3 * t_1) @ so3_exp(-0.4 * t_2) @ normal
    np.testing.assert_allclose(turned, expected, atol=1e-12)
    assert offset == pytest.approx(-0.3)


def test_a_parallel_beam_has_no_finite_distance() -> None:
    model = PlaneDistance((FLOOR,))
    T = beam([0, 0, 0], [1.0, 0, 0])[None]
    T[0, 2, 2] = 0.0
    data = rows_of(RANGER, np.zeros((1, 1)))
    assert not np.isfinite(model.predict(T, np.zeros(3), ("",))).any()
    assert not np.isfinite(model.linearize(T, np.zeros(3), data).residual).any()
    # Nearly parallel ones are no start of a fit.
    F = np.array([beam([0, 0, 0], [0.0, 0, -1])] * 3)
    F[1] = beam([0, 0, 0], [1.0, 0, 5e-4])
    with refused(InputError, "'floor'", file="m.csv", line=3):
        model.register(F, rows_of(RANGER, np.ones((3, 1))), None, None)


# Registration.


def test_unknown_planes_are_registered_from_the_hits() -> None:
    true = PlaneDistance((FLOOR, WALL))
    F = beams(1)
    target = tuple(("wall", "floor")[i % 2] for i in range(len(F)))
    B, X = pin.exp6(np.full(6, 0.2)), pin.exp6(np.full(6, -0.1))
    T = B.homogeneous @ F @ X.homogeneous
    data = rows_of(RANGER, true.predict(T, np.zeros(6), target), "wall", "floor")
    unknown = PlaneDistance((Plane("wall"), Plane("floor")))
    found, base, tool = unknown.register(F, data, B, X)
    assert (base, tool) == (B, X)
    for plane, reference in zip(found.planes, (WALL, FLOOR), strict=True):
        assert plane.name == reference.name and plane.normal is not None
        sign = np.sign(plane.normal @ reference.normal)
        np.testing.assert_allclose(sign * plane.normal, reference.normal, atol=1e-12)
        assert sign * plane.offset == pytest.approx(reference.offset, abs=1e-12)
        assert plane.offset <= 0.0


# From a setup.


def test_planes_of_a_setup_are_normalized() -> None:
    planes = {
        "wall": PlaneSetup((0.0, 3.0, 4.0), -10.0, estimate=False),
        "floor": PlaneSetup((0.0, 0.0, 1.0), 1.0),
    }
    model = measurement_model("plane-distance", Setup(planes=planes), ["floor"])
    assert isinstance(model, PlaneDistance)
    wall, floor = model.planes
    assert (wall.name, wall.offset, wall.estimate) == ("wall", -2.0, False)
    np.testing.assert_allclose(wall.normal, [0.0, 0.6, 0.8])
    assert (floor.name, floor.estimate) == ("floor", True)
    names = [f"{plane}.plane.{c}" for plane in ("wall", "floor") for c in "uvf"]
    assert [p.name for p in model.parameters] == names
    assert [p.free for p in model.parameters] == 3 * [False] + 3 * [True]
    # Planes that rows name, where the setup has none.
    for targets, names in (((), ["plane"]), (("b", "a", "b"), ["b", "a"])):
        model = measurement_model("plane-distance", Setup(), targets)
        assert isinstance(model, PlaneDistance)
        assert [plane.name for plane in model.planes] == names
        assert all(p.normal is None and p.estimate for p in model.planes)


def test_what_cannot_be_a_plane() -> None:
    for normal in ((0.0, 0.0, 0.0), (np.nan, 0.0, 1.0), (np.inf, 0.0, 0.0)):
        with refused(OptionError, "normal'"):
            Setup(planes={"wall": PlaneSetup(normal, 1.0)})
    F = beams(3, 2)
    for target in ("wal", ""):
        data = rows_of(RANGER, np.ones((2, 1)), target)
        with refused(InputError, column="target"):
            PlaneDistance((FLOOR, WALL)).register(F, data, None, None)
    found, base, tool = PlaneDistance((WALL,)).register(
        F, rows_of(RANGER, np.ones((2, 1))), None, None
    )
    assert found.planes == (WALL,)
    assert base == tool == pin.SE3.Identity()


def test_a_ranger_measures_in_the_window_of_its_setup() -> None:
    plane = {"floor": PlaneSetup((0.0, 0.0, 1.0), 1.0)}
    setup = Setup(planes=plane, ranger=RangerSetup((0.5, 2.0), np.radians(45.0)))
    narrow = measurement_model("plane-distance", setup, ())
    usual = measurement_model("plane-distance", Setup(planes=plane), ())
    # The floor is z = -1; distances are 1, 0.4, 2.5, 1.35, 1.56 and -1 m.
    T = np.array(
        [
            beam([0, 0, 0], [0, 0, -1.0]),
            beam([0, 0, -0.6], [0, 0, -1.0]),
            beam([0, 0, 1.5], [0, 0, -1.0]),
            *(
                beam([0, 0, 0], [np.sin(angle), 0, -np.cos(angle)])
                for angle in np.radians([42.0, 50.0])
            ),
            beam([0, 0, 0], [0, 0, 1.0]),
        ]
    )
    seen = [model.observable(T, np.zeros(3), [""] * 6) for model in (narrow, usual)]
    assert seen[0].tolist() == [True, False, False, True, False, False]
    assert seen[1].tolist() == [True, True, True, True, True, False]


@pytest.mark.parametrize(("farthest", "reach"), [(1.9, 2.0), (3.0, 4.5)])
def test_rows_widen_the_window_where_they_reach_beyond_it(
    farthest: float, reach: float
) -> None:
    model = PlaneDistance((FLOOR,), near=0.5, reach=2.0)
    T = np.array([beam([0, 0, z], [0, 0, -1.0]) for z in (0.0, farthest - 1.0)])
    data = rows_of(RANGER, np.array([[1.0], [farthest]]))
    registered, _, _ = model.register(T, data, None, None)
    assert (registered.near, registered.reach) == (0.5, reach)


def test_rounding_does_not_choose_the_tangents() -> None:
    """Two components of the normal are zero: which is less is up to the processor."""
    plain, first, second = (
        replace(FLOOR, normal=np.array(normal)).tangents
        for normal in ((0.0, 0.0, 1.0), (0.0, 1e-17, 1.0), (1e-17, 0.0, 1.0))
    )
    np.testing.assert_allclose(first, plain, rtol=0, atol=1e-13)
    np.testing.assert_allclose(second, plain, rtol=0, atol=1e-13)
