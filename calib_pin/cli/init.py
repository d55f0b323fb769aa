"""`calib-pin init`: a setup file from a look at a robot and its measurements."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import calib_pin.cli.options as options
from calib_pin.cli.files import (
    check_outputs,
    open_setup,
    require_distinct,
    require_folders,
)
from calib_pin.cli.printing import notice, say, say_json, say_written, told_command
from calib_pin.errors import InputError, OptionError, enumerated, stated_in
from calib_pin.units import as_number

if TYPE_CHECKING:
    from calib_pin.io.first_look import Joints, Look
    from calib_pin.io.foreign_headers import Foreign
    from calib_pin.io.table import Table
    from calib_pin.kinematics.robot import Robot
    from calib_pin.setup import Setup

TOUCHES = ("fixed-point", "plane-contact", "sphere-contact")
LENGTHS = ("plane-distance", "point-distance", "relative-distance")

AT_REST = 0.05
"""Scatter of a nominal robot's ball in its sockets, in parts of how far it moved, below
which it was in sockets."""

SIGMA = 1e-5
"""Standard deviation of a distance between sockets [m]: they are gauged."""


def init(
    context: typer.Context,
    robot: options.RobotName,
    measurements: Annotated[
        list[Path],
        typer.Argument(
            metavar="MEASUREMENTS...",
            help="CSV or Parquet files with one row per measurement, as they are.",
        ),
    ],
    output: Annotated[
        Path | None,
        options.output(
            "-o --output YAML", "Setup file to write; without it, it is printed."
        ),
    ] = None,
    package_dir: options.PackageDirs = None,
    model: options.Model = None,
    base: options.Base = None,
    tip: Annotated[
        str | None,
        options.robot(
            "--tip LINK",
            "Last link of the chain; of chains that the measurements name, "
            "NAME=LINK,...",
        ),
    ] = None,
    distance: Annotated[
        str | None,
        options.robot(
            "--distance LENGTH",
            "Known distance of the two sockets of each place, such as '50 mm'.",
        ),
    ] = None,
    board: Annotated[
        str | None,
        options.robot("--board SPEC", "Board of a camera, as for 'detect'."),
    ] = None,
    setup: options.SetupFile = None,
    station_per_file: options.StationPerFile = False,
    force: options.Force = False,
    json: options.Json = False,
) -> int:
    """Look at a robot and its measurements, and draft a setup file.

    Finds the tip, the joints, what was measured, foreign names of columns and their
    units, by trying on the nominal robot, and says in comments what it found. Asks what
    cannot be known, on a terminal; elsewhere an error names the option that says it.
    The setup file that `detect` wrote (--setup) has the board and the camera.
    """
    from calib_pin.io.drafts import draft
    from calib_pin.io.files import write_files
    from calib_pin.io.foreign_headers import foreign, measured
    from calib_pin.io.setup import setup_document
    from calib_pin.io.table import read_table
    from calib_pin.io.urdf import load_robot
    from calib_pin.parameterizations.placement import HAND_SET
    from calib_pin.setup import Setup

    require_folders(package_dir or [])
    require_distinct(measurements)
    check_outputs([output], [robot, *measurements, setup], force)
    loaded = load_robot(robot, package_dir or ())
    table = read_table(measurements[0]).whole(loaded.model.names)
    with stated_in(str(measurements[0])):
        columns = foreign(table.columns)
    given = open_setup(setup)
    start = Setup(base, tip, model=model, board=given.board, camera=given.camera)
    start, joints = _ends(start, loaded, columns, table)
    corners = {"u", "v"} <= measured(columns).keys() and model in (None, "camera")
    if corners:
        start = _with_camera(start, measured(columns), board)
    elif board is not None or setup is not None:
        reason = "--board and --setup are for a camera, and there are no columns u, v"
        raise OptionError(reason)
    look = _best(start, loaded, joints, columns, measurements, station_per_file)
    if look.data is not None and "fixed-point" in look.data.models:
        look = _with_distances(look, distance)
    elif distance is not None:
        raise OptionError("--distance is that of sockets (fixed-point)")
    if look.hand_set:
        prior = {"*.joint-offset.q": round(HAND_SET, 3)}
        offsets = replace(look.setup, parameters=("joint-offset",), prior=prior)
        look = replace(look, setup=offsets)
    text = draft(loaded, look, told_command(context))
    for remark in look.remarks:
        notice(remark)
    if not look.fits:
        notice("no reading of the columns fits the robot; see the draft")
    files = {} if output is None else {output: text.encode()}
    with write_files(files, force=force):
        pass
    if json:
        found = {"setup": setup_document(look.setup), "nominal": look.errors}
        say_json(found, files)
    else:
        say(text)
        files_of = " ".join(map(shlex.quote, map(str, measurements)))
        after = f"next: calib-pin calibrate {robot} {files_of} --setup {output} -o out"
        say_written([*(f"wrote {file}" for file in files), *([after] if files else [])])
    return 0


def _ends(
    setup: Setup, robot: Robot, columns: Sequence[Foreign], table: Table
) -> tuple[Setup, list[Joints]]:
    """The setup with the chains that a column names, and what may be the joints."""
    from calib_pin.io.first_look import joint_columns, named_chains
    from calib_pin.io.foreign_headers import measured
    from calib_pin.setup import WORLD, ChainSetup

    named = measured(columns).get("chain")
    tips = dict(word.partition("=")[::2] for word in (setup.tip or "").split(","))
    if named is None or (setup.tip is not None and "=" not in setup.tip):
        with stated_in(table.file):
            joints = joint_columns(robot, setup.base, setup.tip, columns)
    else:
        names = table.texts([named[0].name])[named[0].name].distinct
        own = [name for name in names if name not in ("", WORLD, *robot.links)]
        chains = dict[str, ChainSetup]()
        all_joints, links = named_chains(robot, setup.base, own, columns)
        for name in own:
            link = tips.get(name) or _choose(
                f"which link is the tip of chain '{name}'",
                links[name] or robot.links,
                f"--tip {name}=LINK",
            )
            chains[name] = ChainSetup(tip=link)
        setup = replace(setup, tip=None, chains=chains)
        joints = [all_joints] if all_joints.columns else []
    if not joints:
        every = [name for name in robot.model.names if name != "universe"]
        raise InputError(
            "joint positions are needed (a pose of the controller hides the branch and "
            "the errors of the robot), and no columns are found for them; map them "
            f"with 'columns' in a setup file (joints: {enumerated(every)})",
            file=table.file,
        )
    return setup, joints


def _choose(question: str, choices: Sequence[str], option: str) -> str:
    """The choice of the user, on a terminal, or the only one.

    Raises:
        OptionError: If there are several, and nobody to be asked.
    """
    if len(choices) == 1:
        return choices[0]
    if not choices or not sys.stdin.isatty():
        how = f"state {option}" if option else "state it in a setup file"
        raise OptionError(f"{question}? {how}", allowed=enumerated(choices) or None)
    print(f"{question}?", file=sys.stderr)
    for number, choice in enumerate(choices, 1):
        print(f"  {number}  {choice}", file=sys.stderr)
    while True:
        answer = typer.prompt("number or name", default=choices[0], err=True)
        if answer in choices:
            return str(answer)
        if answer.isdecimal() and 1 <= int(answer) <= len(choices):
            return choices[int(answer) - 1]


def _best(
    setup: Setup,
    robot: Robot,
    joints: Sequence[Joints],
    columns: Sequence[Foreign],
    files: Sequence[Path],
    station_per_file: bool,
) -> Look:
    """The reading that fits the robot best, of the model that is asked for or shows.

    Raises:
        CalibPinError: If the files cannot be read in any way.
    """
    from calib_pin.io.first_look import (
        CLEAR,
        best,
        looked,
        readings,
        unlikely_joints,
    )
    from calib_pin.io.foreign_headers import measured

    def looks_of(stated: Setup, own: Joints) -> list[Look]:
        return [
            looked(way, robot, files, station_per_file=station_per_file)
            for camera in _mounts(stated)
            for way in readings(camera, robot, own, columns)
        ]

    def tried(model: str | None) -> Look:
        stated = replace(setup, model=model)
        with stated_in(str(files[0])):
            looks = [look for own in joints for look in looks_of(stated, own)]
            found = best(looks)
            others = unlikely_joints(robot, setup.base, joints)
            while not found.fits and (own := next(others, None)) is not None:
                tries = looks_of(stated, own)
                if (better := best(tries)).share < found.share:
                    looks, found = tries, better
        if CLEAR * found.next_share <= found.share < inf:
            raise InputError(
                "the robot fits about as well with other units; state the units in the "
                "header, such as 'x [mm]', or in 'columns' of a setup file",
                file=files[0],
            )
        ends = {found.setup.tip: found}
        for look in looks:
            if CLEAR * look.share < found.share < inf:
                ends.setdefault(look.setup.tip, look)
        if len(ends) == 1:
            return found
        tip = _choose("which link was measured", [end or "" for end in ends], "--tip")
        return best([look for look in looks if look.setup.tip == tip])

    meanings = measured(columns).keys()
    if setup.model is not None or meanings & {"x", "u"}:
        look = tried(setup.model)
    elif "distance" in meanings:
        looks = sorted(map(tried, LENGTHS), key=lambda look: look.share)
        look = looks[0]
        if not look.share < CLEAR * looks[1].share:
            look = tried(_choose("of which kind is the distance", LENGTHS, "--model"))
    else:
        look = tried("fixed-point")
        if not look.share < AT_REST:
            look = tried(
                _choose(
                    "did the tool rest in sockets or touch planes or spheres",
                    TOUCHES,
                    "--model",
                )
            )
    if look.fault is not None:
        raise look.fault
    return look


def _with_camera(
    setup: Setup, found: Mapping[str, Sequence[Foreign]], board: str | None
) -> Setup:
    """The setup with a board and a camera to start from, those given where there are.

    Raises:
        OptionError: If nothing says which board it is.
    """
    from calib_pin.io.boards import board_of
    from calib_pin.setup import CameraSetup

    seen = setup.board if board is None else board_of(board)
    if seen is None:
        raise OptionError(
            "the points that the camera saw must be known: state --board, or --setup, "
            "the file of detect's --setup-output",
            allowed="such as charuco:7x5:0.03:0.022, lengths in m",
        )
    # The image is larger than where corners were seen, by how much nobody knows.
    width, height = (100.0 * -(-found[axis][0].largest // 100.0) for axis in "uv")
    camera = setup.camera or CameraSetup(
        mount="hand",
        focal=(width, width),
        center=((width - 1.0) / 2.0, (height - 1.0) / 2.0),
        estimate=True,
    )
    return replace(setup, model="camera", board=seen, camera=camera)


def _mounts(setup: Setup) -> list[Setup]:
    """The setup with a camera on the hand, and with one that looks at the robot."""
    if (camera := setup.camera) is None:
        return [setup]
    ways = (replace(camera, mount="hand"), replace(camera, mount="world"))
    return [replace(setup, camera=way) for way in ways]


def _with_distances(look: Look, stated: str | None) -> Look:
    """The reading with the known distance of the sockets of each place."""
    from calib_pin.setup import DistanceSetup

    assert look.data is not None
    places = dict[str, list[str]]()
    names = (name.rpartition("@")[2] for name in look.data.target.distinct)
    for name in dict.fromkeys(names):
        places.setdefault(name.rpartition("/")[0], []).append(name)
    pairs = [names for names in places.values() if len(names) == 2]
    if not pairs and stated is not None:
        raise OptionError("no place has two sockets, called PLACE/0 and PLACE/1")
    if not pairs:
        return look
    if stated is None:
        if not sys.stdin.isatty():
            raise OptionError(
                "sockets tell no size: state how far the two of a place are apart",
                allowed="--distance '50 mm'",
            )
        question = f"how far apart are {pairs[0][0]} and {pairs[0][1]} (such as 50 mm)"
        stated = str(typer.prompt(question, err=True))
    value = _length(stated)
    known = tuple(DistanceSetup((a, b), value, SIGMA) for a, b in pairs)
    return replace(look, setup=replace(look.setup, distances=known))


def _length(text: str) -> float:
    """A length such as `50 mm` [m].

    Raises:
        OptionError: If it is none.
    """
    import re

    from calib_pin.io.columns import LENGTH

    found = re.fullmatch(r"\s*([0-9.]+)\s*\[?(\w*)\]?\s*", text)
    unit = LENGTH.units.get(found[2] or "m") if found else None
    value = unit * (as_number(found[1]) or 0.0) if found and unit else 0.0
    if not 0.0 < value < 100.0:
        raise OptionError("--distance is no length", value=text, allowed="50 mm, 0.05")
    return value
