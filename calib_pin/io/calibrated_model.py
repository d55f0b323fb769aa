"""The calibrated robot as plain data, and as a URDF.

Frames and reference objects are written as a setup file states them, where the fit has
them; where it began, they are written once more: the values of their parameters are the
way between both.

A learned correction is plain numbers, nothing to execute. It means nothing for another
robot, and nobody can see from its numbers that one of them has been changed: it is
taken only as it was written, by its checksum.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from calib_pin.errors import OptionError, OutputError
from calib_pin.estimation.formulation import make_terms
from calib_pin.estimation.learning import with_learned
from calib_pin.estimation.terms import FRAME, Term, Terms
from calib_pin.io.files import sha256, write_atomically
from calib_pin.io.json_text import encode
from calib_pin.io.setup import setup_document, setup_of
from calib_pin.io.urdf import corrected_urdf
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.robot import Robot
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import measurement_model
from calib_pin.observations import BlockKey
from calib_pin.parameterizations import frame_pose, frame_setup
from calib_pin.residual_models import LearnedCorrection, restore
from calib_pin.residual_models.documents import numbers
from calib_pin.setup import (
    AnchorSetup,
    CameraSetup,
    FrameSetup,
    PlaneSetup,
    PointSetup,
    Setup,
    SphereSetup,
)
from calib_pin.validation.calibrated_model import CalibratedChain, CalibratedModel

LARGEST = 1e6
"""Largest number that a value, a position or an offset can be [m, rad, px]."""


@dataclass(frozen=True)
class Places:
    """Frames, and reference objects by their sections, by name."""

    frames: Mapping[str, FrameSetup]
    targets: Mapping[str, PointSetup] = field(default_factory=dict)
    planes: Mapping[str, PlaneSetup] = field(default_factory=dict)
    sockets: Mapping[str, PointSetup] = field(default_factory=dict)
    spheres: Mapping[str, SphereSetup] = field(default_factory=dict)
    anchors: Mapping[str, AnchorSetup] = field(default_factory=dict)
    camera: Mapping[str, CameraSetup] = field(
        default_factory=dict, metadata={"key": "cameras"}
    )


@dataclass(frozen=True)
class Block:
    """A block of measurements, and the targets that they are of."""

    key: BlockKey = field(metadata={"key": ""})
    targets: tuple[str, ...]


@dataclass(frozen=True)
class Value:
    """The value of a parameter."""

    name: str
    value: float


@dataclass(frozen=True)
class ModelRecord:
    """A calibrated robot, but for its chains and what was learned."""

    model: str = field(metadata={"key": "measurements.model"})
    blocks: tuple[Block, ...] = field(metadata={"key": "measurements.blocks"})
    parameters: tuple[Value, ...]
    places: Places = field(metadata={"key": ""})
    setup: Mapping[str, Any]


@dataclass(frozen=True)
class LearnedRecord:
    """A learned correction: its name, its numbers, and the SHA-256 of these.

    Attributes:
        shift: Of all parameters, in their order, shape (P,).
        model: Document of the `ResidualModel`.
    """

    name: str
    sha256: str
    shift: tuple[float, ...]
    model: Mapping[str, Any]


def model_name(system: Terms) -> str:
    """Names of the measurement models, joined by plus signs."""
    return "+".join(dict.fromkeys(key.model for key in system.terms))


def model_record(model: CalibratedModel) -> ModelRecord:
    """A calibrated robot as plain data."""
    blocks = (Block(k, tuple(p.measurement.targets)) for k, p in model.terms.items())
    values = map(Value, model.given.names, model.theta.tolist())
    about = places_of(model), setup_document(model.setup)
    return ModelRecord(model_name(model), tuple(blocks), tuple(values), *about)


def places_of(model: CalibratedModel) -> Places:
    """Where the frames of all stations and tools are, each once, and all references."""
    sections: dict[str, Any] = {}
    for (section, name), reference in model.references.items():
        sections.setdefault(section, {})[name] = reference.stated()
    stations, tools = dict[str, FrameSetup](), dict[str, FrameSetup]()
    for key, term in model.terms.items():
        free, (base, on) = model.given.free[term.of_error], _frame_keys(term)
        tool = model.of(key).tool * term.frames.offset.inverse()
        stations[base] = frame_setup(term.error.base, known=not free[:FRAME].any())
        tools[on] = frame_setup(tool, known=not free[-FRAME:].any())
    return Places(stations | tools, **sections)


def _frame_keys(term: Term) -> Iterator[str]:
    """Keys of the station and of the tool of a part under `frames`."""
    names = term.frames.station, term.frames.tool
    return (name.removesuffix(".frame") for name in names)


def model_of(
    record: ModelRecord, chains: Chains, reference: Places | None = None
) -> CalibratedModel:
    """The calibrated robot of plain data.

    Args:
        record: What `model_record` made.
        chains: The nominal chains.
        reference: Where the fit began, for the nominal robot there.

    Raises:
        CalibPinError, KeyError, TypeError, ValueError, AttributeError: If a part is
            missing or is not what it should be, see `json_text.reading`.
    """
    setup, places = setup_of(record.setup), reference or record.places
    # A model that looks at nothing with a name has no targets.
    blocks = {block.key: list(block.targets) or [""] for block in record.blocks}
    terms, given = make_terms(chains, blocks, setup)
    values = {one.name: one.value for one in record.parameters}
    theta = np.array([*values.values()])
    if tuple(values) != given.names or not np.all(np.abs(theta) < LARGEST):
        raise ValueError("the parameters are not those of this chain, in their order")
    theta = theta if reference is None else np.zeros(len(given))
    terms = {
        key: _placed(term, blocks[key], setup, places, theta)
        for key, term in terms.items()
    }
    model = CalibratedModel(chains, terms, given, theta, setup)
    # Frames and reference objects hold their own values.
    return replace(model, theta=np.where(model.referred, 0.0, theta))


def _placed(
    term: Term, targets: list[str], setup: Setup, places: Places, theta: Floats
) -> Term:
    """A part with its instrument, its station and its tool where they are.

    Raises:
        ValueError: If a place is not known, or is none that anything can have.
    """
    sections: dict[str, Any] = {"camera": {}}
    for one in term.measurement.references:
        section, name = term.frames.place(one)
        sections.setdefault(section, {})[one.name] = getattr(places, section)[name]
    sections["camera"] = sections["camera"].get("camera")
    setup = replace(setup, **sections)
    measurement = measurement_model(term.key.model, setup, targets)
    if (list(measurement.targets) or [""]) != targets:
        raise ValueError("'measurements' have other targets than their model")
    frames = [places.frames[name] for name in _frame_keys(term)]
    base, tool = map(frame_pose, frames)
    stated = all(None not in (frame.xyz, frame.rpy) for frame in frames)
    far = max(np.abs(pose.homogeneous).max() for pose in (base, tool))
    if not (
        stated and far < LARGEST and all(r.located for r in measurement.references)
    ):
        raise ValueError("a place is not known")
    # An error of the tip is carried by the tool, since a URDF has no place for it.
    error = term.error.with_frames(base, pin.SE3.Identity())
    tip = CalibratedChain(error, theta[term.of_error], setup).tool
    error = error.with_frames(base, tip.actInv(tool) * term.frames.offset)
    return replace(term, measurement=measurement, error=error)


def learned_record(model: CalibratedModel) -> LearnedRecord | None:
    """The learned correction of a robot; None where nothing was learned."""
    learned, shift = None, np.zeros(len(model.given))
    for term in model.terms.values():
        if isinstance(own := term.error.learned, LearnedCorrection):
            learned, shift[term.of_error] = own, own.shift
    if learned is None:
        return None
    content = tuple(shift.tolist()), learned.model.document()
    return LearnedRecord(learned.model.name, sha256(encode({"": content})), *content)


def learned_model(
    model: CalibratedModel, record: LearnedRecord | None
) -> CalibratedModel:
    """A robot with what it has learned.

    Raises:
        ValueError: If that is not as it was written, or does not belong to the robot.
    """
    if (record is None) != (model.setup.learned is None):
        raise ValueError("'residual_model' and 'setup.learned' need each other")
    if record is None:
        return model
    if sha256(encode({"": (record.shift, record.model)})) != record.sha256:
        raise ValueError("'residual_model' is not the one that was learned")
    shift = numbers({"shift": record.shift}, "shift", (len(model.given),))
    learned = restore(record.model, len(model.moving.error.chain.joints))
    return with_learned(model, LearnedCorrection(learned, shift))


AGREEMENT = 1e-9
"""Largest difference of forward kinematics between model and written URDF [m, rad]."""


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
    if not model.geometric:
        raise OptionError(
            "a URDF cannot hold corrections of the joints; write the geometry alone",
            file=path,
            allowed="CalibrationResult.geometry",
        )
    chains = model.chains
    q = chains.random_configurations(20, np.random.default_rng(0))

    def check(robot: Robot) -> None:
        for name in model.measured_chains:
            own, nominal = q[:, chains.columns(name)], chains[name]
            fitted, there = model.of(name), Chain(robot, nominal.base, nominal.tip)
            written = fitted.error.base.homogeneous @ there.poses(own)
            expected = fitted.poses(own) @ fitted.tool.inverse().homogeneous
            difference = float(np.abs(written - expected).max())
            if not difference < AGREEMENT:
                reason = f"the written robot differs from the model by {difference:.2g}"
                raise OutputError(f"{path}: {reason}")

    return corrected_urdf(path, chains.robot, model.urdf_corrections(), check)
