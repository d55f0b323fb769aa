"""An older calibration that a command goes on from."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from calib_pin.errors import InputError

if TYPE_CHECKING:
    from calib_pin.setup import Setup
    from calib_pin.validation.result import CalibrationResult


def open_older(
    path: Path | None, measurements: Sequence[Path] = ()
) -> CalibrationResult | None:
    """An older calibration; None without one.

    Args:
        path: Its folder or its `calibration.json`.
        measurements: Measurements that it must not have used.

    Raises:
        InputError: If it cannot be read, or has used one of the measurements: they
            would count twice.
    """
    if path is None:
        return None
    from calib_pin.io.results import document_file, read_result, used_files

    found = read_result(path)
    for file in used_files(document_file(path), measurements):
        raise InputError(
            "the older calibration has used these measurements; they would count twice",
            file=file,
            value=str(path),
            allowed="measurements that were taken since then",
        )
    return found


PLANNED = (
    *("model", "parameters", "fixed", "base_frame", "tool_frame", "stations", "tools"),
    *("targets", "planes", "sockets", "spheres", "anchors", "camera"),
    *("distances", "angles", "payloads", "gravity"),
)
"""Statements that a plan takes from an older calibration where there is no other."""


def as_before(
    setup: Setup, older: CalibrationResult | None, *, planned: bool = False
) -> Setup:
    """A setup with what it leaves open as an older calibration has it.

    Args:
        setup: The options of a command, on top of its setup file; without one the
            parameters and the ends of the chain are taken.
        older: The older calibration; None leaves the setup as it is.
        planned: Whether the instrument and the frames that it has found are taken.
    """
    from dataclasses import replace

    from calib_pin.planning.suggestions import calibrated_setup
    from calib_pin.setup import WORLD
    from calib_pin.setup import Setup as Empty

    if older is None:
        return setup
    model, before = older.model, dict[str, Any]()
    if not setup.file:
        before["parameters"] = model.setup.parameters
        if model.chains.names == ("",):
            chain = model.moving.error.chain
            before |= {"base": chain.base, "tip": chain.tip}
    if planned:
        found = vars(calibrated_setup(model))
        models = dict.fromkeys(k.model for k in model.terms if k.chain != WORLD)
        before |= {n: found[n] for n in PLANNED} | {"model": "+".join(models)}
    given, empty = vars(setup), vars(Empty())
    taken = {n: value for n, value in before.items() if given[n] == empty[n]}
    return replace(setup, **taken)
