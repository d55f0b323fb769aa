"""A calibration from files to files, as `calibrate` and every job of `fleet` run it."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import calib_pin.calibration as calibration
import calib_pin.cli.files as files_of
from calib_pin.cli import options, printing, results
from calib_pin.cli.results import draw_calibration
from calib_pin.io.measured_columns import place_of
from calib_pin.io.results import document_file
from calib_pin.io.urdf import other_robots
from calib_pin.kinematics.chains import Chains
from calib_pin.observations import Observations
from calib_pin.planning.suggestions import calibrated_setup, suggestions
from calib_pin.setup import Setup
from calib_pin.validation.model_selection import USES
from calib_pin.validation.result import CalibrationResult, Provenance, Suggestion
from calib_pin.workers import SERIAL, Workers


@dataclass(frozen=True)
class Opened:
    """The input of a calibration, read and checked.

    Attributes:
        request: What is asked for.
        setup: The setup with the options on top.
        chains: The nominal chains that were measured.
        measurements: The measurements.
        validation: Those of the validation file; None without one.
        output: Folder for the results; None where they are only printed.
        older: The older calibration to go on from; None without one.
    """

    request: options.Request
    setup: Setup
    chains: Chains
    measurements: Observations
    validation: Observations | None
    output: Path | None
    older: CalibrationResult | None = None

    def again(self, *_: object, **options: object) -> tuple[Chains, Observations]:
        """The chains and measurements, for who reads them as `open_measurements`."""
        return self.chains, self.measurements


@dataclass(frozen=True)
class Calibrated:
    """A calibration, with what its files need beside the result.

    Attributes:
        result: The result.
        suggestions: Suggested measurements.
        contents: All files and figures by their paths.
    """

    result: CalibrationResult
    suggestions: Sequence[Suggestion]
    contents: Mapping[Path, bytes]


def opened(
    request: options.Request,
    output: Path | None,
    pictures: Sequence[Path] = (),
    *,
    force: bool = False,
    quiet: bool = True,
    bar: printing.Bar | None = None,
) -> Opened:
    """Read the input of a calibration, and check where its results would go.

    Raises:
        InputError: If the input cannot be used.
        OptionError: If an option cannot, or results must not be written there.
    """
    rows_in = request.measurements
    further = [] if request.validation is None else [request.validation]
    older, stated = files_of.open_older(
        request.start, request.stated(), used=[*rows_in, *further]
    )
    chains = request.chains(stated)
    # None of them may be written.
    started = [] if request.start is None else [document_file(request.start)]
    inputs = [request.robot, request.setup, *started, *rows_in, *further]
    results.check_results(output, pictures, chains.robot, inputs, force)
    files_of.require_distinct([*rows_in, *further])
    chains, rows = request.read(rows_in, chains, stated, quiet=quiet, bar=bar)
    unseen = None
    if further:
        same = replace(stated, model="+".join(rows.models))
        sockets = map(place_of, rows.target.distinct)
        _, unseen = request.read(further, chains, same, quiet=True, sockets=sockets)
    if rows.validate.any() and (further or request.holdout is not None):
        option = "--validation" if further else "--holdout"
        reason = "the measurements that 'set' marks for validation are not used with"
        printing.notice(f"{reason} {option}")
    return Opened(request, stated, chains, rows, unseen, output, older)


def calibrated(
    opened: Opened,
    words: Sequence[str],
    pictures: Sequence[Path] = (),
    *,
    page: bool = True,
    bar: printing.Bar | None = None,
    workers: Workers = SERIAL,
) -> Calibrated:
    """Calibrate, and compose the files of the result.

    Args:
        opened: The input.
        words: The command line, for the provenance.
        pictures: Files of the figures.
        page: Whether there is a `report.html` among the files.
        bar: Told the progress.
        workers: Who fits the folds and candidates.
    """
    request, folder, setup = opened.request, opened.output, opened.setup
    shown = (folder is not None and page) or bool(pictures)
    start = time.perf_counter()
    given = options.same(request, calibration.calibrate) | {
        "setup": setup,
        "validation": opened.validation,
        "measurements": opened.measurements,
        "start": opened.older,
        "ladder": request.model_ladder or request.use is not None,
        "use": request.use or USES[0],
        "workers": workers,
    }
    others = partial(other_robots, opened.chains, setup)
    result = calibration.calibrate(opened.chains, **given, progress=bar, others=others)
    seconds = time.perf_counter() - start
    better = suggestions(
        opened.chains,
        opened.measurements.keys,
        calibrated_setup(result.model),
        result,
        seed=request.seed,
    )
    drawn = []
    if shown:
        drawn = draw_calibration(result, bar, request.package_dir)
    contents = results.figure_contents(drawn, pictures)
    if folder is not None:
        created = datetime.now(UTC).isoformat(timespec="seconds")
        made = Provenance.at(created, tuple(words), seconds)
        contents = results.result_contents(
            result, folder, made, drawn if page else None, contents, better
        )
    return Calibrated(result, better, contents)
