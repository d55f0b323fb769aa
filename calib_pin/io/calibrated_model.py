"""The calibrated robot as plain data, as a URDF, and the file of what was learned.

Frames and reference objects are written as a setup file states them, where the fit has
them, with `reference`, where it began: the values of their parameters are the way
between both.

A residual model has a file of its own: plain numbers in JSON, nothing to execute.

    {"format": "calib-pin/residual-model", "version": 1,
     "run": "",           # id of the run that learned it, where there was one
     "robot": {"name", "sha256", "base", "tip", "joints"},
     "shift": [],         # of the parameters of the error model, in their order
     "model": {...},      # what `ResidualModel.document` gives
     "sha256": ""}        # of the canonical JSON of all the rest

A learned correction means nothing for another robot, and nobody can see from its
numbers that one of them has been changed: a calibration takes it only byte for byte as
it was written with it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from calib_pin.errors import InputError, OptionError, OutputError
from calib_pin.estimation.formulation import make_terms
from calib_pin.estimation.terms import BASE, FRAME, TOOL, Term, Terms, assembled
from calib_pin.io.files import sha256, write_atomically
from calib_pin.io.json_text import (
    Json,
    decoded,
    format_keys,
    reading,
    require_finite,
    typed,
)
from calib_pin.io.setup import setup_document, setup_of
from calib_pin.io.urdf import corrected_urdf
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.robot import Robot
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import measurement_model
from calib_pin.observations import BlockKey
from calib_pin.parameterizations import frame_pose, frame_setup
from calib_pin.residual_models import LearnedCorrection, of_older_release, restore
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
from calib_pin.validation.calibrated_model import CalibratedModel

CAMERA, CAMERAS = "camera", "cameras"
"""The section of the camera, and that of the cameras where stations have their own."""

SECTIONS: Mapping[str, type] = {
    "frames": FrameSetup,
    "targets": PointSetup,
    "planes": PlaneSetup,
    "sockets": PointSetup,
    "spheres": SphereSetup,
    "anchors": AnchorSetup,
    CAMERAS: CameraSetup,
}
"""Sections of frames and reference objects."""

Places = dict[tuple[str, str], Any]
"""Frames and reference objects, by section and name."""


def frame_key(place: str) -> str:
    """Key under `frames` of a frame, by the owner and the kind of its parameters.

    Examples:
        >>> frame_key("base.frame"), frame_key("day1.station")
        ('base', 'day1.station')
    """
    return {BASE: "base", TOOL: "tool"}.get(place, place)


def count_without_instruments(system: Terms) -> int:
    """Number of parameters of stations, robot and tools; those come first."""
    return 1 + max(int(term.of_error.max()) for term in system.terms.values())


def _tip_correction(term: Term, theta: Floats) -> pin.SE3:
    """The error of the tip that the tool carries, since a URDF has no place for it.

    Args:
        term: The term of a block.
        theta: Values of all parameters, shape (P,).
    """
    if term.error.chain.tip_joint is not None:
        return pin.SE3.Identity()
    return term.error.corrections(term.values(theta)[0])[-2]


def model_name(system: Terms) -> str:
    """Names of the measurement models, joined by plus signs."""
    return "+".join(dict.fromkeys(key.model for key in system.terms))


def model_document(model: CalibratedModel, reference: CalibratedModel) -> Json:
    """A calibrated robot as plain data, without its parameters.

    Points of the tool and planes have a section in every document.

    Args:
        model: The calibrated robot.
        reference: The nominal robot where the fit began.
    """
    targets = {k: list(p.measurement.targets) for k, p in model.terms.items()}
    about: Json = {
        "model": model_name(model),
        "targets": list(dict.fromkeys(t for own in targets.values() for t in own)),
    }
    if len(targets) > 1 or any(model.only.key[1:]):
        blocks = targets.items()
        about["blocks"] = [{**key._asdict(), "targets": own} for key, own in blocks]
    sections: Json = {"targets": {}, "planes": {}}
    for (section, name), found in model.references.items():
        start = reference.references[section, name].stated()
        entry = _entry(found.stated(), start)
        if (section, name) == (CAMERA, CAMERA):
            sections[CAMERA] = entry
        else:
            key = CAMERAS if section == CAMERA else section
            sections.setdefault(key, {})[name] = entry
    return {
        "measurements": about,
        "frames": _frames(model, reference),
        **sections,
        "setup": setup_document(model.setup),
    }


def _frames(model: CalibratedModel, reference: CalibratedModel) -> Json:
    """The frames of all stations, then of all tools, each once."""
    stations: Json = {}
    tools: Json = {}
    for key, term in model.terms.items():
        error, start = term.error, reference.terms[key]
        inner, tool = len(error.screws) - FRAME, _carrier(term)
        tool = _tip_correction(term, model.theta) * tool
        for found, place, pose, begun, at, link in (
            (stations, term.frames.station, error.base, start.error.base, 0, "base"),
            (tools, term.frames.tool, tool, _carrier(start), inner, "tip"),
        ):
            known = not model.given.free[term.index][at : at + FRAME].any()
            stated = frame_setup(pose, known=known), frame_setup(begun, known=True)
            name, entry = frame_key(place), _entry(*stated)
            if name not in ("base", "tool"):
                entry["link"] = getattr(error.chain, link)
            found[name] = entry
    return stations | tools


def _carrier(term: Term) -> pin.SE3:
    """The tool frame of a part, or that of the tool that its own is known on."""
    return term.error.tool * term.frames.offset.inverse()


def _entry(found: Any, start: Any) -> Json:
    """A frame or a reference object, what of it was estimated, and where it began."""
    stated = {key: v for key, v in asdict(start).items() if "estimate" not in key}
    entry = {k.replace("estimate", "estimated"): v for k, v in asdict(found).items()}
    return {**entry, "reference": stated}


def model_of(
    document: Json, chains: Chains, *, reference: bool = False
) -> CalibratedModel:
    """The calibrated robot of a document.

    Args:
        document: What `model_document` made, and the parameters.
        chains: The nominal chains.
        reference: Whether to return the nominal robot where the fit began.

    Raises:
        CalibPinError, KeyError, TypeError, ValueError, AttributeError: If a part is
            missing or is not what it should be, see `json_text.reading`.
    """
    setup, stated = setup_of(document["setup"]), _stated(document, reference)
    blocks = _blocks(document["measurements"])
    terms, given = assembled(
        [
            _measured(term, setup, stated, blocks[key])
            for key, term in make_terms(chains, blocks, setup)[0].items()
        ]
    )
    values = _values(document["parameters"])
    count = count_without_instruments(Terms(chains, terms, given))
    if tuple(values) not in (given.names, given.names[:count]):
        raise ValueError("the parameters are not those of this chain, in their order")
    theta = given.vector({} if reference else values)
    terms = {key: _placed(term, stated, theta) for key, term in terms.items()}
    model = CalibratedModel(chains, terms, given, theta, setup)
    places = {place for place in stated if place[0] != "frames"}
    for section, name in places - model.references.keys():
        raise ValueError(f"no measurement refers to '{name}' under '{section}'")
    # Frames and reference objects hold their own values.
    return replace(model, theta=np.where(model.referred, 0.0, theta))


def _stated(document: Json, reference: bool) -> Places:
    """The frames and reference objects of a document, as a setup states them.

    Args:
        document: The document.
        reference: Whether it is where the fit began.
    """
    sections = {name: document.get(name, {}) for name in SECTIONS}
    if CAMERA in document:
        sections[CAMERAS] = {CAMERA: document[CAMERA]}
    found: Places = {}
    for section, entries in sections.items():
        kind = SECTIONS[section]
        for name, entry in entries.items():
            values = {**entry, **entry["reference"]} if reference else entry
            place = {
                part.name: values[part.name.replace("estimate", "estimated")]
                for part in fields(kind)
            }
            # An image may have no edge.
            require_finite([v for key, v in place.items() if key != "size"])
            found[CAMERA if section == CAMERAS else section, name] = typed(kind, place)
    return found


def _blocks(about: Json) -> dict[BlockKey, list[str]]:
    """The targets of the blocks of measurements; the only one need not be listed."""
    found: dict[BlockKey, list[str]] = {}
    for block in about.get("blocks", [about]):
        key = typed(BlockKey, dict.fromkeys(BlockKey._fields, "") | block)
        # A model that looks at nothing with a name has no targets.
        found[key] = list(typed(tuple[str, ...], block["targets"])) or [""]
    return found


def _values(entries: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Value of every parameter by name."""
    values = {typed(str, e["name"]): typed(float, e["value"]) for e in entries}
    require_finite([*values.values()])
    return values


