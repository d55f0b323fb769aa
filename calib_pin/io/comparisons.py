"""A comparison of two calibrations as a JSON document."""

from __future__ import annotations

from dataclasses import asdict

from calib_pin.io.documents import stated
from calib_pin.io.json_text import Json
from calib_pin.validation.comparison import BOUND, Comparison, Difference
from calib_pin.validation.result import Accuracy, CalibrationResult
from calib_pin.validation.tip_drift import TipDrift


def comparison_document(found: Comparison) -> Json:
    """The numbers of a comparison, in SI units; B is the second calibration.

    `drifted` is null where the noise is unknown, orientations where rows do not tell
    them.
    """
    names = {"base": None, "tool": None} | {d.frame: d for d in found.displacements}
    return {
        **stated("comparison"),
        "a": _record(found.first),
        "b": _record(found.second),
        "same": {
            "nominal_robot": found.same_nominal,
            "parameters": found.same_parameters,
            "measurements": found.same_rows,
        },
        "drifted": found.drifted,
        "changed": found.changed,
        "tip": _tip(found, found.drift),
        "displacements": {
            name: None if d is None else {"position": d.shift, "orientation": d.turn}
            for name, d in names.items()
        },
        "bound": BOUND,
        "parameters": [
            {"name": d.name, **_difference(d)} for d in found.differences if not d.terms
        ],
        "coupled": [
            {
                "expression": d.name,
                **_difference(d),
                "terms": [
                    {"parameter": name, "coefficient": coefficient}
                    for name, coefficient in d.terms
                ],
            }
            for d in found.differences
            if d.terms
        ],
        "parameters_alone": dict(zip("ab", map(list, found.alone), strict=True)),
        "coupled_alone": dict(zip("ab", found.sums_alone, strict=True)),
    }


def _record(record: CalibrationResult) -> Json:
    return {
        "file": record.provenance.file,
        "created": record.provenance.created,
        "verdict": {"status": record.verdict, "reason": record.reason},
        "model": record.model.measurement.name,
        "parameters": list(record.model.setup.parameters),
        "residual_model": record.model.setup.learned,
        "training": len(record.fitted),
        "validation": record.validation.method,
        "errors": {
            error.name: {
                "unit": error.unit,
                "training": asdict(error.after),
                "validation": _sizes(error.validation_after),
            }
            for error in record.errors
        },
    }


def _tip(found: Comparison, drift: TipDrift) -> Json:
    position, orientation = found.explained or (None, None)
    farthest = drift.farthest
    return {
        "configurations": len(drift.q),
        "fitted_away": list(drift.absorbed),
        "position": {**asdict(drift.position), "explained": position},
        "orientation": (
            {**asdict(drift.orientation), "explained": orientation}
            if found.oriented
            else None
        ),
        "largest": {
            "drift": float(drift.drift[farthest]),
            "tip": drift.points[farthest].tolist(),
            "configuration": drift.q[farthest].tolist(),
        },
    }


def _difference(found: Difference) -> Json:
    return {
        "unit": found.unit,
        "a": found.first,
        "b": found.second,
        "difference": found.change,
        "sigma": found.sigma,
        "significance": found.significance,
    }


def _sizes(accuracy: Accuracy | None) -> Json | None:
    return None if accuracy is None else asdict(accuracy)
