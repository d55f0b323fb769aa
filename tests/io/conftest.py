"""Files of measurements, and a robot of two hands that they may be of."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from calib_pin.io.table import Table, read_table
from calib_pin.io.urdf import parse_robot
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.setup import ChainSetup
from tests.shared import chain_of, joint, urdf_of


@pytest.fixture(scope="session")
def tree() -> Chains:
    """Two hands of one body; the finger of the right one follows its arm."""
    follows = '<mimic joint="right" multiplier="-0.5" offset="0.1"/>'
    text = urdf_of(
        joint("torso", "base body", kind="prismatic"),
        joint("left", "body left_hand"),
        joint("right", "body upper", kind="continuous"),
        joint("finger", "upper lower", kind="continuous", more=follows),
        joint("slide", "lower right_hand", kind="prismatic"),
    )
    touch = ChainSetup(base="left_hand", tip="right_hand")
    robot = parse_robot(text.encode(), "tree.urdf")
    return Chains(robot, tip="right_hand", setups={"touch": touch})


@pytest.fixture(scope="session")
def arm() -> Callable[..., Chain]:
    """A chain of a lift, an elbow and a wrist, before a gripper."""

    def arm(lift: str = "lift", **elbow: Any) -> Chain:
        joints = (
            joint(lift, "base a", kind="prismatic"),
            joint("elbow", "a b", **elbow),
            joint("wrist", "b c", kind="continuous"),
            joint("gripper", "c d", kind="prismatic", limits="0 0.05"),
        )
        return chain_of(urdf_of(*joints), tip="c")

    return arm


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """Write a file and return its path."""

    def write(text: str | bytes, name: str = "m.csv") -> Path:
        file = tmp_path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(text.encode() if isinstance(text, str) else text)
        return file

    return write


@pytest.fixture
def table(write: Callable[..., Path]) -> Callable[..., Table]:
    """The table of a text, as `read_table` reads it from a file."""

    def table(text: str, columns: Mapping[str, str] = {}, **more: Any) -> Table:
        return read_table(write(text, "a.csv"), columns=columns, **more)

    return table
