"""Residual models in files of their own: plain numbers in JSON, nothing to execute.

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

from calib_pin.errors import InputError
from calib_pin.io.files import read_bytes
from calib_pin.io.journal import sha256
from calib_pin.io.json_text import Json, require_format
from calib_pin.io.result_folder import RESIDUAL_MODEL
from calib_pin.kinematics.chain import Chain
from calib_pin.parameterizations.error_model import ErrorModel
from calib_pin.residual_models import LearnedCorrection, restore
from calib_pin.residual_models.documents import numbers
from calib_pin.validation.calibrated_model import CalibratedModel

FORMAT = "calib-pin/residual-model"
VERSION = 1


def encode_residual_model(
    model: CalibratedModel, run: str | None = None
) -> bytes | None:
    """The file of what a calibration has learned; None where it has not.

    Args:
        model: The calibrated robot.
        run: Id of the run that learned it.
    """
    learned = model.error.learned
    if not isinstance(learned, LearnedCorrection):
        return None
    document: Json = {
        "format": FORMAT,
        "version": VERSION,
        **({} if run is None else {"run": run}),
        "robot": _robot(model.chain),
        "shift": learned.shift.tolist(),
        "model": learned.model.document(),
    }
    document["sha256"] = _digest(document)
    return json.dumps(document, allow_nan=False, separators=(",", ":")).encode()


def reference(data: bytes) -> dict[str, str]:
    """How `calibration.json` refers to the bytes of such a file beside it."""
    name = json.loads(data)["model"]["kind"]
    return {"name": name, "file": RESIDUAL_MODEL, "sha256": sha256(data)}


def read_residual_model(
    path: str | Path,
    error: ErrorModel,
    content: str | None = None,
    read: Callable[[str | Path], bytes] = read_bytes,
) -> LearnedCorrection:
    """What the residual model of a file corrects.

    Args:
        path: The file.
        error: The error model that it corrects.
        content: SHA-256 that the file must have, as a calibration states it.
        read: Gives the bytes of the file.

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
    stated = document.pop("sha256", None)
    if stated != _digest(document):
        raise InputError("edited or damaged: its checksum does not match", file=path)
    _require_same_robot(document.get("robot"), error.chain, path)
    if content is not None and sha256(data) != content:
        raise InputError(
            "not the file that this calibration was written with", file=path
        )
    try:
        shift = numbers(document, "shift", (len(error.screws),))
        model = restore(document.get("model"), len(error.chain.joints))
    except (TypeError, ValueError) as mistake:
        reason = f"damaged or edited residual model: {mistake}"
        raise InputError(reason, file=path) from mistake
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
