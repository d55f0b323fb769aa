"""Instruments and targets that are drawn around a robot stand where they were found."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import calib_pin
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.kinematics.shapes import Shape
from calib_pin.report.surroundings import Thing, surroundings, touched_by
from calib_pin.setup import (
    AnchorSetup,
    CameraSetup,
    FrameSetup,
    PlaneSetup,
    PointSetup,
    Setup,
    SphereSetup,
)

BASE = FrameSetup((0.3, -0.2, 0.1), (0.1, 0.2, 0.7))
TOOL = FrameSetup((0.01, 0.02, 0.1), (0.0, 0.3, 0.0))

BOARD = {f"m{k}": PointSetup((0.04 * (k % 4), 0.03 * (k // 4), 0.0)) for k in range(12)}


@pytest.fixture
def around() -> Callable[..., dict[str, Thing]]:
    """Things by kind and name: `around(model, touched points, **setup)`."""

    def make(model: str, near: Any = None, **settings: Any) -> dict[str, Thing]:
        chain = calib_pin.load_chain("space6")
        setup = Setup(base_frame=BASE, tool_frame=TOOL, **settings)
        problem = nominal_problem(chain, model, setup)
        theta, rng = np.zeros(len(problem.parameters)), np.random.default_rng(0)
        rows = calib_pin.simulate(problem, theta, rng, count=6)
        points = np.zeros((len(rows), 3)) if near is None else np.asarray(near)
        found = surroundings(problem.parts, touched_by(rows, points), 1.2)
        return {f"{thing.kind} {thing.name}": thing for thing in found}

    return make


def posed(frame: FrameSetup) -> pin.SE3:
    assert frame.xyz is not None and frame.rpy is not None
    return pin.SE3(pin.rpy.rpyToMatrix(*frame.rpy), np.array(frame.xyz))


def in_base(xyz: tuple[float, ...]) -> np.ndarray:
    """A point of the measurement frame in the base link."""
    return np.asarray(posed(BASE).inverse().act(np.array(xyz)))


def corners(shapes: tuple[Shape, ...]) -> np.ndarray:
    return np.concatenate(
        [
            s.surface.vertices @ s.placement[:3, :3].T + s.placement[:3, 3]
            for s in shapes
        ]
    )


def test_a_tracker_is_a_frame(around: Callable[..., dict[str, Thing]]) -> None:
    ((name, frame),) = around("position").items()
    assert (name, frame.link) == ("station base.frame", "base_link")
    np.testing.assert_allclose(frame.origin, in_base((0.0, 0.0, 0.0)), atol=1e-12)
    # Three axes of 0.2 m from there.
    for k, axis in enumerate(frame.shapes[1:]):
        end = in_base(tuple(0.2 * np.eye(3)[k]))
        away = np.linalg.norm(corners((axis,)) - end, axis=1).min()
        assert away < 0.01


def test_sites_stand_in_the_base_link(
    around: Callable[..., dict[str, Thing]],
) -> None:
    xyz = (0.4, 0.3, 0.2)
    found = around("fixed-point", sockets={"a": PointSetup(xyz)})
    np.testing.assert_allclose(
        corners(found["socket a"].shapes).max(axis=0),
        in_base(xyz),
        atol=0.04,
    )
    found = around("sphere-contact", spheres={"b": SphereSetup(xyz, 0.05)})
    ball = corners(found["sphere b"].shapes)
    np.testing.assert_allclose(
        np.linalg.norm(ball - in_base(xyz), axis=1), 0.05, atol=1e-9
    )
    assert found["sphere b"].shapes[0].opacity < 1.0
    found = around("point-distance", anchors={"c": AnchorSetup(xyz)})
    np.testing.assert_allclose(found["anchor c"].origin, in_base(xyz), atol=1e-12)


def test_a_plane_is_as_large_as_its_touched_points(
    around: Callable[..., dict[str, Thing]],
) -> None:
    normal = np.array([0.0, 0.6, 0.8])
    plane = PlaneSetup((0.0, 0.6, 0.8), -0.5)
    spread = np.random.default_rng(1).uniform(-0.4, 0.4, (6, 3))
    near = np.array([in_base(tuple(p - normal * (normal @ p - 0.5))) for p in spread])
    found = around("plane-contact", near, planes={"wall": plane})["plane wall"]
    patch = corners(found.shapes)
    back = posed(BASE)
    heights = [normal @ back.act(p) - 0.5 for p in patch]
    np.testing.assert_allclose(heights, 0.0, atol=1e-3)
    middle, size = patch.mean(axis=0), np.linalg.norm(patch - patch.mean(0), axis=1)
    assert np.linalg.norm(near - middle, axis=1).max() < size.max()
    assert size.max() < 1.5 * np.linalg.norm(near - near.mean(0), axis=1).max() + 0.1


@pytest.mark.parametrize("mount", ["hand", "world"])
def test_camera_and_board(around: Callable[..., dict[str, Thing]], mount: str) -> None:
    camera = CameraSetup(mount, (900.0, 900.0), (640.0, 480.0))  # type: ignore[arg-type]
    found = around("camera", camera=camera, targets=BOARD)
    kinds = {name.partition(" ")[0]: thing for name, thing in found.items()}
    assert set(kinds) == {"camera", "board"}
    hand, other = ("camera", "board") if mount == "hand" else ("board", "camera")
    chain = calib_pin.load_chain("space6")
    assert (kinds[hand].link, kinds[other].link) == (chain.tip, chain.base)
    middle = np.array([0.06, 0.03, 0.0])
    if mount == "hand":
        np.testing.assert_allclose(kinds["board"].origin, in_base(tuple(middle)))
        place = posed(TOOL).translation
    else:
        np.testing.assert_allclose(kinds["board"].origin, posed(TOOL).act(middle))
        place = in_base((0.0, 0.0, 0.0))
    np.testing.assert_allclose(kinds["camera"].origin, place, atol=1e-12)
