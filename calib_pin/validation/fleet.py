"""A fleet in rows: one calibration each, sorted by who needs attention."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from calib_pin.estimation.evidence import TRUSTED
from calib_pin.validation.comparison import Comparison, faults
from calib_pin.validation.result import CalibrationResult

FAILED = "failed"
"""Verdict of a job that ended in an error."""

ORDER = (FAILED, "untrusted", "unchecked")
"""Verdicts that need attention, the most urgent first."""


class Expected(NamedTuple):
    """Expected tool error over the workspace, root mean square [m].

    Attributes:
        nominal: Of the nominal robot.
        calibrated: Of the calibrated one.
        bound: Upper bound of that with 95 % confidence.
    """

    nominal: float = math.nan
    calibrated: float = math.nan
    bound: float = math.nan


class Drift(NamedTuple):
    """Difference of the tool points since an earlier calibration of the robot.

    Attributes:
        previous: Name of that calibration; empty if there is none.
        size: The difference over the workspace, root mean square [m].
        explained: The part of it that noise explains [m].
        beyond: Whether it is more than that.
    """

    previous: str = ""
    size: float = math.nan
    explained: float = math.nan
    beyond: bool = False


@dataclass(frozen=True)
class FleetRow:
    """A calibration of a fleet; see `fleet_columns` for `fleet.csv`.

    Attributes:
        job: Name of the job and of its folder.
        serial_number: Serial number of the robot.
        date: Day of the measurements.
        robot: Name of the robot in its URDF.
        verdict: The verdict; `failed` where the job ended in an error.
        reason: Why, in one sentence.
        quantity: The quantity whose errors are told.
        unit: Its unit.
        fitted: Number of fitted measurements.
        held_out: Number of held-out measurements.
        nominal: Error of the nominal robot on these, on the fitted ones where none is
            held out, root mean square [unit].
        calibrated: That of the calibrated robot.
        expected: Expected tool error.
        drift: Difference from an earlier calibration.
        outliers: Number of measurements that were set aside.
        findings: Codes of findings, errors and warnings.
    """

    job: str
    serial_number: str = ""
    date: str = ""
    robot: str = ""
    verdict: str = FAILED
    reason: str = ""
    quantity: str = ""
    unit: str = ""
    fitted: int = 0
    held_out: int = 0
    nominal: float = math.nan
    calibrated: float = math.nan
    expected: Expected = field(default_factory=Expected)
    drift: Drift = field(default_factory=Drift)
    outliers: int = 0
    findings: tuple[str, ...] = ()

    @property
    def trusted(self) -> bool:
        """Whether the calibration may be used."""
        return self.verdict in TRUSTED

    @property
    def urgency(self) -> tuple[int, float]:
        """Small where somebody has to look at it first."""
        level = (*ORDER, self.verdict).index(self.verdict)
        # Among equals the robot that is least accurate, and those of which that is
        # unknown before it.
        size = self.expected.calibrated
        level += level == len(ORDER) and not self.drift.beyond
        return level, -math.inf if math.isnan(size) else -size


def fleet_row(
    job: str, result: CalibrationResult, serial_number: str = "", date: str = ""
) -> FleetRow:
    """The row of a calibration.

    Args:
        job: Name of the job.
        result: The result.
        serial_number: Serial number; default that of the setup.
        date: Day of the measurements; default that of the setup.
    """
    error, report = result.errors[0], result.model.setup.report
    before, after = error.shown
    known = [a.workspace for a in result.accuracies.values() if a.workspace]
    worst = max(known, key=lambda accuracy: accuracy.calibrated.position, default=None)
    sizes = (worst.nominal, worst.calibrated, worst.bound) if worst else ()
    codes = [f.code for f in result.findings if f.severity != "info"]
    identity = serial_number or report.serial_number, date or report.date or ""
    verdict = result.verdict, result.reason, error.name, error.unit
    counts = len(result.fitted), result.validation.count
    return FleetRow(
        job,
        *identity,
        result.model.chains.robot.name,
        *verdict,
        *counts,
        before.rms,
        after.rms,
        Expected(*(size.position for size in sizes)),
        outliers=len(result.statistics.outliers),
        findings=tuple(dict.fromkeys(codes)),
    )


def with_drift(row: FleetRow, comparison: Comparison, previous: str) -> FleetRow:
    """A row with the drift from an earlier calibration.

    Args:
        row: The row.
        comparison: The comparison of the earlier calibration with its own.
        previous: Name of the earlier one.
    """
    size, explained = comparison.drift.position.rms, math.nan
    if comparison.drift.explained is not None:
        explained = comparison.drift.explained[0]
    codes = (*row.findings, *(fault.code for fault in faults(comparison)))
    drift = Drift(previous, size, explained, bool(comparison.drifted))
    return replace(row, drift=drift, findings=tuple(dict.fromkeys(codes)))


def by_urgency(rows: Iterable[FleetRow]) -> tuple[FleetRow, ...]:
    """The rows, those that need attention first; among equals in their order."""
    return tuple(sorted(rows, key=lambda row: row.urgency))


def fleet_columns(rows: Iterable[FleetRow]) -> dict[str, list[object]]:
    """The columns of `fleet.csv`; what is unknown is empty.

    Examples:
        >>> list(fleet_columns([FleetRow("a")]))[-3:]
        ['drift_beyond', 'outliers', 'findings']
    """
    columns: dict[str, list[object]] = {}
    for row in rows:
        for column, value in vars(row).items():
            parts = value._asdict() if hasattr(value, "_asdict") else {"": value}
            for part, item in parts.items():
                cell = " ".join(item) if isinstance(item, tuple) else item
                unknown = isinstance(item, float) and math.isnan(item)
                cells = columns.setdefault(f"{column}_{part}".rstrip("_"), [])
                cells.append("" if unknown else cell)
    return columns
