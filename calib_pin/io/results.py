"""The calibrated robot out of `calibration.json`, and into a corrected URDF.

A residual model has a file of its own: plain numbers in JSON, nothing to execute.

    {"format": "calib-pin/residual-model", "version": 1,
     "run": "",           # id of the run that learned it, where there was one
     "robot": {"name", "sha256", "base", "tip", "joints"},
     "shift": [],         # of the parameters of the error model, in their order
     "model": {...},      # what `ResidualModel.document` gives
     "sha256": ""}        # of the canonical JSON of all the rest

A learned correction means nothing for another robot, and nobody can see from its
numbers that one of them has been changed; so both are checked.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import InputError, OptionError, OutputError, RobotError
from calib_pin.estimation.evidence import TRUSTED
from calib_pin.estimation.learning import with_learned
from calib_pin.estimation.system import System
from calib_pin.io.calibrated_model import count_without_instruments, model_of
from calib_pin.io.files import read_bytes, write_atomically
from calib_pin.io.journal import sha256
from calib_pin.io.json_text import Json, require_format
from calib_pin.io.older_results import upgraded
from calib_pin.io.result_folder import (
    NOMINAL,
    RESIDUAL_MODEL,
    Read,
    members,
    opened,
    read_document,
    reading,
    require_one_run,
    stated_errors,
    text,
)
from calib_pin.io.setup import setup_of
from calib_pin.io.straightening import straight_source
from calib_pin.io.urdf import corrected_urdf, is_xacro, locate_robot
from calib_pin.io.urdf_tree import parse_robot
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.robot import Robot
from calib_pin.residual_models import LearnedCorrection, restore
from calib_pin.residual_models.documents import numbers
from calib_pin.validation.calibrated_model import CalibratedModel

FORMAT, VERSION = "calib-pin/residual-model", 1
"""The newest format of residual models."""


def encode_residual_model(
    model: CalibratedModel, run: str | None = None
) -> bytes | None:
    """The file of a learned correction; None where nothing was learned.

    Args:
        model: The calibrated robot.
        run: Id of the run that learned it.
    """
    learned, shift = None, np.zeros(count_without_instruments(model))
    for part in model.parts.values():
        own = part.error.learned
        if isinstance(own, LearnedCorrection):
            learned = learned or own
            shift[part.index[: len(own.shift)]] = own.shift
    if learned is None:
        return None
    document: Json = {
        "format": FORMAT,
        "version": VERSION,
        **({} if run is None else {"run": run}),
        "robot": _robot(model.moving.error.chain),
        "shift": shift.tolist(),
        "model": learned.model.document(),
    }
    document["sha256"] = _digest(document)
    return json.dumps(document, allow_nan=False, separators=(",", ":")).encode()


def reference(data: bytes) -> dict[str, str]:
    """The reference of `calibration.json` to the bytes of such a file beside it."""
    name = json.loads(data)["model"]["kind"]
    return {"name": name, "file": RESIDUAL_MODEL, "sha256": sha256(data)}


def read_residual_model(
    path: str | Path,
    system: System,
    content: str | None = None,
    read: Callable[[str | Path], bytes] = read_bytes,
) -> LearnedCorrection:
    """The residual model of a file.

    Args:
        path: The file.
        system: The robot that it corrects.
        content: SHA-256 that the file must have, as a calibration states it.
        read: Gives the bytes of the file.

    Returns:
        The correction, with a shift of all parameters.

    Raises:
        InputError: If it is no such file, of a later version, of another robot, or
            not as it was written.
    """
    data = read(path)
    try:
        document = json.loads(data)
    except (ValueError, RecursionError) as mistake:
        # Cut off anywhere it is no JSON any more.
        found = getattr(mistake, "msg", mistake)
        reason = f"not a residual model, or truncated: {found}"
        raise InputError(reason, file=path) from mistake
    document = require_format(document, "residual model", FORMAT, VERSION, path)
    if document.pop("sha256", None) != _digest(document):
        raise InputError("edited or damaged: its checksum does not match", file=path)
    chain = system.moving.error.chain
    _require_same_robot(document.get("robot"), chain, path)
    if content is not None and sha256(data) != content:
        raise InputError(
            "not the file that this calibration was written with", file=path
        )
    try:
        stated = numbers(document, "shift", (count_without_instruments(system),))
        model = restore(document.get("model"), len(chain.joints))
    except (TypeError, ValueError) as mistake:
        reason = f"damaged or edited residual model: {mistake}"
        raise InputError(reason, file=path) from mistake
    shift = np.zeros(len(system.given))
    shift[: len(stated)] = stated
    return LearnedCorrection(model, shift)


def _require_same_robot(stated: object, chain: Chain, path: str | Path) -> None:
    expected = _robot(chain)
    if isinstance(stated, Mapping) and dict(stated) == expected:
        return
    name = stated.get("name") if isinstance(stated, Mapping) else None
    what = "other content of its URDF" if name == expected["name"] else f"'{name}'"
    if isinstance(stated, Mapping) and stated.get("sha256") == expected["sha256"]:
        what = f"the chain {stated.get('base')} to {stated.get('tip')}"
    raise InputError(
        f"learned on another robot: {what}",
        file=path,
        allowed=f"'{chain.robot.name}' from {chain.base} to {chain.tip}",
    )


def _robot(chain: Chain) -> Json:
    return {
        "name": chain.robot.name,
        "sha256": sha256(chain.robot.source),
        "base": chain.base,
        "tip": chain.tip,
        "joints": list(chain.joints),
    }


def _digest(document: Mapping[str, Any]) -> str:
    """SHA-256 of a document whatever the spaces and the order of its keys."""
    try:
        text = json.dumps(document, sort_keys=True, separators=(",", ":"))
    except (ValueError, RecursionError):
        return ""
    return sha256(text.encode())


AGREEMENT = 1e-9
"""Largest difference of forward kinematics between model and written URDF [m, rad]."""


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
        document, model = read_model(Path(path), read)
    verdict = document["verdict"]
    if notice is not None and verdict["status"] not in TRUSTED:
        notice(f"{path} must not be trusted: {verdict['reason']}")
    return model


def read_model(path: Path, read: Read) -> tuple[Json, CalibratedModel]:
    """A `calibration.json` and the calibrated robot that it tells of.

    Args:
        path: The file.
        read: Gives the bytes of a file.

    Raises:
        InputError, RobotError: As `read_calibration`.
    """
    document = read_document(path, read)
    robot = _find_robot(document, path, read)
    with reading(path):
        listed, run = members(document), str(document.get("run", ""))
        document = upgraded(document)
        model = model_of(document, _chains(document, robot))
        learned = _learned(document.get("residual_model"))
        if (learned is None) != (model.setup.learned is None):
            raise ValueError("'residual_model' and 'setup.learned' need each other")
        _ = document["verdict"]["status"], document["verdict"]["reason"]
    require_one_run(listed, run, robot.source, path, read)
    if learned is None:
        return document, model
    name, content = learned
    found = read_residual_model(path.parent / name, model, content, read)
    return document, with_learned(model, found)


def _chains(document: Json, robot: Robot) -> Chains:
    """The chains that were measured."""
    about = document["robot"]
    ends = about.get("chains") or {"": about}
    built = {
        name: Chain(robot, text(end["base"]), text(end["tip"]))
        for name, end in ends.items()
    }
    setup = setup_of(document.get("setup", {}))
    default = built.get("", setup)
    stated = default.base, default.tip, setup.chains
    chains = Chains(robot, *stated, tuple(built), built)
    if list(chains.joints) != about["joints"]:
        raise ValueError("the joints are not those from base to tip")
    return chains


def read_accuracy(path: str | Path) -> dict[str, dict[str, Any]]:
    """The accuracy on validation measurements that a `calibration.json` states.

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
        if is_xacro(stated):  # It was expanded, and what came of it is in the copy.
            places = [copy]
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
        if sha256(data) != content and place != copy:
            data = straight_source(data)
        if sha256(data) == content:
            kept = stated if is_xacro(stated) and stated.is_file() else place
            own = kept == stated and missing is None
            return parse_robot(data, name if own else str(place))
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


def _learned(stated: Mapping[str, Any] | None) -> tuple[str, str] | None:
    """Name and SHA-256 of the file of what was learned, if anything was."""
    if stated is None:
        return None
    if not isinstance(stated, Mapping):
        raise ValueError("'residual_model' is not a mapping")
    # Its name alone: a calibration does not reach into other folders.
    return Path(text(stated["file"])).name, text(stated["sha256"])
