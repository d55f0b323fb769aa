"""An older calibration that a command goes on from."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import calib_pin.cli.options as options
from calib_pin.errors import InputError

if TYPE_CHECKING:
    from calib_pin.setup import Setup
    from calib_pin.validation.result import CalibrationResult

Start = Annotated[
    Path | None,
    options.fit(
        "--start CALIBRATION",
        "Go on from an older calibration of the robot, a folder or its "
        "calibration.json: few measurements are enough, and sudden changes of the "
        "robot are told.",
    ),
]
PlannedStart = Annotated[
    Path | None,
    options.option(
        "Plan",
        "--start CALIBRATION",
        "Plan for a calibration that goes on from this older one.",
    ),
]
ProcessNoise = Annotated[
    float | None,
    options.fit(
        "--process-noise S",
        "With --start: how far each error of the geometry may have drifted since "
        "then, standard deviation in m and rad; by default as the measurements show.",
        options.number(float, "--process-noise", "1e-9 to 0.01 [m, rad]", 1e-9, 1e-2),
    ),
]


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


def older_files(path: Path) -> list[Path]:
    """The file of an older calibration, which nothing may replace."""
    from calib_pin.io.results import document_file

    return [document_file(path)]


def as_before(setup: Setup, older: CalibrationResult | None) -> Setup:
    """A setup with the parameters of an older calibration, and the ends of its chain.

    Args:
        setup: The options of a command, without a setup file.
        older: The older calibration; None leaves the setup as it is.
    """
    from dataclasses import replace

    from calib_pin.setup import Setup as Empty

    if older is None or setup.file:
        return setup
    before, chain = older.model.setup, older.model.moving.error.chain
    if older.model.chains.names == ("",):
        base, tip = setup.base or chain.base, setup.tip or chain.tip
        setup = replace(setup, base=base, tip=tip)
    if setup.parameters == Empty().parameters:
        setup = replace(setup, parameters=before.parameters)
    return setup


PLANNED = (
    *("model", "parameters", "fixed", "base_frame", "tool_frame", "stations", "tools"),
    *("targets", "planes", "sockets", "spheres", "anchors", "camera"),
    *("distances", "angles", "payloads", "gravity"),
)
"""Statements that a plan takes from an older calibration where there is no other."""


def planned_before(setup: Setup, older: CalibrationResult | None) -> Setup:
    """A setup with the instrument and the frames that an older calibration has found.

    Args:
        setup: The options of a command, on top of its setup file.
        older: The older calibration; None leaves the setup as it is.
    """
    from dataclasses import replace

    from calib_pin.planning.suggestions import calibrated_setup
    from calib_pin.setup import WORLD
    from calib_pin.setup import Setup as Empty

    setup = as_before(setup, older)
    if older is None:
        return setup
    models = dict.fromkeys(k.model for k in older.model.terms if k.chain != WORLD)
    before = vars(calibrated_setup(older.model)) | {"model": "+".join(models)}
    given, empty = vars(setup), vars(Empty())
    taken = {name: before[name] for name in PLANNED if given[name] == empty[name]}
    return replace(setup, **taken)
