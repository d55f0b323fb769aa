"""Other robots that measurement files may be of."""

from __future__ import annotations

from collections.abc import Iterator

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
    joints = [f'"{joint}"'.encode() for joint in chains.joints]
    # Of robots with the same geometry the plainest name counts.
    for name, path in sorted(known_robots().items(), key=lambda known: len(known[0])):
        try:
            source = read_bytes(path)
            if source == chains.robot.source or not all(j in source for j in joints):
                continue
            robot = load_robot(name)
            base, tip = (
                end if end in robot.links else None for end in (setup.base, setup.tip)
            )
            other = Chains(robot, base, tip, setup.chains, chains.names)
        except CalibPinError:
            continue
        if {*other.joints} == {*chains.joints}:
            yield other