def _measured(term: Term, setup: Setup, stated: Places, targets: Sequence[str]) -> Term:
    """A part with its instrument as it was fitted.

    Args:
        term: The term.
        setup: The setup.
        stated: Frames and reference objects.
        targets: Targets of the block.
    """
    sections: dict[str, dict[str, Any]] = {}
    for reference in term.measurement.references:
        section, name = term.frames.place(reference)
        sections.setdefault(section, {})[reference.name] = stated[section, name]
    camera = sections.pop(CAMERA, {}).get(CAMERA)
    fitted: Any = {**sections, "camera": camera}
    measurement = measurement_model(term.key.model, replace(setup, **fitted), targets)
    if (list(measurement.targets) or [""]) != targets:
        raise ValueError("'measurements' have other targets than their model")
    return replace(term, measurement=measurement)


def _placed(term: Term, stated: Places, theta: Floats) -> Term:
    """A part about its station and its tool."""
    places = frame_key(term.frames.station), frame_key(term.frames.tool)
    base, tool = (frame_pose(stated["frames", name]) for name in places)
    tool = _tip_correction(term, theta).actInv(tool) * term.frames.offset
    return replace(term, error=term.error.with_frames(base, tool))


RESIDUAL_MODEL = "residual_model.json"
"""Name of the file of what was learned."""

