"""Results of version 0.1 with several measurement models, as they are today.

Every target had the name of its model before it, `camera:m3`. A model that follows
nothing, a camera, had its frames relative to those of the others: D of its base behind
the station, E before its tool. It has a station D B and a tool X E of its own now.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from calib_pin.io.json_text import Json
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import declared
from calib_pin.observations import BlockKey
from calib_pin.validation.calibrated_model import CalibratedModel

PLUS, PART = "+", ":"
"""Sign between the names of models, and that between a model and a target."""

SCREWS = ("x", "y", "z", "rx", "ry", "rz")


def upgraded(document: Json) -> Json:
    """A document with blocks in the place of models among one another.

    Args:
        document: A calibration, or its geometry alone; any other is returned as it is.

    Raises:
        KeyError, TypeError, ValueError, AttributeError: See `result_folder.reading`.
    """
    urdf = document.get("urdf")
    if urdf is not None and urdf.get("model") is not None:
        urdf = {**urdf, "model": upgraded(urdf["model"])}
        document = {**document, "urdf": urdf}
    about = document["measurements"]
    names = about["model"].split(PLUS)
    if len(names) == 1 or "blocks" in about:
        return document
    targets: dict[str, list[str]] = {name: [] for name in names}
    for target in about["targets"]:
        name, _, plain = target.partition(PART)
        if name not in targets:
            raise ValueError(
                "'measurements.targets' are not those of 'measurements.model'"
            )
        targets[name].append(plain)
    blocks = [{"model": name, "targets": found} for name, found in targets.items()]
    older = document["frames"]
    frames = {end: older[end] for end in ("base", "tool")}
    moved = [name for name in names if not _follows(name)]
    for name in moved:
        base, tool = (older[f"{name}.{end}"] for end in ("base", "tool"))
        frames[f"{name}.station"] = _product(base, older["base"])
        frames[f"{name}.tool"] = _product(older["tool"], tool)
    return {
        **document,
        "measurements": {**about, "blocks": blocks},
        "frames": frames,
        **_parameters(document, names, frames),
    }


def _follows(name: str) -> bool:
    """Whether a model had the frames of others."""
    return bool(declared(name).tracks) or not declared(name).external


def with_blocks(
    words: Mapping[str, Sequence[str]],
    columns: Mapping[str, Floats],
    model: CalibratedModel,
) -> tuple[dict[str, list[str]], dict[str, Floats]]:
    """Columns of `measurements.csv` with those that tell the blocks.

    Values of all models stood side by side; what a measurement had not was infinitely
    uncertain.

    Args:
        words: Columns of text.
        columns: Columns of numbers.
        model: The calibrated robot.
    """
    found = {name: list(cells) for name, cells in words.items()}
    numbers = {k: np.array(v) for k, v in columns.items()}
    halves = [target.partition(PART) for target in found["target"]]
    found["target"] = [plain for _, _, plain in halves]
    keys = {key.model: key for key in model.parts}
    of_row = [keys[name] for name, _, _ in halves]
    for field in BlockKey._fields:
        found[field] = [getattr(key, field) for key in of_row]
    for name, column in numbers.items():
        if name.endswith(".sigma"):
            lacking = columns[f"{name.removesuffix('.sigma')}.after"]
            column[np.isnan(lacking)] = np.nan
    at, models = 0, np.array(found["model"])
    for name in keys:
        rows, width = models == name, len(declared(name).values)
        for k in range(width):
            source = columns[f"measured.{at + k + 1}"]
            numbers[f"measured.{k + 1}"][rows] = source[rows]
        at += width
    return found, numbers


def _parameters(document: Json, names: Sequence[str], frames: Json) -> Json:
    """The parameters in their order of today, and their covariance.

    Args:
        document: The document.
        names: Names of the models.
        frames: The frames of today.
    """
    entries = {entry["name"]: entry for entry in document["parameters"]}
    older = document["frames"]
    owners = [name if not _follows(name) else "" for name in names]
    ends = [
        [
            f"{owner}.{end}" if owner else f"{end}.frame"
            for owner in dict.fromkeys(owners)
        ]
        for end in ("base", "tool")
    ]
    stations, tools = ([f"{k}.{c}" for k in own for c in SCREWS] for own in ends)
    others = [name for name in entries if name not in (*stations, *tools)]
    robot = list(entries).index("tool.frame.x") - len(SCREWS)
    order = [*stations, *others[:robot], *tools, *others[robot:]]
    result = {
        name: {"name": name, "value": 0.0, **entries.get(name, {})} for name in order
    }
    covariance, at = document.get("covariance"), {n: k for k, n in enumerate(entries)}
    if covariance is not None:
        J, six = np.eye(len(order)), np.arange(len(SCREWS))
        base, tool = (at[f"{end}.frame.x"] + six for end in ("base", "tool"))
        for name in filter(None, owners):
            own, mount = (at[f"{name}.{end}.x"] + six for end in ("base", "tool"))
            # D B = D_0 Exp(d) B_0 Exp(b), and X E alike: twists add up behind both.
            J[np.ix_(own, own)] = _pose(older["base"]).toActionMatrixInverse()
            J[np.ix_(own, base)] = np.eye(len(six))
            E = _pose(older[f"{name}.tool"])
            J[np.ix_(mount, tool)] = E.toActionMatrixInverse()
        places = [at[name] for name in order]
        covariance = (J @ np.array(covariance, float) @ J.T)[np.ix_(places, places)]
    for name in filter(None, owners):
        for end, key in (("base", f"{name}.station"), ("tool", f"{name}.tool")):
            start, pose = _pose(frames[key]["reference"]), _pose(frames[key])
            for component, value in zip(
                SCREWS, _screws(start.actInv(pose)), strict=True
            ):
                entry = result[f"{name}.{end}.{component}"]
                entry |= {"name": f"{key}.{component}", "value": value}
                behind = entries[f"{end}.frame.{component}"]
                if behind.get("status", "fixed") not in ("fixed", "identifiable"):
                    entry |= {"status": behind["status"], "sigma": None}
                elif covariance is not None and entry["sigma"] is not None:
                    k = order.index(f"{name}.{end}.{component}")
                    entry["sigma"] = float(np.sqrt(covariance[k, k]))
    return {
        "parameters": [*result.values()],
        "covariance": None if covariance is None else covariance.tolist(),
    }


def _product(first: Json, second: Json) -> Json:
    """The frame of an instrument from its own and that which it was relative to."""

    def product(a: Json, b: Json) -> Json:
        pose = _pose(a) * _pose(b)
        rpy = pin.rpy.matrixToRpy(pose.rotation).tolist()
        return {"xyz": pose.translation.tolist(), "rpy": rpy}

    start = (entry.get("reference", entry) for entry in (first, second))
    return {
        **product(first, second),
        "estimated": first["estimated"] or second["estimated"],
        "reference": product(*start),
    }


def _pose(entry: Mapping[str, Any]) -> pin.SE3:
    position = np.array(entry["xyz"], float)
    return pin.SE3(pin.rpy.rpyToMatrix(*map(float, entry["rpy"])), position)


def _screws(pose: pin.SE3) -> list[float]:
    """Values of the screws of a frame, in their order, that make a pose."""
    back = pin.rpy.matrixToRpy(pose.rotation.T)
    return [*pose.translation.tolist(), *(-back).tolist()]
