"""`calibration.json`: a result as a file, and the calibrated robot back from it."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from calib_pin.chain import Chain
from calib_pin.error_model import ErrorModel
from calib_pin.errors import CalibPinError, InputError, OutputError
from calib_pin.io.files import read_bytes
from calib_pin.io.urdf import load_robot, write_corrected_urdf
from calib_pin.measurement_models import measurement_model
from calib_pin.measurement_models.plane_distance import PlaneDistance
from calib_pin.result import (
    Accuracy,
    CalibratedModel,
    CalibrationResult,
    Identification,
    QuantityErrors,
)
from calib_pin.setup import PlaneSetup, Setup

__all__ = [
    "FORMAT",
    "VERSION",
    "Provenance",
    "calibration_document",
    "encode",
    "identification_document",
    "read_calibration",
    "sha256",
    "write_urdf",
]

FORMAT = "calib-pin/calibration"
VERSION = 1

AGREEMENT = 1e-9
"""Largest difference of forward kinematics between model and written URDF [m, rad]."""

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


def sha256(data: bytes) -> str:
    """Hexadecimal SHA-256 of bytes."""
    return hashlib.sha256(data).hexdigest()


def encode(document: Mapping[str, Any]) -> bytes:
    """JSON text of a document; numbers that are not finite become null."""
    text = json.dumps(_finite(document), indent=1, allow_nan=False, ensure_ascii=False)
    return text.encode() + b"\n"


def identification_document(found: Identification) -> Json:
    """The parts `parameters` and `identifiability` of section 8 of the contract."""
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
            "structural_gap": ranks.gap,
            "everett": ranks.everett,
            "weak": ranks.weak,
            "condition": ranks.condition,
            "singular_values": list(ranks.singular_values),
            "observability": ranks.observability,
            "coupled": [
                {
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
                for group in found.groups
            ],
            "correlated": [
                {"first": first, "second": second, "correlation": value}
                for first, second, value in ranks.correlated
            ],
        },
    }


def calibration_document(result: CalibrationResult, provenance: Provenance) -> Json:
    """A result as the JSON document of version 1.

    Raises:
        InputError: If a measurement file cannot be read again for its hash.
    """
    model, robot = result.model, result.model.chain.robot
    planes = {}
    if isinstance(model.measurement, PlaneDistance):
        planes = {
            plane.name: {
                "normal": np.asarray(plane.normal).tolist(),
                "offset": plane.offset,
                "estimated": plane.estimate,
            }
            for plane in model.measurement.planes
        }
    free = model.error.parameters.free
    return {
        "format": FORMAT,
        "version": VERSION,
        "verdict": {"status": result.verdict, "reason": result.reason},
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
                {"file": file, "sha256": sha256(read_bytes(file))}
                for file in result.files
            ],
            "model": model.measurement.name,
            "training": result.training,
            "validation": result.validated,
        },
        **identification_document(result),
        "errors": {e.name: _errors(e, result.validation) for e in result.errors},
        "statistics": {
            "chi2": result.chi2,
            "dof": result.dof,
            "sigma0": result.sigma0,
            "stated_sigma": result.stated_sigma,
            "outliers": [asdict(outlier) for outlier in result.outliers],
        },
        "solver": {
            "name": "gauss-newton",
            "status": result.status.value,
            "iterations": result.iterations,
            "evaluations": result.evaluations,
            "seconds": provenance.seconds,
            "seed": result.seed,
        },
        "frames": {
            "base": _frame(model.error.base, bool(free[:6].any())),
            "tool": _frame(model.tool, bool(free[-6:].any())),
        },
        "targets": {},
        "planes": planes,
        "residual_model": None,
        "provenance": {
            **provenance.versions,
            "command": list(provenance.command),
            "created": provenance.created,
        },
    }


def read_calibration(path: str | Path) -> CalibratedModel:
    """The calibrated robot of a `calibration.json`.

    The robot is found where the file says, or beside the file itself, and must be the
    one that was calibrated.

    Raises:
        InputError: If the file is not such a document or of a later version, or the
            robot has changed.
        RobotError: If the robot cannot be found.
    """
    try:
        document = json.loads(read_bytes(path).decode("utf-8-sig"))
    except ValueError as error:
        reason = f"not a calibration: {error}"
        raise InputError(reason, file=path) from error
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise InputError("not a calibration of calib-pin", file=path)
    version = document.get("version")
    if not isinstance(version, int) or not 1 <= version <= VERSION:
        raise InputError(
            "a calibration of another version",
            file=path,
            value=version,
            allowed=f"1 to {VERSION}",
        )
    try:
        return _model(document, Path(path))
    except CalibPinError:
        raise
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        reason = f"damaged or edited calibration ({type(error).__name__}: {error})"
        raise InputError(reason, file=path) from error


def write_urdf(
    model: CalibratedModel, path: str | Path, *, force: bool = False
) -> None:
    """Write the corrected URDF of a calibrated robot.

    Only the joint origins that change are edited. The result is read again and its
    forward kinematics compared with the model before it is put in place.

    Args:
        model: The calibrated robot.
        path: The new file.
        force: Replace an existing file; the robot's own file is never replaced.

    Raises:
        OptionError: If the file exists or is the robot's own.
        OutputError: If it cannot be written or does not agree with the model.
    """
    chain = model.chain
    q = chain.random_configurations(20, np.random.default_rng(0))
    expected = model.error.base.actInv(pin.SE3.Identity()).homogeneous @ model.poses(q)

    def check(robot: Any) -> None:
        written = Chain(robot, chain.base, chain.tip)
        found = written.poses(q) @ model.tool.homogeneous
        difference = float(np.abs(found - expected).max())
        if not difference < AGREEMENT:
            raise OutputError(
                f"{path}: the written robot differs from the model by {difference:.2g}"
            )

    write_corrected_urdf(path, chain.robot, model.urdf_corrections(), check, force)


def _model(document: Json, path: Path) -> CalibratedModel:
    about = document["robot"]
    beside = path.parent / Path(about["file"]).name
    moved = not Path(about["file"]).is_file() and beside.is_file()
    robot = load_robot(beside if moved else about["file"])
    if sha256(robot.source) != about["sha256"]:
        raise InputError(
            f"the robot '{about['file']}' is not the one that was calibrated: its "
            "content has changed",
            file=path,
        )
    chain = Chain(robot, about["base"], about["tip"])
    values = {entry["name"]: float(entry["value"]) for entry in document["parameters"]}
    kinds = dict.fromkeys(name.rsplit(".", 2)[-2] for name in values)
    known = ("placement", "link-transform", "dh", "joint-offset")
    error = ErrorModel.create(
        chain,
        # The names of `dh` are among those of `dh-full`.
        ["dh-full" if kind == "dh" else kind for kind in known if kind in kinds],
        estimate_base=bool(document["frames"]["base"]["estimated"]),
        estimate_tool=bool(document["frames"]["tool"]["estimated"]),
    )
    theta = error.parameters.vector(
        {
            name: value
            for name, value in values.items()
            if name.rsplit(".", 2)[-2] not in ("frame", "plane")
        }
    )
    base, tool = (_read_frame(document["frames"][name]) for name in ("base", "tool"))
    if chain.tip_joint is None:
        tool = error.corrections(theta)[-2].actInv(tool)
    planes = {
        name: PlaneSetup(
            normal=_triple(plane["normal"]),
            offset=float(plane["offset"]),
            estimate=bool(plane["estimated"]),
        )
        for name, plane in document["planes"].items()
    }
    setup = Setup(
        base=chain.base,
        tip=chain.tip,
        model=document["measurements"]["model"],
        planes=planes,
    )
    return CalibratedModel(
        error=error.with_frames(base, tool),
        measurement=measurement_model(str(setup.model), setup),
        theta=theta,
        setup=setup,
    )


def _frame(pose: pin.SE3, estimated: bool) -> Json:
    return {
        "xyz": pose.translation.tolist(),
        "rpy": pin.rpy.matrixToRpy(pose.rotation).tolist(),
        "estimated": estimated,
    }


def _read_frame(entry: Mapping[str, Sequence[float]]) -> pin.SE3:
    rotation = pin.rpy.rpyToMatrix(*map(float, entry["rpy"]))
    return pin.SE3(rotation, np.array(entry["xyz"], float))


def _triple(values: Sequence[float]) -> tuple[float, float, float]:
    x, y, z = map(float, values)
    return x, y, z


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
