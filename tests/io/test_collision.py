"""Collision geometry from a URDF, an SRDF and obstacles; one line where one is bad."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.errors import InputError, RobotError
from calib_pin.io.collision import load_collisions
from calib_pin.io.urdf import load_chain, locate_robot
from calib_pin.kinematics.chain import Chain
from calib_pin.setup import Obstacle

# A tetrahedron with edges of 0.2 m, in the positive octant.
TETRAHEDRON = """v 0 0 0\nv 0.2 0 0\nv 0 0.2 0\nv 0 0 0.2
f 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"""
BALL = Obstacle(sphere=0.1, xyz=(0.0, 0.0, 0.5))


def urdf(*shapes: str, name: str = "arm") -> str:
    """Links in a row, 0.3 m apart along x and turning about z; an empty shape for none.

    Their names are link_0, link_1, ..., and joint_1 carries link_1.
    """
    lines = []
    for k, shape in enumerate(shapes):
        solid = f"<collision><geometry>{shape}</geometry></collision>" if shape else ""
        lines.append(f'<link name="link_{k}">{solid}</link>')
        if k:
            lines.append(
                f'<joint name="joint_{k}" type="revolute"><origin xyz="0.3 0 0"/>'
                f'<parent link="link_{k - 1}"/><child link="link_{k}"/>'
                '<axis xyz="0 0 1"/>'
                '<limit lower="-3" upper="3" effort="1" velocity="1"/></joint>'
            )
    return "\n".join([f'<robot name="{name}">', *lines, "</robot>"])


def sphere(radius: float) -> str:
    return f'<sphere radius="{radius}"/>'


def mesh(file: str) -> str:
    return f'<mesh filename="{file}"/>'


@pytest.fixture
def chain_in(tmp_path: Path) -> Callable[..., Chain]:
    """Chain of a URDF that stands at a path in the temporary folder."""

    def make(text: str, path: str = "ws/src/arm/urdf/arm.urdf") -> Chain:
        file = tmp_path / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
        return load_chain(file)

    return make


@pytest.fixture
def file_of(tmp_path: Path) -> Callable[..., Path]:
    def make(path: str, text: str = TETRAHEDRON) -> Path:
        file = tmp_path / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
        return file

    return make


def test_no_collision_geometry(chain_in: Callable[..., Chain]) -> None:
    notices: list[str] = []
    chain = chain_in(urdf("", "", ""))
    assert load_collisions(chain, notice=notices.append) is None
    assert load_collisions(chain, [BALL], notice=notices.append) is None
    assert notices == [
        "the robot has no collision geometry: self-collision is not checked",
        "the robot has no collision geometry: self-collision is not checked, and "
        "neither are collisions with the obstacles",
    ]


def test_nothing_that_could_collide(chain_in: Callable[..., Chain]) -> None:
    notices: list[str] = []
    chain = chain_in(urdf("", sphere(0.1)))
    collisions = load_collisions(chain, notice=notices.append)
    assert collisions is not None
    assert collisions.free(np.zeros((2, 1))).all()
    assert len(notices) == 1
    assert notices[0].endswith("no collision is checked")


def test_links_joined_by_a_joint_are_not_checked(
    chain_in: Callable[..., Chain],
) -> None:
    notices: list[str] = []
    chain = chain_in(urdf(*[sphere(0.16)] * 4))
    collisions = load_collisions(chain, notice=notices.append)
    assert collisions is not None
    assert sorted(collisions.pairs) == [
        ("link_0", "link_2"),
        ("link_0", "link_3"),
        ("link_1", "link_3"),
    ]
    assert notices == []


def test_links_that_always_touch_are_not_checked(
    chain_in: Callable[..., Chain],
) -> None:
    notices: list[str] = []
    # Links two joints apart are at most 0.6 m away from each other.
    chain = chain_in(urdf(*[sphere(0.31)] * 6))
    collisions = load_collisions(chain, notice=notices.append)
    assert collisions is not None
    assert ("link_0", "link_3") in collisions.pairs
    assert ("link_1", "link_3") not in collisions.pairs
    assert notices == [
        "links that touch at nearly every configuration are not checked against each "
        "other: 4 pairs (link_0 and link_2; link_1 and link_3; link_2 and link_4; ...)"
    ]


@pytest.mark.parametrize("with_srdf", [False, True])
def test_links_that_are_always_close_are_kept_from_touching(
    chain_in: Callable[..., Chain], file_of: Callable[..., Path], with_srdf: bool
) -> None:
    # Links two joints apart are at most 0.6 m away from each other.
    chain = chain_in(urdf(*[sphere(0.1)] * 6))
    neighbors = "".join(
        f'<disable_collisions link1="link_{k}" link2="link_{k + 1}"/>' for k in range(5)
    )
    file = file_of("arm.srdf", f'<robot name="arm">{neighbors}</robot>')
    notices: list[str] = []
    collisions, bare = (
        load_collisions(
            chain,
            srdf=file if with_srdf else None,
            clearance=clearance,
            notice=notices.append,
        )
        for clearance in (0.41, 0.0)
    )
    assert collisions is not None
    assert bare is not None
    assert sorted(collisions.pairs) == sorted(bare.pairs)
    kept = dict(zip(collisions.pairs, collisions.clearances, strict=True))
    assert {pair for pair, distance in kept.items() if distance == 0.0} == {
        ("link_0", "link_2"),
        ("link_1", "link_3"),
        ("link_2", "link_4"),
        ("link_3", "link_5"),
    }
    assert kept["link_0", "link_3"] == 0.41
    assert notices == [
        "links that are always closer than the clearance are only kept from touching: "
        "4 pairs (link_0 and link_2; link_1 and link_3; link_2 and link_4; ...)"
    ]
    # A straight arm is closer everywhere, a folded one touches.
    straight, folded = np.zeros(5), np.array([2.9, 0.0, 0.0, 0.0, 0.0])
    of_pair = collisions.contacts(np.array([straight, folded])).T
    met = [
        of_pair[k] for k, p in enumerate(collisions.pairs) if p == ("link_0", "link_2")
    ]
    assert np.any(met, axis=0).tolist() == [False, True]


def test_obstacles_that_are_always_close_keep_the_clearance(
    chain_in: Callable[..., Chain],
) -> None:
    notices: list[str] = []
    table = Obstacle(box=(9.0, 9.0, 0.1), xyz=(0.0, 0.0, -0.2))
    chain = chain_in(urdf("", sphere(0.1)))
    for clearance, free in ((0.04, True), (0.06, False)):
        collisions = load_collisions(
            chain, [table], clearance=clearance, notice=notices.append
        )
        assert collisions is not None
        assert collisions.free(np.zeros((1, 1))).tolist() == [free]
    assert notices == []


def test_obstacles_that_always_touch_are_checked(
    chain_in: Callable[..., Chain],
) -> None:
    notices: list[str] = []
    around = Obstacle(box=(9.0, 9.0, 9.0))
    chain = chain_in(urdf("", sphere(0.1)))
    collisions = load_collisions(chain, [around], notice=notices.append)
    assert collisions is not None
    assert collisions.pairs == (("link_1", "obstacle 1 (box)"),)
    assert not collisions.free(np.zeros((1, 1))).any()
    assert notices == []


@pytest.mark.parametrize(
    ("written", "stored"),
    [
        ("package://arm/meshes/a.obj", "ws/src/arm/meshes/a.obj"),
        ("package://other/a.obj", "ws/src/other/a.obj"),
        ("package://far/a.obj", "elsewhere/far/a.obj"),
        ("package://far/a.obj", "ros/far/a.obj"),
        ("package://far/a.obj", "ament/share/far/a.obj"),
        ("../meshes/a.obj", "ws/src/arm/meshes/a.obj"),
        ("a.obj", "ws/src/arm/urdf/a.obj"),
    ],
)
@pytest.mark.parametrize("given", ["parent", "package"])
def test_meshes_are_found(
    chain_in: Callable[..., Chain],
    file_of: Callable[..., Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    written: str,
    stored: str,
    given: str,
) -> None:
    file_of(stored)
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"/nowhere:{tmp_path / 'ros'}")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "ament"))
    folder = tmp_path / "elsewhere"
    folders = [folder if given == "parent" else folder / "far"]
    chain = chain_in(urdf("", mesh(written)))
    collisions = load_collisions(chain, [BALL], package_dirs=folders)
    assert collisions is not None
    assert len(collisions.pairs) == 1


def test_absolute_meshes_are_found(
    chain_in: Callable[..., Chain], file_of: Callable[..., Path]
) -> None:
    file = file_of("a.obj")
    for written in (str(file), f"file://{file}"):
        chain = chain_in(urdf("", mesh(written)))
        assert load_collisions(chain, [BALL]) is not None


@pytest.mark.parametrize(
    ("written", "hint"),
    [
        ("package://far/a.obj", "--package-dir DIR, the folder of its package"),
        ("meshes/a.obj", "a path from the folder of the URDF"),
        ("http://x/a.obj", "a path from the folder of the URDF"),
    ],
)
def test_missing_meshes(
    chain_in: Callable[..., Chain],
    refused: Callable[..., Any],
    written: str,
    hint: str,
    capfd: pytest.CaptureFixture,
) -> None:
    chain = chain_in(urdf(sphere(0.1), mesh(written)))
    with refused(
        RobotError,
        file=chain.robot.file,
        line=3,
        reason=("'link_1'", f"'{written}' does not exist"),
        allowed=(hint, "--ignore-collisions"),
    ):
        load_collisions(chain)
    assert capfd.readouterr() == ("", "")


def test_a_prefix_that_nobody_declares(
    chain_in: Callable[..., Chain], refused: Callable[..., Any]
) -> None:
    """Pinocchio reads it, the parser of its shapes does not."""
    text = urdf(sphere(0.1), sphere(0.1))
    chain = chain_in(text.replace("</robot>", "<a:b/></robot>"))
    reason = "its collision geometry cannot be read: unbound prefix"
    with refused(RobotError, file=chain.robot.file, reason=reason):
        load_collisions(chain)


def test_meshes_that_cannot_be_read(
    chain_in: Callable[..., Chain],
    file_of: Callable[..., Path],
    refused: Callable[..., Any],
    capfd: pytest.CaptureFixture,
) -> None:
    file = file_of("ws/src/arm/urdf/a.stl", "no mesh")
    chain = chain_in(urdf(sphere(0.1), mesh("a.stl")))
    with refused(
        RobotError,
        file=chain.robot.file,
        line=3,
        reason=("'link_1'", "cannot be read"),
        allowed=("another mesh", "--ignore-collisions"),
    ):
        load_collisions(chain)
    obstacle = Obstacle(mesh=str(file), scale=(1.0, 1.0, 1.0))
    with refused(
        InputError, file="s.yaml", reason=(f"'{file}' of obstacle 2", "cannot be read")
    ):
        load_collisions(
            chain_in(urdf("", sphere(0.1))), [BALL, obstacle], file="s.yaml"
        )
    assert capfd.readouterr() == ("", "")


def test_numbers_of_meshes(
    chain_in: Callable[..., Chain],
    file_of: Callable[..., Path],
    refused: Callable[..., Any],
) -> None:
    """Of which no solid can be built."""
    file_of("ws/src/arm/urdf/a.obj")
    file_of("ws/src/arm/urdf/nan.obj", TETRAHEDRON.replace("0.2", "nan"))
    for name, scale, reason in (
        ("a.obj", "1e308 1 1", "'a.obj' has the vertex (2e+307 0 0)"),
        ("nan.obj", "1 1 1", "'nan.obj' has the vertex (nan nan nan)"),
    ):
        shape = f'<mesh filename="{name}" scale="{scale}"/>'
        chain = chain_in(urdf(sphere(0.1), shape))
        with refused(RobotError, file=chain.robot.file, line=3, reason=reason):
            load_collisions(chain)


def test_meshes_stand_where_their_links_do(
    chain_in: Callable[..., Chain], file_of: Callable[..., Path]
) -> None:
    """Each in the place of its own, among other solids of its link."""
    file_of("ws/src/arm/urdf/a.obj")
    first = f"{sphere(0.01)}</geometry></collision><collision><origin xyz='0 0 1'/>"
    chain = chain_in(urdf("", f"{first}<geometry>{mesh('a.obj')}"))
    for z, free in ((0.5, True), (1.1, False)):
        ball = Obstacle(sphere=0.1, xyz=(0.3, 0.0, z))
        collisions = load_collisions(chain, [ball])
        assert collisions is not None
        assert collisions.free(np.zeros((1, 1))).tolist() == [free]


def test_missing_meshes_of_obstacles(
    chain_in: Callable[..., Chain], refused: Callable[..., Any]
) -> None:
    chain = chain_in(urdf("", sphere(0.1)))
    obstacle = Obstacle(mesh="/no/such/table.stl", scale=(1.0, 1.0, 1.0))
    reason = "'/no/such/table.stl' of obstacle 1 does not exist"
    with refused(InputError, file="setup.yaml", reason=reason):
        load_collisions(chain, [obstacle], file="setup.yaml")


def test_mesh_obstacles(
    chain_in: Callable[..., Chain], file_of: Callable[..., Path]
) -> None:
    chain = chain_in(urdf("", sphere(0.1)))
    file = str(file_of("table.obj"))
    # The ball's middle is at x = 0.3; the corner of the mesh comes near it.
    for x, free in ((0.29, False), (0.39, False), (0.42, True)):
        obstacle = Obstacle(mesh=file, scale=(1.0, 1.0, 1.0), xyz=(x, 0.0, 0.0))
        collisions = load_collisions(chain, [obstacle])
        assert collisions is not None
        assert collisions.free(np.zeros((1, 1))).tolist() == [free]
    far = Obstacle(
        mesh=file, scale=(10.0, 1.0, 1.0), xyz=(2.4, 0.0, 0.0), rpy=(0.0, 0.0, np.pi)
    )
    collisions = load_collisions(chain, [far])
    assert collisions is not None
    assert not collisions.free(np.zeros((1, 1))).any()


@pytest.mark.parametrize(
    ("robot", "base", "tip", "srdf"),
    [
        ("panda", None, "panda_link8", "panda.srdf"),
        pytest.param(
            "talos_reduced",
            "torso_2_link",
            "gripper_left_base_link",
            "talos.srdf",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_an_srdf_disables_what_pinocchio_reads_in_it(
    robot: str, base: str | None, tip: str, srdf: str
) -> None:
    notices: list[str] = []
    chain = load_chain(f"example:{robot}", base=base, tip=tip)
    path = locate_robot(chain.robot.file).resolve()
    file = path.parents[1] / "srdf" / srdf
    everything = load_collisions(chain, [BALL])
    collisions = load_collisions(chain, [BALL], srdf=file, notice=notices.append)
    assert everything is not None
    assert collisions is not None
    model = chain.robot.model
    folders = [str(folder) for folder in path.parents]
    geometry = pin.buildGeomFromUrdf(
        model, str(path), pin.COLLISION, package_dirs=folders
    )
    geometry.addAllCollisionPairs()
    pin.removeCollisionPairs(model, geometry, str(file))
    names = [model.frames[s.parentFrame].name for s in geometry.geometryObjects]
    left = {
        frozenset((names[pair.first], names[pair.second]))
        for pair in geometry.collisionPairs
    }
    of_robot = {
        frozenset(pair) for pair in collisions.pairs if "obstacle" not in pair[1]
    }
    assert of_robot
    assert of_robot <= left
    # What is left and not checked does not move; the rest Pinocchio removed as well.
    moving = {frozenset(pair) for pair in everything.pairs}
    assert left & moving <= of_robot
    with_obstacle = {pair for pair in everything.pairs if "obstacle" in pair[1]}
    assert with_obstacle <= set(collisions.pairs)
    assert notices == []


def test_with_an_srdf_nothing_else_is_left_out(
    chain_in: Callable[..., Chain], file_of: Callable[..., Path]
) -> None:
    notices: list[str] = []
    srdf = file_of(
        "arm.srdf",
        '<robot name="arm"><disable_collisions link1="link_2" link2="link_1"/>'
        '<disable_collisions link1="link_7" link2="link_8" reason="Never"/></robot>',
    )
    chain = chain_in(urdf(*[sphere(0.31)] * 3))
    collisions = load_collisions(chain, srdf=srdf, notice=notices.append)
    assert collisions is not None
    assert sorted(collisions.pairs) == [("link_0", "link_1"), ("link_0", "link_2")]
    assert notices == []


def test_an_srdf_of_moveit_2(
    chain_in: Callable[..., Chain], file_of: Callable[..., Path]
) -> None:
    srdf = file_of(
        "arm.srdf",
        '<robot name="arm"><disable_default_collisions link="link_0"/>'
        '<enable_collisions link1="link_3" link2="link_0"/></robot>',
    )
    chain = chain_in(urdf(*[sphere(0.1)] * 4))
    collisions = load_collisions(chain, srdf=srdf)
    assert collisions is not None
    assert sorted(collisions.pairs) == [
        ("link_0", "link_3"),
        ("link_1", "link_2"),
        ("link_1", "link_3"),
        ("link_2", "link_3"),
    ]


@pytest.mark.parametrize(
    ("text", "fields"),
    [
        ("group: arm", dict(line=1, reason="not an SRDF")),
        ("<robot name='arm'>\n<group>", dict(line=2, reason="not an SRDF")),
        ("<launch/>", dict(reason="not an SRDF but <launch>")),
        (urdf("", ""), dict(reason="not an SRDF but a URDF")),
        (
            '<robot name="leg"/>',
            dict(value="leg", reason="another robot", allowed="arm"),
        ),
    ],
)
def test_what_is_not_the_srdf_of_the_robot(
    chain_in: Callable[..., Chain],
    file_of: Callable[..., Path],
    refused: Callable[..., Any],
    text: str,
    fields: dict[str, Any],
) -> None:
    chain = chain_in(urdf("", sphere(0.1)))
    srdf = file_of("a.srdf", text)
    with refused(InputError, file=str(srdf), **fields):
        load_collisions(chain, [BALL], srdf=srdf)
    with refused(InputError, reason="no such file"):
        load_collisions(chain, srdf=srdf.with_name("missing.srdf"))


def test_the_same_pairs_in_the_same_order_every_time() -> None:
    chain = load_chain("example:ur10_robot", tip="tool0")
    first, second = (load_collisions(chain, [BALL]) for _ in range(2))
    assert first is not None
    assert second is not None
    assert first.pairs == second.pairs
