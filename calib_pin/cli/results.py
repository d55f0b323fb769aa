"""The files that a calibration leaves."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from calib_pin.cli.files import exists
from calib_pin.cli.printing import notice

if TYPE_CHECKING:
    from calib_pin.remedies import Remedy
    from calib_pin.report.figures import Drawn
    from calib_pin.result import CalibrationResult

__all__ = ["Run", "result_files", "write_results"]


class Run(NamedTuple):
    """How a result came about: the words of the command, and the time of the fit."""

    words: tuple[str, ...]
    seconds: float


class _Files(NamedTuple):
    """Paths of the results."""

    urdf: Path
    residual_model: Path
    json: Path
    report: Path


def result_files(folder: Path, robot: str) -> _Files:
    """Where the results go.

    Raises:
        OptionError: If a file stands in the place of the folder.
    """
    import re

    from calib_pin.errors import OptionError
    from calib_pin.io.residual_model import FILE_NAME

    if exists(folder) and not folder.is_dir():
        raise OptionError("is a file, not a folder", file=folder)
    # The name comes from the file: it must not lead out of the folder.
    name = re.sub(r"[^\w.-]", "_", robot).lstrip(".") or "robot"
    return _Files(
        folder / f"{name}.urdf",
        folder / FILE_NAME,
        folder / "calibration.json",
        folder / "report.html",
    )


def write_results(
    result: CalibrationResult,
    files: _Files,
    run: Run,
    *,
    figures: Sequence[Drawn],
    remedies: Sequence[Remedy],
    force: bool,
) -> list[Path]:
    """Write the corrected URDF, if it can be trusted, and what is said of it.

    What is there of an earlier run and not written now would pass for a result of this
    one, so it is removed.

    Returns:
        The files that were written.
    """
    from calib_pin.io.files import write_atomically
    from calib_pin.io.residual_model import encode_residual_model
    from calib_pin.io.results import write_urdf
    from calib_pin.report.html import html_report

    learned = encode_residual_model(result.model)
    document, encoded = _document(result, run, learned, remedies)
    page = html_report(result, document, figures=figures, remedies=remedies)
    contents = {files.json: encoded, files.report: page}
    if learned is not None:
        contents = {files.residual_model: learned, **contents}
    written = []
    if result.geometry is not None:
        write_urdf(result.geometry, files.urdf, force=force)
        written.append(files.urdf)
    for path, content in contents.items():
        write_atomically(path, content, force=force)
        written.append(path)
    for path in files:
        if path not in written and exists(path):
            path.unlink()
            notice(f"removed {path} of an earlier run")
    if result.geometry is not None and result.geometry.tool_carries_tip:
        notice(
            f"'{result.model.chain.tip}' is the link of the last joint itself: the "
            "error behind that joint stands in frames.tool of calibration.json"
        )
    return written


def _document(
    result: CalibrationResult,
    run: Run,
    learned: bytes | None,
    remedies: Sequence[Remedy],
) -> tuple[dict[str, Any], bytes]:
    """`calibration.json`, and its bytes."""
    from datetime import UTC, datetime
    from importlib.metadata import version

    from calib_pin.io.documents import Provenance, calibration_document, encode
    from calib_pin.io.residual_model import reference

    provenance = Provenance(
        command=run.words,
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        seconds=run.seconds,
        versions={
            "calib_pin": version("calib-pin"),
            "pinocchio": version("pin"),
            "numpy": version("numpy"),
        },
    )
    refers = None if learned is None else reference(learned)
    document = calibration_document(result, provenance, refers, remedies)
    return document, encode(document)
