"""A result as `calibration.json` and the files beside it tell of it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from reprlib import repr
from typing import Any

import numpy as np

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import InputError
from calib_pin.estimation.evidence import (
    VERDICTS,
    ExpectedAccuracy,
    Finding,
    FoundCurve,
    TipAccuracy,
)
from calib_pin.io.calibrated_model import model_of, reference_of
from calib_pin.io.calibration_file import numbers, reading, stated_errors, text
from calib_pin.io.json_text import Json, typed
from calib_pin.io.measurement_errors import FILE_NAME, decode_errors, unknown_errors
from calib_pin.io.result_folder import DOCUMENT, Read, opened
from calib_pin.io.results import read_model
from calib_pin.planning.suggestions import Suggestion
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.measurement_errors import MeasurementErrors
from calib_pin.validation.result import (
    CalibrationResult,
    CoupledGroup,
    FoundDistance,
    Identifiability,
    ParameterEstimate,
    UrdfResult,
)
from calib_pin.validation.summaries import (
    Candidate,
    ModelSelection,
    NamedArray,
    Provenance,
    SolverSummary,
    Statistics,
    ToolAccuracy,
    Validation,
)

LATER: Mapping[str, Json] = {
    "statistics": {"sigma0": None, "stated_sigma": False},
    "solver": {"evaluator": "", "history": [], "at_bounds": [], "iterations": 0}
    | {"evaluations": 0, "seed": 0, "name": "", "status": ""},
    "identifiability": {"structural_gap": None, "structural_singular_values": []}
    | {"robot_rank": 0, "everett": 0, "weak": 0, "revealed": 0, "correlated": []}
    | {"condition": None, "singular_values": [], "observability": {}}
    | {"parameters": 0, "rank": 0, "structural_rank": 0},
}
"""Keys that older files lack, by their section."""


def document_file(path: str | Path) -> Path:
    """The `calibration.json` of a folder, or the file itself."""
    path = Path(path)
    return path / DOCUMENT if path.is_dir() else path


def read_result(path: str | Path) -> CalibrationResult:
    """The whole result of a calibration: of a folder, or of a `calibration.json`.

    Without `measurements.csv`, as older versions wrote it, the errors of the
    measurements are unknown (NaN).

    Args:
        path: The folder or the file.

    Raises:
        InputError: If the file is not such a document or of a later version, the
            robot has changed, or the files beside it are of another run.
        OutputError: If another program does not let go of the folder.
        RobotError: If the robot cannot be found.

    Example:
        >>> import calib_pin
        >>> calib_pin.read_result("/no/such/folder/calibration.json")
        Traceback (most recent call last):
        calib_pin.errors.InputError: /no/such/folder/calibration.json: no such file
    """
    return read_written(path)[0]


@serial_blas
def read_written(path: str | Path) -> tuple[CalibrationResult, Json]:
    """A result, and the document that it was read from.

    Args:
        path: The folder or the file.

    Raises:
        InputError, OutputError, RobotError: As `read_result`.
    """
    file = document_file(path)
    with opened(file) as read:
        document, model = read_model(file, read)
        with reading(file):
            result = _result(document, model, str(file), _errors(file, read))
    return result, document


def read_suggestions(document: Json) -> tuple[Suggestion, ...]:
    """The suggested measurements that a document holds."""
    stated = document["identifiability"].get("remedies", [])
    return tuple(typed(Suggestion, entry) for entry in stated)


def _errors(file: Path, read: Read) -> bytes | None:
    """The measurements of a folder; None where there are none."""
    try:
        return read(file.parent / FILE_NAME)
    except InputError:
        return None


def _result(
    document: Json, model: CalibratedModel, file: str, errors: bytes | None
) -> CalibrationResult:
    verdict, about = document["verdict"], document["measurements"]
    if verdict["status"] not in VERDICTS:
        raise ValueError(f"{repr(verdict['status'])} is no verdict")
    stated = stated_errors(document)
    parameters, groups = _estimates(document)
    sections = {key: {**older, **document[key]} for key, older in LATER.items()}
    (training,) = numbers([about["training"]], 1)
    fitted, held_out = _measured(document, model, errors, int(training))
    names = [parameter.name for parameter in parameters]
    unknown = np.full((len(names), len(names)), np.nan)
    covariance = document.get("covariance") or unknown
    validation: Json = {"method": stated[0][1] if stated else "none", "count": 0}
    urdf = document.get("urdf")
    return CalibrationResult(
        parameters=parameters,
        groups=groups,
        identifiability=typed(Identifiability, sections["identifiability"]),
        model=model,
        reference=reference_of(document, model),
        verdict=verdict["status"],
        reason=_words(verdict["reason"]),
        errors=tuple(errors for errors, _ in stated),
        validation=typed(Validation, document.get("validation", validation)),
        solver=typed(SolverSummary, sections["solver"]),
        statistics=typed(Statistics, sections["statistics"]),
        accuracy=_accuracy(document.get("predicted"), len(model.chain.joints)),
        covariance=NamedArray.of(covariance, names, names),
        fitted=fitted,
        held_out=held_out,
        files=tuple(_words(entry["file"]) for entry in about["files"]),
        model_selection=_ladder(document.get("model_ladder")),
        urdf=None if urdf is None else _urdf(urdf, model),
        rejected=document.get("rejected_residual_model", ""),
        distances=tuple(
            typed(FoundDistance, entry) for entry in document.get("distances", ())
        ),
        findings=tuple(typed(Finding, entry) for entry in document.get("findings", ())),
        provenance=_provenance(document, file),
    )


def _estimates(
    document: Json,
) -> tuple[tuple[ParameterEstimate, ...], tuple[CoupledGroup, ...]]:
    parameters = [typed(ParameterEstimate, p) for p in document["parameters"]]
    coupled = document["identifiability"]["coupled"]
    groups = [typed(CoupledGroup, group) for group in coupled]
    values = [(e.value, e.sigma) for e in parameters]
    for value, sigma in values + [(e.value, e.sigma) for e in groups]:
        numbers([value], 1)
        if sigma is not None and not sigma >= 0.0:
            reason = "stands in the place of a standard deviation"
            raise ValueError(f"{sigma!r} {reason}")
    for group in groups:
        numbers([term.coefficient for term in group.terms], len(group.terms))
    return tuple(parameters), tuple(groups)


def _measured(
    document: Json, model: CalibratedModel, errors: bytes | None, training: int
) -> tuple[MeasurementErrors, MeasurementErrors | None]:
    """The errors of the fitted and of the validation measurements."""
    rotation = document.get("rotation_to_base")
    if errors is None or rotation is None:
        return unknown_errors(model, training), None
    return decode_errors(errors, model, np.array(rotation, float))


def _accuracy(entry: Mapping[str, Any] | None, joints: int) -> ToolAccuracy:
    if entry is None:
        return ToolAccuracy()
    known = {
        name: _expected(entry[name])
        for name in ("measured", "workspace")
        if name in entry
    }
    sizes = entry["position"], entry["orientation"]
    tip = None if None in sizes else _tip(entry, joints)
    return ToolAccuracy(tip, known.get("measured"), known.get("workspace"))


def _tip(entry: Mapping[str, Any], joints: int) -> TipAccuracy:
    sizes = numbers([entry["position"], entry["orientation"]], 2)
    alone = entry.get("robot") or {"position": None, "orientation": None}
    samples = (
        entry.get("samples")
        or {  # Older files have their mean alone.
            "configurations": np.zeros((0, joints)),
            "points": np.zeros((0, 3)),
            "position": sizes[:1],
            "orientation": sizes[1:],
        }
    )
    by_count = entry.get("by_count", {"measurements": [], "position": []})
    arrays = {name: np.array(values, float) for name, values in samples.items()}
    return TipAccuracy(
        q=arrays["configurations"],
        points=arrays["points"],
        position=arrays["position"],
        orientation=arrays["orientation"],
        of_robot=_pair(alone),
        by_count=FoundCurve(
            (
                np.array(by_count["measurements"], float),
                np.array(by_count["position"], float),
            )
        ),
    )


def _expected(entry: Mapping[str, Any]) -> ExpectedAccuracy:
    return ExpectedAccuracy(
        nominal=_pair(entry["nominal"]),
        calibrated=_pair(entry["calibrated"]),
        bound=_pair(entry["bound"]),
        unmodeled=_pair(entry["unmodeled"]),
        better=float(entry["better"]),
        share=float(entry["share"]),
    )


def _pair(entry: Mapping[str, Any]) -> tuple[float, float]:
    """A position and an orientation; null is unknown."""
    position, orientation = (
        np.nan if entry[key] is None else float(entry[key])
        for key in ("position", "orientation")
    )
    return position, orientation


def _ladder(entry: Mapping[str, Any] | None) -> ModelSelection | None:
    if entry is None:
        return None
    rungs = tuple(
        typed(
            Candidate,
            {
                **rung,
                "errors": [
                    (name, error["unit"], error["mean"])
                    for name, error in rung["errors"].items()
                ],
            },
        )
        for rung in entry["rungs"]
    )
    return ModelSelection(rungs, [rung.name for rung in rungs].index(entry["chosen"]))


def _urdf(entry: Json, model: CalibratedModel) -> UrdfResult:
    described = entry.get("model")
    return UrdfResult(
        model=None if described is None else model_of(described, model.chain),
        errors=tuple(errors for errors, _ in stated_errors(entry)),
        reason=_words(entry["reason"]),
    )


def _provenance(document: Json, file: str) -> Provenance:
    about = document.get("provenance", {})
    created = _words(about.get("created", ""))
    versions = {k: v for k, v in about.items() if k not in ("command", "created")}
    return Provenance(
        command=tuple(about.get("command", ())),
        created=created,
        seconds=float(document.get("solver", {}).get("seconds") or np.nan),
        versions=versions,
        file=file,
        hashes=tuple(_words(e["sha256"]) for e in document["measurements"]["files"]),
    )


def _words(value: object) -> str:
    """Any words, or none."""
    return "" if value == "" else text(value)
