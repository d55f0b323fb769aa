"""Tables of jobs: what is to be calibrated in a fleet, as CSV or YAML."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

from calib_pin.errors import InputError, nearest
from calib_pin.io.setup import allowed_instead, context, wrong_value
from calib_pin.io.table import Table, read_table
from calib_pin.setup import JobSetup

if TYPE_CHECKING:
    from pydantic import ValidationError


KEYS = tuple(field.name for field in fields(JobSetup))
"""Columns and keys of a job."""

JOBS = "jobs"
"""Key of the list of jobs in YAML; those beside it hold for all jobs."""

CHAINED = ";"
"""Between files in a cell."""

FLAGS = {"true": True, "false": False}
"""Cells that say whether something is so."""

PREVIOUS = "previous"
"""The `start` that is the calibration before of the same robot."""

OF_FLEET = (
    *("cluster", "details", "figure_format", "figures", "force", "json", "output"),
    *("quiet", "workers"),
)
"""Options of `calibrate` that are those of the whole fleet, and no job has."""


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
    from pydantic import TypeAdapter, ValidationError

    folder, adapter = Path(path).parent, TypeAdapter(JobSetup)
    yaml = Path(path).suffix.lower() in (".yaml", ".yml")
    found = list[tuple[int, JobSetup]]()
    for line, given, blame in _of_yaml(path) if yaml else _of_csv(path, notice):
        for key in ("measurements", "package_dir"):
            if isinstance(files := given.get(key), str):
                given[key] = [f.strip() for f in files.split(CHAINED) if f.strip()]
        for key in ("model_ladder", "station_per_file"):
            given |= {key: FLAGS[t]} if (t := given.get(key)) in FLAGS else {}
        try:
            stated = adapter.validate_python(given, context=context())
        except ValidationError as error:
            raise blame(error) from None
        found.append((line, stated))
    jobs: list[Job] = []
    places: dict[str, int] = {}
    for number, (line, stated) in enumerate(found, 1):
        name = stated.name or _name(stated, number, found)
        if name.casefold() in places:
            raise InputError(
                f"the job has the folder of that in line {places[name.casefold()]}",
                file=path,
                line=line,
                value=name,
                allowed="a 'name' of its own",
            )
        places[name.casefold()] = line
        if stated.start == PREVIOUS and not (stated.serial_number or stated.previous):
            raise InputError(
                f"'start: {PREVIOUS}' needs a 'serial_number'", file=path, line=line
            )
        jobs.append(Job(name, line, _from(folder, stated)))
    before = _before(jobs)
    return tuple(replace(job, before=before.get(job.name, "")) for job in jobs)


Given = tuple[int, dict[str, Any], Callable[["ValidationError"], InputError]]
"""Line and keys of a job, and what blames them."""


def _of_yaml(path: str | Path) -> Iterator[Given]:
    from calib_pin.io.yaml_tree import read_tree

    tree = read_tree(path)
    listed = tree.data.get(JOBS) if isinstance(tree.data, dict) else None
    if not isinstance(listed, list) or not listed:
        raise tree.error(
            f"the file must be a mapping with a list '{JOBS}'",
            (),
            allowed=f"{JOBS}: [{{robot: arm.urdf, measurements: [a.csv]}}, ...]",
        )
    general = {key: value for key, value in tree.data.items() if key != JOBS}
    for number, own in enumerate(listed):
        if not isinstance(own, dict):
            raise tree.error("a job is a mapping of keys to values", (JOBS, number))

        def place(
            path: Sequence[str | int], number: int = number, own: Any = own
        ) -> Any:
            """Where a key stands: with the job, or with what holds for all."""
            alone = path and path[0] in general.keys() - own.keys()
            return path if alone else (JOBS, number, *path)

        blame = partial(wrong_value, tree, known=lambda path: KEYS, place=place)
        yield tree.line((JOBS, number)), {**general, **own}, blame


def _of_csv(path: str | Path, notice: Callable[[str], None]) -> Iterator[Given]:
    table = read_table(path)
    foreign = [name for name in table.columns if name not in KEYS]
    for name in foreign:
        hint = nearest(name, KEYS)
        if hint or name in OF_FLEET:
            raise table.error(f"no column of a job{hint}", name, ", ".join(KEYS))
    if remark := table.ignored(foreign):
        notice(remark)
    texts = table.texts([name for name in KEYS if name in table])
    for row, line in enumerate(table.lines.tolist()):
        cells = {name: column[row] for name, column in texts.items() if column[row]}
        yield line, cells, partial(_cell_error, table, row)


def _cell_error(table: Table, row: int, error: ValidationError) -> InputError:
    problem = error.errors(include_url=False)[0]
    name = str(problem["loc"][0])
    if problem["type"] == "missing":
        line = int(table.lines[row])
        return InputError(f"'{name}' is missing", file=table.file, line=line)
    reason = "the job cannot have this"
    return table.cell_error(reason, name, row, allowed_instead(problem))


def folder_name(serial: str) -> str:
    """The name of a folder by a serial number."""
    kept = (c if c.isalnum() or c in "._- " else "_" for c in serial)
    return "".join(kept).lstrip(".")


def _name(stated: JobSetup, number: int, found: Sequence[tuple[int, JobSetup]]) -> str:
    """The name of a job that states none."""
    serial = stated.serial_number
    if not serial:
        return f"job-{number:0{len(str(len(found)))}d}"
    alone = sum(other.serial_number == serial for _, other in found) == 1
    dated = not alone or stated.start == PREVIOUS
    return folder_name(f"{serial}-{stated.date}" if dated and stated.date else serial)


def _from(folder: Path, stated: JobSetup) -> JobSetup:
    """A job with its files named from here, not from the folder of the table."""
    keys = ["setup", "validation", "previous"]
    keys += [] if stated.start == PREVIOUS else ["start"]
    files = {key: getattr(stated, key) for key in keys}
    placed: dict[str, Any] = {k: str(folder / f) for k, f in files.items() if f}
    # A robot may be a bundled one, and a xacro file has its arguments behind it.
    there = (folder / stated.robot.split(" ")[0]).exists()
    return replace(
        stated,
        robot=str(folder / stated.robot) if there else stated.robot,
        measurements=tuple(str(folder / file) for file in stated.measurements),
        package_dir=tuple(str(folder / file) for file in stated.package_dir),
        **placed,
    )


def _before(jobs: Sequence[Job]) -> dict[str, str]:
    """For each job of a robot the job before it, by their names."""
    by_serial: dict[str, list[Job]] = {}
    for job in jobs:
        if job.stated.serial_number:
            by_serial.setdefault(job.stated.serial_number, []).append(job)
    found: dict[str, str] = {}
    for own in by_serial.values():
        if all(job.stated.date for job in own):
            own = sorted(own, key=lambda job: str(job.stated.date))
        found |= {later.name: job.name for job, later in pairwise(own)}
    return found
