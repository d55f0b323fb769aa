"""Files of measurements, and a robot of two hands that they may be of."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from calib_pin.io.urdf import load_robot
from calib_pin.kinematics.chains import Chains
from calib_pin.setup import ChainSetup
from tests.io.robots import joint, robot

FOLLOWS = '<mimic joint="right" multiplier="-0.5" offset="0.1"/>'
TREE = robot(
    joint("torso", "base body", kind="prismatic", limits="0 0.5"),
    joint("left", "body left_hand", "0 0.4 0", "0 1 0", limits="-2.9 2.9"),
    joint("right", "body upper", "0 -0.4 0", "1 0 0", "continuous"),
    joint("finger", "upper lower", "0.3 0 0", "1 0 0", "continuous", more=FOLLOWS),
    joint("slide", "lower right_hand", "0 0 0", "1 0 0", "prismatic", "0 0.5"),
    name="tree",
)


@pytest.fixture(scope="session")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Chains:
    """Two hands of one body; the finger of the right one follows its arm."""
    file = tmp_path_factory.mktemp("tree") / "tree.urdf"
    file.write_text(TREE)
    touch = ChainSetup(base="left_hand", tip="right_hand")
    return Chains(load_robot(str(file)), tip="right_hand", stated={"touch": touch})


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """Write a file and return its path."""

    def write(text: str | bytes, name: str = "m.csv") -> Path:
        file = tmp_path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(text.encode() if isinstance(text, str) else text)
        return file

    return write
