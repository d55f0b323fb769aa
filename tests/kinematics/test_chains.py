"""Several chains of one tree: their names, their joints, mimic joints among them."""

from __future__ import annotations

import numpy as np
import pytest

from calib_pin.errors import RobotError
from calib_pin.io.urdf import load_chain, load_robot
from calib_pin.io.urdf_tree import parse_robot
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.robot import Robot
from calib_pin.kinematics.spatial import invert
from calib_pin.setup import WORLD, ChainSetup
from tests.shared import joint, refused, urdf_of

LEFT, RIGHT = "gripper_left_base_link", "gripper_right_base_link"


@pytest.fixture(scope="module")
def talos() -> Robot:
    return load_robot("example:talos_reduced")


@pytest.fixture
def hand() -> Robot:
    """A wrist that carries two fingers, both driven by a knob on another branch.

    The first finger slides; the second follows the first. Each behind its mimic joint
    has a joint of its own.
    """
    at = "0 0 0"
    by_knob = '<mimic joint="knob" multiplier="0.05" offset="0.02"/>'
    by_slide = '<mimic joint="slide" multiplier="-20" offset="0.3"/>'
    joints = (
        joint("wrist", "base palm", limits="-2 2"),
        joint("slide", "palm thumb", at, "0 1 0", "prismatic", "0 0.1", more=by_knob),
        joint("turn", "palm finger", at, "1 0 0", limits="-9 9", more=by_slide),
        joint("end", "finger nail", limits="-2 2"),
        joint("knob", "base dial", limits="-1 3"),
    )
    return parse_robot(urdf_of(*joints).encode(), "hand.urdf")


def test_a_single_chain() -> None:
    chain = load_chain("example:tiago_no_hand", tip="arm_7_link")
    chains = Chains.of(chain)
    assert chains[""] is chain
    assert Chains.of(chains) is chains
    assert (chains.names, chains.joints) == (("",), chain.joints)
    assert chains.columns("").tolist() == list(range(len(chain.joints)))
    for name in ("revolute", "lower", "upper"):
        np.testing.assert_array_equal(getattr(chains, name), getattr(chain, name))
    np.testing.assert_array_equal(
        chains.random_configurations(5, np.random.default_rng(2)),
        chain.random_configurations(5, np.random.default_rng(2)),
    )
    # The order is that of the chain, which here runs up the tree; nothing else moves.
    back = Chain(chain.robot, chain.tip, chain.base)
    assert Chains.of(back).named(("", WORLD)).joints == back.joints


def test_joints_of_several_chains(talos: Robot) -> None:
    names = (LEFT, "", "touch", WORLD, RIGHT, LEFT)
    stated = {"touch": ChainSetup(RIGHT, LEFT)}
    chains = Chains(talos, tip="head_2_link", setups=stated, names=names)
    assert chains.names == (LEFT, "", "touch", WORLD, RIGHT)
    places = [talos.model.getJointId(joint) for joint in chains.joints]
    assert places == sorted(set(places))
    used = {joint for name in chains.names for joint in chains[name].joints}
    assert set(chains.joints) == used
    q = chains.random_configurations(4, np.random.default_rng(0))
    for name in chains.names:
        part = np.array(chains.joints, str)[chains.columns(name)]
        assert tuple(part) == chains[name].joints
        np.testing.assert_array_equal(
            chains.lower[chains.columns(name)], chains[name].lower
        )
    left, right, touch = (
        chains[name].poses(q[:, chains.columns(name)])
        for name in (LEFT, RIGHT, "touch")
    )
    np.testing.assert_allclose(touch, invert(left) @ right, rtol=0, atol=1e-12)
    assert chains["touch"].base == LEFT


