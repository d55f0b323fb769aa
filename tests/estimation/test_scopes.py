"""Names of the frames that blocks share, and of what belongs to them."""

from __future__ import annotations

from collections.abc import Callable

import pinocchio as pin
import pytest

from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.scopes import scopes
from calib_pin.io.urdf_tree import parse_robot
from calib_pin.kinematics.chains import Chains
from calib_pin.observations import BlockKey
from calib_pin.setup import (
    WORLD,
    CameraSetup,
    ChainSetup,
    FrameSetup,
    PointSetup,
    Setup,
    ToolSetup,
)

POINT, CAMERA, TOUCH = map(BlockKey, ("position", "camera", "fixed-point"))
STATED = FrameSetup((1.0, 2.0, 3.0))


@pytest.fixture(scope="module")
def tree(urdf_of: Callable[..., str]) -> Callable[..., Chains]:
    """Chains of a trunk with two limbs: `tree("", "right")`."""
    joints = [("trunk", "root", "chest"), ("l", "chest", "left"), ("r", "chest", "end")]
    text = urdf_of(*({"name": n, "parent": p, "child": c} for n, p, c in joints))
    robot = parse_robot(text.encode(), "tree.urdf")
    stated = {
        "right": ChainSetup(tip="end"),
        "touch": ChainSetup(base="left", tip="end"),
    }

    def make(*names: str) -> Chains:
        return Chains(robot, None, "left", stated, names)

    return make


def names(chains: Chains, *keys: BlockKey) -> list[tuple[str, str]]:
    found = scopes(chains, keys, Setup())
    return [(found[key].station, found[key].tool) for key in keys]


BASE, TOOL = "base.frame", "tool.frame"


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ([POINT], [(BASE, TOOL)]),
        # A name alone tells nothing apart.
        ([POINT._replace(station="one", tool="ball")], [(BASE, TOOL)]),
        (
            [POINT._replace(station="one"), POINT._replace(station="two", tool="ball")],
            [("one.station", TOOL), ("two.station", "ball.tool")],
        ),
        # What stands still has the station of what moves.
        (
            [POINT, POINT._replace(chain=WORLD)],
            [(BASE, TOOL), (BASE, "root.tool")],
        ),
        # A tool of each limb; the base is one link.
        ([POINT, POINT._replace(chain="right")], [(BASE, TOOL), (BASE, "end.tool")]),
        # A hand that is touched is a place of its own.
        (
            [POINT, TOUCH._replace(chain="touch")],
            [(BASE, TOOL), ("left.station", "end.tool")],
        ),
        # A camera among others follows nothing that these do.
        ([POINT, CAMERA], [(BASE, TOOL), ("camera.station", "camera.tool")]),
        (
            [POINT, CAMERA._replace(tool="ball")],
            [(BASE, TOOL), ("camera.station", "ball.tool")],
        ),
        ([CAMERA], [(BASE, TOOL)]),
        ([POINT, TOUCH], [(BASE, TOOL), (BASE, TOOL)]),
    ],
)
def test_names_of_frames(
    keys: list[BlockKey],
    expected: list[tuple[str, str]],
    tree: Callable[..., Chains],
) -> None:
    chains = tree(*dict.fromkeys(key.chain for key in keys))
    assert names(chains, *keys) == expected


def test_a_name_on_two_links_is_two_frames(tree: Callable[..., Chains]) -> None:
    """The same probe, mounted on one hand and then on the other."""
    keys = [POINT._replace(chain=chain, tool="ball") for chain in ("", "right")]
    found = names(tree("", "right"), *keys)
    assert [tool for _, tool in found] == ["ball.tool", "ball/end.tool"]


def test_what_is_stated_of_frames(tree: Callable[..., Chains]) -> None:
    on = ToolSetup((0.0, 0.0, 0.1), (0.3, 0.0, 0.0), on="ball")
    further = ToolSetup((0.0, 0.2, 0.0), on="pin")
    ball = ToolSetup((0.1, 0.0, 0.0), None, False)
    setup = Setup(
        base_frame=STATED,
        stations={"two": FrameSetup((4.0, 5.0, 6.0))},
        tools={"ball": ball, "pin": on, "tip": further},
    )
    keys = [
        POINT._replace(station="one", tool="tip"),
        POINT._replace(station="two", tool="ball"),
        POINT._replace(tool="pin"),
    ]
    first, second, third = scopes(tree(""), keys, setup).values()
    # What the setup says of the frame without a name is not of one that has a name.
    assert (first.base, third.base) == (FrameSetup(), STATED)
    assert second.base.xyz == (4.0, 5.0, 6.0)
    assert {s.tool for s in (first, second, third)} == {"ball.tool"}
    assert all(s.end is ball for s in (first, second, third))
    assert second.offset == pin.SE3.Identity()
    turned = pin.SE3(pin.rpy.rpyToMatrix(0.3, 0.0, 0.0), pin.SE3.Identity().translation)
    turned.translation[2] = 0.1
    assert third.offset.isApprox(turned, 1e-15)
    shifted = pin.SE3.Identity()
    shifted.translation[1] = 0.2
    assert first.offset.isApprox(turned * shifted, 1e-15)


def test_objects_belong_to_their_place(tree: Callable[..., Chains]) -> None:
    """A point is another one on another tool, a socket before another station."""
    setup = Setup(
        targets={"a": PointSetup((0.1, 0.0, 0.0)), "b": PointSetup((0.2, 0.0, 0.0))},
        sockets={"s": PointSetup((0.3, 0.0, 0.0))},
        camera=CameraSetup("world", (900.0, 910.0), (640.0, 500.0)),
    )
    measured = {
        POINT._replace(tool="x"): ("a", "b"),
        POINT._replace(tool="y", station="one"): ("a",),
        TOUCH._replace(tool="x", station="one"): ("b@s",),
        TOUCH._replace(tool="x", station="two"): ("b@s",),
    }
    found = nominal_problem(tree(""), measured, setup).references
    assert set(found) == {
        ("targets", "x/a"),
        ("targets", "x/b"),
        ("targets", "y/a"),
        ("sockets", "one/s"),
        ("sockets", "two/s"),
    }
