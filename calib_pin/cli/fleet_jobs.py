"""The jobs of a fleet, as workers do them: a folder of results, and a row each."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from calib_pin.cli.jobs import PREVIOUS, Job, folder_name
from calib_pin.cli.printing import tell_notices
from calib_pin.cli.request import Request
from calib_pin.cli.requests import calibrated, opened
from calib_pin.cli.results import write_results
from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import CalibPinError, InputError, OptionError, one_line
from calib_pin.estimation.evidence import TRUSTED
from calib_pin.io.files import read_bytes, sha256
from calib_pin.io.results import (
    DOCUMENT,
    REPORT,
    document_file,
    read_document,
    read_result,
)
from calib_pin.setup import DATE
from calib_pin.validation.comparison import compare
from calib_pin.validation.fleet import Drift, FleetRow, fleet_row, with_drift
from calib_pin.validation.robot_state import robot_evidence

if TYPE_CHECKING:
    from calib_pin.estimation.statistics.population_prior import RobotEvidence
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

    def enter(self) -> None:
        """Make the process name files as the command does.

        Raises:
            OptionError: If the folder of the command is not there, as on a cluster
                without a common file system.
        """
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
    try:
        orders.enter()
        request = request_of(orders, job)
        result = finished(orders, job, request) if orders.resume else None
        if result is None:
            _calibrated(orders, job, request)
            # As the folder has it, so that who goes on later has the same bytes.
            result = read_result(orders.output / job.name)
        date = job.stated.date or ""
        row = fleet_row(job.name, result, job.stated.serial_number, date)
        return Outcome(row, _evidence(result))
    except CalibPinError as error:
        return failed(job, str(error))
    except OSError as error:
        reason = f"{error.filename or job.name}: {error.strerror or error}"
        return failed(job, reason)
    except Exception as error:  # One broken job stops nothing.
        return failed(job, one_line(f"{type(error).__name__}: {error}"))
    finally:
        tell_notices(forget=True)


def failed(job: Job, reason: str) -> Outcome:
    """The outcome of a job that ended in an error."""
    stated = job.stated
    row = FleetRow(job.name, stated.serial_number, stated.date or "", reason=reason)
    return Outcome(row)


def lost_job(job: Job) -> Outcome:
    """The outcome of a job over which workers died again and again."""
    return failed(job, "the process that calibrates it dies each time")


def _evidence(result: CalibrationResult) -> RobotEvidence | None:
    """The evidence of a calibration for its type; None where there is none."""
    try:
        return robot_evidence(result) if result.verdict in TRUSTED else None
    except InputError:  # Something was learned, say.
        return None


@serial_blas
def compare_job(orders: Orders, pair: tuple[FleetRow, Path, str]) -> FleetRow:
    """The row of a calibration with its drift.

    Args:
        orders: The orders.
        pair: Its row, the folder or file of the earlier calibration, and its name.
    """
    row, file, name = pair
    try:
        orders.enter()
        own = read_result(orders.output / row.job)
        return with_drift(row, compare(read_result(file), own), name)
    except CalibPinError as error:
        said = f"no drift from {name}: {error}"
        reason = one_line(f"{row.reason}; {said}" if row.reason else said)
        return replace(row, drift=Drift(name), reason=reason)


def request_of(orders: Orders, job: Job) -> Request:
    """The calibration that a job asks for.

    Raises:
        InputError: If no measurement file has a name of those with a *, or there is no
            calibration to go on from.
    """
    files: list[Path] = []
    for file in job.stated.measurements:
        alike = sorted(file.parent.glob(file.name)) if "*" in file.name else [file]
        if not alike:
            raise InputError("no file has such a name", file=file)
        files += alike
    start = job.stated.start
    if start == PREVIOUS:
        start = job.stated.previous or _before(orders, job)
    return replace(job.stated, measurements=files, start=start)


def _before(orders: Orders, job: Job) -> Path:
    """The calibration before of the same serial number.

    Raises:
        InputError: If there is none.
    """
    if job.before:
        return orders.output / job.before
    serial, found = folder_name(job.stated.serial_number), list[str]()
    for name in (path.parent.name for path in orders.output.glob(f"*/{DOCUMENT}")):
        day = DATE.fullmatch(name.removeprefix(f"{serial}-"))
        later = day and job.stated.date and day[0] >= job.stated.date
        if name == serial or (day and not later):
            found.append(name)
    if not found:
        raise InputError(
            "'start: previous', and there is no earlier calibration of serial number "
            f"'{job.stated.serial_number}' in the table or in {orders.output}"
        )
    return orders.output / max(found)


def _calibrated(orders: Orders, job: Job, request: Request) -> None:
    """Calibrate, and write the folder of the results."""
    folder = orders.output / job.name
    given = opened(request, folder, force=True)
    found = calibrated(given, request.words(folder), page=orders.pages)
    assert given.files is not None
    with write_results(found.result, given.files, found.contents, force=True):
        pass


def finished(orders: Orders, job: Job, request: Request) -> CalibrationResult | None:
    """The result that is there already; None where it is another one's, or not whole.

    It is the same if the command and the content of all files are.
    """
    folder, robot = orders.output / job.name, Path(request.robot)
    try:
        document, _ = read_document(folder / DOCUMENT)
        used = [*document["measurements"]["files"], document["setup_file"]]
        same = [sha256(read_bytes(f["file"])) == f["sha256"] for f in used if f]
        words = tuple(document["provenance"]["command"])
        same += [words == request.words(folder)]
        same += [REPORT in document["files"] or not orders.pages]
        if request.start is not None:
            begun = document["recalibration"]["steps"][-1]["created"]
            started, _ = read_document(document_file(request.start))
            same += [begun == started["provenance"]["created"]]
        result = read_result(folder) if all(same) else None
        if result is None or not robot.is_file():
            return result
        nominal = result.model.chains.robot.source
        return result if read_bytes(robot) == nominal else None
    except (CalibPinError, KeyError, TypeError):
        return None
