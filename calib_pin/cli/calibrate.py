"""`calib-pin calibrate`: from a URDF and measurements to a corrected URDF."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from calib_pin.cli import options, printing, requests, results
from calib_pin.cli.asked import Calibrate
from calib_pin.estimation.evidence import TRUSTED
from calib_pin.io.results import calibration_document
from calib_pin.report import blocks, text
from calib_pin.report.blocks import Block


def calibrate(asked: Calibrate, words: Sequence[str]) -> int:
    """Do what `Calibrate` asks for."""
    force, quiet, details = asked.force, asked.quiet, asked.details
    pictures = results.figure_files(asked.figures, asked.figure_format, "calibration")
    with printing.progress_bar(quiet=quiet) as bar:
        given = requests.opened(
            asked, asked.output, pictures, force=force, quiet=quiet, bar=bar
        )
    with (
        printing.progress_bar(quiet=quiet) as bar,
        options.asked_workers(asked.workers, asked.cluster) as several,
    ):
        words = ("calib-pin", *words)
        found = requests.calibrated(given, words, pictures, bar=bar, workers=several)
    result, files, contents = found.result, given.files, found.contents

    def said() -> Iterator[Block]:
        yield from text.report(result, found.suggestions, details=details)
        if not details:
            more = f"{files.report}, or --details" if files else "--details"
            yield blocks.Line(f"Statistics and all parameters: {more}")

    def document() -> Mapping[str, Any] | bytes:
        if files is None:
            return calibration_document(result, suggestions=found.suggestions)
        return contents[files.json]

    def written() -> Iterator[str]:
        yield from (f"wrote {path}" for path in files or () if path in contents)
        yield from results.told_figures(found.pictures, pictures)

    writing = None
    if files is not None:
        writing = results.write_results(result, files, contents, force=force)
    asked.give(contents, document, said(), written(), writing)
    if (quiet or asked.json) and result.verdict not in TRUSTED:
        printing.notice(f"{result.verdict}: {result.reason}")
    return 0 if result.verdict in TRUSTED else 2
