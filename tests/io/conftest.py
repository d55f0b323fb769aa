"""Files of measurements, and a robot of two hands that they may be of."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from calib_pin.io.urdf import load_robot
from calib_pin.kinematics.chains import Chains
from calib_pin.setup import ChainSetup

TREE = """<robot name="tree">
  <link name="base"/><link name="body"/><link name="left_hand"/>
  <link name="upper"/><link name="lower"/><link name="right_hand"/>
  <joint name="torso" type="prismatic">
    <parent link="base"/><child link="body"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="0.5" effort="1" velocity="1"/>
  </joint>
  <joint name="left" type="revolute">
    <parent link="body"/><child link="left_hand"/><axis xyz="0 1 0"/>
    <origin xyz="0 0.4 0"/>
    <limit lower="-2.9" upper="2.9" effort="1" velocity="1"/>
  </joint>
  <joint name="right" type="continuous">
    <parent link="body"/><child link="upper"/><axis xyz="1 0 0"/>
    <origin xyz="0 -0.4 0"/>
  </joint>
  <joint name="finger" type="continuous">
    <parent link="upper"/><child link="lower"/><axis xyz="1 0 0"/>
    <origin xyz="0.3 0 0"/>
    <mimic joint="right" multiplier="-0.5" offset="0.1"/>
  </joint>
  <joint name="slide" type="prismatic">
    <parent link="lower"/><child link="right_hand"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="0.5" effort="1" velocity="1"/>
  </joint>
</robot>"""


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
