"""The calibrated robot of a `calibration.json`."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import permutations, product
from typing import Any

import numpy as np
import pinocchio as pin

from calib_pin.io.calibration_file import numbers, text
from calib_pin.io.json_text import Json
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
    Triple,
)
from calib_pin.validation.calibrated_model import CalibratedModel

ENDS = ("base", "tool")
"""The frames at the two ends of a chain."""

SECTIONS = ("planes", "targets", "sockets", "spheres", "anchors")
"""Sections of what measurements can refer to by name."""


def model_of(document: Json, chain: Chain) -> CalibratedModel:
    """The calibrated robot of a document.

    Args:
        document: Frames, what the measurements refer to, parameters and setup.
        chain: The nominal chain.

    Raises:
        CalibPinError, KeyError, TypeError, ValueError, AttributeError: If a part is
            missing or is not what it should be, see `calibration_file.reading`.
    """
    frames = document["frames"]
    (base, free_base), (tool, free_tool) = (_read_frame(frames[k]) for k in ENDS)
    fitted = _instrument(document)
    if "setup" in document:
        setup = setup_of(document["setup"])
    else:  # It is no part of the contract; what is known follows from the rest.
        known = (_known_frame(base, free_base), _known_frame(tool, free_tool))
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
    """What rows refer to as it was fitted; files may lack what came later."""

    def section(key: str, read: Callable[[Json], Any]) -> dict[str, Any]:
        return {name: read(entry) for name, entry in document.get(key, {}).items()}

    camera = document.get("camera")
    return Setup(
        planes=section("planes", _read_plane),
        targets=section("targets", _read_point),
        sockets=section("sockets", _read_point),
        spheres=section("spheres", _read_sphere),
        anchors=section("anchors", _read_anchor),
        camera=None if camera is None else _read_camera(camera),
    )


def _measurement(about: Json, fitted: Setup, frames: Json) -> MeasurementModel:
    """The measurement model as it was fitted.

    Args:
        about: What the document says of the measurements.
        fitted: What rows refer to.
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
    model = model.with_references(
        [
            _read_stand(reference, frames)
            if isinstance(reference, Frame)
            else reference
            for reference in model.references
        ]
    )
    for reference in model.references:
        if not reference.located:
            raise ValueError(
                f"'{reference.name}' is missing under '{reference.section}'"
            )
    used = {(reference.section, reference.name) for reference in model.references}
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
    """One of the models, which knows only what its rows can name."""
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
    """The kind in `<owner>.<kind>.<component>`; an owner may contain points."""
    _, kind, _ = name.rsplit(".", 2)
    return kind


def _read_frame(entry: Mapping[str, Any]) -> tuple[pin.SE3, bool]:
    """A frame and whether it was estimated."""
    roll, pitch, yaw = numbers(entry["rpy"], 3)
    position = np.array(numbers(entry["xyz"], 3))
    return pin.SE3(pin.rpy.rpyToMatrix(roll, pitch, yaw), position), _flag(entry)


def _known_frame(pose: pin.SE3, estimated: bool) -> FrameSetup:
    return FrameSetup(estimate=True) if estimated else frame_setup(pose, known=True)


def _read_stand(frame: Frame, frames: Json) -> Frame:
    """A frame of an instrument that is one among others."""
    pose, estimated = _read_frame(frames[f"{frame.name}.{frame.kind}"])
    return replace(frame, pose=pose, estimate=estimated)


def _read_plane(entry: Mapping[str, Any]) -> PlaneSetup:
    x, y, z = numbers(entry["normal"], 3)
    if not 0.99 < math.hypot(x, y, z) < 1.01:
        raise ValueError("the normal of a plane is not of unit length")
    (offset,) = numbers([entry["offset"]], 1)
    return PlaneSetup(normal=(x, y, z), offset=offset, estimate=_flag(entry))


def _read_point(entry: Mapping[str, Any]) -> PointSetup:
    return PointSetup(_xyz(entry), _flag(entry))


def _read_sphere(entry: Mapping[str, Any]) -> SphereSetup:
    (radius,) = numbers([entry["radius"]], 1)
    if radius <= 0.0:
        raise ValueError("the radius of a sphere is not positive")
    return SphereSetup(_xyz(entry), radius, _flag(entry), _flag(entry, "_radius"))


def _read_anchor(entry: Mapping[str, Any]) -> AnchorSetup:
    (bias,) = numbers([entry["bias"]], 1)
    return AnchorSetup(_xyz(entry), bias, _flag(entry), _flag(entry, "_bias"))


def _read_camera(entry: Mapping[str, Any]) -> CameraSetup:
    mount = entry["mount"]
    if mount not in ("hand", "world"):
        raise ValueError("the mount of the camera is neither hand nor world")
    f_x, f_y, c_x, c_y = numbers([*entry["focal"], *entry["center"]], 4)
    k_1, k_2, p_1, p_2, k_3 = numbers(entry["distortion"], 5)
    size = None
    if entry["size"] is not None:
        width, height = numbers(entry["size"], 2)
        size = width, height
    return CameraSetup(
        mount, (f_x, f_y), (c_x, c_y), (k_1, k_2, p_1, p_2, k_3), size, _flag(entry)
    )


def _xyz(entry: Mapping[str, Any]) -> Triple:
    x, y, z = numbers(entry["xyz"], 3)
    return x, y, z


def _flag(entry: Mapping[str, Any], of: str = "") -> bool:
    flag = entry[f"estimated{of}"]
    if not isinstance(flag, bool):
        raise ValueError(f"'estimated{of}' is neither true nor false")
    return flag