RESIDUAL = "calib-pin/residual-model"
"""Its format."""


def encode_residual_model(
    model: CalibratedModel, run: str | None = None
) -> bytes | None:
    """The file of a learned correction; None where nothing was learned.

    Args:
        model: The calibrated robot.
        run: Id of the run that learned it.
    """
    learned, shift = None, np.zeros(count_without_instruments(model))
    for term in model.terms.values():
        own = term.error.learned
        if isinstance(own, LearnedCorrection):
            learned = learned or own
            shift[term.index[: len(own.shift)]] = own.shift
    if learned is None:
        return None
    chain = model.moving.error.chain
    document: Json = {
        **format_keys(RESIDUAL),
        **({} if run is None else {"run": run}),
        "robot": {
            "name": chain.robot.name,
            "sha256": sha256(chain.robot.source),
            "base": chain.base,
            "tip": chain.tip,
            "joints": list(chain.joints),
        },
        "shift": shift.tolist(),
        "model": learned.model.document(),
    }
    canonical = json.dumps(document, sort_keys=True, separators=(",", ":"))
    document["sha256"] = sha256(canonical.encode())
    return json.dumps(document, allow_nan=False, separators=(",", ":")).encode()


def reference(data: bytes) -> dict[str, str]:
    """The reference of `calibration.json` to the bytes of such a file beside it."""
    name = json.loads(data)["model"]["kind"]
    return {"name": name, "file": RESIDUAL_MODEL, "sha256": sha256(data)}


def read_residual_model(
    data: bytes, system: Terms, file: str | Path
) -> LearnedCorrection:
    """The correction of a residual model, with a shift of all parameters.

    Args:
        data: Bytes of the file, those that its calibration was written with.
        system: The robot that it corrects.
        file: The file.

    Raises:
        InputError: If it is no such file.
    """
    document = decoded(data, "residual model", RESIDUAL, file)
    if of_older_release(document.get("model")):
        reason = "of an older version of calib-pin: calibrate again"
        raise InputError(reason, file=file)
    count = count_without_instruments(system)
    shift = np.zeros(len(system.given))
    with reading(file, "residual model"):
        shift[:count] = numbers(document, "shift", (count,))
        joints = len(system.moving.error.chain.joints)
        return LearnedCorrection(restore(document["model"], joints), shift)


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
            fitted = model.of(name)
            expected = fitted.error.base.inverse().homogeneous @ fitted.poses(own)
            written = Chain(robot, nominal.base, nominal.tip)
            found = written.poses(own) @ fitted.tool.homogeneous
            difference = float(np.abs(found - expected).max())
            if not difference < AGREEMENT:
                raise OutputError(
                    f"{path}: the written robot differs from the model by "
                    f"{difference:.2g}"
                )

    return corrected_urdf(path, chains.robot, model.urdf_corrections(), check)
