"""The folder of a calibration: corrected URDF, result, errors and page."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from calib_pin.errors import OptionError
from calib_pin.io import json_text, measurement_errors, results, urdf
from calib_pin.io.files import listed, same_file, sha256, write_files
from calib_pin.io.measurement_errors import MEASUREMENTS
from calib_pin.io.results import DOCUMENT, NOMINAL, REPORT, urdf_name, written_before
from calib_pin.kinematics.robot import Robot
from calib_pin.planning.suggestions import with_suggestions
from calib_pin.validation.result import CalibrationResult, Provenance

if TYPE_CHECKING:  # Drawing loads slowly, and is not always asked for.
    from calib_pin.report.figures import Drawn


def result_files(folder: Path, robot: Robot) -> list[Path]:
    """Where the results of a robot go, the corrected one first."""
    names = (urdf_name(robot.name), NOMINAL, DOCUMENT, MEASUREMENTS, REPORT)
    return [folder / name for name in names]


def result_contents(
    result: CalibrationResult,
    folder: Path,
    made: Provenance,
    figures: Sequence[Drawn] | None,
    pictures: Mapping[Path, bytes],
) -> dict[Path, bytes]:
    """All files of a result, of which the last one knows the hashes of the others.

    The corrected URDF is there if it can be trusted, and is the nominal one where
    there is no gain; the page is there if figures for it are given, however few.
    """
    from calib_pin.report.html import html_report

    document = results.calibration_document(result, made)
    # The same input and seed lead to the same id.
    unlike = {"solver": ["seconds"], "provenance": ["command", "created"]}
    blank = {key: dict.fromkeys(names) for key, names in unlike.items()}
    document["run"] = sha256(json_text.encode(json_text.merged(document, blank)))[:16]
    robot = result.model.chains.robot
    corrected, nominal, main, rows, page = result_files(folder, robot)
    contents = {nominal: robot.source}
    if result.verdict == "no-gain":
        contents[corrected] = robot.source
    elif result.geometry is not None:
        contents[corrected] = results.encode_urdf(result.geometry, corrected)
    contents[rows] = measurement_errors.encode_errors(result, document["run"])
    if figures is not None:
        contents[page] = html_report(result, document, figures=figures)
    contents |= pictures
    document["files"] = {
        name: None if path == page else sha256(data)
        for path, data in contents.items()
        if (name := listed(path, folder))
    }
    if urdf.is_source(nominal, robot):
        del contents[nominal]  # It is an input, and stays as it is.
    return {**contents, main: json_text.encode(document)}


def outdated(folder: Path, contents: Iterable[Path]) -> list[Path]:
    """Files of an earlier run that would pass for those of one with these files."""
    names = {NOMINAL, *(listed(path, folder) for path in contents)}
    old = written_before(folder / DOCUMENT)
    return [path for path in old if listed(path, folder) not in names]


def write_result(
    result: CalibrationResult, folder: str | Path, *, force: bool = False
) -> None:
    """Write a result to a folder, as `calib-pin calibrate -o` does.

    `read_result` reads it, and every command takes it. The corrected URDF is among its
    files if it can be trusted.

    Args:
        result: The result.
        folder: The folder; it is made where there is none.
        force: Replace the result that is there.

    Raises:
        OptionError: If there is one, and `force` is false; or if it would take the
            place of the robot or the measurements.
        OutputError: If it cannot be written.

    Examples:
        >>> import calib_pin, tempfile
        >>> chain = calib_pin.load_chain("space7")
        >>> setup = calib_pin.read_setup(calib_pin.robot_file("space7", "setup.yaml"))
        >>> rows = calib_pin.read_measurements(
        ...     calib_pin.robot_file("space7", "measurements.csv"), chain
        ... )
        >>> result = calib_pin.calibrate(chain, rows, setup)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     calib_pin.write_result(result, folder)
        ...     calib_pin.read_result(folder).reason == result.reason
        True
    """
    from calib_pin.report.html import made_now, report_figures

    folder, result = Path(folder), with_suggestions(result)
    figures = report_figures(result)
    contents = result_contents(result, folder, made_now(result), figures, {})
    for path in contents:
        if any(same_file(path, Path(file)) for file in result.files):
            reason = "is a file of measurements, which is never replaced"
            raise OptionError(reason, file=path, allowed="another folder")
    old = outdated(folder, contents)
    with write_files(contents, force=force, folder=folder, removed=old):
        pass
