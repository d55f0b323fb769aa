"""Dots and arrows by the hundred as one path each, which is drawn and shown fastest."""

from __future__ import annotations

import numpy as np
from matplotlib.patches import PathPatch
from matplotlib.path import Path

from calib_pin.spatial import Floats

__all__ = ["arrows", "dots"]

BARB = 0.055
"""Length of the two strokes of an arrow's head [inch]; a short arrow has less."""

TINY = 1e-4
"""Length of a stroke that is a dot [inch]."""


def dots(spots: Floats, color: str, width: float, scale: float) -> PathPatch:
    """Strokes without length, whose round ends make a dot.

    Args:
        spots: Where they are, shape (N, 2).
        color: Their color.
        width: Their diameter [pt].
        scale: Inches per unit.
    """
    ends = spots + np.array([TINY / scale, 0.0])
    vertices = np.stack([spots, ends], axis=1).reshape(-1, 2)
    codes = np.tile([Path.MOVETO, Path.LINETO], len(spots))
    return _strokes(Path(vertices, codes), color, width)


def arrows(starts: Floats, ends: Floats, color: str, scale: float) -> PathPatch:
    """Shafts and heads; an arrow without length is a dot.

    Args:
        starts: Where they begin, shape (N, 2).
        ends: Where they end, shape (N, 2).
        color: Their color.
        scale: Inches per unit.
    """
    along = ends - starts
    length = np.linalg.norm(along, axis=1, keepdims=True)
    tiny = TINY / scale
    ends = np.where(length < tiny, starts + np.array([tiny, 0.0]), ends)
    length = np.maximum(length, tiny)
    back = along / length * np.minimum(BARB / scale, 0.4 * length)
    aside = 0.45 * np.column_stack([-back[:, 1], back[:, 0]])
    corners = (starts, ends, ends - back + aside, ends, ends - back - aside)
    codes = [Path.MOVETO, Path.LINETO, Path.MOVETO, Path.LINETO, Path.LINETO]
    vertices = np.stack(corners, axis=1).reshape(-1, 2)
    return _strokes(Path(vertices, np.tile(codes, len(starts))), color, 0.9)


def _strokes(path: Path, color: str, width: float) -> PathPatch:
    # What is short must not be lost, as part of a long line or between two pixels.
    path.should_simplify = False
    return PathPatch(
        path,
        edgecolor=color,
        fill=False,
        linewidth=width,
        capstyle="round",
        snap=False,
    )
