"""The folder of a calibration: one run wrote all of it, and it can be moved.

`calibration.json` has the id of the run and a manifest, the SHA-256 of every file that
was written with it. A URDF is known by its hash, so that it stays as it is. The page
says when it was made: it is known by the id, and has no hash, so that the same run
leaves the same manifest at any time.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path, PurePosixPath

from calib_pin.errors import InputError, RobotError
from calib_pin.io.files import inside, read_bytes, settled, sha256
from calib_pin.io.json_text import Json, decoded, encode, reading
from calib_pin.io.straightening import straight_source
from calib_pin.io.urdf import is_xacro, locate_robot
from calib_pin.io.urdf_tree import parse_robot
from calib_pin.kinematics.robot import Robot
from calib_pin.validation.breakdown import Breakdown

FORMAT = "calib-pin/calibration"

BREAKDOWN = tuple(f.name for f in fields(Breakdown) if f.name != "accuracies")
"""Parts of a result that tell of its stations, tools, chains and blocks."""

JSON = 1 << 28
"""Bytes of the largest document: its objects take many times as much memory."""

DOCUMENT = "calibration.json"
REPORT = "report.html"
NOMINAL = "nominal.urdf"
MEASUREMENTS = "measurements.csv"
RESIDUAL_MODEL = "residual_model.json"
"""Names in a folder: the result, the page, the robot as it was, the errors of the
measurements, and what was learned."""

MADE = ("command", "created")
"""Keys of the provenance that are new for every run; all others are versions."""

PICTURES = (".png", ".pdf", ".svg")
"""Endings of files from which no program takes a number: these may be edited."""


def urdf_name(robot: str) -> str:
    """Name of the corrected URDF of a robot.

    Examples:
        >>> urdf_name("ur 10"), urdf_name("Nominal"), urdf_name("../arm")
        ('ur_10.urdf', 'Nominal-corrected.urdf', '_arm.urdf')
    """
    # The name comes from the file: it must not lead out of the folder.
    name = re.sub(r"[^\w.-]", "_", robot).lstrip(".") or "robot"
    # Some file systems do not tell capitals apart.
    taken = f"{name}.urdf".casefold() == NOMINAL
    return f"{name}-corrected.urdf" if taken else f"{name}.urdf"


def run_id(document: Json, learned: bytes | None) -> str:
    """Id of the run that led to a document; the same input and seed lead to the same.

    Args:
        document: The `calibration.json`, without an id.
        learned: Its residual model, without an id.
    """
    solver, about = document["solver"], document["provenance"]
    content = {
        **document,
        "residual_model": None,
        "solver": {k: v for k, v in solver.items() if k != "seconds"},
        "provenance": {k: v for k, v in about.items() if k not in MADE},
    }
    return sha256(encode(content) + (learned or b""))[:16]


def read_document(path: str | Path) -> Json:
    """The content of a `calibration.json`.

    Raises:
        InputError: If the file is not such a document, or of another version.
    """
    document = decoded(read_bytes(path, JSON), "calibration", FORMAT, path)
    # Version 0.1 of the program wrote none of these.
    if not document.keys() >= set(BREAKDOWN):
        reason = "of an older version of calib-pin, or edited: calibrate again"
        raise InputError(f"{reason} from the measurements", file=path)
    return document


def members(document: Json) -> dict[str, str | None]:
    """SHA-256 of the files that were written with a calibration, by name.

    None for those that are known by the id of the run.

    Raises:
        ValueError: If these are no such names.
    """
    stated = document.get("files", {})
    if not isinstance(stated, Mapping) or not all(
        isinstance(name, str) and inside(name) for name in stated
    ):
        raise ValueError("'files' are not those of a folder")
    return dict(stated)


def require_one_run(document: Json, robot: bytes, path: Path) -> None:
    """Refuse a calibration among files that were not written with it.

    Those that are not there are not missed here; pictures may be edited.

    Args:
        document: The calibration.
        robot: The robot that was calibrated, which may stand in the place of the
            corrected one.
        path: The `calibration.json`.

    Raises:
        InputError: If one of them is of another run, or was edited.
    """
    run = str(document.get("run", "")).encode()
    with reading(path):
        listed = members(document)
    for name, content in listed.items():
        if PurePosixPath(name).suffix in PICTURES:
            continue
        try:
            data = read_bytes(path.parent / name)
        except InputError:
            continue
        if content is None:
            fits = run in data
        else:
            fits = sha256(data) == content or data == robot
        if not fits:
            raise InputError(
                f"not the file that '{path.name}' beside it was written with, but of "
                "another run or edited; keep the files of one run together, or remove "
                "this one",
                file=path.parent / name,
            )


def find_robot(name: str, content: str, path: Path) -> Robot:
    """The robot that was calibrated, recognized by its content.

    Where it was calibrated comes before the copy: meshes are beside the former.

    Args:
        name: Its file as it was given.
        content: Its SHA-256.
        path: The `calibration.json`.

    Raises:
        InputError: If there is only another one.
        RobotError: If there is none.
    """
    copy, other = path.parent / NOMINAL, None
    missing = RobotError(
        f"the robot '{name}' that was calibrated is neither there nor beside the "
        "calibration",
        file=path,
    )
    try:
        given = locate_robot(name)
        places = [given, path.parent / given, path.parent / given.name, copy]
    except RobotError as error:  # The package it came from is not installed here.
        missing, given, places = error, copy, [copy]
    if is_xacro(given):  # It was expanded, and what came of it is in the copy.
        places = [copy]
    for place in places:
        try:
            data = read_bytes(place)
        except InputError:
            continue
        if sha256(data) != content and place != copy:
            data = straight_source(data)
        if sha256(data) == content:
            kept = given if is_xacro(given) and given.is_file() else place
            there = kept == given and given != copy
            return parse_robot(data, name if there else str(place))
        other = other or place
    if other is None:
        raise missing
    raise InputError(
        f"'{other}' is not the robot that was calibrated: its content differs; keep "
        "the files of one run together",
        file=path,
    )


def written_before(path: Path) -> list[Path]:
    """Files that were written with a calibration and are still there.

    They are those of its manifest; of anything else, nothing is known.

    Args:
        path: The `calibration.json`, if there is one.

    Raises:
        OutputError: If what a killed run decided on cannot be put in place.
    """
    try:
        with settled(path.parent):
            names = members(read_document(path))
    except (InputError, ValueError):
        return []
    return [path.parent / name for name in names if (path.parent / name).is_file()]
