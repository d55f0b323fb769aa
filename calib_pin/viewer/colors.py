"""Colors of the scene; they can be told apart without color vision."""

from __future__ import annotations

import numpy as np
from matplotlib import colormaps
from numpy.typing import NDArray

from calib_pin.kinematics.spatial import Floats

RGB = tuple[int, int, int]

STAGES: dict[str, RGB] = {"before": (213, 94, 0), "after": (0, 114, 178)}
"""Of errors, after Okabe and Ito."""

MARK: RGB = (204, 121, 167)
"""Of the row that is looked at."""

MEASURED: RGB = (40, 40, 40)
PATH: RGB = (0, 158, 115)
ROBOT: RGB = (225, 222, 214)
"""Of a robot whose URDF states none."""

GHOST: RGB = (120, 120, 125)
"""Of the nominal robot beside the corrected one."""

MAP = "viridis"
"""Colormap of sizes: perceptually uniform, and of growing lightness."""


def scaled(sizes: Floats) -> NDArray[np.uint8]:
    """Colors of sizes between the least and the largest, shape (N,) -> (N, 3)."""
    parts = np.zeros(len(sizes))
    if len(sizes) and np.ptp(sizes) > 0.0:
        parts = (sizes - sizes.min()) / np.ptp(sizes)
    return np.asarray(colormaps[MAP](parts, bytes=True)[:, :3])


def gradient() -> str:
    """The colormap from the least to the largest size, as a CSS background."""
    steps = colormaps[MAP](np.linspace(0.0, 1.0, 9), bytes=True)[:, :3]
    return f"linear-gradient(to right, {', '.join(map(css, steps.tolist()))})"


def css(color: tuple[int, ...]) -> str:
    """A color as style sheets write it."""
    return f"rgb({', '.join(map(str, color))})"
