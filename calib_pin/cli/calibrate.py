"""`calib-pin calibrate`: from a URDF and measurements to a corrected URDF."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from calib_pin.cli import options, printing, requests, results
from calib_pin.cli.asked import Calibrate
from calib_pin.io.files import write_files
from calib_pin.io.json_text import encode
from calib_pin.io.results import DOCUMENT, REPORT, calibration_document
from calib_pin.report import blocks, text
from calib_pin.report.blocks import Block


def calibrate(asked: Calibrate, words: Sequence[str]) -> int:
    """Do what `Calibrate` asks for."""
    force, quiet, details = asked.force, asked.quiet, asked.details
    pictures, folder = results.figure_files(asked), asked.output
    with printing.progress_bar(quiet=quiet) as bar:
        given = requests.opened(
            asked, folder, pictures, force=force, quiet=quiet, bar=bar
        )
    with (
        printing.progress_bar(quiet=quiet) as bar,
        options.asked_workers(asked.workers, asked.cluster) as several,
    ):
        words = ("calib-pin", *words)
        found = requests.calibrated(given, words, pictures, bar=bar, workers=several)
    result, contents = found.result, found.contents
    robot = result.model.chains.robot
    files = [] if folder is None else results.result_files(folder, robot)

    def said() -> Iterator[Block]:
        yield from text.report(result, found.suggestions, details=details)
        if not details:
            more = f"{folder / REPORT}, or --details" if folder else "--details"
            yield blocks.Line(f"Statistics and all parameters: {more}")

    def document() -> bytes:
        if folder is not None:
            return contents[folder / DOCUMENT]
        return encode(calibration_document(result, suggestions=found.suggestions))

    told = not (quiet or asked.json)
    if folder is None:
        writing = write_files(contents, force=force)
    else:
        writing = results.write_results(result, folder, contents, force=force)
    # Nothing is written if nothing can be said, as to a full disk.
    with writing:
        if asked.json:
            printing.say(document().decode())
        elif told:
            printing.show(said())
    if told:
        wrote = [f"wrote {path}" for path in files if path in contents]
        wrote += results.told_figures(contents, pictures)
        printing.say_written(wrote)
    return asked.ended(result.verdict, result.reason, told=told)
