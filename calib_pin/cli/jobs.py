"""Tables of jobs: what is to be calibrated in a fleet, as CSV or YAML.

A job is what `calibrate` can be asked for, with what a fleet needs beside it. Its cells
are taken as the options of a command line are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from inspect import signature
from itertools import groupby, pairwise
from operator import attrgetter
from pathlib import Path
from types import NoneType
from typing import Annotated, Any, get_args, get_type_hints

from calib_pin.cli.calibrate import calibrate
from calib_pin.cli.request import Request, Told
from calib_pin.errors import InputError, OptionError, nearest
from calib_pin.io.table import read_table
from calib_pin.setup import Date, Entry
from calib_pin.setup.arguments import taken

JOBS = "jobs"
"""Key of the list of jobs in YAML; those beside it hold for all jobs."""

CHAINED = ";"
"""Between files in a cell."""

FLAGS = dict(true=True, yes=True, on=True, false=False, no=False, off=False)
"""Cells that say whether something is so."""

PREVIOUS = Path("previous")
"""The `start` that is the calibration before of the same robot."""

Texts = Mapping[str, list[str]]

SEPARATORS = '/\\:*?"<>|'
"""Letters that no folder of a job may have in its name, on any system."""


def _folder(text: str) -> str:
    name = text.strip()
    usable = name.isprintable() and not set(SEPARATORS) & set(name)
    if not name or not usable or name.startswith(".") or len(name) > 100:
        raise OptionError(
            "",
            allowed="a name for a folder, of at most 100 letters, without "
            f"{SEPARATORS} and no point in front",
        )
    return name


ENTRY, DATE = (partial(taken, "", hint=kind) for kind in (Entry, Date))


@dataclass(frozen=True)
class JobSetup(Request):
    """A calibration of a fleet. Its files are named from the folder of the table.

    A name of measurements may hold * for any letters; in a CSV table semicolons
    separate files. `start: previous` is the calibration before of the same serial
    number, in the table or in the folder of the results.

    Attributes:
        name: Name of its folder; None for the serial number with the date.
        serial_number: Serial number of the robot.
        date: Day of the measurements; of one serial number, the drift is told from
            the day before, or from the line before.
        previous: An earlier calibration of this robot, from which drift is told; None
            for the one before in the table.
    """

    name: Annotated[str | None, Told(parse=_folder)] = None
    serial_number: Annotated[str, Told(parse=ENTRY)] = ""
    date: Annotated[str | None, Told(parse=DATE)] = None
    previous: Annotated[Path | None, Told()] = None


KEYS = get_type_hints(JobSetup, include_extras=True)
"""Columns and keys of a job."""


@dataclass(frozen=True)
class Job:
    """A calibration that is asked for.

    Attributes:
        name: Name of its folder, unlike those of all other jobs.
        line: Line of the table.
        stated: Everything that is asked for, files from where the table lies.
        before: Name of the job before it with the same robot; empty for none.
    """

    name: str
    line: int
    stated: JobSetup
    before: str = ""


def read_jobs(
    path: str | Path, notice: Callable[[str], None] = lambda remark: None
) -> tuple[Job, ...]:
    r"""Read a table of jobs.

    Args:
        path: CSV file with a line for each job, or YAML (`.yaml`, `.yml`) with a list
            `jobs` and, beside it, what holds for all of them.
        notice: Told of columns that mean nothing.

    Raises:
        InputError: If the table cannot be used; names the first such line.

    Examples:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     file = Path(folder) / "jobs.csv"
        ...     _ = file.write_text("robot,measurements,serial_number\npa10,a.csv,A7\n")
        ...     [job.name for job in read_jobs(file)]
        ['A7']
    """
    yaml = Path(path).suffix.lower() in (".yaml", ".yml")
    rows = _of_yaml(path) if yaml else _of_csv(path, notice)
    found = [(lines[""], _job(path, lines, texts)) for lines, texts in rows]
    jobs = dict[str, Job]()
    for number, (line, stated) in enumerate(found, 1):
        name = stated.name or _name(stated, number, [job for _, job in found])
        if (twin := jobs.get(name.casefold())) is not None:
            reason = f"the job needs a 'name': it has the folder of line {twin.line}"
            raise InputError(reason, file=path, line=line, value=name)
        if stated.start == PREVIOUS and not (stated.serial_number or stated.previous):
            reason = "'start: previous' needs a 'serial_number'"
            raise InputError(reason, file=path, line=line)
        jobs[name.casefold()] = Job(name, line, stated)
    return _in_order([*jobs.values()])


Row = tuple[dict[str, int], dict[str, list[str]]]
"""Lines and texts of a job by its keys; its own line is that of the empty one."""


def _of_yaml(path: str | Path) -> Iterator[Row]:
    from calib_pin.io.yaml_tree import read_tree

    tree = read_tree(path)
    listed = tree.data.get(JOBS) if isinstance(tree.data, dict) else None
    if not isinstance(listed, list) or not listed:
        raise tree.error(
            f"the file must be a mapping with a list '{JOBS}'",
            (),
            allowed=f"{JOBS}: [{{robot: arm.urdf, measurements: [a.csv]}}, ...]",
        )
    for number, own in enumerate(listed):
        if not isinstance(own, dict):
            raise tree.error("a job is a mapping of keys to values", (JOBS, number))
        lines: dict[str, int] = {"": tree.line((JOBS, number))}
        texts: dict[str, list[str]] = {}
        for key, value in {**tree.data, **own}.items():
            place = (JOBS, number, key) if key in own else (key,)
            lines[key], several = tree.line(place), isinstance(value, list)
            places = [(*place, k) for k in range(len(value))] if several else [place]
            if key == JOBS or value is None:
                continue
            cells = value if several else [value]
            if any(isinstance(cell, dict | list) for cell in cells):
                reason = f"'{key}' cannot have this value"
                raise tree.error(reason, place, allowed="a single value, or a list")
            texts[key] = [str(tree.written(at)) for at in places]
        yield lines, texts


def _of_csv(path: str | Path, notice: Callable[[str], None]) -> Iterator[Row]:
    table = read_table(path)
    foreign = [name for name in table.columns if name not in KEYS]
    for name in foreign:
        hint = nearest(name, KEYS)
        if hint or name in signature(calibrate).parameters:
            raise table.error(f"no column of a job{hint}", name, ", ".join(KEYS))
    if remark := table.ignored(foreign):
        notice(remark)
    texts = table.texts([name for name in KEYS if name in table])
    for row, line in enumerate(table.lines.tolist()):
        yield {"": line}, {k: [cells[row]] for k, cells in texts.items() if cells[row]}


def _job(path: str | Path, lines: Mapping[str, int], given: Texts) -> JobSetup:
    """A job by its cells.

    Raises:
        InputError: If a cell cannot be used.
    """

    def error(key: str, reason: str, **told: Any) -> InputError:
        return InputError(reason, file=path, line=lines.get(key, lines[""]), **told)

    found, folder = dict[str, Any](), Path(path).parent
    for key, texts in given.items():
        if key not in KEYS:
            reason = f"unknown key '{key}'{nearest(key, KEYS)}"
            raise error(key, reason, allowed=", ".join(KEYS))
        try:
            found[key] = _value(key, texts, folder)
        except OptionError as wrong:
            reason, value = f"'{key}' cannot have this value", "; ".join(texts)
            raise error(key, reason, value=value, allowed=wrong.allowed) from None
    for key in ("robot", "measurements"):
        if key not in found:
            raise error(key, f"'{key}' is missing")
    # A robot may be a bundled one, and a xacro file has its arguments behind it.
    if (folder / found["robot"].split(" ")[0]).exists():
        found["robot"] = str(folder / found["robot"])
    return JobSetup(**found)


def _value(key: str, texts: Sequence[str], folder: Path) -> Any:
    """The value of a key as a command line takes it, files as from this folder.

    Raises:
        OptionError: If it cannot be used.
    """
    hint, told = get_args(KEYS[key])
    kind = get_args(hint)[0] if NoneType in get_args(hint) else hint
    if kind == list[Path]:
        found = [f.strip() for text in texts for f in text.split(CHAINED) if f.strip()]
        if not found or len(set(found)) < len(found):
            raise OptionError("", allowed="files, each at most once")
        return [folder / file for file in found]
    if len(texts) != 1 or (kind is bool and texts[0].lower() not in FLAGS):
        allowed = "true, false" if kind is bool else "one value"
        raise OptionError("", allowed=allowed)
    if kind is Path:
        return (
            PREVIOUS if (key, texts) == ("start", ["previous"]) else folder / texts[0]
        )
    return FLAGS[texts[0].lower()] if kind is bool else (told.parse or kind)(texts[0])


def folder_name(serial: str) -> str:
    """The name of a folder by a serial number."""
    kept = (c if c.isalnum() or c in "._- " else "_" for c in serial)
    return "".join(kept).lstrip(".")


def _name(stated: JobSetup, number: int, every: Sequence[JobSetup]) -> str:
    """The name of a job that states none."""
    serial = stated.serial_number
    if not serial:
        return f"job-{number:0{len(str(len(every)))}d}"
    alone = sum(other.serial_number == serial for other in every) == 1
    dated = not alone or stated.start == PREVIOUS
    return folder_name(f"{serial}-{stated.date}" if dated and stated.date else serial)


def _in_order(jobs: Sequence[Job]) -> tuple[Job, ...]:
    """The jobs, each with the name of the one before it of the same robot."""
    found, serial = dict[str, str](), attrgetter("stated.serial_number")
    for name, alike in groupby(sorted(jobs, key=serial), serial):
        own = list(alike)
        if all(job.stated.date for job in own):
            own.sort(key=attrgetter("stated.date"))
        found |= {later.name: job.name for job, later in pairwise(own) if name}
    return tuple(replace(job, before=found.get(job.name, "")) for job in jobs)
