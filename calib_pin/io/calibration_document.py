"""`calibration.json`: a result as a JSON document, section 8 of the contract."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pinocchio as pin

from calib_pin.estimation.evidence import PoseErrors
from calib_pin.io.documents import identification_parts, stated
from calib_pin.io.files import read_bytes
from calib_pin.io.journal import sha256
from calib_pin.io.json_text import Json, plain
from calib_pin.io.setup import setup_document
from calib_pin.measurement_models.mount import Frame
from calib_pin.measurement_models.references import ReferenceObject
from calib_pin.planning.suggestions import Suggestion
from calib_pin.validation.accuracy import QuantityErrors
from calib_pin.validation.assessment import chi2_interval
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.result import CalibrationResult, UrdfResult
from calib_pin.validation.summaries import ModelSelection, Provenance, ToolAccuracy

SAMPLES = ("configurations", "points", "position", "orientation")
"""Keys of the predicted uncertainty of the tool point, arrays over the workspace."""

CURVE = ("measurements", "position")
"""Keys of that uncertainty by the number of measurements."""


def calibration_document(
    result: CalibrationResult,
    provenance: Provenance | None = None,
    residual_model: Mapping[str, str] | None = None,
    suggestions: Sequence[Suggestion] = (),
) -> Json:
    """A result as the JSON document of version 1.

    Errors of single measurements stand beside it, see `io.measurement_errors`.

    Args:
        result: The result.
        provenance: How it came about; default what the result says.
        residual_model: Where what was learned is written, see `io.results`.
        suggestions: Suggested measurements.

    Raises:
        InputError: If a measurement file cannot be read again for its hash.
    """
    model, robot = result.model, result.model.chain.robot
    statistics, made = result.statistics, provenance or result.provenance
    hashes = made.hashes or tuple(map(_sha256_of, result.files))
    dof, covariance = statistics.dof, result.covariance
    described = _model(model, result.reference)
    return {
        **stated("calibration"),
        "verdict": {"status": result.verdict, "reason": result.reason},
        "findings": plain(result.findings),
        "robot": {
            "name": robot.name,
            "file": robot.file,
            "sha256": sha256(robot.source),
            "base": model.chain.base,
            "tip": model.chain.tip,
            "joints": list(model.chain.joints),
        },
        "measurements": {
            "files": [
                {"file": file, "sha256": content}
                for file, content in zip(result.files, hashes, strict=True)
            ],
            **described.pop("measurements"),
            "training": len(result.fitted),
            "validation": result.validation.count,
            "placed_by_validation": list(result.validation.located),
        },
        "rotation_to_base": result.fitted.to_base.tolist(),
        **described,
        **identification_parts(result, suggestions),
        "errors": _errors(result.errors, result.validation.method),
        "validation": plain(result.validation),
        "predicted": _predicted(result.accuracy),
        "statistics": {
            **plain(statistics),
            "chi2_interval": list(chi2_interval(dof)) if dof > 0 else [],
        },
        "covariance": covariance.tolist() if np.isfinite(covariance).all() else None,
        "solver": {**plain(result.solver), "seconds": made.seconds},
        "distances": plain(result.distances),
        "residual_model": None if residual_model is None else dict(residual_model),
        "rejected_residual_model": result.rejected,
        "model_ladder": None
        if result.model_selection is None
        else _ladder(result.model_selection),
        "urdf": None
        if result.urdf is None
        else _urdf(result.urdf, result.validation.method),
        "setup_file": _setup_file(model.setup.file),
        "provenance": {
            **made.versions,
            "command": list(made.command),
            "created": made.created,
        },
    }


def provenance(command: tuple[str, ...] = (), seconds: float = math.nan) -> Provenance:
    """How a result comes about that is written now, by these versions.

    Args:
        command: The command line; none for a program of its own.
        seconds: Time the solver took; NaN where nobody looked.
    """
    names = {"calib_pin": "calib-pin", "pinocchio": "pin", "numpy": "numpy"}
    return Provenance(
        command=command,
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        seconds=seconds,
        versions={name: version(package) for name, package in names.items()},
    )


def _model(model: CalibratedModel, reference: CalibratedModel) -> Json:
    """A calibrated robot: frames, what the measurements refer to, and its setup.

    Points of the tool and planes have a section in every document.
    """
    free = model.error.parameters.free
    frames: Json = {
        "base": {
            **_frame(model.error.base),
            "estimated": bool(free[:6].any()),
            "reference": _frame(reference.error.base),
        },
        "tool": {
            **_frame(model.tool),
            "estimated": bool(free[-6:].any()),
            "reference": _frame(reference.error.tool),
        },
    }
    sections: Json = {"targets": {}, "planes": {}}
    for found, start in zip(
        model.measurement.references, reference.measurement.references, strict=True
    ):
        values, flags = _stated(found)
        entry = {**values, **flags, "reference": _stated(start)[0]}
        if isinstance(found, Frame):
            frames[f"{found.name}.{found.kind}"] = entry
        elif found.section == "camera":  # There is one at most.
            sections[found.section] = entry
        else:
            sections.setdefault(found.section, {})[found.name] = entry
    return {
        "measurements": {
            "model": model.measurement.name,
            "targets": list(model.measurement.targets),
        },
        "frames": frames,
        **sections,
        "setup": setup_document(model.setup),
    }


def _stated(reference: ReferenceObject) -> tuple[Json, Json]:
    """Values of a reference object, and what of it was estimated."""
    values = asdict(reference.stated())
    flags = {key: values.pop(key) for key in [*values] if key.startswith("estimate")}
    return values, {k.replace("estimate", "estimated"): v for k, v in flags.items()}


def _frame(pose: pin.SE3) -> Json:
    return {
        "xyz": pose.translation.tolist(),
        "rpy": pin.rpy.matrixToRpy(pose.rotation).tolist(),
    }


def _errors(errors: Sequence[QuantityErrors], method: str) -> Json:
    return {
        e.name: {
            "unit": e.unit,
            "training": {"before": plain(e.before), "after": plain(e.after)},
            "validation": {
                "method": method,
                "before": plain(e.validation_before),
                "after": plain(e.validation_after),
            },
        }
        for e in errors
    }


def _predicted(accuracy: ToolAccuracy) -> Json | None:
    """Errors of the tool to expect: what noise leaves by the fit, and all of them."""
    stages = {"measured": accuracy.measured, "workspace": accuracy.workspace}
    known = {name: plain(found) for name, found in stages.items() if found}
    if accuracy.tip is None:
        return {"position": None, "orientation": None, **known} if known else None
    tip = accuracy.tip
    samples = tip.q, tip.points, tip.position, tip.orientation
    return {
        **PoseErrors(*tip.rms)._asdict(),
        "robot": PoseErrors(*tip.of_robot)._asdict(),
        **known,
        "samples": plain(dict(zip(SAMPLES, samples, strict=True))),
        "by_count": plain(dict(zip(CURVE, tip.by_count.curve, strict=True))),
    }


def _urdf(urdf: UrdfResult, method: str) -> Json:
    described = None
    if urdf.model is not None:
        parameters = urdf.model.error.parameters
        described = {
            **_model(urdf.model, urdf.model),
            "parameters": [
                {"name": name, "value": value}
                for name, value in zip(
                    parameters.names, urdf.model.theta.tolist(), strict=True
                )
            ],
        }
    return {
        "reason": urdf.reason,
        "errors": _errors(urdf.errors, method),
        "model": described,
    }


def _ladder(ladder: ModelSelection) -> Json:
    return {
        "chosen": ladder.candidates[ladder.chosen].name,
        "rungs": [
            {
                **plain(rung),
                "errors": {
                    name: {"unit": unit, "mean": mean}
                    for name, unit, mean in rung.errors
                },
            }
            for rung in ladder.candidates
        ],
    }


def _sha256_of(file: str) -> str:
    # A pipe cannot be read twice.
    return sha256(read_bytes(file)) if Path(file).is_file() else ""


def _setup_file(file: str) -> Json | None:
    return {"file": file, "sha256": _sha256_of(file)} if file else None
