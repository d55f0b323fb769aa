"""The calibrated robot of a `calibration.json`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from itertools import permutations, product
from typing import Any, TypeVar

import numpy as np
import pinocchio as pin

from calib_pin.io.json_text import Json, typed
from calib_pin.io.result_folder import numbers, text
from calib_pin.io.setup import setup_of
from calib_pin.kinematics.chain import Chain
from calib_pin.measurement_models import MeasurementModel, Mixed, measurement_model
from calib_pin.measurement_models.mixed import qualified
from calib_pin.measurement_models.mount import Frame
from calib_pin.observations import AT, PART, PLUS
from calib_pin.parameterizations import PARAMETERIZATIONS, frame_setup
from calib_pin.parameterizations.error_model import ErrorModel
from calib_pin.setup import (
    AnchorSetup,
    CameraSetup,
    FrameSetup,
    PlaneSetup,
    PointSetup,
    Setup,
    SphereSetup,
)
from calib_pin.validation.calibrated_model import CalibratedModel

_T = TypeVar("_T")

ENDS = ("base", "tool")
"""The frames at the two ends of a chain."""

SECTIONS: Mapping[str, type] = {
    "planes": PlaneSetup,
    "targets": PointSetup,
    "sockets": PointSetup,
    "spheres": SphereSetup,
    "anchors": AnchorSetup,
}
"""Sections of what measurements can refer to by name."""


def model_of(document: Json, chain: Chain) -> CalibratedModel:
    """The calibrated robot of a document.

    Args:
        document: Frames, what the measurements refer to, parameters and setup.
        chain: The nominal chain.

    Raises:
        CalibPinError, KeyError, TypeError, ValueError, AttributeError: If a part is
            missing or is not what it should be, see `result_folder.reading`.
    """
    frames = document["frames"]
    (base, free_base), (tool, free_tool) = (_read_frame(frames[k]) for k in ENDS)
    fitted = _instrument(document)
    if "setup" in document:
        setup = setup_of(document["setup"])
    else:  # It is no part of the contract; what is known follows from the rest.
        known = [
            FrameSetup(estimate=True) if estimated else frame_setup(pose, known=True)
            for pose, estimated in ((base, free_base), (tool, free_tool))
        ]
        setup = replace(fitted, base_frame=known[0], tool_frame=known[1])
    fitted = replace(fitted, ranger=setup.ranger)
    measurement = _measurement(document["measurements"], fitted, frames)
    values = _values(document["parameters"])
    kinds = {_kind(name) for name in values}
    for member in PARAMETERIZATIONS.values():
        for key in member.requires if member.kind in kinds else ():
            if key not in document.get("setup", {}):
                raise ValueError(
                    f"'setup.{key}' is missing, which '{member.kind}' needs"
                )
    own = {parameter.name for parameter in measurement.parameters}
    names = [name for name in values if name not in own]
    error = _error_model(chain, names, setup, free_base, free_tool)
    stated = {name: values[name] for name in error.parameters.names}
    theta = error.parameters.vector(stated)
    theta[error.parameters.nuisance] = 0.0  # The frames hold these.
    if chain.tip_joint is None:
        tool = error.corrections(theta)[-2].actInv(tool)
    return CalibratedModel(
        error=error.with_frames(base, tool),
        measurement=measurement,
        theta=theta,
        setup=setup,
    )


def reference_of(document: Json, model: CalibratedModel) -> CalibratedModel:
    """The nominal robot about the references of a document.

    Args:
        document: The document; where it states no reference, that is the value.
        model: The calibrated robot that it tells of.

    Raises:
        CalibPinError, KeyError, TypeError, ValueError, AttributeError: As `model_of`.
    """

    def at_start(entries: Json) -> Json:
        return {
            k: {**entry, **entry.get("reference", {})} for k, entry in entries.items()
        }

    sections = {key: at_start(document.get(key, {})) for key in ("frames", *SECTIONS)}
    if document.get("camera") is not None:
        sections |= at_start({"camera": document["camera"]})
    zero = [{**entry, "value": 0.0} for entry in document["parameters"]]
    return model_of({**document, **sections, "parameters": zero}, model.chain)


def _instrument(document: Json) -> Setup:
    """The references of the measurements as they were fitted."""
    sections: dict[str, Any] = {
        # Files may lack what came later.
        section: {
            name: _reference(kind, entry)
            for name, entry in document.get(section, {}).items()
        }
        for section, kind in SECTIONS.items()
    }
    for plane in sections["planes"].values():
        if not 0.99 < math.hypot(*plane.normal) < 1.01:
            raise ValueError("the normal of a plane is not of unit length")
    if any(sphere.radius <= 0.0 for sphere in sections["spheres"].values()):
        raise ValueError("the radius of a sphere is not positive")
    camera = document.get("camera")
    if camera is not None:
        camera = _reference(CameraSetup, camera)
    return Setup(**sections, camera=camera)


def _reference(kind: type[_T], entry: Json) -> _T:
    """One of them, of which a document states every key."""
    keys = [part.name for part in fields(kind)]  # type: ignore[arg-type]
    stated = {key: entry[key.replace("estimate", "estimated")] for key in keys}
    for key, value in stated.items():
        if not isinstance(value, str | bool) and (key, value) != ("size", None):
            numbers(value if isinstance(value, list) else [value])
    return typed(kind, stated)


def _measurement(about: Json, fitted: Setup, frames: Json) -> MeasurementModel:
    """The measurement model as it was fitted.

    Args:
        about: The document's part about the measurements.
        fitted: The references of the measurements.
        frames: The frames by name.
    """
    name = text(about["model"])
    parts = name.split(PLUS)
    mixed = len(parts) > 1
    # Earlier files name no targets; they have neither mixed models nor points.
    known = "targets" in about or mixed or bool(fitted.targets)
    targets = ["" if t == "" else text(t) for t in about["targets"]] if known else []
    if mixed and not {target.partition(PART)[0] for target in targets} <= set(parts):
        raise ValueError("'measurements.targets' are not those of 'measurements.model'")
    named = qualified(parts, targets) if mixed else {name: targets}
    made = {part: _part(part, fitted, seen) for part, seen in named.items()}
    model: MeasurementModel = Mixed.create(made) if mixed else made[name]
    references = list(model.references)
    for k, frame in enumerate(references):
        if isinstance(frame, Frame):  # Of an instrument that is one among others.
            pose, estimated = _read_frame(frames[f"{frame.name}.{frame.kind}"])
            references[k] = replace(frame, pose=pose, estimate=estimated)
    model = model.with_references(references)
    for part in references:
        if not part.located:
            raise ValueError(f"'{part.name}' is missing under '{part.section}'")
    used = {(part.section, part.name) for part in references}
    for section in SECTIONS:
        for member in getattr(fitted, section):
            if (section, member) not in used:
                raise ValueError(
                    f"no measurement refers to '{member}' under '{section}'"
                )
    if model.name != name or (known and list(model.targets) != targets):
        raise ValueError("'measurements.targets' are not those of 'measurements.model'")
    return model


def _part(name: str, fitted: Setup, targets: Sequence[str]) -> MeasurementModel:
    """One of the models, which knows only what its targets can name."""
    if name == "camera" and fitted.camera is None:
        raise ValueError("'camera' is missing")
    halves = {half for target in targets for half in (target, *target.rpartition(AT))}

    def seen(members: Mapping[str, Any]) -> dict[str, Any]:
        return {k: v for k, v in members.items() if not targets or k in halves}

    named = replace(fitted, planes=seen(fitted.planes), targets=seen(fitted.targets))
    return measurement_model(name, named, targets)


def _values(entries: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Value of every parameter by name."""
    values: dict[str, float] = {}
    for entry in entries:
        name = text(entry["name"])
        if name in values:
            raise ValueError(f"parameter '{name}' is here twice")
        (values[name],) = numbers([entry["value"]], 1)
    return values


