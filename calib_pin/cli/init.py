"""`calib-pin init`: a setup file from a look at a robot and its measurements."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import calib_pin.cli.files as files_of
from calib_pin.cli import printing
from calib_pin.cli.asked import Init
from calib_pin.errors import InputError, OptionError, enumerated, in_file
from calib_pin.io.columns import LENGTH, Kind
from calib_pin.io.first_look import Choose, Look, draft, first_look
from calib_pin.io.urdf import load_robot
from calib_pin.kinematics.robot import Robot
from calib_pin.setup import DistanceSetup, Setup
from calib_pin.units import as_number

SIGMA = 1e-5
"""Standard deviation of a distance between sockets [m]: they are gauged."""


def init(asked: Init, words: Sequence[str]) -> int:
    """Do what `Init` asks for."""
    files = asked.measurements
    files_of.check_outputs(
        [asked.output], [asked.robot, *files, asked.setup], asked.force
    )
    robot, look = looked_at(asked, _choose)
    text = draft(robot, look, printing.command_line(words))
    written, contents = list[str](), dict[Path, bytes]()
    if asked.output is not None:
        contents = {asked.output: text.encode()}
        words = shlex.join(map(str, [asked.robot, *files, "--setup", asked.output]))
        written = [f"wrote {asked.output}", f"next: calib-pin calibrate {words} -o out"]
    asked.give(contents, text, written)
    return 0


def looked_at(asked: Init, choose: Choose) -> tuple[Robot, Look]:
    """A robot and the reading of measurement files that fits it best.

    Args:
        asked: What is known.
        choose: Called where only a user can tell readings apart.

    Raises:
        CalibPinError: If one of the files cannot be used.
    """
    files, folders = asked.measurements, asked.package_dir or []
    files_of.require_folders(folders)
    files_of.require_distinct(files)
    robot, given = load_robot(asked.robot, folders), files_of.setup_for(asked)
    seen = given.board
    if asked.board is not None:
        from calib_pin.io.boards import board_of  # Loads what looks at images.

        seen = board_of(asked.board)
    start = Setup(asked.base, asked.tip, model=asked.model, board=seen)
    start = replace(start, camera=given.camera)
    with in_file(str(files[0])):
        look = first_look(robot, files, start, choose, asked.station_per_file)
    if look.setup.camera is None and (asked.board or asked.setup):
        reason = "--board and --setup are for a camera, and there are no columns u, v"
        raise OptionError(reason)
    if look.data is not None and "fixed-point" in look.data.models:
        look = _with_distances(look, asked.distance)
    elif asked.distance is not None:
        raise OptionError("--distance is that of sockets (fixed-point)")
    for remark in look.remarks:
        printing.notice(remark)
    if not look.fits:
        printing.notice("no reading of the columns fits the robot; see the draft")
    return robot, look


def _choose(question: str, choices: Sequence[str], option: str) -> str:
    """The only choice.

    Raises:
        OptionError: If there are several, or none.
    """
    if len(choices) != 1:
        allowed = enumerated(choices) or None
        raise OptionError(f"{question}? state {option}", allowed=allowed)
    return choices[0]


def _with_distances(look: Look, distance: str | None) -> Look:
    """The reading with the known distance of the sockets of each place."""
    assert look.data is not None
    places = dict[str, list[str]]()
    for name in dict.fromkeys(k.rpartition("@")[2] for k in look.data.target.distinct):
        places.setdefault(name.rpartition("/")[0], []).append(name)
    pairs = [names for names in places.values() if len(names) == 2]
    if distance is None:
        if pairs:
            both = " and ".join(pairs[0])
            advice = f"say how far apart {both} are: --distance '50 mm'"
            printing.notice(f"sockets tell no size: {advice}")
        return look
    if not pairs:
        raise OptionError("no place has two sockets, called PLACE/0 and PLACE/1")
    (length,), _ = reading(distance, {"--distance": LENGTH}, "m")
    if length <= 0.0:
        raise OptionError("--distance is no length", value=distance)
    known = tuple(DistanceSetup((a, b), length, SIGMA) for a, b in pairs)
    return replace(look, setup=replace(look.setup, distances=known))


def reading(text: str, kinds: Mapping[str, Kind], unit: str) -> tuple[list[float], str]:
    """Typed numbers in SI units, and the unit they were in.

    A comma is a decimal mark; blanks or semicolons separate. Where no unit is typed, it
    is that of the reading before.

    Args:
        text: The text.
        kinds: The columns or options that are asked for.
        unit: The unit of the reading before; empty where there was none.

    Raises:
        InputError: If the text is something else.
    """
    parts = r"(?<=[.\d])(?=(?!e[-+\d])[a-zA-Z])|[\s;\[\]]+"
    words, names = re.sub(parts, " ", text.replace(",", ".")).split(), ", ".join(kinds)
    if words and not re.match(r"[-+.\d]", words[-1]):
        unit = words.pop()
    (kind,) = {one.si: one for one in kinds.values()}.values()
    if unit not in kind.units:
        reason, allowed = f"say the unit of {names}", ", ".join(kind.units)
        raise InputError(reason, value=unit, allowed=allowed)
    given = [as_number(word) for word in words]
    numbers = [math.nan if n is None else kind.units[unit] * n for n in given]
    if len(numbers) != len(kinds) or not all(abs(n) <= kind.largest for n in numbers):
        allowed = f"numbers and a unit, as 523.5 mm, up to {kind.largest:g} {kind.si}"
        raise InputError(f"{names} cannot be read", value=text, allowed=allowed)
    return numbers, unit
