"""A calibration from files to files, as `calibrate` and every job of `fleet` run it."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING

from calib_pin.cli.files import (
    FLAGS,
    check_outputs,
    open_chains,
    open_measurements,
    open_setup,
    require_distinct,
)
from calib_pin.cli.older import as_before, open_older
from calib_pin.cli.printing import Bar, notice
from calib_pin.cli.request import Request
from calib_pin.cli.results import (
    ResultFiles,
    check_results,
    draw_calibration,
    figure_contents,
    result_contents,
    result_files,
)
from calib_pin.errors import require_known
from calib_pin.workers import SERIAL, Workers

if TYPE_CHECKING:
    from calib_pin.kinematics.chains import Chains
    from calib_pin.observations import Observations
    from calib_pin.planning.suggestions import Suggestion
    from calib_pin.setup import Setup
    from calib_pin.validation.result import CalibrationResult


@dataclass(frozen=True)
class Opened:
    """The input of a calibration, read and checked.

    Attributes:
        request: What is asked for.
        setup: The setup with the options on top.
        chains: The nominal chains that were measured.
        measurements: The measurements.
        validation: Those of the validation file; None without one.
        files: Where the results go; None where they are only printed.
        older: The older calibration to go on from; None without one.
    """

    request: Request
    setup: Setup
    chains: Chains
    measurements: Observations
    validation: Observations | None
    files: ResultFiles | None
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
        pictures: The figures among them.
    """

    result: CalibrationResult
    suggestions: Sequence[Suggestion]
    contents: Mapping[Path, bytes]
    pictures: Mapping[Path, bytes]


def opened(
    request: Request,
    output: Path | None,
    pictures: Sequence[Path] = (),
    *,
    force: bool = False,
    quiet: bool = True,
    bar: Bar | None = None,
) -> Opened:
    """Read the input of a calibration, and check where its results would go.

    Raises:
        InputError: If the input cannot be used.
        OptionError: If an option cannot, or results must not be written there.
    """
    from calib_pin.io.measured_columns import place_of
    from calib_pin.io.results import document_file

    if request.use is not None:
        from calib_pin.validation.model_selection import USES

        require_known("use", request.use, USES)
    asked = vars(request)
    stated = open_setup(request.setup, **{name: asked[name] for name in FLAGS})
    further = [] if request.validation is None else [request.validation]
    older = open_older(request.start, [*request.measurements, *further])
    stated = as_before(stated, older)
    if stated.solver.evolution and stated.solver.name not in ("de", "hybrid"):
        name = stated.solver.name
        notice(f"{name} ignores the options of differential evolution in 'solver'")
    chains = open_chains(request.robot, stated, package_dirs=request.package_dir)
    files = None if output is None else result_files(output, chains.robot.name)
    # None of them may be written.
    started = [] if request.start is None else [document_file(request.start)]
    inputs = [request.robot, request.setup, *started, *request.measurements, *further]
    if files is None:
        check_outputs(pictures, inputs, force)
    else:
        check_results(files, pictures, chains.robot, inputs, force)
    require_distinct([*request.measurements, *further])
    read = partial(open_measurements, station_per_file=request.station_per_file)
    chains, rows = read(request.measurements, chains, stated, quiet=quiet, bar=bar)
    unseen = None
    if further:
        same = replace(stated, model="+".join(rows.models))
        sockets = map(place_of, rows.target.distinct)
        _, unseen = read(further, chains, same, quiet=True, sockets=sockets)
    if rows.validate.any() and (further or request.holdout is not None):
        option = "--validation" if further else "--holdout"
        notice(
            f"the measurements that 'set' marks for validation are not used with "
            f"{option}"
        )
    return Opened(request, stated, chains, rows, unseen, files, older)


def calibrated(
    opened: Opened,
    words: Sequence[str],
    pictures: Sequence[Path] = (),
    *,
    page: bool = True,
    bar: Bar | None = None,
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
    from calib_pin.calibration import calibrate
    from calib_pin.io.urdf import other_robots
    from calib_pin.planning.suggestions import calibrated_setup, suggestions
    from calib_pin.validation.model_selection import USES

    request, files, setup = opened.request, opened.files, opened.setup
    shown = (files is not None and page) or bool(pictures)
    start = time.perf_counter()
    # What `calibrate` calls as the request does is passed on as it is.
    same = signature(calibrate).parameters.keys() & vars(request).keys()
    given = {name: getattr(request, name) for name in same} | {
        "setup": setup,
        "validation": opened.validation,
        "measurements": opened.measurements,
        "start": opened.older,
        "use": request.use or USES[0],
    }
    result = calibrate(
        opened.chains,
        **given,
        ladder=request.model_ladder or request.use is not None,
        progress=bar,
        others=partial(other_robots, opened.chains, setup),
        workers=workers,
    )
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
        from calib_pin.io.robot_shapes import robot_shapes

        shapes = robot_shapes(opened.chains.robot, request.package_dir or ()).parts
        drawn = draw_calibration(result, bar, shapes)
    contents = drawings = figure_contents(drawn, pictures)
    if files is not None:
        from calib_pin.validation.result import Provenance

        created = datetime.now(UTC).isoformat(timespec="seconds")
        made = Provenance.at(created, tuple(words), seconds)
        contents = result_contents(
            result, files, made, drawn if page else None, drawings, better
        )
    return Calibrated(result, better, contents, drawings)
