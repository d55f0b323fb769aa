"""Dots, arrows and marks by the hundred, as one path, and which of many are drawn."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.artist import allow_rasterization
from matplotlib.backend_bases import RendererBase
from matplotlib.colors import to_rgba
from matplotlib.lines import Line2D
from matplotlib.markers import MarkerStyle
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from matplotlib.transforms import IdentityTransform
from numpy.typing import NDArray

from calib_pin.kinematics.spatial import Floats

BARB = 0.055
"""Length of the two strokes of an arrow's head [inch]; a short arrow has less."""

TINY = 1e-4
"""Length of a stroke that is a dot [inch]."""


CIRCLE = (
    np.array([0.5, 0.0, 0.5, 2 / 3, -0.5, 2 / 3, -0.5, 0.0]).reshape(-1, 2),
    np.array([Path.MOVETO, *[Path.CURVE4] * 6, Path.CLOSEPOLY]),
)
"""Half of two curves that are within 2 % of a circle; matplotlib's own has eight."""


class Marks(Line2D):
    """A line that is nothing but its marks, as one path instead of one use for each.

    Takes what `Line2D` takes.
    """

    @allow_rasterization  # type: ignore[untyped-decorator]
    def draw(self, renderer: RendererBase) -> None:
        """Draw the marks whose place is finite."""
        if self.get_rasterized():
            super().draw(renderer)
            return
        spots = self.get_transform().transform(self.get_xydata())
        spots = spots[np.isfinite(spots).all(axis=1)]
        if not self.get_visible() or not len(spots):
            return
        outline, codes = _sign(str(self.get_marker()))
        size = np.asarray(renderer.points_to_pixels(self.get_markersize()), float)
        # To two decimals of a point, like all coordinates in a page.
        vertices = np.round(spots[:, None] + size * outline, 2).reshape(-1, 2)
        path = Path(vertices, np.tile(codes, len(spots)))
        path.should_simplify = False
        gc = renderer.new_gc()
        gc.set_clip_rectangle(self.get_clip_box())
        gc.set_snap(False)
        gc.set_foreground(self.get_markeredgecolor())
        gc.set_linewidth(float(self.get_markeredgewidth()))
        gc.set_joinstyle("miter")
        face = self.get_markerfacecolor()
        filled = None if face == "none" else to_rgba(face)
        renderer.draw_path(gc, path, IdentityTransform(), filled)
        gc.restore()


def _sign(marker: str) -> tuple[Floats, NDArray[np.uint8]]:
    """Vertices (n, 2) and codes (n,) of a mark of size one."""
    if marker == "o":
        half, codes = CIRCLE
        return np.concatenate([half, -half[1:], half[:1]]), codes
    style = MarkerStyle(marker)
    sign = style.get_path().transformed(style.get_transform())
    vertices = np.asarray(sign.vertices)
    if sign.codes is not None:
        return vertices, np.asarray(sign.codes)
    codes = np.full(len(vertices), Path.LINETO)
    codes[0] = Path.MOVETO
    return vertices, codes


def dots(spots: Floats, color: str, width: float, scale: float) -> PathPatch:
    """Strokes at (N, 2) without length, whose round ends make a dot.

    The width is in points, the scale in inches per unit.
    """
    ends = spots + np.array([TINY / scale, 0.0])
    vertices = np.stack([spots, ends], axis=1).reshape(-1, 2)
    codes = np.tile([Path.MOVETO, Path.LINETO], len(spots))
    return _strokes(Path(vertices, codes), color, width)


def arrows(starts: Floats, ends: Floats, color: str, scale: float) -> PathPatch:
    """Shafts and heads from (N, 2) to (N, 2); an arrow without length is a dot.

    The scale is in inches per unit.
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


LARGEST = 100
"""Largest errors of every kind that are always drawn."""


def thinned(
    count: int, limit: int, sizes: Sequence[Floats], always: Sequence[int] = ()
) -> NDArray[np.intp]:
    """Positions of the measurements that are drawn, ascending, shape (M,).

    Args:
        count: Number N of measurements.
        limit: Number that is drawn at most.
        sizes: Sizes of errors, shape (N,) each, NaN where there is none; the largest
            are drawn.
        always: Positions that are drawn as well, the most important ones first; they
            may take half of all.
    """
    if count <= limit:
        return np.arange(count)
    least = max(1, limit // (4 * max(len(sizes), 1)))
    largest = min(LARGEST, least)
    parts = [np.asarray(always[: limit // 2], np.intp)]
    for size in sizes:
        filled = np.where(np.isnan(size), -np.inf, size)
        parts.append(np.argpartition(filled, -largest)[-largest:])
    kept = np.unique(np.concatenate(parts))
    rest = np.setdiff1d(np.arange(count), kept)
    evenly = np.linspace(0, len(rest) - 1, limit - len(kept)).round().astype(np.intp)
    return np.sort(np.concatenate([kept, rest[evenly]]))


def thinning(shown: int, count: int) -> str:
    """A sentence where measurements are left out; empty where none is."""
    if shown == count:
        return ""
    return f" {shown} of {count} measurements are drawn, including the largest errors."
