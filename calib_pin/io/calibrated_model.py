"""The calibrated robot of a `calibration.json`."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, replace
from itertools import permutations, product
from typing import Any, TypeVar

import numpy as np
import pinocchio as pin

from calib_pin.estimation.formulation import make_parts
from calib_pin.estimation.scopes import BASE, TOOL
from calib_pin.estimation.system import FRAME, Part, System, assembled
from calib_pin.io.json_text import Json, typed
from calib_pin.io.result_folder import numbers, text
from calib_pin.io.setup import setup_of
from calib_pin.kinematics.chains import Chains
from calib_pin.measurement_models import measurement_model
from calib_pin.observations import BlockKey
from calib_pin.parameterizations import PARAMETERIZATIONS, frame_setup
from calib_pin.parameters import ParameterSet
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

SECTIONS: Mapping[str, type] = {
    "planes": PlaneSetup,
    "targets": PointSetup,
    "sockets": PointSetup,
    "spheres": SphereSetup,
    "anchors": AnchorSetup,
}
"""Sections of what measurements can refer to by name."""

CAMERA, CAMERAS = "camera", "cameras"
"""The section of the camera, and that of the cameras where stations have their own."""

References = Mapping[str, Mapping[str, Any]]
"""The reference objects of measurements, by section and by name among all."""

Blocks = Mapping[BlockKey, Sequence[str]]
"""The targets of each block of measurements."""


def frame_key(place: str) -> str:
    """Key under `frames` of a frame, by the owner and the kind of its parameters.

    Examples:
        >>> frame_key("base.frame"), frame_key("day1.station")
        ('base', 'day1.station')
    """
    return {BASE: "base", TOOL: "tool"}.get(place, place)


def count_without_instruments(system: System) -> int:
    """Number of parameters of stations, robot and tools; those come first."""
    return 1 + max(int(part.of_error.max()) for part in system.parts.values())


def tip_correction(part: Part, theta: np.ndarray[Any, Any]) -> pin.SE3:
    """The error of the tip that the tool carries, since a URDF has no place for it.

    Args:
        part: The part of a block.
        theta: Values of all parameters, shape (P,).
    """
    if part.error.chain.tip_joint is not None:
        return pin.SE3.Identity()
    return part.error.corrections(part.values(theta)[0])[-2]


def model_of(document: Json, chains: Chains) -> CalibratedModel:
    """The calibrated robot of a document.

    Args:
        document: Frames, what the measurements refer to, parameters and setup.
        chains: The nominal chains.

    Raises:
        CalibPinError, KeyError, TypeError, ValueError, AttributeError: If a part is
            missing or is not what it should be, see `result_folder.reading`.
    """
    references, about = _references(document), document["measurements"]
    sections: dict[str, Any] = {name: references[name] for name in SECTIONS}
    sections[CAMERA] = next(iter(references[CAMERA].values()), None)
    stated = "setup" in document
    if stated:
        setup = setup_of(document["setup"])
    else:  # It is no part of the contract; what is known follows from the rest.
        ends = (document["frames"][frame_key(place)] for place in (BASE, TOOL))
        base, tool = (
            FrameSetup(estimate=True) if estimated else frame_setup(pose, known=True)
            for pose, estimated in map(_read_frame, ends)
        )
        setup = Setup(**sections, base_frame=base, tool_frame=tool)
    # Earlier files name no targets; they have neither several blocks nor points.
    named = "blocks" in about or "targets" in about or bool(references["targets"])
    blocks = _blocks(about) if named else {BlockKey(text(about["model"])): ()}
    shape = setup if stated and named else replace(setup, **sections)
    values = _values(document["parameters"])
    kinds = {_kind(name) for name in values}
    for member in PARAMETERIZATIONS.values():
        for key in member.requires if member.kind in kinds else ():
            if key not in document.get("setup", {}):
                raise ValueError(
                    f"'setup.{key}' is missing, which '{member.kind}' needs"
                )
    parts, given = _parts(chains, blocks, shape, references, values, stated)
    if named:
        for part in parts.values():
            if (list(part.measurement.targets) or [""]) != blocks[part.key]:
                raise ValueError("'measurements' have other targets than their model")
    theta = given.vector({name: values.get(name, 0.0) for name in given.names})
    # The frames hold these.
    theta[System(chains, parts, given).referred] = 0.0
    return CalibratedModel(
        chains=chains,
        parts=_placed(parts, given, document["frames"], theta),
        given=given,
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

    keys = ("frames", *SECTIONS, CAMERAS)
    sections = {key: at_start(document.get(key, {})) for key in keys}
    if document.get(CAMERA) is not None:
        sections |= at_start({CAMERA: document[CAMERA]})
    zero = [{**entry, "value": 0.0} for entry in document["parameters"]]
    return model_of({**document, **sections, "parameters": zero}, model.chains)


def _references(document: Json) -> References:
    """The references of the measurements as they were fitted."""
    sections: dict[str, dict[str, Any]] = {
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
    cameras = dict(document.get(CAMERAS, {}))
    if document.get(CAMERA) is not None:
        cameras[CAMERA] = document[CAMERA]
    sections[CAMERA] = {k: _reference(CameraSetup, v) for k, v in cameras.items()}
    return sections


def _reference(kind: type[_T], entry: Json) -> _T:
    """One of them, of which a document states every key."""
    keys = [part.name for part in fields(kind)]  # type: ignore[arg-type]
    stated = {key: entry[key.replace("estimate", "estimated")] for key in keys}
    for key, value in stated.items():
        if not isinstance(value, str | bool) and (key, value) != ("size", None):
            numbers(value if isinstance(value, list) else [value])
    return typed(kind, stated)


def _blocks(about: Json) -> Blocks:
    """The blocks of measurements; a document of only one need not list it."""
    found: dict[BlockKey, list[str]] = {}
    for block in about.get("blocks") or [about]:
        stated = (block.get(field, "") for field in BlockKey._fields[1:])
        key = BlockKey(text(block["model"]), *map(_name, stated))
        if key in found:
            raise ValueError("a block of the measurements is here twice")
        # A model that looks at nothing with a name has no targets.
        found[key] = list(map(_name, block["targets"])) or [""]
    return found


def _name(value: object) -> str:
    """A name that may be empty."""
    return "" if value == "" else text(value)


def _parts(
    chains: Chains,
    blocks: Blocks,
    shape: Setup,
    references: References,
    values: Mapping[str, float],
    stated: bool,
) -> tuple[dict[BlockKey, Part], ParameterSet]:
    """The parts of all blocks with their instruments, and all parameters.

    Args:
        chains: The nominal chains.
        blocks: The blocks.
        shape: The setup, whose references have the names that measurements give.
        references: What these refer to, as it was fitted.
        values: Value of every parameter; those of the robot must be these.
        stated: Whether the setup names the parameterizations.
    """
    for order in [shape.parameters] if stated else _orders(values):
        bare, _ = make_parts(chains, blocks, replace(shape, parameters=order))
        used: set[tuple[str, str]] = set()
        own = [
            _measured(p, shape, references, blocks[p.key], used) for p in bare.values()
        ]
        for section, members in references.items():
            for name in members:
                if (section, name) not in used:
                    raise ValueError(
                        f"no measurement refers to '{name}' under '{section}'"
                    )
        parts, given = assembled(own)
        count = count_without_instruments(System(chains, parts, given))
        instrument = given.names[count:]
        names = [name for name in values if name not in instrument]
        if names == [n for n in given.names[:count] if n in values or not _later(n)]:
            return parts, given
    raise ValueError("the parameters are not those of this chain, in their order")


def _measured(
    part: Part,
    shape: Setup,
    references: References,
    targets: Sequence[str],
    used: set[tuple[str, str]],
) -> Part:
    """A part with its instrument as it was fitted.

    Args:
        part: The part.
        shape: The setup.
        references: What measurements refer to.
        targets: Targets of the block.
        used: Section and name of what any part refers to; these are added.
    """
    sections: dict[str, dict[str, Any]] = {name: {} for name in (*SECTIONS, CAMERA)}
    for reference in part.measurement.references:
        section, name = reference.section, part.scope.reference(reference)
        if name not in references[section]:
            place = "" if section == CAMERA else f" under '{section}'"
            raise ValueError(f"'{name}' is missing{place}")
        sections[section][reference.name] = references[section][name]
        used.add((section, name))
    camera = sections.pop(CAMERA).get(CAMERA)
    own = replace(shape, **sections, camera=camera)  # type: ignore[arg-type]
    measurement = measurement_model(part.key.model, own, targets)
    return replace(part, measurement=measurement)


def _placed(
    parts: Mapping[BlockKey, Part],
    given: ParameterSet,
    frames: Json,
    theta: np.ndarray[Any, Any],
) -> dict[BlockKey, Part]:
    """The parts about their stations and tools."""
    result = {}
    for key, part in parts.items():
        poses = []
        inner = len(part.error.screws) - FRAME
        for place, start in ((part.scope.station, 0), (part.scope.tool, inner)):
            pose, estimated = _read_frame(frames[frame_key(place)])
            if estimated != given.free[part.index[start : start + FRAME]].any():
                raise ValueError(
                    f"whether '{frame_key(place)}' is estimated is not as in the setup"
                )
            poses.append(pose)
        base, tool = poses
        tool = tip_correction(part, theta).actInv(tool) * part.scope.offset
        result[key] = replace(part, error=part.error.with_frames(base, tool))
    return result


def _values(entries: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Value of every parameter by name."""
    values: dict[str, float] = {}
    for entry in entries:
        name = text(entry["name"])
        if name in values:
            raise ValueError(f"parameter '{name}' is here twice")
        (values[name],) = numbers([entry["value"]], 1)
    return values


def _orders(names: Iterable[str]) -> Iterator[tuple[str, ...]]:
    """Parameterizations that parameters could be of.

    The order matters: it is that of the screws at a place, so also that in which the
    user named the parameterizations.
    """
    kinds = [
        [name for name, member in PARAMETERIZATIONS.items() if member.kind == kind]
        for kind in dict.fromkeys(map(_kind, names))
    ]
    # Several parameterizations may share a kind of parameters.
    for members in product(*filter(None, kinds)):
        yield from permutations(members)


def _later(name: str) -> bool:
    """Whether older calibrations do not have a parameter of the robot."""
    _, kind, component = name.rsplit(".", 2)
    members = (one for one in PARAMETERIZATIONS.values() if one.kind == kind)
    return any(component in member.later for member in members)


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
