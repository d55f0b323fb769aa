"""Other robots that measurement files may be of."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress

from calib_pin.errors import CalibPinError
from calib_pin.io.files import read_bytes
from calib_pin.io.urdf import known_robots, load_robot
from calib_pin.kinematics.chains import Chains
from calib_pin.setup import Setup


def other_robots(chains: Chains, setup: Setup) -> Iterator[Chains]:
    """Robots known by name whose chains have the same joints.

    Args:
        chains: The chains that were taken to be measured.
        setup: The setup.
    """
    ends = (setup.base, setup.tip)
    joints = [f'"{joint}"'.encode() for joint in chains.joints]
    # Of robots with the same geometry the plainest name counts.
    for name, path in sorted(known_robots().items(), key=lambda known: len(known[0])):
        with suppress(CalibPinError):
            source = read_bytes(path)
            if source != chains.robot.source and all(j in source for j in joints):
                robot = load_robot(name)
                base, tip = (k if k in robot.links else None for k in ends)
                other = Chains(robot, base, tip, setup.chains, chains.names)
                if {*other.joints} == {*chains.joints}:
                    yield other
