"""Other robots and links that measurement files may be of."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from calib_pin.errors import CalibPinError
from calib_pin.io.files import read_bytes
from calib_pin.io.urdf import known_robots, load_robot
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.observations import Observations
from calib_pin.setup import Setup
from calib_pin.validation.findings.case import LINKS, Other

HEAD = 65536
"""Bytes of a measurement file that hold its header."""

MOST = 12
"""Links that are tried, by the joints that move them."""


def other_chains(
    files: Sequence[str | Path],
    chains: Chains,
    setup: Setup,
    read: Callable[[Chains], Observations],
) -> Iterator[Other]:
    """Other robots with these joints, and links that further joints of the files move.

    Args:
        files: The measurement files.
        chains: The chains that were taken to be measured.
        setup: The setup.
        read: Reads the files for other chains.
    """
    found = [*_robots(chains, setup), *_links(files, chains, setup)]
    for code, words, other, stated, advice in found:
        try:
            data = read(other)
        except CalibPinError:
            continue
        yield Other(code, words, other, data, stated, advice)


_Found = tuple[str, str, Chains, dict[str, str], str]


def _robots(chains: Chains, setup: Setup) -> Iterator[_Found]:
    """Robots known by name whose chains have the same joints."""
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
            words = f"the robot is '{name}', not '{chains.robot.name}'"
            advice = f"use '{name}' in place of '{chains.robot.file}'"
            yield "robot", words, other, {}, advice


def _links(
    files: Sequence[str | Path], chains: Chains, setup: Setup
) -> Iterator[_Found]:
    """Links that joints move which are no part of the chain, but columns of a file."""
    if chains.names != ("",) or not Path(files[0]).is_file():
        return
    chain, robot = chains[""], chains.robot
    with Path(files[0]).open("rb") as file:
        head = file.read(HEAD)
    there = {column.joint for column in setup.joints.values()}
    there |= {name for name in robot.model.names if name.encode() in head}
    ends = {"base": chain.base, "tip": chain.tip}
    own = frozenset(chain.joints)
    seen = {own}
    for end in ends:
        for link in robot.links:
            try:
                other = Chains.of(Chain(robot, **{**ends, end: link}))
            except CalibPinError:
                continue
            joints = frozenset(other.joints)
            # Those with fewer joints are tried without the files.
            if joints <= own or joints in seen or not joints <= there:
                continue
            if len(seen) > MOST:
                return
            seen.add(joints)
            words = f"the {end} link is '{link}', not '{ends[end]}'"
            yield LINKS[end], words, other, {end: link}, ""
