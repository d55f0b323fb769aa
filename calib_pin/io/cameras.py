"""Intrinsics of a camera from `camera_info` of ROS, or `FileStorage` of OpenCV as YAML.

Both have the matrix and the distortion under the same names.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import InputError
from calib_pin.io.files import read_bytes

LARGEST = 1 << 20
"""Most bytes of a file."""

KEYS = ("camera_matrix", "distortion_coefficients", "image_width", "image_height")

BROWN = ("", "plumb_bob")
"""Models of a lens that are that of Brown and Conrady."""

MOST = 5
"""Coefficients that it has."""


def camera_of(path: Path, estimate: bool) -> dict[str, Any]:
    """The keys of `camera` in a setup file, from a file of other software.

    Args:
        path: The file.
        estimate: Whether the intrinsics are estimated: then a lens of another model
            than that of Brown and Conrady starts without a distortion.

    Raises:
        InputError: If the file holds no such camera, or another lens.
    """
    from calib_pin.io.yaml_tree import parse_tree

    # OpenCV writes a directive that is not YAML, and tags.
    data = read_bytes(path, LARGEST)
    plain = re.sub(rb"^%YAML.*|^---.*|^\.\.\..*", b"", data, flags=re.MULTILINE)
    document = parse_tree(re.sub(rb"!![\w-]+", b"", plain), str(path)).data
    document = document if isinstance(document, Mapping) else {}
    K, lens, *size = (_numbers(document.get(key)) for key in KEYS)
    if len(K) != 9 or "distortion_coefficients" not in document:
        reason = "is no camera_info of ROS, and no FileStorage of OpenCV as YAML"
        raise InputError(reason, file=path, allowed=", ".join(KEYS[:2]))
    model, lens = str(document.get("distortion_model", "")), np.trim_zeros(lens, "b")
    if len(lens) and (len(lens) > MOST or model not in BROWN):
        if not estimate:
            reason = f"the lens '{model or len(lens)}' is none of Brown and Conrady"
            allowed = "such a one to start from, with 'estimate: true' beside 'file'"
            raise InputError(reason, file=path, allowed=allowed)
        lens = np.zeros(0)
    camera = {
        "focal": K[[0, 4]].tolist(),
        "center": K[[2, 5]].tolist(),
        "distortion": np.pad(lens, (0, MOST - len(lens))).tolist(),
    }
    numbers = np.concatenate(size).tolist()
    return {**camera, "size": numbers} if len(numbers) == 2 else camera


def _numbers(value: Any) -> NDArray[np.float64]:
    """The numbers of a number, a list, or a mapping with `data`; empty for others."""
    if isinstance(value, Mapping):
        value = value.get("data")
    try:
        return np.array([] if value is None else value, float).ravel()
    except (TypeError, ValueError):
        return np.zeros(0)
