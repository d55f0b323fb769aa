"""The jobs of a fleet, as workers do them: a folder of results, and a row each."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from calib_pin.cli.printing import tell_notices
from calib_pin.cli.requests import Request, calibrated, opened
from calib_pin.cli.results import write_results
from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import CalibPinError, InputError, OptionError, one_line
from calib_pin.estimation.evidence import TRUSTED
from calib_pin.io.results import DOCUMENT, REPORT, document_file, read_document
from calib_pin.setup.printing import DATE
from calib_pin.validation.fleet import Drift, FleetRow, fleet_row, with_drift

if TYPE_CHECKING:
    from calib_pin.estimation.statistics.population_prior import RobotEvidence
    from calib_pin.io.jobs import Job
    from calib_pin.validation.result import CalibrationResult


@dataclass(frozen=True)
class Orders:
    """The orders that all jobs of a fleet share.

    Attributes:
        home: Folder from which files are named, that of the command.
        output: Folder of the fleet.
        pages: Whether each calibration gets its `report.html`.
        resume: Whether a finished calibration of the same files stays.
    """

    home: Path
    output: Path
    pages: bool = True
    resume: bool = False

    def folder(self, name: str) -> Path:
        """Folder of the results of a job."""
        return self.output / name

    def enter(self) -> None:
        """Make the process name files as the command does.

        Raises:
            OptionError: If the folder of the command is not there, as on a cluster
                without a common file system.
        """
        if Path.cwd() == self.home:
            return
        try:
            os.chdir(self.home)
        except OSError as error:
            raise OptionError(
                "workers do not see this folder; all of a cluster need the same files",
                file=self.home,
            ) from error


class Outcome(NamedTuple):
    """A row, and the evidence of a trusted calibration for the prior of its type."""

    row: FleetRow
    evidence: RobotEvidence | None = None


@serial_blas
def calibrate_job(orders: Orders, job: Job) -> Outcome:
    """Calibrate, write the folder of the results, and tell its row."""
    from calib_pin.io.results import read_result

    blank = _blank(job)
    try:
        orders.enter()
        result = _finished(orders, job) if orders.resume else None
        if result is None:
            _calibrated(orders, job)
            # As the folder has it, so that who goes on later has the same bytes.
            result = read_result(orders.folder(job.name))
        row = fleet_row(job.name, result, blank.serial_number, blank.date)
        return Outcome(row, _evidence(result))
    except CalibPinError as error:
        reason = str(error)
    except OSError as error:
        reason = f"{error.filename or job.name}: {error.strerror or error}"
    except Exception as error:  # One broken job stops nothing.
        reason = one_line(f"{type(error).__name__}: {error}")
    finally:
        tell_notices(forget=True)
    return Outcome(replace(blank, reason=reason))


def _blank(job: Job) -> FleetRow:
    """The row of a job before anything is known of it."""
    return FleetRow(job.name, job.stated.serial_number, job.stated.date or "")


def lost_job(job: Job) -> Outcome:
    """The outcome of a job over which workers died again and again."""
    reason = "the process that calibrates it dies each time"
    return Outcome(replace(_blank(job), reason=reason))


def _evidence(result: CalibrationResult) -> RobotEvidence | None:
    """The evidence of a calibration for its type; None where there is none."""
    from calib_pin.validation.robot_state import robot_evidence

    if result.verdict not in TRUSTED:
        return None
    try:
        return robot_evidence(result)
    except InputError:  # Something was learned, say.
        return None


@dataclass(frozen=True)
class Successor:
    """A calibration whose drift is to be told.

    Attributes:
        row: Its row.
        previous: Folder or `calibration.json` of the earlier one, and its name.
    """

    row: FleetRow
    previous: tuple[Path, str]


@serial_blas
def compare_job(orders: Orders, pair: Successor) -> FleetRow:
    """The row of a calibration with its drift."""
    from calib_pin.io.results import read_result
    from calib_pin.validation.comparison import compare

    row, (file, name) = pair.row, pair.previous
    try:
        orders.enter()
        own = read_result(orders.folder(row.job))
        return with_drift(row, compare(read_result(file), own), name)
    except CalibPinError as error:
        said = f"no drift from {name}: {error}"
        reason = one_line(f"{row.reason}; {said}" if row.reason else said)
        return replace(row, drift=Drift(name), reason=reason)


def _request(orders: Orders, job: Job) -> Request:
    """The calibration that a job asks for.

    Raises:
        InputError: If no measurement file has a name of those with a *, or there is no
            calibration to go on from.
    """
    stated = job.stated
    files: list[Path] = []
    for file in map(Path, stated.measurements):
        alike = "*" in file.name
        found = sorted(file.parent.glob(file.name)) if alike else [file]
        if not found:
            raise InputError("no file has such a name", file=file)
        files += found
    names = Request.__dataclass_fields__
    values = {key: value for key, value in vars(stated).items() if key in names}
    for key in ("setup", "validation"):
        values[key] = None if values[key] is None else Path(values[key])
    values["measurements"] = tuple(files)
    values["package_dir"] = tuple(map(Path, stated.package_dir))
    use = stated.use or ("both" if stated.model_ladder else None)
    return Request(**{**values, "use": use, "start": start_of(orders, job)})


def start_of(orders: Orders, job: Job) -> Path | None:
    """The older calibration that a job goes on from; None where it does not.

    Raises:
        InputError: If there is none before of its serial number.
    """
    from calib_pin.io.jobs import PREVIOUS, folder_name

    stated = job.stated
    if stated.start != PREVIOUS:
        return None if stated.start is None else Path(stated.start)
    if stated.previous is not None:
        return Path(stated.previous)
    if job.before:
        return orders.folder(job.before)
    folders, found = orders.output.glob(f"*/{DOCUMENT}"), list[str]()
    serial = folder_name(stated.serial_number)
    for name in (path.parent.name for path in folders):
        day = DATE.fullmatch(name.removeprefix(f"{serial}-"))
        if name == serial or (day and not (stated.date and day[0] >= stated.date)):
            found.append(name)
    if not found:
        raise InputError(
            f"'start: {PREVIOUS}', and there is no earlier calibration of serial "
            f"number '{stated.serial_number}' in the table or in {orders.output}"
        )
    return orders.folder(max(found))


def _calibrated(orders: Orders, job: Job) -> None:
    """Calibrate, and write the folder of the results."""
    request, folder = _request(orders, job), orders.folder(job.name)
    given = opened(request, folder, force=True)
    found = calibrated(given, request.words(folder), page=orders.pages)
    assert given.files is not None
    with write_results(found.result, given.files, found.contents, force=True):
        pass


def _finished(orders: Orders, job: Job) -> CalibrationResult | None:
    """The result that is there already; None where it is another one's, or not whole.

    It is the same if the command and the content of all files are.
    """
    from calib_pin.io.files import read_bytes, sha256
    from calib_pin.io.results import read_result

    request, folder = _request(orders, job), orders.folder(job.name)
    try:
        document = read_document(folder / DOCUMENT)
        used = [*document["measurements"]["files"], *_stated(document)]
        there = all(sha256(read_bytes(f["file"])) == f["sha256"] for f in used)
        words = tuple(document["provenance"]["command"])
        complete = REPORT in document["files"] or not orders.pages
        if request.start is not None:
            begun = document["recalibration"]["steps"][-1]["created"]
            started = read_document(document_file(request.start))
            there &= begun == started["provenance"]["created"]
        if not there or not complete or words != request.words(folder):
            return None
        result = read_result(folder)
        robot = Path(request.robot)
        nominal = result.model.chains.robot.source
        same = not robot.is_file() or read_bytes(robot) == nominal
        return result if same else None
    except (CalibPinError, KeyError, TypeError):
        return None


def _stated(document: dict[str, object]) -> Sequence[dict[str, str]]:
    """The setup file of a calibration, where there is one."""
    file = document["setup_file"]
    return [file] if isinstance(file, dict) else []
