"""Names of the frames that blocks share, and of what belongs to them."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from calib_pin.estimation.terms import frames_of_blocks
from calib_pin.io.urdf_tree import parse_robot
from calib_pin.kinematics.chains import Chains
from calib_pin.observations import BlockKey
from calib_pin.setup import (
    WORLD,
    ChainSetup,
    FrameSetup,
    Setup,
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
        # The same probe, mounted on one hand and then on the other.
        (
            [POINT._replace(chain=chain, tool="ball") for chain in ("", "right")],
            [(BASE, "ball.tool"), (BASE, "ball/end.tool")],
        ),
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
    found = frames_of_blocks(chains, keys, Setup())
    assert [(found[key].station, found[key].tool) for key in keys] == expected