def _error_model(
    chain: Chain,
    names: list[str],
    setup: Setup,
    free_base: bool,
    free_tool: bool,
) -> ErrorModel:
    """The error model with parameters of these names in this order.

    The order matters: it is that of the screws at a place, so also that in which the
    user named the parameterizations.
    """
    kinds = [
        [name for name, member in PARAMETERIZATIONS.items() if member.kind == kind]
        for kind in dict.fromkeys(map(_kind, names))
    ]
    # Several parameterizations may share a kind of parameters.
    orders = [
        order
        for members in product(*filter(None, kinds))
        for order in permutations(members)
    ]
    for order in orders:
        error = ErrorModel.create(
            chain,
            order,
            setup=setup,
            estimate_base=free_base,
            estimate_tool=free_tool,
        )
        if list(error.parameters.names) == names:
            return error
    raise ValueError("the parameters are not those of this chain, in their order")


def _kind(name: str) -> str:
    """The kind in `<owner>.<kind>.<component>`; an owner may contain points.

    Raises:
        ValueError: If it is no such name.
    """
    _, kind, _ = name.rsplit(".", 2)
    return kind


def _read_frame(entry: Mapping[str, Any]) -> tuple[pin.SE3, bool]:
    """A frame and whether it was estimated."""
    roll, pitch, yaw = numbers(entry["rpy"], 3)
    position = np.array(numbers(entry["xyz"], 3))
    pose = pin.SE3(pin.rpy.rpyToMatrix(roll, pitch, yaw), position)
    return pose, typed(bool, entry["estimated"])
