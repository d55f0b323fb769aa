"""`calibration.json`: a result as a JSON document, section 8 of the contract."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import pinocchio as pin

from calib_pin.errors import InputError
from calib_pin.estimation.evidence import ExpectedAccuracy
from calib_pin.io.files import read_blocks
from calib_pin.io.journal import sha256
from calib_pin.io.setup import setup_document
from calib_pin.measurement_models import Feature, MeasurementModel
from calib_pin.measurement_models.features import Frame
from calib_pin.planning.plan import Plan
from calib_pin.planning.suggestions import Suggestion
from calib_pin.validation.assessment import chi2_interval
from calib_pin.validation.result import (
    Accuracy,
    CalibrationResult,
    CoupledGroup,
    Identification,
    Ladder,
    QuantityErrors,
    UrdfResult,
)

__all__ = [
    "FORMAT",
    "VERSION",
    "Json",
    "Provenance",
    "calibration_document",
    "encode",
    "identification_document",
    "plan_document",
    "require_format",
]

FORMAT = "calib-pin/calibration"
VERSION = 1

Json = dict[str, Any]


@dataclass(frozen=True)
class Provenance:
    """How a result came about.

    Attributes:
        command: The command line.
        created: Time of writing, ISO 8601.
        seconds: Time the solver took.
        versions: Version of each package by name.
    """

    command: tuple[str, ...]
    created: str
    seconds: float
    versions: Mapping[str, str]


def encode(document: Mapping[str, Any]) -> bytes:
    """JSON text of a document; numbers that are not finite become null."""
    text = json.dumps(_finite(document), indent=1, allow_nan=False, ensure_ascii=False)
    # Lone surrogates, of file names that are not UTF-8, become JSON's own escapes.
    return text.encode("utf-8", "backslashreplace") + b"\n"


def require_format(
    document: object, what: str, name: str, newest: int, file: str | Path
) -> Json:
    """A document of one of our formats, of a version that can be read.

    Args:
        document: What the file holds.
        what: What it is called in messages.
        name: Name of the format.
        newest: Newest version that can be read.
        file: The file.

    Raises:
        InputError: If it is anything else.
    """
    if not isinstance(document, dict) or document.get("format") != name:
        raise InputError(f"not a {what} of calib-pin", file=file)
    version = document.get("version")
    if type(version) is not int or not 1 <= version <= newest:
        raise InputError(
            f"a {what} of another version",
            file=file,
            value=version,
            allowed=f"1 to {newest}",
        )
    return document


def identification_document(
    found: Identification, remedies: Sequence[Suggestion] = ()
) -> Json:
    """The parts `parameters` and `identifiability` of section 8 of the contract.

    Args:
        found: What can be known.
        remedies: What would tell more.
    """
    ranks = found.identifiability
    return {
        "parameters": [
            {**asdict(parameter), "groups": list(parameter.groups)}
            for parameter in found.parameters
        ],
        "identifiability": {
            "parameters": ranks.parameters,
            "rank": ranks.rank,
            "structural_rank": ranks.structural_rank,
            "robot_rank": ranks.robot_rank,
            "structural_gap": ranks.gap,
            "everett": ranks.everett,
            "weak": ranks.weak,
            "revealed": ranks.revealed,
            "scale_observable": ranks.scale_observable,
            "condition": ranks.condition,
            "singular_values": list(ranks.singular_values),
            "structural_singular_values": list(ranks.structural_values),
            "observability": ranks.observability,
            "coupled": [_group(group) for group in found.groups],
            "correlated": [
                {"first": first, "second": second, "correlation": value}
                for first, second, value in ranks.correlated
            ],
            "remedies": [asdict(remedy) for remedy in remedies],
        },
    }


def plan_document(plan: Plan) -> Json:
    """A plan: its configurations, what they reach, and what they will tell."""
    predicted = plan.predicted
    return {
        "joints": list(plan.problem.error.chain.joints),
        "configurations": plan.q.tolist(),
        "target": list(plan.target),
        "criterion": {"name": plan.criterion, "value": plan.value},
        "random": plan.random,
        "method": plan.method,
        "status": plan.status.value,
        "measured": plan.measured,
        "candidates": plan.candidates,
        "collisions": {"checked": plan.checked, "blocked_moves": list(plan.blocked)},
        "steps": [asdict(step) for step in plan.steps],
        "predicted": {
            "rank": predicted.directions.count,
            "structural_rank": plan.rank,
            "position": predicted.position,
            "orientation": predicted.orientation,
            "parameters": [
                {"name": p.name, "unit": p.unit, "sigma": p.sigma, "status": p.status}
                for p in plan.parameters
            ],
            "coupled": [_group(group) for group in plan.groups],
        },
    }


def calibration_document(
    result: CalibrationResult,
    provenance: Provenance,
    residual_model: Mapping[str, str] | None = None,
    remedies: Sequence[Suggestion] = (),
) -> Json:
    """A result as the JSON document of version 1.

    Args:
        result: The result.
        provenance: How it came about.
        residual_model: Where what was learned is written, see `io.residual_model`.
        remedies: What would tell more of the robot.

    Raises:
        InputError: If a measurement file cannot be read again for its hash.
    """
    model, robot = result.model, result.model.chain.robot
    free = model.error.parameters.free
    frames, sections = _instrument(model.measurement, result.reference.measurement)
    return {
        "format": FORMAT,
        "version": VERSION,
        "verdict": {"status": result.verdict, "reason": result.reason},
        "findings": [asdict(finding) for finding in result.findings],
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
                {"file": file, "sha256": _sha256_of(file)} for file in result.files
            ],
            "model": model.measurement.name,
            "targets": list(model.measurement.targets),
            "training": result.training,
            "validation": result.validated,
            "placed_by_validation": list(result.placed),
        },
        **identification_document(result, remedies),
        "errors": {e.name: _errors(e, result.validation) for e in result.errors},
        "predicted": _predicted(result),
        "statistics": {
            "chi2": result.chi2,
            "dof": result.dof,
            "sigma0": result.sigma0,
            "stated_sigma": result.stated_sigma,
            "chi2_interval": list(chi2_interval(result.dof)) if result.dof > 0 else [],
            "noise": [asdict(component) for component in result.noise],
            "outliers": [asdict(outlier) for outlier in result.outliers],
            "displaced": result.displaced,
            "gains": [asdict(gain) for gain in result.gains],
        },
        "solver": {
            "name": result.solver,
            "evaluator": result.evaluator,
            "status": result.status.value,
            "iterations": result.iterations,
            "evaluations": result.evaluations,
            "history": list(result.history),
            "at_bounds": list(result.at_bounds),
            "seconds": provenance.seconds,
            "seed": result.seed,
        },
        "frames": {
            "base": {
                **_frame(model.error.base),
                "estimated": bool(free[:6].any()),
                "reference": _frame(result.reference.error.base),
            },
            "tool": {
                **_frame(model.tool),
                "estimated": bool(free[-6:].any()),
                "reference": _frame(result.reference.error.tool),
            },
            **frames,
        },
        **sections,
        "distances": [asdict(distance) for distance in result.distances],
        "residual_model": None if residual_model is None else dict(residual_model),
        "model_ladder": None if result.ladder is None else _ladder(result.ladder),
        "urdf": None if result.urdf is None else _urdf(result.urdf, result.validation),
        "setup": setup_document(model.setup),
        "setup_file": _setup_file(model.setup.file),
        "provenance": {
            **provenance.versions,
            "command": list(provenance.command),
            "created": provenance.created,
        },
    }


def _predicted(result: CalibrationResult) -> Json | None:
    """Errors of the tool to expect: what noise leaves by the fit, and all of them."""
    stages = {"measured": result.measured, "workspace": result.workspace}
    known = {name: _expected(found) for name, found in stages.items() if found}
    if result.tip is None:
        return {"position": None, "orientation": None, **known} if known else None
    (position, orientation), alone = result.tip.rms, result.tip.of_robot
    return {
        "position": position,
        "orientation": orientation,
        "robot": {"position": alone[0], "orientation": alone[1]},
        **known,
    }


def _expected(found: ExpectedAccuracy) -> Json:
    sizes = {
        stage: dict(zip(("position", "orientation"), size, strict=True))
        for stage, size in (
            ("nominal", found.nominal),
            ("calibrated", found.calibrated),
            ("bound", found.bound),
            ("unmodeled", found.unmodeled),
        )
    }
    return {**sizes, "better": found.better, "share": found.share}


def _urdf(urdf: UrdfResult, method: str) -> Json:
    return {
        "reason": urdf.reason,
        "errors": {e.name: _errors(e, method) for e in urdf.errors},
    }


def _ladder(ladder: Ladder) -> Json:
    return {
        "chosen": ladder.rungs[ladder.chosen].name,
        "rungs": [
            {
                **asdict(rung),
                "parameters": list(rung.parameters),
                "errors": {
                    name: {"unit": unit, "mean": mean}
                    for name, unit, mean in rung.errors
                },
            }
            for rung in ladder.rungs
        ],
    }


def _group(group: CoupledGroup) -> Json:
    return {
        "group": group.number,
        "expression": group.expression,
        "unit": group.unit,
        "value": group.value,
        "sigma": group.sigma,
        "terms": [
            {"parameter": name, "coefficient": coefficient}
            for name, coefficient in group.terms
        ],
    }


def _setup_file(file: str) -> Json | None:
    return {"file": file, "sha256": _sha256_of(file)} if file else None


def _sha256_of(file: str) -> str:
    # A pipe cannot be read twice.
    if not Path(file).is_file():
        return ""
    digest = hashlib.sha256()
    for block in read_blocks(file, 1 << 20):
        digest.update(block)
    return digest.hexdigest()


def _frame(pose: pin.SE3) -> Json:
    return {
        "xyz": pose.translation.tolist(),
        "rpy": pin.rpy.matrixToRpy(pose.rotation).tolist(),
    }


def _instrument(
    fitted: MeasurementModel, reference: MeasurementModel
) -> tuple[Json, Json]:
    """What rows refer to: frames by name, and the other sections.

    Points of the tool and planes have a section in every document.
    """
    frames: Json = {}
    sections: Json = {"targets": {}, "planes": {}}
    for feature, start in zip(fitted.features, reference.features, strict=True):
        values, flags = _stated(feature)
        entry = {**values, **flags, "reference": _stated(start)[0]}
        if isinstance(feature, Frame):
            frames[f"{feature.name}.{feature.kind}"] = entry
        elif feature.section == "camera":  # There is one at most.
            sections[feature.section] = entry
        else:
            sections.setdefault(feature.section, {})[feature.name] = entry
    return frames, sections


def _stated(feature: Feature) -> tuple[Json, Json]:
    """Values of a feature, and what of it was estimated."""
    stated = asdict(feature.stated())
    flags = {key: stated.pop(key) for key in [*stated] if key.startswith("estimate")}
    return stated, {k.replace("estimate", "estimated"): v for k, v in flags.items()}


def _errors(errors: QuantityErrors, method: str) -> Json:
    def plain(accuracy: Accuracy | None) -> Json | None:
        return None if accuracy is None else asdict(accuracy)

    return {
        "unit": errors.unit,
        "training": {"before": plain(errors.before), "after": plain(errors.after)},
        "validation": {
            "method": method,
            "before": plain(errors.validation_before),
            "after": plain(errors.validation_after),
        },
    }


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return value
