"""The calibrated robot out of `calibration.json`, and into a corrected URDF."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import permutations, product
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import InputError, OptionError, OutputError, RobotError
from calib_pin.estimation.evidence import TRUSTED
from calib_pin.io.calibration_file import (
    numbers,
    read_document,
    reading,
    stated_errors,
    text,
)
from calib_pin.io.documents import Json
from calib_pin.io.files import write_atomically
from calib_pin.io.journal import sha256
from calib_pin.io.residual_model import read_residual_model
from calib_pin.io.result_folder import (
    NOMINAL,
    Read,
    members,
    opened,
    require_one_run,
)
from calib_pin.io.setup import setup_of
from calib_pin.io.urdf import corrected_urdf, locate_robot, parse_robot
from calib_pin.kinematics.chain import Chain, Robot
from calib_pin.measurement_models import MeasurementModel, Mixed, measurement_model
from calib_pin.measurement_models.features import Frame
from calib_pin.measurement_models.mixed import qualified
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
from calib_pin.validation.result import CalibratedModel

__all__ = ["encode_urdf", "read_accuracy", "read_calibration", "write_urdf"]

AGREEMENT = 1e-9
"""Largest difference of forward kinematics between model and written URDF [m, rad]."""

ENDS = ("base", "tool")
"""The frames at the two ends of a chain."""

SECTIONS = ("planes", "targets", "sockets", "spheres", "anchors")
"""What rows can refer to, by name."""


@serial_blas
def read_calibration(
    path: str | Path, *, notice: Callable[[str], None] | None = None
) -> CalibratedModel:
    """The calibrated robot of a `calibration.json`.

    The robot is looked for where the file says, from the working folder and from that
    of the file, and beside the file itself, where `calibrate` keeps a copy. It must be
    the one that was calibrated.

    Args:
        path: The file.
        notice: Called with one sentence if the calibration must not be trusted.

    Raises:
        InputError: If the file is not such a document or of a later version, the
            robot has changed, or the files beside it are of another run.
        OutputError: If another program does not let go of the folder.
        RobotError: If the robot cannot be found.
    """
    with opened(path) as read:
        return _read(Path(path), read, notice)


def _read(
    path: Path, read: Read, notice: Callable[[str], None] | None
) -> CalibratedModel:
    document = read_document(path, read)
    robot = _find_robot(document, path, read)
    with reading(path):
        listed, run = members(document), str(document.get("run", ""))
        model = _model(document, robot)
        learned = _learned(document.get("residual_model"))
        if (learned is None) != (model.setup.learned is None):
            raise ValueError("'residual_model' and 'setup.learned' need each other")
        verdict = document["verdict"]
        if notice is not None and verdict["status"] not in TRUSTED:
            notice(f"{path} must not be trusted: {verdict['reason']}")
    require_one_run(listed, run, robot.source, path, read)
    if learned is None:
        return model
    name, content = learned
    found = read_residual_model(path.parent / name, model.error, content, read)
    return replace(model, error=replace(model.error, learned=found))


def read_accuracy(path: str | Path) -> dict[str, dict[str, Any]]:
    """What a `calibration.json` says of its accuracy on unseen rows.

    Args:
        path: The file, which `read_calibration` has read.

    Returns:
        Unit, mean, max and method of every quantity; none where nothing was checked.
    """
    with opened(path) as read:
        document = read_document(path, read)
    with reading(path):
        stated = stated_errors(document)
    return {
        errors.name: {
            "unit": errors.unit,
            "mean": errors.validation_after.mean,
            "max": errors.validation_after.max,
            "method": method,
        }
        for errors, method in stated
        if errors.validation_after is not None and errors.unit in ("m", "rad")
    }


def write_urdf(
    model: CalibratedModel, path: str | Path, *, force: bool = False
) -> None:
    """Write the corrected URDF of a calibrated robot.

    Args:
        model: The calibrated robot, `CalibrationResult.geometry`.
        path: The new file.
        force: Replace an existing file; the robot's own file is never replaced.

    Raises:
        OptionError: If the file exists or is the robot's own, or the model has
            corrections that a URDF cannot hold.
        OutputError: If it cannot be written or does not agree with the model.
    """
    write_atomically(Path(path), encode_urdf(model, path), force=force)


def encode_urdf(model: CalibratedModel, path: str | Path) -> bytes:
    """The corrected URDF of a calibrated robot.

    Only the joint origins that change are edited. The result is read again and its
    forward kinematics compared with the model.

    Args:
        model: The calibrated robot, `CalibrationResult.geometry`.
        path: The file it is for, never the robot's own.

    Raises:
        OptionError: If the file is the robot's own, or the model has corrections that
            a URDF cannot hold.
        OutputError: If it does not agree with the model.
    """
    chain = model.chain
    if not model.geometric:
        raise OptionError(
            "a URDF cannot hold corrections of the joints; write the geometry alone",
            file=path,
            allowed="CalibrationResult.geometry",
        )
    q = chain.random_configurations(20, np.random.default_rng(0))
    expected = model.error.base.inverse().homogeneous @ model.poses(q)

    def check(robot: Robot) -> None:
        written = Chain(robot, chain.base, chain.tip)
        found = written.poses(q) @ model.tool.homogeneous
        difference = float(np.abs(found - expected).max())
        if not difference < AGREEMENT:
            raise OutputError(
                f"{path}: the written robot differs from the model by {difference:.2g}"
            )

    return corrected_urdf(path, chain.robot, model.urdf_corrections(), check)


def _find_robot(document: Json, path: Path, read: Read) -> Robot:
    """The robot that was calibrated, recognized by its content.

    Where it was calibrated comes before the copy: meshes are beside the former.
    """
    missing: RobotError | None = None
    copy = path.parent / NOMINAL
    try:
        name, content = document["robot"]["file"], document["robot"]["sha256"]
        stated = locate_robot(name)
        places = [stated, path.parent / stated, path.parent / stated.name, copy]
    except RobotError as error:  # The package it came from is not installed here.
        missing, stated, places = error, copy, [copy]
    except (KeyError, TypeError, AttributeError) as error:
        reason = "damaged or edited calibration: it names no robot"
        raise InputError(reason, file=path) from error
    found = None
    for place in dict.fromkeys(places):
        try:
            data = read(place)
        except InputError:
            continue
        if sha256(data) == content:
            kept = place == stated and missing is None
            return parse_robot(data, name if kept else str(place))
        found = found or place
    if missing is not None:
        raise missing
    if found is None:
        raise RobotError(
            f"the robot '{name}' that was calibrated is neither there nor beside the "
            "calibration",
            file=path,
        )
    raise InputError(
        f"'{found}' is not the robot that was calibrated: its content differs; keep "
        "the files of one run together",
        file=path,
    )


def _model(document: Json, robot: Robot) -> CalibratedModel:
    about = document["robot"]
    chain = Chain(robot, text(about["base"]), text(about["tip"]))
    if list(chain.joints) != about["joints"]:
        raise ValueError("the joints are not those from base to tip")
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
    model = model.with_features(
        [
            _read_stand(feature, frames) if isinstance(feature, Frame) else feature
            for feature in model.features
        ]
    )
    for feature in model.features:
        if not feature.placed:
            raise ValueError(f"'{feature.name}' is missing under '{feature.section}'")
    used = {(feature.section, feature.name) for feature in model.features}
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


def _learned(stated: Mapping[str, Any] | None) -> tuple[str, str] | None:
    """Name and SHA-256 of the file of what was learned, if anything was."""
    if stated is None:
        return None
    if not isinstance(stated, Mapping):
        raise ValueError("'residual_model' is not a mapping")
    # Its name alone: a calibration does not reach into other folders.
    return Path(text(stated["file"])).name, text(stated["sha256"])


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
