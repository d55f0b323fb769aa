"""`calibration.json`: a result as a JSON document, section 8 of the contract."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pinocchio as pin

from calib_pin.estimation.evidence import PoseErrors
from calib_pin.estimation.system import FRAME, Part
from calib_pin.io.calibrated_model import (
    CAMERA,
    CAMERAS,
    count_without_instruments,
    frame_key,
    tip_correction,
)
from calib_pin.io.documents import identification_parts, model_name, stated
from calib_pin.io.files import read_bytes
from calib_pin.io.journal import sha256
from calib_pin.io.json_text import Json, plain
from calib_pin.io.measurement_errors import SETS
from calib_pin.io.setup import setup_document
from calib_pin.kinematics.chains import Chains
from calib_pin.measurement_models.references import ReferenceObject
from calib_pin.planning.suggestions import Suggestion
from calib_pin.validation.accuracy import QuantityErrors
from calib_pin.validation.assessment import chi2_interval
from calib_pin.validation.breakdown import Breakdown
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.result import CalibrationResult, UrdfResult
from calib_pin.validation.summaries import ModelSelection, Provenance, ToolAccuracy

SAMPLES = ("configurations", "points", "position", "orientation")
"""Keys of the predicted uncertainty of the tool point, arrays over the workspace."""

BREAKDOWN = tuple(f.name for f in fields(Breakdown) if f.name != "accuracies")
"""Parts of a result that tell of its stations, tools, chains and blocks."""

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
    model, robot = result.model, result.model.chains.robot
    statistics, made = result.statistics, provenance or result.provenance
    hashes = made.hashes or tuple(map(sha256_of, result.files))
    dof, covariance = statistics.dof, result.covariance
    described = _model(model, result.reference)
    chain = model.moving.error.chain
    return {
        **stated("calibration"),
        "verdict": {"status": result.verdict, "reason": result.reason},
        "findings": plain(result.findings),
        "robot": {
            "name": robot.name,
            "file": robot.file,
            "sha256": sha256(robot.source),
            "base": chain.base,
            "tip": chain.tip,
            "joints": list(model.chains.joints),
            **_chains(model.chains),
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
        **_rotations(result),
        **described,
        **identification_parts(result, suggestions),
        "errors": _errors(result.errors, result.validation.method),
        "validation": plain(result.validation),
        "predicted": _predicted(result.accuracy),
        **_further_chains(result),
        **{key: plain(getattr(result, key)) for key in BREAKDOWN},
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
        **(
            {"recalibration": plain(result.recalibration)}
            if result.recalibration is not None
            else {}
        ),
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


def _chains(chains: Chains) -> Json:
    """Both ends of all chains by name; none where there is only one, without a name."""
    if chains.names == ("",):
        return {}
    ends = {name: chains[name] for name in chains.names}
    found = {name: {"base": end.base, "tip": end.tip} for name, end in ends.items()}
    return {"chains": found}


def _model(model: CalibratedModel, reference: CalibratedModel) -> Json:
    """A calibrated robot: frames, what the measurements refer to, and its setup.

    Points of the tool and planes have a section in every document.
    """
    sections: Json = {"targets": {}, "planes": {}}
    for (section, name), found in model.references.items():
        values, flags = _stated(found)
        start = _stated(reference.references[section, name])[0]
        entry = {**values, **flags, "reference": start}
        if (section, name) == (CAMERA, CAMERA):
            sections[CAMERA] = entry
        else:
            key = CAMERAS if section == CAMERA else section
            sections.setdefault(key, {})[name] = entry
    parts = model.parts.values()
    targets = (target for part in parts for target in part.measurement.targets)
    blocks = [
        {**key._asdict(), "targets": list(part.measurement.targets)}
        for key, part in model.parts.items()
    ]
    plain = len(blocks) == 1 and not any(model.only.key[1:])
    return {
        "measurements": {
            "model": model_name(model),
            "targets": list(dict.fromkeys(targets)),
            **({} if plain else {"blocks": blocks}),
        },
        "frames": _frames(model, reference),
        **sections,
        "setup": setup_document(model.setup),
    }


def _frames(model: CalibratedModel, reference: CalibratedModel) -> Json:
    """The frames of all stations, then of all tools, each once."""
    stations: Json = {}
    tools: Json = {}
    for key, part in model.parts.items():
        chain, start, scope = part.error.chain, reference.parts[key], part.scope
        station, tool = frame_key(scope.station), frame_key(scope.tool)
        free = model.given.free[part.index]
        inner = len(part.error.screws) - FRAME
        stations[station] = {
            **_frame(part.error.base),
            "estimated": bool(free[:FRAME].any()),
            "reference": _frame(start.error.base),
            **({} if station == "base" else {"link": chain.base}),
        }
        tools[tool] = {
            **_frame(tip_correction(part, model.theta) * _carrier(part)),
            "estimated": bool(free[inner : inner + FRAME].any()),
            "reference": _frame(_carrier(start)),
            **({} if tool == "tool" else {"link": chain.tip}),
        }
    return stations | tools


def _carrier(part: Part) -> pin.SE3:
    """The tool frame of a part, or that of the tool that its own is known on."""
    return part.error.tool * part.scope.offset.inverse()


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


def _further_chains(result: CalibrationResult) -> Json:
    """The expected errors of the tools of all chains but the first."""
    _, *others = result.accuracies or [""]
    found = {name: _predicted(result.accuracies[name]) for name in others}
    return {"predicted_by_chain": found} if found else {}


def _rotations(result: CalibrationResult) -> Json:
    """Rotations from the measurement frame to the base link.

    It is that of the first block; where others differ, those of all stand beside it.
    """
    sets = zip(SETS, (result.fitted, result.held_out), strict=True)
    found = {name: part.to_base for name, part in sets if part is not None}
    first = result.fitted.to_base[0]
    alike = all(
        np.array_equal(rotation, first, equal_nan=True)
        for rotations in found.values()
        for rotation in rotations
    )
    return {
        "rotation_to_base": first.tolist(),
        **({} if alike else {"rotations_to_base": plain(found)}),
    }


def _urdf(urdf: UrdfResult, method: str) -> Json:
    described = None
    if urdf.model is not None:
        count = count_without_instruments(urdf.model)
        values = urdf.model.theta[:count].tolist()
        described = {
            **_model(urdf.model, urdf.model),
            "parameters": [
                {"name": name, "value": value}
                for name, value in zip(urdf.model.given.names, values, strict=False)
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
        "use": ladder.use,
        "near": plain(ladder.near),
        "rungs": [
            {
                **plain(rung),
                "errors": {
                    name: {"unit": unit, "mean": mean}
                    for name, unit, mean in rung.errors
                },
                "away": rung.away
                and {
                    **plain(rung.away),
                    "errors": {
                        e.name: {"unit": e.unit, "mean": e.mean, "rms": e.rms}
                        for e in rung.away.errors
                    },
                },
            }
            for rung in ladder.candidates
        ],
    }


def sha256_of(file: str) -> str:
    """Hexadecimal SHA-256 of a file; empty for what is none, such as a pipe."""
    # A pipe cannot be read twice.
    return sha256(read_bytes(file)) if Path(file).is_file() else ""


def _setup_file(file: str) -> Json | None:
    return {"file": file, "sha256": sha256_of(file)} if file else None
