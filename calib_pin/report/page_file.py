"""The page of a calibration as a file."""

from __future__ import annotations

from pathlib import Path

from calib_pin.io.calibration_document import calibration_document, provenance
from calib_pin.io.files import write_atomically
from calib_pin.io.result_file import read_suggestions, read_written
from calib_pin.planning.suggestions import calibrated_setup, suggestions
from calib_pin.report.figures import calibration_figures
from calib_pin.report.html import html_report
from calib_pin.validation.result import CalibrationResult


def report(
    result: CalibrationResult | str | Path, file: str | Path, *, force: bool = False
) -> None:
    """Write the page of a calibration, with its figures.

    Args:
        result: The result, or the folder or `calibration.json` that holds it.
        file: The page.
        force: Replace an existing file.

    Raises:
        InputError: If a calibration cannot be read.
        OptionError: If the page exists and `force` is false.
        OutputError: If it cannot be written.

    Example:
        >>> import calib_pin, tempfile
        >>> chain = calib_pin.load_chain("space7")
        >>> setup = calib_pin.read_setup(calib_pin.robot_file("space7", "setup.yaml"))
        >>> rows = calib_pin.read_measurements(
        ...     calib_pin.robot_file("space7", "measurements.csv"), chain
        ... )
        >>> result = calib_pin.calibrate(chain, rows, setup)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     calib_pin.report(result, Path(folder) / "page.html")
        ...     len((Path(folder) / "page.html").read_bytes()) > 100_000
        True
    """
    if isinstance(result, CalibrationResult):
        model = result.model
        setup, name = calibrated_setup(model), model.measurement.name
        suggested = suggestions(
            model.chain, name, setup, result, seed=result.solver.seed
        )
        made = result.provenance if result.provenance.versions else provenance()
        document = calibration_document(result, made, suggestions=suggested)
    else:
        result, document = read_written(result)
        suggested = read_suggestions(document)
    figures = list(calibration_figures(result))
    page = html_report(result, document, figures=figures, suggestions=suggested)
    write_atomically(Path(file), page, force=force)
