"""The folder of a calibration: one run wrote all of it, and it can be moved.

`calibration.json` has the id of the run and a manifest, the SHA-256 of every file that
was written with it. A URDF is known by its hash, so that it stays as it is. The page
says when it was made: it is known by the id, and has no hash, so that the same run
leaves the same manifest at any time.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Any

from calib_pin.errors import InputError
from calib_pin.io.calibration_file import read_document
from calib_pin.io.files import read_bytes
from calib_pin.io.journal import inside, settled, sha256
from calib_pin.io.json_text import Json, encode
from calib_pin.io.residual_model import FILE_NAME

DOCUMENT = "calibration.json"
REPORT = "report.html"
NOMINAL = "nominal.urdf"
"""Names in every folder: what was found, the page, and the robot as it was."""

Read = Callable[[str | Path], bytes]
"""What gives the bytes of a file."""

PICTURES = (".png", ".pdf", ".svg")
"""Endings of files from which no program takes a number: these may be edited."""


def urdf_name(robot: str) -> str:
    """Name of the corrected URDF of a robot.

    Example:
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
        "provenance": {
            k: v for k, v in about.items() if k not in ("command", "created")
        },
    }
    return sha256(encode(content) + (learned or b""))[:16]


@contextmanager
def opened(path: str | Path) -> Iterator[Read]:
    """The folder of a calibration for reading; no run writes to it meanwhile.

    Args:
        path: The `calibration.json`.

    Yields:
        What gives the bytes of the files in it.

    Raises:
        InputError: If a run was killed that cannot be completed.
        OutputError: If another program does not let go of the folder.
    """
    with settled(Path(path).parent) as waiting:

        def read(file: str | Path) -> bytes:
            return read_bytes(waiting.get(Path(file), Path(file)))

        yield read


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


def require_one_run(
    listed: Mapping[str, str | None], run: str, robot: bytes, path: Path, read: Read
) -> None:
    """Refuse a calibration among files that were not written with it.

    Those that are not there are not missed here; pictures may be edited.

    Args:
        listed: Its `members`.
        run: The id of its run.
        robot: The robot that was calibrated, which may stand in the place of the
            corrected one.
        path: The `calibration.json`.
        read: Gives the bytes of a file.

    Raises:
        InputError: If one of them is of another run, or was edited.
    """
    for name, content in listed.items():
        if PurePosixPath(name).suffix in PICTURES:
            continue
        try:
            data = read(path.parent / name)
        except InputError:
            continue
        if content is None:
            fits = run.encode() in data
        else:
            fits = sha256(data) == content or data == robot
        if not fits:
            raise InputError(
                f"not the file that '{path.name}' beside it was written with, but of "
                "another run or edited; keep the files of one run together, or remove "
                "this one",
                file=path.parent / name,
            )


def written_before(path: Path) -> list[Path]:
    """Files that were written with a calibration and are still there.

    They are those of its manifest. Earlier versions had none; what they wrote is
    recognized by its name and its content. Of anything else, nothing is known.

    Args:
        path: The `calibration.json`, if there is one.

    Raises:
        OutputError: If another program does not let go of the folder.
    """
    folder = path.parent
    try:
        with opened(path) as read:
            document = read_document(path, read)
            if "files" in document:
                names = list(members(document))
            else:
                names = list(_known(document, folder, read))
    except (InputError, KeyError, TypeError, ValueError, AttributeError):
        return []
    return [folder / name for name in names if (folder / name).is_file()]


def _known(document: Mapping[str, Any], folder: Path, read: Read) -> Iterator[str]:
    """Names of what a calibration without a manifest was written with."""
    robot, learned = document["robot"], document.get("residual_model")
    content = robot["sha256"]

    def holds(name: str, test: Callable[[bytes], bool]) -> bool:
        try:
            return test(read(folder / name))
        except InputError:
            return False

    name = re.escape(robot["name"]).encode()
    tag = re.compile(rb"<robot\s[^>]*name\s*=\s*[\"']" + name + rb"[\"']")
    urdf = urdf_name(robot["name"])
    if holds(urdf, lambda data: bool(tag.search(data)) and sha256(data) != content):
        yield urdf
    if learned and holds(FILE_NAME, lambda data: sha256(data) == learned["sha256"]):
        yield FILE_NAME
    if holds(REPORT, lambda data: content.encode() in data):
        yield REPORT
