"""Joint limits as words of the command line."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from calib_pin.cli.plan import parse_limits
from calib_pin.errors import OptionError
from calib_pin.io.urdf_tree import parse_robot
from calib_pin.kinematics.chain import Chain

JOINTS = {
    "elbow": "revolute",
    "lift": "prismatic",
    "wrist_1": "revolute",
    "wrist_2": "continuous",
    "joint[12]": "prismatic",
    "joint1": "revolute",
    "a=b": "revolute",
}


@pytest.fixture(scope="module")
def chain() -> Chain:
    links = [f'<link name="link_{k}"/>' for k in range(len(JOINTS) + 1)]
    joints = [
        f'<joint name="{name}" type="{kind}"><parent link="link_{k}"/>'
        f'<child link="link_{k + 1}"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
        for k, (name, kind) in enumerate(JOINTS.items())
    ]
    text = "".join(['<robot name="arm">', *links, *joints, "</robot>"])
    return Chain(parse_robot(text.encode(), "arm.urdf"))


@pytest.mark.parametrize(
    ("word", "name", "limits"),
    [
        ("elbow=-1:1.5", "elbow", (-1.0, 1.5)),
        ("elbow=-90:180 [deg]", "elbow", (-math.pi / 2, math.pi)),
        ("elbow=-90:180[deg]", "elbow", (-math.pi / 2, math.pi)),
        (" elbow = -1 : 1 ", "elbow", (-1.0, 1.0)),
        ("lift=0:350 [mm]", "lift", (0.0, 0.35)),
        ("joint_*=-1e-3:+2", "joint_*", (-1e-3, 2.0)),
        ("joint[12]=0:1", "joint[12]", (0.0, 1.0)),
        # The name of a joint comes first: the glob would mean a revolute one.
        ("joint[12]=0:350 [mm]", "joint[12]", (0.0, 0.35)),
        ("wrist_*=-90:180 [deg]", "wrist_*", (-math.pi / 2, math.pi)),
        ("*=-1:1", "*", (-1.0, 1.0)),
        # What means no joint is told where limits are used.
        ("neck=0:1 [mm]", "neck", (0.0, 1e-3)),
        ("a=b=0:1", "a=b", (0.0, 1.0)),
        ("axis 1=0.25:0.25", "axis 1", (0.25, 0.25)),
    ],
)
def test_words(word: str, name: str, limits: tuple[float, float], chain: Chain) -> None:
    found = parse_limits([word], chain)
    assert list(found) == [name]
    assert found[name] == pytest.approx(limits, rel=1e-12)


def test_units_of_another_kind_of_joint(
    chain: Chain, refused: Callable[..., Any]
) -> None:
    for word, joint in (
        ("wrist_*=0:1 [in]", "'wrist_1'"),
        ("wrist_2=0:1 [m]", "'wrist_2'"),
        ("joint[12]=0:1 [rad]", "'joint[12]'"),
        ("*=-90:90 [deg]", "'lift'"),
        ("*=-90:90 [mm]", "'elbow'"),
    ):
        with refused(OptionError, reason=(repr(word), joint)):
            parse_limits([word], chain)


def test_several_words_and_none(chain: Chain) -> None:
    assert parse_limits([], chain) == {}
    assert list(parse_limits(["b=0:1", "a=0:1"], chain)) == ["b", "a"]
    # The later one of the same joint holds, as for every other option.
    assert parse_limits(["a=0:1", "a=0:2"], chain) == {"a": (0.0, 2.0)}


MALFORMED = "|elbow|elbow=|=0:1|elbow=1|elbow=0:1:2|elbow=a:b|0:1|elbow=0:1 [cm]"
MALFORMED += "|elbow=0:1 [deg|elbow=:|elbow=0:|elbow:0=1"
ABSURD = "elbow=1:-1|elbow=nan:1|elbow=0:nan|elbow=-inf:inf|elbow=0:1e9|elbow=-120:120"


@pytest.mark.parametrize(
    ("words", "allowed"), [(MALFORMED, "JOINT=LOWER:UPPER"), (ABSURD, "LOWER up to")]
)
def test_words_that_cannot_be_meant(
    words: str, allowed: str, chain: Chain, refused: Callable[..., Any]
) -> None:
    for word in words.split("|"):
        with refused(OptionError, reason=repr(word), allowed=allowed):
            parse_limits([word], chain)
