"""`calib-pin robots`: the bundled robots, and a copy of one."""

from __future__ import annotations

from calib_pin.cli.asked import Robots
from calib_pin.errors import OptionError, require_known
from calib_pin.io.files import read_bytes
from calib_pin.io.urdf import bundled_robots, load_robot
from calib_pin.kinematics.chain import Chain
from calib_pin.report.blocks import table


def robots(asked: Robots) -> int:
    """Do what `Robots` asks for."""
    known, name, output = bundled_robots(), asked.name, asked.output
    if (name is None) != (output is None):
        raise OptionError("name the robot and the folder: robots NAME -o DIR")
    if name is not None and output is not None:
        require_known("bundled robot", name, known)
        files = sorted(path for path in known[name].parent.iterdir() if path.is_file())
        copies = {output / path.name: read_bytes(path) for path in files}
        asked.give(copies)
        return 0
    rows = []
    for robot, path in known.items():
        chain = Chain(load_robot(robot))
        others = sorted(p.name for p in path.parent.iterdir() if p.suffix != ".urdf")
        ends = f"{chain.base} -> {chain.tip}"
        rows.append((robot, ends, len(chain.joints), ", ".join(others)))
    shown = table("", ("name", "chain|word", "joints", "files|remark"), rows)
    more = "calib-pin robots NAME -o DIR copies one with its example files"
    asked.give({}, [shown], [more])
    return 0
