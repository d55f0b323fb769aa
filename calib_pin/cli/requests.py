"""A calibration from files to files, as `calibrate` and every job of `fleet` run it."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from calib_pin.cli.files import (
    check_outputs,
    open_chains,
    open_measurements,
    open_setup,
    require_distinct,
)
from calib_pin.cli.older import as_before, older_files, open_older
from calib_pin.cli.printing import Bar, notice
from calib_pin.cli.results import (
    ResultFiles,
    Run,
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
class Request:
    """A calibration as it is asked for; each field is an option of `calibrate`."""

    robot: str
    measurements: tuple[Path, ...]
    setup: Path | None = None
    package_dir: tuple[Path, ...] = ()
    base: str | None = None
    tip: str | None = None
    model: str | None = None
    parameters: str | None = None
    solver: str | None = None
    loss: str | None = None
    learned: str | None = None
    use: str | None = None
    station_per_file: bool = False
    validation: Path | None = None
    holdout: float | None = None
    start: Path | None = None
    process_noise: float | None = None
    seed: int = 0

    @property
    def inputs(self) -> list[str | Path | None]:
        """The files that it reads, none of which may be written."""
        older = [] if self.start is None else older_files(self.start)
        return [self.robot, self.setup, self.validation, *older, *self.measurements]

    def words(self, output: Path) -> tuple[str, ...]:
        """The command line of `calibrate` that asks for the same."""
        words = ["calibrate", self.robot, *map(str, self.measurements)]
        for name, default in Request.__dataclass_fields__.items():
            value = getattr(self, name)
            if name in ("robot", "measurements") or value == default.default:
                continue
            option = f"--{name.replace('_', '-')}"
            for one in value if isinstance(value, tuple) else (value,):
                words += [option] if one is True else [option, str(one)]
        return ("calib-pin", *words, "-o", str(output))


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


@dataclass(frozen=True)
class Calibrated:
    """A calibration, with what its files need beside the result.

    Attributes:
        result: The result.
        suggestions: Suggested measurements.
        seconds: Time of the fit.
        contents: All files and figures by their paths.
        pictures: The figures among them.
    """

    result: CalibrationResult
    suggestions: Sequence[Suggestion]
    seconds: float
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

    if request.use is not None:
        from calib_pin.validation.candidate_scores import USES

        require_known("use", request.use, USES)
    stated = open_setup(
        request.setup,
        base=request.base,
        tip=request.tip,
        model=request.model,
        parameters=request.parameters,
        solver=request.solver,
        loss=request.loss,
        learned=request.learned,
    )
    further = [] if request.validation is None else [request.validation]
    older = open_older(request.start, [*request.measurements, *further])
    stated = as_before(stated, older)
    if stated.solver.evolution and stated.solver.name not in ("de", "hybrid"):
        name = stated.solver.name
        notice(f"{name} ignores the options of differential evolution in 'solver'")
    chains = open_chains(request.robot, stated, package_dirs=request.package_dir)
    files = None if output is None else result_files(output, chains.robot.name)
    if files is None:
        check_outputs(pictures, request.inputs, force)
    else:
        check_results(files, pictures, chains.robot, request.inputs, force)
    validation, per_file = request.validation, request.station_per_file
    require_distinct([*request.measurements, *further])
    chains, rows = open_measurements(
        request.measurements,
        chains,
        stated,
        station_per_file=per_file,
        quiet=quiet,
        bar=bar,
    )
    unseen = None
    if validation is not None:
        same = replace(stated, model="+".join(rows.models))
        sockets = map(place_of, rows.target.distinct)
        _, unseen = open_measurements(
            [validation],
            chains,
            same,
            station_per_file=per_file,
            quiet=True,
            sockets=sockets,
        )
    if rows.validate.any() and (unseen is not None or request.holdout is not None):
        option = "--holdout" if unseen is None else "--validation"
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
    from calib_pin.io.other_robots import other_robots
    from calib_pin.planning.suggestions import calibrated_setup, suggestions
    from calib_pin.validation.candidate_scores import USES

    request, files = opened.request, opened.files
    shown = (files is not None and page) or bool(pictures)
    start = time.perf_counter()
    result = calibrate(
        opened.chains,
        opened.measurements,
        opened.setup,
        validation=opened.validation,
        holdout=request.holdout,
        ladder=request.use is not None,
        use=request.use or USES[0],
        seed=request.seed,
        progress=bar,
        others=partial(other_robots, opened.chains, opened.setup),
        workers=workers,
        start=opened.older,
        process_noise=request.process_noise,
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
    drawings = figure_contents(drawn, pictures)
    contents = drawings
    if files is not None:
        run = Run(tuple(words), seconds)
        contents = result_contents(
            result, files, run, drawn if page else None, drawings, better
        )
    return Calibrated(result, better, seconds, contents, drawings)
