"""Jobs of a fleet: their table, as CSV or YAML, and how workers do them.

A job is what `calibrate` can be asked for, with what a fleet needs beside it. Its cells
are taken as the options of a command line are. Done, it is a folder of results and a
row.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from inspect import signature
from itertools import groupby, pairwise
from operator import attrgetter
from pathlib import Path
from types import NoneType
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, get_args, get_type_hints

import calib_pin.io.results as results
from calib_pin.cli.asked import Calibrate, Fleet
from calib_pin.cli.calibrate import calibrated, open_inputs
from calib_pin.cli.files import beside
from calib_pin.cli.options import Request, Spec
from calib_pin.cli.printing import complaint, pop_notices
from calib_pin.cli.results import write_results
from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import CalibPinError, InputError, OptionError, nearest, one_line
from calib_pin.estimation.evidence import TRUSTED
from calib_pin.io.files import read_bytes, sha256
from calib_pin.io.table import read_table
from calib_pin.setup import DATE, Date, Entry
from calib_pin.setup.arguments import parse
from calib_pin.validation.comparison import compare
from calib_pin.validation.fleet import Drift, FleetRow, fleet_row, with_drift
from calib_pin.validation.robot_state import robot_evidence

if TYPE_CHECKING:
    from calib_pin.estimation.statistics.population_prior import RobotEvidence
    from calib_pin.validation.result import CalibrationResult

JOBS = "jobs"
"""Key of the list of jobs in YAML; those beside it hold for all jobs."""

CHAINED = ";"
"""Between files in a cell."""

FLAGS = dict(true=True, yes=True, on=True, false=False, no=False, off=False)
"""Cells that say whether something is so."""

PREVIOUS = Path("previous")
"""The `start` that is the calibration before of the same robot."""

SEPARATORS = '/\\:*?"<>|'
"""Letters that no folder of a job may have in its name, on any system."""


def _folder(text: str) -> str:
    name = text.strip()
    usable = name.isprintable() and not set(SEPARATORS) & set(name)
    if not name or not usable or name.startswith(".") or len(name) > 100:
        allowed = "a name for a folder, of at most 100 letters, without "
        raise OptionError("", allowed=f"{allowed}{SEPARATORS} and no point in front")
    return name


ENTRY, DAY = partial(parse, "", hint=Entry), partial(parse, "", hint=Date)


class Job(Request):
    """A calibration of a fleet. Its files are named from the folder of the table.

    A name of measurements may hold * for any letters; in a CSV table semicolons
    separate files. `start: previous` is the calibration before of the same serial
    number, in the table or in the folder of the results.

    Attributes:
        name: Name of its folder, unlike those of all others; by default the serial
            number with the date.
        serial_number: Serial number of the robot.
        date: Day of the measurements; of one serial number, the drift is told from
            the day before, or from the line before.
        previous: An earlier calibration of this robot, from which drift is told; None
            for the one before in the table.
        line: Line of the table.
        before: Name of the job before it with the same robot; empty for none.
    """

    name: Annotated[str, Spec(parse=_folder)] = ""
    serial_number: Annotated[str, Spec(parse=ENTRY)] = ""
    date: Annotated[str, Spec(parse=DAY)] = ""
    previous: Annotated[Path | None, Spec()] = None
    line: int = 0
    before: str = ""


HINTS = get_type_hints(Job, include_extras=True)
KEYS = {name: hint for name, hint in HINTS.items() if hasattr(hint, "__metadata__")}
"""Columns and keys of a job."""


# --- the table ----------------------------------------------------------------------


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
    every = [_job(path, line, cells) for line, cells in rows]
    if not every:
        raise InputError("the table has no jobs", file=path)
    jobs = dict[str, Job]()
    for number, job in enumerate(every, 1):
        name, line = job.name or _name(job, number, every), job.line
        if (twin := jobs.get(name.casefold())) is not None:
            reason = f"the job needs a 'name': it has the folder of line {twin.line}"
            raise InputError(reason, file=path, line=line, value=name)
        if job.start == PREVIOUS and not (job.serial_number or job.previous):
            reason = "'start: previous' needs a 'serial_number'"
            raise InputError(reason, file=path, line=line)
        jobs[name.casefold()] = replace(job, name=name)
    before, serial = dict[str, str](), attrgetter("serial_number")
    for robot, group in groupby(sorted(jobs.values(), key=serial), serial):
        series = list(group)
        if all(job.date for job in series):
            series.sort(key=attrgetter("date"))
        before |= {later.name: job.name for job, later in pairwise(series) if robot}
    return tuple(replace(j, before=before.get(j.name, "")) for j in jobs.values())


Cells = dict[str, tuple[str, int]]
"""Texts of a job and their lines, by its keys."""


def _of_yaml(path: str | Path) -> Iterator[tuple[int, Cells]]:
    """The lines and the cells of jobs."""
    from calib_pin.io.yaml_tree import read_tree

    tree = read_tree(path)
    listed = tree.data.get(JOBS) if isinstance(tree.data, dict) else None
    if not isinstance(listed, list) or not listed:
        allowed = f"{JOBS}: [{{robot: arm.urdf, measurements: [a.csv]}}, ...]"
        reason = f"the file must be a mapping with a list '{JOBS}'"
        raise tree.error(reason, (), allowed=allowed)
    for number, entry in enumerate(listed):
        if not isinstance(entry, dict):
            raise tree.error("a job is a mapping of keys to values", (JOBS, number))
        texts: Cells = {}
        for key, value in {**tree.data, **entry}.items():
            if key == JOBS or value is None:
                continue
            place = (JOBS, number, key) if key in entry else (key,)
            several = isinstance(value, list)
            cells = value if several else [value]
            if any(isinstance(cell, dict | list) for cell in cells):
                reason = f"'{key}' cannot have this value"
                raise tree.error(reason, place, allowed="a single value, or a list")
            places = [(*place, k) for k in range(len(cells))] if several else [place]
            text = CHAINED.join(str(tree.written(at)) for at in places)
            texts[key] = text, tree.line(place)
        yield tree.line((JOBS, number)), texts


def _of_csv(
    path: str | Path, notice: Callable[[str], None]
) -> Iterator[tuple[int, Cells]]:
    """The lines and the cells of jobs."""
    table = read_table(path, names=None)
    # A spreadsheet may call a column `Serial number`.
    plain = {name.casefold().replace(" ", "_"): name for name in table.columns}
    table = table.renamed(plain)
    foreign = [name for name in table.columns if name not in KEYS]
    for name in foreign:
        hint = nearest(name, KEYS)
        if hint or name in signature(Calibrate).parameters:
            raise table.error(f"no column of a job{hint}", name, ", ".join(KEYS))
    if remark := table.ignored(foreign):
        notice(remark)
    texts = table.texts(KEYS)
    for row, line in enumerate(table.lines.tolist()):
        cells = {k: (column[row], line) for k, column in texts.items() if column[row]}
        if cells:  # Spreadsheets write empty lines at the end.
            yield line, cells


def _job(path: str | Path, line: int, cells: Cells) -> Job:
    """A job by its cells.

    Raises:
        InputError: If a cell cannot be used.
    """
    folder, values = Path(path).parent, dict[str, Any](line=line)
    for key, (text, at) in cells.items():
        where: dict[str, Any] = {"file": path, "line": at}
        if key not in KEYS:
            reason = f"unknown key '{key}'{nearest(key, KEYS)}"
            raise InputError(reason, **where, allowed=", ".join(KEYS))
        try:
            values[key] = _value(key, text, folder)
        except OptionError as wrong:
            reason, where = f"'{key}' cannot have this value", where | {"value": text}
            raise InputError(reason, **where, allowed=wrong.allowed) from None
    for key in ("robot", "measurements"):
        if key not in values:
            raise InputError(f"'{key}' is missing", file=path, line=line)
    values["robot"] = beside(Path(path), values["robot"])
    return Job(**values)


def _value(key: str, text: str, folder: Path) -> Any:
    """The value of a key as a command line takes it, files as from this folder.

    Raises:
        OptionError: If it cannot be used.
    """
    hint, spec = get_args(KEYS[key])
    kind = get_args(hint)[0] if NoneType in get_args(hint) else hint
    if kind == list[Path]:
        names = [name.strip() for name in text.split(CHAINED) if name.strip()]
        if not names or len(set(names)) < len(names):
            raise OptionError("", allowed="files, each at most once")
        return [folder / file for file in names]
    if kind is Path:
        return PREVIOUS if (key, text) == ("start", "previous") else folder / text
    if kind is bool:
        if text.lower() not in FLAGS:
            raise OptionError("", allowed="true, false")
        return FLAGS[text.lower()]
    return (spec.parser(key, kind) or kind)(text)


def folder_name(serial: str) -> str:
    """The name of a folder by a serial number."""
    characters = (c if c.isalnum() or c in "._- " else "_" for c in serial)
    return "".join(characters).lstrip(".")


def _name(job: Job, number: int, every: Sequence[Job]) -> str:
    """The name of a job that states none."""
    if not (serial := job.serial_number):
        return f"job-{number:0{len(str(len(every)))}d}"
    alone = sum(other.serial_number == serial for other in every) == 1
    dated = (not alone or job.start == PREVIOUS) and job.date
    return folder_name(f"{serial}-{job.date}" if dated else serial)


# --- the work -----------------------------------------------------------------------


class Outcome(NamedTuple):
    """A row, and the evidence of a trusted calibration for the prior of its type."""

    row: FleetRow
    evidence: RobotEvidence | None = None


@serial_blas
def calibrate_job(shared: tuple[Path, Fleet], job: Job) -> Outcome:
    """Calibrate, write the folder of the results, and tell its row.

    Args:
        shared: The folder of the command, from which files are named, and what it asks
            for.
        job: The job.
    """
    home, asked = shared
    try:
        # Where there is no common file system, as on a cluster, this names the folder.
        os.chdir(home)
        folder = asked.output / job.name
        request = request_of(job, asked.output)
        pages = not asked.no_pages
        result = finished(folder, request, pages) if asked.resume else None
        if result is None:
            inputs = open_inputs(request, folder, force=True)
            result, contents = calibrated(inputs, page=pages)
            with write_results(result, folder, contents, force=True):
                pass
            # As the folder has it, so that who goes on later has the same bytes.
            result = results.read_result(folder)
        row = fleet_row(job.name, result, job.serial_number, job.date)
        row = _drifted(row, asked.output, job, result)
        return Outcome(row, _evidence(result))
    except Exception as error:  # One broken job stops nothing.
        return failed(job, one_line(complaint(error)))
    finally:
        pop_notices()


def failed(job: Job, reason: str) -> Outcome:
    """The outcome of a job that ended in an error."""
    return Outcome(FleetRow(job.name, job.serial_number, job.date, reason=reason))


def lost_job(job: Job) -> Outcome:
    """The outcome of a job over which workers died again and again."""
    return failed(job, "the process that calibrates it dies each time")


def _evidence(result: CalibrationResult) -> RobotEvidence | None:
    """The evidence of a calibration for its type; None where there is none."""
    try:
        return robot_evidence(result) if result.verdict in TRUSTED else None
    except InputError:  # Something was learned, say.
        return None


def _drifted(row: FleetRow, output: Path, job: Job, new: CalibrationResult) -> FleetRow:
    """The row of a calibration with its drift since the one before, if there is one."""
    name = str(job.previous or job.before)
    if not name:
        return row
    try:
        before = results.read_result(job.previous or output / name)
        return with_drift(row, compare(before, new), name)
    except CalibPinError as error:
        message = f"no drift from {name}: {error}"
        reason = one_line(f"{row.reason}; {message}" if row.reason else message)
        return replace(row, drift=Drift(name), reason=reason)


def request_of(job: Job, output: Path) -> Request:
    """The calibration that a job of a fleet with this output asks for.

    Raises:
        InputError: If no measurement file has a name of those with a *, or there is no
            calibration to go on from.
    """
    files: list[Path] = []
    for file in job.measurements:
        matches = sorted(file.parent.glob(file.name)) if "*" in file.name else [file]
        if not matches:
            raise InputError("no file has such a name", file=file)
        files += matches
    start = job.start
    if start == PREVIOUS:
        start = job.previous or _previous(job, output)
    return replace(job, measurements=files, start=start)


def _previous(job: Job, output: Path) -> Path:
    """The calibration before of the same serial number.

    Raises:
        InputError: If there is none.
    """
    if job.before:
        return output / job.before
    serial, earlier = folder_name(job.serial_number), list[str]()
    for name in (path.parent.name for path in output.glob(f"*/{results.DOCUMENT}")):
        day = DATE.fullmatch(name.removeprefix(f"{serial}-"))
        later = day and job.date and day[0] >= job.date
        if name == serial or (day and not later):
            earlier.append(name)
    if not earlier:
        reason = f"no earlier calibration of '{job.serial_number}', here or in {output}"
        raise InputError(f"'start: previous', and there is {reason}")
    return output / max(earlier)


def finished(folder: Path, request: Request, pages: bool) -> CalibrationResult | None:
    """The result that is there already; None where it is another one's, or not whole.

    It is the same if the command and the content of all files are.
    """
    robot = Path(request.robot)
    try:
        document, _ = results.read_document(folder / results.DOCUMENT)
        used = [*document["measurements"]["files"], document["setup_file"]]
        if robot.is_file():
            used.append({"file": robot, "sha256": document["robot"]["sha256"]})
        same = [
            tuple(document["provenance"]["command"]) == request.words(folder),
            results.REPORT in document["files"] or not pages,
            *(sha256(read_bytes(f["file"])) == f["sha256"] for f in used if f),
        ]
        if request.start is not None:
            begun = document["recalibration"]["steps"][-1]["created"]
            started, _ = results.read_document(results.document_file(request.start))
            same += [begun == started["provenance"]["created"]]
        return results.read_result(folder) if all(same) else None
    except (CalibPinError, KeyError, TypeError):
        return None
