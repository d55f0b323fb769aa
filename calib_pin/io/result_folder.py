"""The folder of a calibration: one run wrote all of it, and it can be moved.

`calibration.json` has the id of the run and a manifest, the SHA-256 of every file that
was written with it. A URDF is known by its hash, so that it stays as it is. The page
says when it was made: it is known by the id, and has no hash, so that the same run
leaves the same manifest at any time.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from reprlib import repr
from typing import Any

from calib_pin.errors import CalibPinError, InputError
from calib_pin.io.files import DATA, read_bytes
from calib_pin.io.journal import inside, settled, sha256
from calib_pin.io.json_text import Json, decode, encode, require_format, typed
from calib_pin.units import DISPLAY
from calib_pin.validation.accuracy import Accuracy, QuantityErrors

FORMAT, VERSION = "calib-pin/calibration", 1
"""The format that is read, and its newest version."""

JSON = 1 << 28
"""Bytes of the largest document: its objects take many times as much memory."""

LARGEST = 1e6
"""Largest number that a value, a position or an offset can be [m, rad, px]."""


def read_document(
    path: str | Path, read: Callable[[str | Path], bytes] = read_bytes
) -> Json:
    """The content of a `calibration.json`.

    Args:
        path: The file.
        read: Gives its bytes.

    Raises:
        InputError: If the file is not such a document or of a later version.
    """
    try:
        document = decode(read(path))
    except RecursionError as error:
        raise InputError("not a calibration of calib-pin", file=path) from error
    except ValueError as error:
        line = getattr(error, "lineno", None)
        reason = f"not a calibration: {getattr(error, 'msg', error)}"
        raise InputError(reason, file=path, line=line) from error
    return require_format(document, "calibration", FORMAT, VERSION, path)


@contextmanager
def reading(path: str | Path) -> Iterator[None]:
    """Turn what goes wrong with the parts of a document into one line.

    Raises:
        InputError: If a part is missing or is not what it should be.
    """
    try:
        yield
    except KeyError as error:
        reason = f"damaged or edited calibration: {error} is missing"
        raise InputError(reason, file=path) from error
    except (CalibPinError, TypeError, ValueError, AttributeError) as error:
        reason = f"damaged or edited calibration: {error}"
        raise InputError(reason, file=path) from error


def stated_errors(document: Json) -> tuple[tuple[QuantityErrors, str], ...]:
    """Accuracy by quantity, each with how it was validated.

    Raises:
        KeyError, TypeError, ValueError, AttributeError: See `reading`.
    """
    result = []
    for name, entry in document["errors"].items():
        training, validation = entry["training"], entry["validation"]
        unit = text(entry["unit"])
        if unit not in DISPLAY:
            raise ValueError(f"{repr(unit)} is no unit of '{name}'")
        fitted = (_accuracy(training[stage]) for stage in ("before", "after"))
        unseen = (
            None if validation[stage] is None else _accuracy(validation[stage])
            for stage in ("before", "after")
        )
        errors = QuantityErrors(name, unit, *fitted, *unseen)
        result.append((errors, text(validation["method"])))
    return tuple(result)


def _accuracy(entry: Mapping[str, Any]) -> Accuracy:
    return typed(Accuracy, {"p95": None, **entry})  # Older files have no 95 %.


def text(value: object) -> str:
    """A name.

    Raises:
        ValueError: If it is none, or empty.
    """
    if not isinstance(value, str) or not value:
        raise ValueError(f"{repr(value)} stands in the place of a name")
    return value


def numbers(values: Sequence[object], count: int | None = None) -> list[float]:
    """Finite numbers, of a count where that is known.

    Raises:
        ValueError: If there are more or fewer, or one is no such number.
    """
    if count is not None and len(values) != count:
        raise ValueError(f"{len(values)} numbers stand in the place of {count}")
    for value in values:
        number = isinstance(value, float | int) and not isinstance(value, bool)
        # Python reads NaN, Infinity and numbers of any length, JSON knows none.
        if not number or not abs(value) < LARGEST:  # type: ignore[arg-type]
            raise ValueError(f"{repr(value)} stands in the place of a number")
    return [float(value) for value in values]  # type: ignore[arg-type]


DOCUMENT = "calibration.json"
REPORT = "report.html"
NOMINAL = "nominal.urdf"
MEASUREMENTS = "measurements.csv"
RESIDUAL_MODEL = "residual_model.json"
"""Names in a folder: the result, the page, the robot as it was, the errors of the
measurements, and what was learned."""

Read = Callable[[str | Path], bytes]
"""Gives the bytes of a file."""

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


@contextmanager
def opened(path: str | Path) -> Iterator[Read]:
    """The folder of a calibration for reading; no run writes to it meanwhile.

    Args:
        path: The `calibration.json`.

    Yields:
        A function that returns the bytes of the files in it.

    Raises:
        InputError: If a run was killed that cannot be completed.
        OutputError: If another program does not let go of the folder.
    """
    with settled(Path(path).parent) as waiting:

        def read(file: str | Path) -> bytes:
            path = Path(file)
            largest = JSON if path.suffix == ".json" else DATA
            return read_bytes(waiting.get(path, path), largest)

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
    if learned and holds(
        RESIDUAL_MODEL, lambda data: sha256(data) == learned["sha256"]
    ):
        yield RESIDUAL_MODEL
    if holds(REPORT, lambda data: content.encode() in data):
        yield REPORT
