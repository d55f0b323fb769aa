"""Intrinsics of a camera from the files of other software.

ROS (`camera_info`), OpenCV (`FileStorage` as YAML, XML or JSON), Kalibr (`camchain`),
RealSense, MATLAB, and what scripts write: the same numbers have a few names each, alone
or as a matrix. MATLAB counts pixels from 1 and turns its matrix over.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import InputError
from calib_pin.io.files import read_bytes
from calib_pin.units import as_number

LARGEST = 1 << 20
"""Most bytes of a file."""

MATRIX = "cameramatrix|intrinsicmatrix|intrinsics?|k|mtx|m1|matrix|cameraintrinsics?"
LENS = "(lens)?dist(?!ance|ortionmodel).*|d|d1|coeffs"
SINGLE = {
    "focal": (("fx",), ("fy",)),
    "center": (("cx", "ppx"), ("cy", "ppy")),
    "size": (("width", "imagewidth"), ("height", "imageheight")),
    "distortion": (("k1",), ("k2",), ("p1",), ("p2",), ("k3",)),
}
"""Names of numbers that are alone, without signs and in lower case."""

BROWN = "plumbbob|radtan|brownconrady|modifiedbrownconrady|opencv|none|"
"""Models of a lens that are that of Brown and Conrady."""

MOST = 5
"""Coefficients that it has."""

Numbers = NDArray[np.float64]


def camera_of(path: Path, name: str, estimate: bool) -> dict[str, Any]:
    """The keys of `camera` in a setup file, from a file of other software.

    Args:
        path: The file.
        name: Of which camera, where it holds several; else empty.
        estimate: Whether the intrinsics are estimated: then a lens of another model
            than that of Brown and Conrady starts without a distortion.

    Raises:
        InputError: If the file holds no camera, several, or another lens.
    """
    found = {".".join(key): own for key, own in _cameras((), _data(path))}
    if not found:
        allowed = "camera_info of ROS, FileStorage of OpenCV, camchain of Kalibr, or "
        allowed += "fx, fy, cx, cy"
        raise InputError("holds no camera", file=path, allowed=allowed)
    if name not in found and (len(found) > 1 or name):
        allowed = ", ".join(f"{path.name}#{one}" for one in found)
        raise InputError("holds no such camera; name one", file=path, allowed=allowed)
    camera, lens, model = found[name] if name else next(iter(found.values()))
    lens = np.trim_zeros(lens, "b")
    if len(lens) > MOST or not (re.fullmatch(BROWN, model) or len(lens) == 0):
        if not estimate:
            reason = f"the lens '{model or len(lens)}' is none of Brown and Conrady; "
            reason += "state 'estimate: true' beside 'file', and such a one is fitted"
            raise InputError(reason, file=path)
        lens = np.zeros(0)
    lens = np.pad(lens, (0, MOST - len(lens)))
    return {**camera, "distortion": lens.tolist()}


def _data(path: Path) -> Any:
    """The file as mappings, lists, texts and numbers."""
    data = read_bytes(path, LARGEST)
    if data.lstrip().startswith(b"<"):
        from calib_pin.io.urdf_tree import parse_document

        return _of_xml(parse_document(data, str(path), "a camera file").root)
    if data.lstrip().startswith((b"{", b"[")):
        try:
            return json.loads(data)
        except ValueError as error:
            raise InputError(f"is no JSON: {error}", file=path) from None
    from calib_pin.io.yaml_tree import parse_tree

    # OpenCV writes a directive that is not YAML, and tags.
    plain = re.sub(rb"^%YAML.*|^---.*|^\.\.\..*", b"", data, flags=re.MULTILINE)
    return parse_tree(re.sub(rb"!![\w-]+", b"", plain), str(path)).data


def _of_xml(element: Element) -> Any:
    if len(element):
        return {child.tag: _of_xml(child) for child in element}
    numbers = [as_number(word) for word in (element.text or "").split()]
    return element.text if None in numbers else numbers


def _cameras(
    key: tuple[str, ...], value: Any
) -> Iterator[tuple[tuple[str, ...], tuple[dict[str, Any], Numbers, str]]]:
    """The cameras below a value, each with its keys, its lens, and the lens's model."""
    if not isinstance(value, Mapping):
        return
    plain = _plain(value)
    for name, own in [*plain.items()]:
        # Zivid has mappings of single numbers in the place of a matrix and a list.
        parts = re.fullmatch(f"{MATRIX}|{LENS}|resolution", name)
        if parts and isinstance(own, Mapping) and "data" not in own:
            plain |= _plain(own)
    if (camera := _camera(plain)) is not None:
        yield key, camera
        return
    for name, own in value.items():
        yield from _cameras((*key, str(name)), own)


def _plain(value: Mapping[Any, Any]) -> dict[str, Any]:
    """A mapping by its names in lower case, without signs."""
    return {re.sub(r"[\W_]", "", str(k)).lower(): own for k, own in value.items()}


def _camera(plain: Mapping[str, Any]) -> tuple[dict[str, Any], Numbers, str] | None:
    """The camera of a mapping; None where it states none."""
    found, model = dict[str, Any](), ""
    for ours, every in SINGLE.items():
        parts = [_numbers(plain[n]) for way in every for n in way if n in plain]
        if len(parts) == len(every) or (ours == "distortion" and parts):
            found[ours] = np.concatenate(parts)
    for name, value in plain.items():
        numbers = _numbers(value)
        if re.fullmatch(MATRIX, name) and len(numbers) in (4, 9):
            if len(numbers) == 9:
                # MATLAB's is transposed.
                K = numbers.reshape(3, 3)
                numbers = (K if K[2, 0] == 0.0 else K.T)[[0, 1, 0, 1], [0, 1, 2, 2]]
            found |= {"focal": numbers[:2], "center": numbers[2:]}
        elif re.fullmatch(LENS, name) and numbers.size:
            found["distortion"] = numbers
        elif name in ("resolution", "imageresolution") and len(numbers) == 2:
            found["size"] = numbers
        elif name in ("distortionmodel", "model", "lensmodel"):
            model = re.sub(r"[\W_]|distortion", "", str(value)).lower()
    if "principalpoint" in plain and "focallength" in plain:
        # MATLAB: rows before columns, and the first pixel is 1.
        found["focal"] = _numbers(plain["focallength"])
        found["center"] = _numbers(plain["principalpoint"]) - 1.0
        found["size"] = _numbers(plain.get("imagesize"))[::-1]
        radial = _numbers(plain.get("radialdistortion"))
        tangential = _numbers(plain.get("tangentialdistortion"))
        two = (np.pad(own[:2], (0, 2 - len(own[:2]))) for own in (radial, tangential))
        found["distortion"] = np.concatenate([*two, radial[2:]])
    if not {"focal", "center"} <= found.keys():
        return None
    lens = found.pop("distortion", np.zeros(0))
    lists = {ours: own.tolist() for ours, own in found.items() if len(own) == 2}
    return lists, lens, model.removeprefix("rs2")


def _numbers(value: Any) -> Numbers:
    """The numbers of a list, a matrix or a mapping with `data`; empty for others."""
    if isinstance(value, Mapping):
        value = value.get("data")
    try:
        return np.array([] if value is None else value, float).ravel()
    except (TypeError, ValueError):
        return np.zeros(0)
