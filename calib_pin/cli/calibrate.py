"""`calib-pin calibrate`: from a URDF and measurements to a corrected URDF.

Every job of `fleet`, the page of `app` and `watch` take the same steps.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import calib_pin.calibration as calibration
import calib_pin.cli.files as files_of
import calib_pin.io.results as documents
from calib_pin.cli import options, printing, results
from calib_pin.cli.asked import Calibrate
from calib_pin.cli.results import draw_calibration
from calib_pin.io.json_text import encode
from calib_pin.io.measured_columns import place_of
from calib_pin.io.results import DOCUMENT, NOMINAL, REPORT
from calib_pin.io.urdf import is_source, other_robots
from calib_pin.kinematics.chains import Chains
from calib_pin.observations import Observations
from calib_pin.planning.suggestions import with_suggestions
from calib_pin.report import blocks, text
from calib_pin.report.folder import result_contents, result_files
from calib_pin.setup import Setup
from calib_pin.validation.model_selection import USES
from calib_pin.validation.result import CalibrationResult, Provenance
from calib_pin.workers.base import SERIAL, Workers


def calibrate(asked: Calibrate, words: Sequence[str]) -> int:
    """Do what `Calibrate` asks for."""
    pictures, folder = results.figure_files(asked), asked.output
    with printing.progress_bar(quiet=asked.quiet) as bar:
        inputs = open_inputs(asked, folder, pictures, force=asked.force, bar=bar)
        with options.asked_workers(asked.workers, asked.cluster) as several:
            words = ("calib-pin", *words)
            result, contents = calibrated(inputs, words, bar=bar, workers=several)
    verbose = not (asked.quiet or asked.json)
    # Nothing is written if nothing can be said, as to a full disk.
    with results.write_results(result, folder, contents, force=asked.force):
        if asked.json:
            written = folder and contents[folder / DOCUMENT]
            document = written or encode(documents.calibration_document(result))
            printing.say(document.decode())
        elif verbose:
            report = [*text.report(result, details=asked.details)]
            if not asked.details:
                more = f"{folder / REPORT}, or --details" if folder else "--details"
                report.append(blocks.Line(f"Statistics and all parameters: {more}"))
            printing.show(report)
    if verbose:
        robot = result.model.chains.robot
        files = [] if folder is None else result_files(folder, robot)
        wrote = [f"wrote {path}" for path in files if path in contents]
        wrote += results.figure_notes(contents, pictures)
        printing.say_written(wrote)
    return asked.ended(result.verdict, result.reason, reported=verbose)


@dataclass(frozen=True)
class Inputs:
    """The input of a calibration, read and checked.

    Attributes:
        request: What is asked for.
        setup: The setup with the options on top.
        chains: The nominal chains that were measured.
        measurements: The measurements.
        validation: Those of the validation file; None without one.
        output: Folder for the results; None where they are only printed.
        pictures: Files of the figures.
        start: The older calibration to go on from; None without one.
    """

    request: options.Request
    setup: Setup
    chains: Chains
    measurements: Observations
    validation: Observations | None
    output: Path | None
    pictures: Sequence[Path]
    start: CalibrationResult | None


def open_inputs(
    request: options.Request,
    output: Path | None,
    pictures: Sequence[Path] = (),
    *,
    force: bool = False,
    bar: printing.Bar | None = None,
) -> Inputs:
    """Read the input of a calibration, and check where its results would go.

    Raises:
        InputError: If the input cannot be used.
        OptionError: If an option cannot, or results must not be written there.
    """
    paths = request.measurements
    further = [] if request.validation is None else [request.validation]
    older, setup = files_of.open_older(
        request.start, files_of.setup_for(request), used=[*paths, *further]
    )
    chains = files_of.open_chains(request, setup)
    # None of them may be written.
    started = [] if request.start is None else [documents.document_file(request.start)]
    inputs = [request.robot, request.setup, *started, *paths, *further]
    outputs = dict.fromkeys(pictures)
    if output is not None:
        # Files of an earlier run go; its nominal robot may be calibrated again.
        nominal = output / NOMINAL
        sources = [nominal] * is_source(nominal, chains.robot)
        written = documents.written_before(output / DOCUMENT)
        written = [*result_files(output, chains.robot), *written]
        outputs |= dict.fromkeys(path for path in written if path not in sources)
    files_of.check_outputs(outputs, inputs, force)
    files_of.require_distinct([*paths, *further])
    chains, rows = files_of.open_rows(request, paths, chains, setup, bar=bar)
    validation = None
    if further:
        same = replace(setup, model="+".join(rows.models))
        sockets = map(place_of, rows.target.distinct)
        _, validation = files_of.open_rows(
            request, further, chains, same, quiet=True, sockets=sockets
        )
    if rows.validate.any() and (further or request.holdout is not None):
        option = "--validation" if further else "--holdout"
        reason = "the measurements that 'set' marks for validation are not used with"
        printing.notice(f"{reason} {option}")
    return Inputs(request, setup, chains, rows, validation, output, pictures, older)


def calibrated(
    inputs: Inputs,
    words: Sequence[str] = (),
    *,
    page: bool = True,
    bar: printing.Bar | None = None,
    workers: Workers = SERIAL,
) -> tuple[CalibrationResult, Mapping[Path, bytes]]:
    """Calibrate, and compose all files and figures of the result, by their paths.

    Args:
        inputs: The input.
        words: The command line, for the provenance; default that of `calibrate`.
        page: Whether there is a `report.html` among the files.
        bar: Told the progress.
        workers: Who fits the folds and candidates.
    """
    request, folder = inputs.request, inputs.output
    start = time.perf_counter()
    fit = calibration.calibrate
    given = options.same(request, fit) | options.same(inputs, fit)
    given["ladder"] = request.model_ladder or request.use is not None
    given |= {"use": request.use or USES[0], "workers": workers}
    given["others"] = partial(other_robots, inputs.chains, inputs.setup)
    result = fit(**given, progress=bar)
    seconds = time.perf_counter() - start
    result = with_suggestions(result)
    drawn = []
    if inputs.pictures or (page and folder is not None):
        drawn = draw_calibration(result, bar, request.package_dir)
    contents = results.figure_contents(drawn, inputs.pictures)
    if folder is not None:
        created = datetime.now(UTC).isoformat(timespec="seconds")
        command = tuple(words) or request.words(folder)
        made = Provenance.at(created, command, seconds)
        contents = result_contents(
            result, folder, made, drawn if page else None, contents
        )
    return result, contents
