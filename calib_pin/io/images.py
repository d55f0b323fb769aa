"""Images as gray levels, read by OpenCV, which is an extra.

The decoders are foreign code: only formats of cameras get to them, and headers that
promise more than a large sensor has are refused before anything is decoded.
"""

from __future__ import annotations

import io
import os
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import InputError, OptionError
from calib_pin.io.files import read_bytes

PIXELS = 1 << 27
"""Most pixels of an image."""

LARGEST = 1 << 30
"""Most bytes of an image file."""

SMALLEST = 16
"""Least width and height of an image."""

FORMATS = (
    *(b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"BM", b"II*\0", b"MM\0*"),
    *(b"P2", b"P3", b"P5", b"P6"),
)
"""First bytes of PNG, JPEG, BMP, TIFF, and portable gray and color maps."""

Gray = NDArray[np.uint8]


def vision() -> Any:
    """OpenCV, with a limit on images and without words of its own.

    Raises:
        OptionError: If the extra is missing.
    """
    if find_spec("cv2") is None:
        raise OptionError(
            "images need OpenCV, which is missing: pip install 'calib-pin[vision]'"
        )
    # It reads these where it is loaded.
    os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(PIXELS))
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
    import cv2

    return cv2


def read_image(path: Path) -> Gray:
    """The gray levels of an image as the sensor has them, shape (height, width).

    Colors become gray, transparency is dropped, and more than 8 bits are scaled. A
    note in the file that the image be turned is not followed.

    Raises:
        InputError: If the file is no image, is damaged, or has too many pixels.
        OptionError: If the extra is missing.
    """
    cv2 = vision()
    data = read_bytes(path, LARGEST)
    if not data.startswith(FORMATS):
        allowed = "PNG, JPEG, BMP, TIFF, PGM, PPM"
        raise InputError("is no image", file=path, allowed=allowed)
    flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    image = None
    with suppress(cv2.error, MemoryError):
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    if image is None:
        reason = f"cannot be read: it is damaged, or has more than {PIXELS} pixels"
        raise InputError(reason, file=path)
    if min(image.shape) < SMALLEST:
        size, allowed = "{1} x {0}".format(*image.shape), f"{SMALLEST} px or more"
        raise InputError("is too small", file=path, value=size, allowed=allowed)
    if image.dtype != np.uint8:
        # Sensors of 10 to 14 bits leave the upper ones empty.
        levels = np.nan_to_num(image.astype(float), posinf=0.0, neginf=0.0)
        image = (levels * (255.0 / max(float(levels.max()), 1e-300))).round()
    return np.asarray(image, np.uint8)


def encode_png(image: Gray, density: float) -> bytes:
    """A PNG file of gray levels that prints at its size.

    Args:
        image: Gray levels, shape (height, width).
        density: Pixels per meter.
    """
    from PIL import Image

    data, per_inch = io.BytesIO(), 0.0254 * density
    Image.fromarray(image).save(data, "PNG", dpi=(per_inch, per_inch))
    return data.getvalue()
