"""All that a `calibration.json` tells of a calibration."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from reprlib import repr
from typing import Any

from calib_pin.estimation.evidence import VERDICTS
from calib_pin.io.calibration_file import (
    numbers,
    read_document,
    reading,
    stated_errors,
    text,
)
from calib_pin.io.documents import Json
from calib_pin.io.result_folder import opened
from calib_pin.io.results import read_calibration
from calib_pin.validation.calibration_record import CalibrationRecord
from calib_pin.validation.result import CalibratedModel, CoupledGroup, ParameterEstimate

__all__ = ["read_record"]


def read_record(path: str | Path) -> CalibrationRecord:
    """The calibrated robot of a `calibration.json`, and what is said of it.

    Args:
        path: The file.

    Raises:
        InputError: As `io.results.read_calibration`.
        RobotError: If the robot cannot be found.
    """
    model = read_calibration(path)
    with opened(path) as read:
        document = read_document(path, read)
    with reading(path):
        return _record(str(path), model, document)


def _record(file: str, model: CalibratedModel, document: Json) -> CalibrationRecord:
    verdict, about = document["verdict"], document["measurements"]
    if verdict["status"] not in VERDICTS:
        raise ValueError(f"{repr(verdict['status'])} is no verdict")
    stated = stated_errors(document)
    (rows,) = numbers([about["training"]], 1)
    return CalibrationRecord(
        file=file,
        model=model,
        verdict=verdict["status"],
        reason=_words(verdict["reason"]),
        parameters=tuple(map(_parameter, document["parameters"])),
        groups=tuple(map(_group, document["identifiability"]["coupled"])),
        errors=tuple(errors for errors, _ in stated),
        validation=stated[0][1] if stated else "none",
        predicted=_predicted(document.get("predicted")),
        predicted_robot=_predicted((document.get("predicted") or {}).get("robot")),
        noise=_noise(document["statistics"]),
        rows=int(rows),
        hashes=tuple(_hashes(about["files"])),
        created=_words(document.get("provenance", {}).get("created", "")),
    )


def _parameter(entry: Mapping[str, Any]) -> ParameterEstimate:
    (value,) = numbers([entry["value"]], 1)
    return ParameterEstimate(
        name=text(entry["name"]),
        unit=_words(entry["unit"]),
        value=value,
        sigma=_sigma(entry["sigma"]),
        status=text(entry["status"]),
        groups=tuple(map(int, numbers(entry["groups"], len(entry["groups"])))),
    )


def _group(entry: Mapping[str, Any]) -> CoupledGroup:
    number, value = numbers([entry["group"], entry["value"]], 2)
    return CoupledGroup(
        number=int(number),
        expression=text(entry["expression"]),
        unit=_words(entry["unit"]),
        value=value,
        sigma=_sigma(entry["sigma"]),
        terms=tuple(
            (text(term["parameter"]), numbers([term["coefficient"]], 1)[0])
            for term in entry["terms"]
        ),
    )


def _sigma(value: object) -> float | None:
    """A standard deviation; null where there is none."""
    if value is None:
        return None
    (sigma,) = numbers([value], 1)
    if sigma < 0.0:
        raise ValueError(f"{sigma!r} stands in the place of a standard deviation")
    return sigma


def _predicted(entry: Mapping[str, Any] | None) -> tuple[float, float] | None:
    """Position and orientation, where the noise of the fit tells; it came later."""
    if entry is None or None in (entry["position"], entry["orientation"]):
        return None
    position, orientation = numbers([entry["position"], entry["orientation"]], 2)
    return position, orientation


def _noise(entry: Mapping[str, Any]) -> float | None:
    """Standard deviation of unit weight, where the rows state theirs."""
    if entry.get("stated_sigma") is not True or entry["sigma0"] is None:
        return None
    return numbers([entry["sigma0"]], 1)[0]


def _hashes(files: list[Mapping[str, Any]]) -> Iterator[str]:
    for file in files:
        # Of what was no file, such as a pipe, there is none.
        if content := _words(file["sha256"]):
            yield content


def _words(value: object) -> str:
    """Any words, or none."""
    return "" if value == "" else text(value)
