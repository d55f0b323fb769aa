"""Collision geometry from a URDF, an SRDF and obstacles; one line where one is bad."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calib_pin.errors import InputError, RobotError
from calib_pin.io.collision import load_collisions
from calib_pin.io.urdf import load_chain
from calib_pin.setup import Obstacle
from tests.shared import TETRAHEDRON, joint, refused, urdf_of

BALL = Obstacle(sphere=0.1, xyz=(0.0, 0.0, 0.5))


def urdf(*shapes: str, name: str = "arm") -> str:
    """Links in a row, 0.3 m apart along x and turning about z; an empty shape for none.

    Their names are link_0, link_1, ..., and joint_1 carries link_1.
    """
    solid = "<collision><geometry>{}</geometry></collision>"
    first, *others = (solid.format(shape) if shape else "" for shape in shapes)
    joints = (
        joint(f"joint_{k}", f"link_{k - 1} link_{k}", "0.3 0 0", inside=other)
        for k, other in enumerate(others, start=1)
    )
    return urdf_of(*joints, name=name, inside=first)


def sphere(radius: float) -> str:
    return f'<sphere radius="{radius}"/>'


def mesh(file: str) -> str:
    return f'<mesh filename="{file}"/>'


@pytest.fixture
def loaded(write: Callable[..., Path]) -> Callable[..., Any]:
    """Collisions of a robot of some shapes, and the notices: `loaded([...], ...)`.

    The URDF stands at a path in the temporary folder.
    """

    def load(shapes: Sequence[str], *about: Any, **more: Any) -> Any:
        chain = load_chain(write(urdf(*shapes), "ws/src/arm/urdf/arm.urdf"))
        notices: list[str] = []
        found = load_collisions(chain, *about, notice=notices.append, **more)
        return found, notices

    return load


def test_robots_without_solids(loaded: Callable[..., Any]) -> None:
    for obstacles in ([], [BALL]):
        collisions, notices = loaded(["", "", ""], obstacles)
        assert collisions is None and len(notices) == 1
    collisions, notices = loaded(["", sphere(0.1)])
    assert collisions.free(np.zeros((2, 1))).all() and len(notices) == 1


def test_links_joined_by_a_joint_are_not_checked(loaded: Callable[..., Any]) -> None:
    collisions, notices = loaded([sphere(0.16)] * 4)
    assert sorted(collisions.pairs) == [
        ("link_0", "link_2"),
        ("link_0", "link_3"),
        ("link_1", "link_3"),
    ]
    assert notices == []


@pytest.mark.parametrize("with_srdf", [False, True])
def test_links_that_are_always_close_are_kept_from_touching(loaded, write, with_srdf):
    neighbors = "".join(
        f'<disable_collisions link1="link_{k}" link2="link_{k + 1}"/>' for k in range(5)
    )
    file = write(f'<robot name="arm">{neighbors}</robot>', "arm.srdf")
    srdf = file if with_srdf else None
    # Links two joints apart are at most 0.6 m away from each other.
    shapes = [sphere(0.1)] * 6
    collisions, (notice,) = loaded(shapes, srdf=srdf, clearance=0.41)
    bare, nothing = loaded(shapes, srdf=srdf, clearance=0.0)
    assert sorted(collisions.pairs) == sorted(bare.pairs) and nothing == []
    kept = dict(zip(collisions.pairs, collisions.clearances, strict=True))
    assert {pair for pair, distance in kept.items() if distance == 0.0} == {
        (f"link_{k}", f"link_{k + 2}") for k in range(4)
    }
    assert kept["link_0", "link_3"] == 0.41
    assert "link_0 and link_2, link_1 and link_3, " in notice
    # A straight arm is closer everywhere, a folded one touches.
    straight, folded = np.zeros(5), np.array([2.9, 0.0, 0.0, 0.0, 0.0])
    of_pair = collisions.contacts(np.array([straight, folded])).T
    pairs = zip(collisions.pairs, of_pair, strict=True)
    met = [touching for pair, touching in pairs if pair == ("link_0", "link_2")]
    assert np.any(met, axis=0).tolist() == [False, True]


def test_obstacles_that_are_always_close_or_touch_are_checked(loaded):
    table = Obstacle(box=(9.0, 9.0, 0.1), xyz=(0.0, 0.0, -0.2))
    around = Obstacle(box=(9.0, 9.0, 9.0))
    for obstacle, clearance, free in (
        (table, 0.04, True),
        (table, 0.06, False),
        (around, 0.0, False),
    ):
        collisions, notices = loaded(["", sphere(0.1)], [obstacle], clearance=clearance)
        assert collisions.pairs == (("link_1", "obstacle 1 (box)"),)
        assert collisions.free(np.zeros((1, 1))).tolist() == [free]
        assert notices == []


@pytest.mark.parametrize(
    ("written", "stored", "folder"),
    [
        ("package://far/a.obj", "elsewhere/far/a.obj", "elsewhere/far"),
        ("package://far/a.obj", "ros/far/a.obj", "elsewhere"),
        ("package://far/a.obj", "ament/share/far/a.obj", "elsewhere/far"),
        ("../meshes/a.obj", "ws/src/arm/meshes/a.obj", "."),
        ("file://{}/ros/a.obj", "ros/a.obj", "."),
    ],
)
def test_meshes_are_found(
    loaded, write, tmp_path, monkeypatch, written, stored, folder
):
    write(TETRAHEDRON, stored)
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"/nowhere:{tmp_path / 'ros'}")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "ament"))
    shapes = ["", mesh(written.format(tmp_path))]
    collisions, _ = loaded(shapes, [BALL], package_dirs=[tmp_path / folder])
    assert len(collisions.pairs) == 1


def test_meshes_that_cannot_be_used(loaded, write, tmp_path, capfd):
    """Missing, no mesh, or with numbers of which no solid can be built."""
    bad = write("no mesh", "ws/src/arm/urdf/a.stl")
    write(TETRAHEDRON, "ws/src/arm/urdf/a.obj")
    write(TETRAHEDRON.replace("0.2", "nan"), "ws/src/arm/urdf/nan.obj")
    shapes = [mesh(f) for f in ("package://far/a.obj", "b.obj", "a.stl", "nan.obj")]
    shapes.append('<mesh filename="a.obj" scale="1e308 1 1"/>')
    file = str(tmp_path / "ws/src/arm/urdf/arm.urdf")
    for shape in shapes:
        with refused(RobotError, file=file, line=3):
            loaded([sphere(0.1), shape])
    for name in ("/no/such/table.stl", str(bad)):
        obstacle = Obstacle(mesh=name, scale=(1.0, 1.0, 1.0))
        with refused(InputError, file="s.yaml", reason=f"'{name}' of obstacle 2"):
            loaded(["", sphere(0.1)], [BALL, obstacle], file="s.yaml")
    assert capfd.readouterr() == ("", "")


def test_what_to_do_without_a_package_is_not_cut_off(loaded):
    """However long its names are: most URDFs come without their packages."""
    name = "package://robots_of_our_company/meshes/arm_with_six_joints/collision/a.obj"
    with pytest.raises(RobotError, match=r"--package-dir.*plan --ignore-collisions$"):
        loaded([sphere(0.1), mesh(name)])


def test_meshes_stand_where_they_belong(loaded, write):
    """Those of links in the place of their own, and those of obstacles."""
    write(TETRAHEDRON, "ws/src/arm/urdf/a.obj")
    first = f"{sphere(0.01)}</geometry></collision><collision><origin xyz='0 0 1'/>"
    for z, free in ((0.5, True), (1.1, False)):
        ball = Obstacle(sphere=0.1, xyz=(0.3, 0.0, z))
        collisions, _ = loaded(["", f"{first}<geometry>{mesh('a.obj')}"], [ball])
        assert collisions.free(np.zeros((1, 1))).tolist() == [free]
    file = str(write(TETRAHEDRON, "table.obj"))
    # The ball's middle is at x = 0.3; the corner of the mesh comes near it.
    obstacles = [
        (Obstacle(mesh=file, scale=(1.0, 1.0, 1.0), xyz=(x, 0.0, 0.0)), free)
        for x, free in ((0.39, False), (0.42, True))
    ]
    turned = {"xyz": (2.4, 0.0, 0.0), "rpy": (0.0, 0.0, np.pi)}
    obstacles.append((Obstacle(mesh=file, scale=(10.0, 1.0, 1.0), **turned), False))
    for obstacle, free in obstacles:
        collisions, _ = loaded(["", sphere(0.1)], [obstacle])
        assert collisions.free(np.zeros((1, 1))).tolist() == [free]


def test_with_an_srdf_nothing_else_is_left_out(loaded, write):
    disabled = (
        '<disable_collisions link1="link_2" link2="link_1"/>'
        '<disable_collisions link1="link_7" link2="link_8" reason="Never"/>'
    )
    srdf = write(f'<robot name="arm">{disabled}</robot>', "arm.srdf")
    collisions, notices = loaded([sphere(0.31)] * 3, srdf=srdf)
    assert sorted(collisions.pairs) == [("link_0", "link_1"), ("link_0", "link_2")]
    assert notices == []
    # MoveIt 2 has more.
    later = (
        '<disable_default_collisions link="link_0"/>'
        '<enable_collisions link1="link_3" link2="link_0"/>'
    )
    srdf = write(f'<robot name="arm">{later}</robot>', "arm.srdf")
    collisions, _ = loaded([sphere(0.1)] * 4, srdf=srdf)
    assert sorted(collisions.pairs) == [
        ("link_0", "link_3"),
        ("link_1", "link_2"),
        ("link_1", "link_3"),
        ("link_2", "link_3"),
    ]


@pytest.mark.parametrize(
    ("text", "fields"),
    [
        ("group: arm", {}),
        ("<robot name='arm'>\n<group>", {"line": 2}),
        (urdf("", ""), {}),
        ('<robot name="leg"/>', {"value": "leg"}),
        (None, {}),
    ],
)
def test_what_is_not_the_srdf_of_the_robot(loaded, write, tmp_path, text, fields):
    srdf = tmp_path / "missing.srdf" if text is None else write(text, "a.srdf")
    with refused(InputError, file=str(srdf), **fields):
        loaded(["", sphere(0.1)], [BALL], srdf=srdf)
