"""Instruments and targets that are drawn around a robot stand where they were found."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import calib_pin
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
from tests.shared import simulated

BASE = FrameSetup((0.3, -0.2, 0.1), (0.1, 0.2, 0.7))
TOOL = FrameSetup((0.01, 0.02, 0.1), (0.0, 0.3, 0.0))

BOARD = {f"m{k}": PointSetup((0.04 * (k % 4), 0.03 * (k // 4), 0.0)) for k in range(12)}


@pytest.fixture
def around() -> Callable[..., dict[str, Thing]]:
    """Things by kind and name: `around(model, touched points, **setup)`."""

    def make(model: str, near: Any = None, **settings: Any) -> dict[str, Thing]:
        setup = Setup(base_frame=BASE, tool_frame=TOOL, **settings)
        problem, _ = simulated(model, setup, 6)
        rows = problem.data
        points = np.zeros((len(rows), 3)) if near is None else np.asarray(near)
        found = surroundings(problem.terms, touched_by(rows, points), 1.2)
        return {f"{thing.kind} {thing.name}": thing for thing in found}

    return make


def posed(frame: FrameSetup) -> pin.SE3:
    assert frame.xyz is not None and frame.rpy is not None
    return pin.SE3(pin.rpy.rpyToMatrix(*frame.rpy), np.array(frame.xyz))


def in_base(xyz: tuple[float, ...]) -> np.ndarray:
    """A point of the measurement frame in the base link."""
    return np.asarray(posed(BASE).inverse().act(np.array(xyz)))


def corners(shapes: tuple[Shape, ...]) -> np.ndarray:
    parts = [(s.surface.vertices, s.placement) for s in shapes]
    return np.concatenate([xyz @ T[:3, :3].T + T[:3, 3] for xyz, T in parts])


def test_sites_stand_in_the_base_link(around):
    ((name, frame),) = around("position").items()
    assert (name, frame.link) == ("station base.frame", "base_link")
    np.testing.assert_allclose(frame.origin, in_base((0.0, 0.0, 0.0)), atol=1e-12)
    xyz = (0.4, 0.3, 0.2)
    found = around("fixed-point", sockets={"a": PointSetup(xyz)})
    highest = corners(found["socket a"].shapes).max(axis=0)
    np.testing.assert_allclose(highest, in_base(xyz), atol=0.04)
    found = around("sphere-contact", spheres={"b": SphereSetup(xyz, 0.05)})
    ball = np.linalg.norm(corners(found["sphere b"].shapes) - in_base(xyz), axis=1)
    np.testing.assert_allclose(ball, 0.05, atol=1e-9)
    found = around("point-distance", anchors={"c": AnchorSetup(xyz)})
    np.testing.assert_allclose(found["anchor c"].origin, in_base(xyz), atol=1e-12)


def test_a_plane_is_as_large_as_its_touched_points(around):
    normal = np.array([0.0, 0.6, 0.8])
    plane = PlaneSetup((0.0, 0.6, 0.8), -0.5)
    spread = np.random.default_rng(1).uniform(-0.4, 0.4, (6, 3))
    near = np.array([in_base(tuple(p - normal * (normal @ p - 0.5))) for p in spread])
    found = around("plane-contact", near, planes={"wall": plane})["plane wall"]
    patch = corners(found.shapes)
    back = posed(BASE)
    heights = [normal @ back.act(p) - 0.5 for p in patch]
    np.testing.assert_allclose(heights, 0.0, atol=1e-3)
    middle = patch.mean(axis=0)
    size = np.linalg.norm(patch - middle, axis=1).max()
    assert np.linalg.norm(near - middle, axis=1).max() < size
    assert size < 1.5 * np.linalg.norm(near - near.mean(0), axis=1).max() + 0.1


@pytest.mark.parametrize("mount", ["hand", "world"])
def test_camera_and_board(around, mount):
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
