"""`calib-pin report`: page and figures of a calibration again, from its files alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from calib_pin.cli import files, printing, results
from calib_pin.cli.asked import Report
from calib_pin.cli.results import draw_calibration
from calib_pin.io.measurement_errors import MEASUREMENTS
from calib_pin.io.results import REPORT, document_file, read_written
from calib_pin.report.cover import calibration_cover
from calib_pin.report.html import html_report, provenance_blocks
from calib_pin.report.pdf import pdf_report, require_pdf
from calib_pin.report.text import report as blocks


def report(asked: Report) -> int:
    """Do what `Report` asks for."""
    pdf = asked.pdf
    if pdf is not None:
        require_pdf()
    files.require_folders(asked.package_dir or [])
    file = document_file(asked.calibration)
    result, document = read_written(file)
    robot, written = result.model.chains.robot, document.get("files", {})
    page = asked.output or file.parent / REPORT
    renews = asked.output is None and REPORT in written
    pictures = results.figure_files(asked)
    inputs: list[str | Path] = [file, file.parent / MEASUREMENTS, robot.file]
    files.check_outputs([page, pdf, *pictures], inputs, asked.force or renews)
    files.check_outputs([pdf], inputs, asked.force)
    if MEASUREMENTS not in written:
        printing.notice(
            f"{file} has no {MEASUREMENTS}: nothing is known of single measurements"
        )
    with printing.progress_bar(quiet=asked.quiet) as bar:
        drawn = draw_calibration(result, bar, asked.package_dir)
        text = html_report(result, document, figures=drawn)
        contents = {page: text}
        if pdf is not None:
            entries = results.dated(result.model.setup.report)
            cover = calibration_cover(result, entries, drawn)
            annex = blocks(result, details=True, formulae=False)
            contents[pdf] = pdf_report(cover, [*annex, *provenance_blocks(document)])
        made = [f"wrote {file}" for file in contents]
        contents |= results.figure_contents(drawn, pictures)
    made += results.figure_notes(contents, pictures)
    replace(asked, force=asked.force or renews).give(contents, blocks(result), made)
    return asked.ended(result.verdict, result.reason, reported=not asked.quiet)