def test_the_base_of_chains(talos: Robot) -> None:
    stated = {"a": ChainSetup(LEFT), "b": ChainSetup(LEFT, "torso_1_link")}
    names = ("a", "b", RIGHT, WORLD)
    chains = Chains(talos, "torso_2_link", setups=stated, names=names)
    bases = [chains[name].base for name in names]
    assert bases == ["torso_2_link", "torso_1_link", "torso_2_link", "torso_2_link"]
    # What a robot measures of its own by default is asked for only where it is named.
    assert Chains(talos, setups=stated, names=("a", WORLD))[WORLD].tip == talos.root
    # A stated chain may have the name of a link.
    renamed = Chains(talos, setups={LEFT: ChainSetup(RIGHT)}, names=(LEFT,))
    assert renamed[LEFT].tip == RIGHT
    more = renamed.named((LEFT, WORLD))
    assert more[LEFT] is renamed[LEFT] and renamed.names == (LEFT,)


def test_names_that_cannot_be_used(hand: Robot) -> None:
    left = {"left": ChainSetup("nail")}
    everything = "world, left, base, palm, thumb, finger, nail, dial"
    with refused(RobotError, "'left'", allowed=everything, file="hand.urdf"):
        Chains(hand, setups=left, names=("lefd",))
    with refused(RobotError, "'nil'"):
        Chains(hand, setups={"left": ChainSetup("nil")}, names=("left",))
    with refused(RobotError, "3 possible tips"):
        Chains(hand)
    with refused(RobotError, "'world'"):
        Chains(hand, setups={WORLD: ChainSetup("nail")}, names=("nail",))
    for arguments in ({"tip": "base"}, {"names": ("base",)}):
        with refused(RobotError, "'base'", allowed="world"):
            Chains(hand, **arguments)


# Mimic joints.


def test_a_leader_outside_the_chains(hand: Robot) -> None:
    chains = Chains(hand, names=("nail",))
    assert chains["nail"].joints == ("wrist", "turn", "end")
    assert chains.joints == ("wrist", "turn", "end", "knob")
    assert list(chains.mimics) == list(chains["nail"].mimics) == ["turn"]
    assert chains.columns("nail").tolist() == [0, 1, 2]
    # -20 (0.05 q + 0.02) + 0.3
    followed = chains.follow(np.array([[1.0, 9.0, 2.0, 0.5], [0.0, 0.0, 0.0, -1.0]]))
    np.testing.assert_allclose(
        followed, [[1.0, -0.6, 2.0, 0.5], [0.0, 0.9, 0.0, -1.0]], rtol=0, atol=1e-14
    )
    both = chains.named(("nail", "thumb"))
    assert both.joints == tuple(k for k in hand.model.names if k in both.joints)
    assert set(both.joints) == {"wrist", "slide", "turn", "end", "knob"}


def test_limits_of_leaders_and_of_those_that_follow(hand: Robot) -> None:
    chains = Chains(hand, names=("nail", "thumb"))
    ends = np.column_stack([chains.lower, chains.upper])
    limits = dict(zip(chains.joints, ends, strict=True))
    # The slide, 0.05 q + 0.02, ends at 0 and 0.1; the turn is -q - 0.1.
    expected = {"slide": (0.0, 0.1), "knob": (-0.4, 1.6), "turn": (-1.7, 0.3)}
    for name, pair in expected.items():
        np.testing.assert_allclose(limits[name], pair, rtol=0, atol=1e-12)
    q = chains.random_configurations(500, np.random.default_rng(0))
    np.testing.assert_array_equal(q, chains.follow(q))
    assert ((chains.lower - 1e-12 <= q) & (q <= chains.upper + 1e-12)).all()
    assert (np.ptp(q, axis=0) > 0.97 * (chains.upper - chains.lower)).all()
    # Where nothing slides, the knob goes from -1 to 3.
    alone = Chain(hand, tip="nail")
    np.testing.assert_allclose(alone.lower, [-2.0, -3.1, -2.0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(alone.upper, [2.0, 0.9, 2.0], rtol=0, atol=1e-12)
