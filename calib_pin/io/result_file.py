"""Read a calibration result from `calibration.json` and the files beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from reprlib import repr
from typing import Any, get_type_hints

import numpy as np

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import InputError
from calib_pin.estimation.evidence import (
    VERDICTS,
    ExpectedAccuracy,
    Finding,
    FoundCurve,
    PoseErrors,
    TipAccuracy,
)
from calib_pin.io.calibrated_model import model_of, reference_of
from calib_pin.io.calibration_document import BREAKDOWN, CURVE, SAMPLES, sha256_of
from calib_pin.io.files import read_bytes
from calib_pin.io.json_text import Json, decode, typed
from calib_pin.io.measurement_errors import SETS, decode_errors, unknown_errors
from calib_pin.io.result_folder import (
    DOCUMENT,
    MADE,
    MEASUREMENTS,
    Read,
    numbers,
    opened,
    reading,
    stated_errors,
)
from calib_pin.io.results import read_model
from calib_pin.planning.suggestions import Suggestion
from calib_pin.setup.values import LARGEST_LENGTH
from calib_pin.validation.breakdown import Breakdown
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.measurement_errors import MeasurementErrors
from calib_pin.validation.result import (
    CalibrationResult,
    CoupledGroup,
    FoundDistance,
    Identifiability,
    ParameterEstimate,
    RobotError,
    UrdfResult,
)
from calib_pin.validation.summaries import (
    Candidate,
    ModelSelection,
    NamedArray,
    Provenance,
    Recalibration,
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
"""Defaults of keys that older files lack, by section."""


def document_file(path: str | Path) -> Path:
    """The `calibration.json` of a folder, or the file itself."""
    path = Path(path)
    return path / DOCUMENT if path.is_dir() else path


def read_result(path: str | Path) -> CalibrationResult:
    """Read the whole result of a calibration.

    If `measurements.csv` is missing, as in folders of older versions, the errors of the
    measurements are unknown (NaN).

    Args:
        path: The folder of the result, or its `calibration.json`.

    Raises:
        InputError: If the file is not such a document or is of a later version, the
            robot has changed, or the files beside it belong to another run.
        OutputError: If another program keeps the folder locked.
        RobotError: If the robot cannot be found.

    Examples:
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
        path: The folder of the result, or its `calibration.json`.

    Raises:
        InputError, OutputError, RobotError: As `read_result`.
    """
    file = document_file(path)
    with opened(file) as read:
        document, model = read_model(file, read)
        with reading(file):
            result = _result(document, model, str(file), read)
            read_suggestions(document)
    return result, document


def used_files(path: str | Path, files: Sequence[Path]) -> list[Path]:
    """Those of some files whose content a calibration has used, to fit or to check.

    Args:
        path: A `calibration.json`, which can be read.
        files: Measurement files; what is no file, such as a pipe, is left alone.
    """
    document = decode(read_bytes(path))
    known = {entry["sha256"] for entry in document["measurements"]["files"]}
    return [file for file in files if sha256_of(str(file)) in known - {""}]


def read_suggestions(document: Json) -> tuple[Suggestion, ...]:
    """The suggested measurements in a document."""
    stated = document["identifiability"].get("remedies", ())
    return typed(tuple[Suggestion, ...], stated)


def _result(
    document: Json, model: CalibratedModel, file: str, read: Read
) -> CalibrationResult:
    verdict, about = document["verdict"], document["measurements"]
    if verdict["status"] not in VERDICTS:
        raise ValueError(f"{repr(verdict['status'])} is no verdict")
    stated = stated_errors(document)
    parameters, groups = _estimates(document)
    made, solver = document.get("provenance", {}), document.get("solver", {})
    sections = {key: {**older, **document[key]} for key, older in LATER.items()}
    fitted, held_out = _measured(document, model, Path(file).parent, read)
    names = [parameter.name for parameter in parameters]
    unknown = np.full((len(names), len(names)), np.nan)
    covariance = document.get("covariance") or unknown
    validation: Json = {"method": stated[0][1] if stated else "none", "count": 0}
    urdf, kinds = document.get("urdf"), get_type_hints(Breakdown)
    return CalibrationResult(
        parameters=parameters,
        groups=groups,
        identifiability=typed(Identifiability, sections["identifiability"]),
        robot_errors=typed(
            tuple[RobotError, ...], document["identifiability"].get("robot_errors", ())
        ),
        model=model,
        reference=reference_of(document, model),
        verdict=verdict["status"],
        reason=typed(str, verdict["reason"]),
        errors=tuple(errors for errors, _ in stated),
        validation=typed(Validation, document.get("validation", validation)),
        solver=typed(SolverSummary, sections["solver"]),
        statistics=typed(Statistics, sections["statistics"]),
        accuracies=_accuracies(document, model),
        **{
            key: typed(kinds[key], document[key])
            for key in BREAKDOWN
            if key in document
        },
        covariance=NamedArray.of(covariance, names, names),
        fitted=fitted,
        held_out=held_out,
        files=tuple(typed(str, entry["file"]) for entry in about["files"]),
        model_selection=_model_selection(document.get("model_ladder")),
        urdf=None
        if urdf is None
        else UrdfResult(
            model=model_of(urdf["model"], model.chains) if urdf.get("model") else None,
            errors=tuple(errors for errors, _ in stated_errors(urdf)),
            reason=typed(str, urdf["reason"]),
        ),
        rejected=document.get("rejected_residual_model", ""),
        distances=typed(tuple[FoundDistance, ...], document.get("distances", ())),
        findings=typed(tuple[Finding, ...], document.get("findings", ())),
        recalibration=typed(Recalibration, begun)
        if (begun := document.get("recalibration"))
        else None,
        provenance=Provenance(
            command=typed(tuple[str, ...], made.get("command", ())),
            created=typed(str, made.get("created", "")),
            seconds=float(solver.get("seconds") or np.nan),
            versions={k: v for k, v in made.items() if k not in MADE},
            file=file,
            hashes=tuple(typed(str, entry["sha256"]) for entry in about["files"]),
        ),
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
            raise ValueError(f"{sigma!r} is no standard deviation")
    for group in groups:
        numbers([term.coefficient for term in group.terms], len(group.terms))
    return tuple(parameters), tuple(groups)


def _measured(
    document: Json, model: CalibratedModel, folder: Path, read: Read
) -> tuple[MeasurementErrors, MeasurementErrors | None]:
    """The errors of the fitted and of the validation measurements."""
    try:
        errors = read(folder / MEASUREMENTS)
        rotation = document["rotation_to_base"]
    except (InputError, KeyError):
        return unknown_errors(model, int(document["measurements"]["training"])), None
    rotations = dict.fromkeys(SETS, rotation) | document.get("rotations_to_base", {})
    found = {name: np.array(stated, float) for name, stated in rotations.items()}
    return decode_errors(errors, model, found)


def _accuracies(document: Json, model: CalibratedModel) -> dict[str, ToolAccuracy]:
    """The expected errors of the tool by the name of the chain."""
    first = {model.moving.key.chain: document.get("predicted")}
    entries = first | document.get("predicted_by_chain", {})
    return {
        name: _accuracy(entry, len(model.chains[name].joints))
        for name, entry in entries.items()
    }


def _accuracy(entry: Mapping[str, Any] | None, joints: int) -> ToolAccuracy:
    if entry is None:
        return ToolAccuracy()
    known = {
        name: typed(ExpectedAccuracy, entry[name])
        for name in ("measured", "workspace")
        if name in entry
    }
    sizes = entry["position"], entry["orientation"]
    tip = None if None in sizes else _tip(entry, joints)
    return ToolAccuracy(tip, known.get("measured"), known.get("workspace"))


def _tip(entry: Mapping[str, Any], joints: int) -> TipAccuracy:
    means = ([mean] for mean in typed(PoseErrors, entry))
    older = np.zeros((0, joints)), np.zeros((0, 3)), *means
    samples = entry.get("samples") or dict(zip(SAMPLES, older, strict=True))
    q, points, position, orientation = (np.array(samples[k], float) for k in SAMPLES)
    if len({len(q), len(points), len(position), len(orientation)}) > 1 and len(q):
        raise ValueError("the lists of 'samples' are not of one length")
    if not np.abs(points).max(initial=0.0) <= LARGEST_LENGTH:
        raise ValueError(f"points are more than {LARGEST_LENGTH:g} m away")
    curve = entry.get("by_count", dict.fromkeys(CURVE, ()))
    counts, errors = (np.array(curve[key], float) for key in CURVE)
    alone = typed(PoseErrors, entry.get("robot") or dict.fromkeys(PoseErrors._fields))
    by_count = FoundCurve((counts, errors))
    return TipAccuracy(q, points, position, orientation, alone, by_count)


def _model_selection(entry: Mapping[str, Any] | None) -> ModelSelection | None:
    if entry is None:
        return None
    candidates = tuple(
        typed(
            Candidate,
            {
                **candidate,
                "errors": [
                    (name, error["unit"], error["mean"])
                    for name, error in candidate["errors"].items()
                ],
                "away": _away(candidate.get("away")),
            },
        )
        for candidate in entry["rungs"]
    )
    names = [candidate.name for candidate in candidates]
    # Without these keys regions were not held out yet.
    return ModelSelection(
        candidates,
        names.index(entry["chosen"]),
        str(entry.get("use", "near")),
        {name: (float(a), float(b)) for name, (a, b) in entry.get("near", {}).items()},
    )


def _away(entry: Mapping[str, Any] | None) -> Mapping[str, Any] | None:
    """Errors away from fitted configurations, as `HeldOutErrors` declares them."""
    if entry is None:
        return None
    errors = [{"name": name, **error} for name, error in entry["errors"].items()]
    return {**entry, "errors": errors}
