"""`calib-pin accept`: an acceptance test in the terms of ISO 9283."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import calib_pin.cli.options as options
from calib_pin.cli.files import (
    check_outputs,
    exists,
    open_calibration,
    open_measurements,
    require_distinct,
    require_file,
)
from calib_pin.cli.options import dated
from calib_pin.cli.printing import notice, progress_bar
from calib_pin.cli.request import Told
from calib_pin.errors import stated_in

if TYPE_CHECKING:
    from collections.abc import Mapping

    from calib_pin.kinematics.chains import Chains
    from calib_pin.validation.result import CalibrationResult

PDF = "acceptance.pdf"


@dataclass(frozen=True, kw_only=True)
class Accept(options.QuietAnswer, options.OfRobot):
    """An acceptance test as it is asked for.

    Attributes:
        measurements: CSV files with the visits of poses, in their order.
        output: Folder for acceptance.json, .csv, .html and .pdf; without it the test is
            only printed.
        register: Fit the station of a calibration anew, never its tool.
        path: The poses are points of a path, measured in every cycle: AT, RT.
    """

    robot: options.RobotOrCalibration
    measurements: Annotated[list[Path], Told("MEASUREMENTS...")]
    output: Annotated[Path | None, Told("DIR", "Output")] = None
    register: Annotated[bool, Told("", "Robot")] = False
    path: Annotated[bool, Told("", "Robot")] = False


@options.spread
def accept(asked: Accept) -> int:
    """Test how accurately and repeatably a robot reaches poses, as ISO 9283 has it.

    Measurements of the same configuration are visits of one pose; columns 'pose' and
    'cycle' number them. The commanded pose is that of the robot's model, with base and
    tool of a calibration, or of the setup ('frames'), or registered on measurements
    that a column 'set' marks 'train' beside visits marked 'validate'. Otherwise they
    are fitted to the visits, and AP is not testable. 'limit' in the setup says what
    must be reached, 'report' what stands on the printed report; without it both are
    those of the calibration. A certified test needs the standard itself. Exit status 2:
    a limit is not reached, or the test does not decide.
    """
    from calib_pin.cli.documents import acceptance_document
    from calib_pin.io.json_text import encode
    from calib_pin.io.measurements import encode_table
    from calib_pin.io.results import read_result
    from calib_pin.report.acceptance_text import acceptance_report
    from calib_pin.report.cover import acceptance_cover
    from calib_pin.report.figures import Judged, drawn
    from calib_pin.report.html import acceptance_page
    from calib_pin.report.pdf import MISSING, can_write_pdf, pdf_report
    from calib_pin.setup import LimitSetup, ReportSetup
    from calib_pin.validation.acceptance import judged, tested

    stated, robot, measurements = asked.stated(), asked.robot, asked.measurements
    output, path = asked.output, asked.path
    limit, entries = stated.limit, stated.report
    subject: Chains | CalibrationResult
    doubts: list[str] = []
    require_file(robot, ", or a robot")
    if robot.endswith(".json"):
        calibrated, used = open_calibration(
            robot, asked.setup, stated, doubts.append, "limit", "report"
        )
        subject, chains = read_result(robot), calibrated.chains
        if limit == LimitSetup():
            limit = used.limit
        if entries == ReportSetup():
            # These of the calibration are not those of the test.
            entries = replace(
                used.report, date=None, temperature=None, load="", speed=""
            )
    else:
        used = stated
        chains = asked.chains(stated)
    require_distinct(measurements)
    files = []
    if output is not None:
        names = ["acceptance.json", "acceptance.csv", "acceptance.html"]
        files = [
            output / name for name in (*names, *([PDF] if can_write_pdf() else []))
        ]
    check_outputs(files, [robot, asked.setup, *measurements], asked.force)
    with progress_bar(quiet=asked.quiet) as bar:
        measured, rows = open_measurements(
            measurements, chains, used, quiet=asked.quiet, bar=bar
        )
        if not robot.endswith(".json"):
            subject = measured
        with stated_in(str(measurements[0])):
            named = _named(measurements, used.columns)
            found = tested(
                subject,
                rows,
                used,
                registration=asked.register,
                named=named,
                doubts=doubts,
            )
    for doubt in doubts:
        notice(doubt)
    blocks = [*acceptance_report(found.tests, limit, found.about, path=path)]
    contents = {}
    if output is not None:
        figure = next(drawn("acceptance", Judged(found.tests, limit, path)))
        cover = acceptance_cover(
            found.tests,
            limit,
            chains.robot,
            dated(entries),
            found.about,
            path=path,
            figure=figure,
        )
        contents = {
            output / "acceptance.json": encode(acceptance_document(found.tests, limit)),
            output / "acceptance.csv": encode_table(found.table(), [found.about]),
            output / "acceptance.html": acceptance_page(cover, blocks),
        }
        if can_write_pdf():
            contents[output / PDF] = pdf_report(cover, blocks)
        else:
            stays = (
                f"; {old} is not from this test" if exists(old := output / PDF) else ""
            )
            notice(f"no {PDF} is written: {MISSING}{stays}")
    written = {"written": [*map(str, files)]} if files else {}
    asked.give(
        contents,
        lambda: acceptance_document(found.tests, limit) | written,
        blocks,
        [f"wrote {file}" for file in files],
    )
    *_, last = found.tests.values()
    passed = all(status == "pass" for _, status, *_ in judged(last, limit))
    return 0 if passed and not last.doubts else 2


def _named(
    files: list[Path], columns: Mapping[str, str]
) -> dict[str, dict[tuple[str, int], int]]:
    """Numbers in columns `pose`, `P5` or `5`, and `cycle`, by file and line."""
    from calib_pin.io.table import read_table

    named: dict[str, dict[tuple[str, int], int]] = {"pose": {}, "cycle": {}}
    for table in (read_table(file, columns=columns) for file in files):
        for column, names in table.texts(named).items():
            for line, name in zip(table.lines.tolist(), names, strict=True):
                digits = name.removeprefix("P")
                if digits.isdecimal() and len(digits) < 6:
                    named[column][table.file, line] = int(digits)
    return named
