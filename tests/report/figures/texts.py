"""Where the texts of a figure are, and what they lie over."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations, pairwise

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.text import Text
from matplotlib.transforms import Bbox, IdentityTransform

from calib_pin.report.figures.canvas import Drawn, drawing

SLACK = 0.5
"""Overlap that nobody sees [pt]."""


def faults(drawn: Drawn) -> list[str]:
    """Those of the file of a figure, with heading and caption."""
    with drawn.worded():
        return faults_of(drawn.figure, apart=drawn.figure.texts[-2:])


def faults_of(figure: Figure, apart: Sequence[Text] = ()) -> list[str]:
    """Texts over texts, over data or color bars, or outside of the figure.

    Args:
        figure: The figure.
        apart: Texts that may be outside of it.
    """
    with drawing():
        figure.set_canvas(FigureCanvasAgg(figure))
        figure.draw_without_rendering()
        return [*_found(figure, apart, SLACK * figure.dpi / 72.0)]


def _found(figure: Figure, apart: Sequence[Text], slack: float) -> Iterator[str]:
    for artist in (*figure.texts, *figure.artists, *figure.patches):
        # What does not move with the figure is elsewhere in a file that is cut.
        if not artist.get_transform().contains_branch(figure.transFigure):
            yield f"{artist} stays where it is when the figure is cut"
    texts = {text: text.get_window_extent() for text in _texts(figure)}
    names = {text: f"'{text.get_text()}'" for text in texts}
    paper = figure.bbox.padded(slack)
    for text, box in texts.items():
        inside = paper.contains(box.x0, box.y0) and paper.contains(box.x1, box.y1)
        if not inside and text not in apart:
            yield f"{names[text]} leaves the figure"
    for one, other in combinations(texts, 2):
        if _shared(texts[one], texts[other], slack):
            yield f"{names[one]} is over {names[other]}"
    for artist, points in _data(figure):
        for text, box in texts.items():
            # What has a ground of its own is read over lines, but not under them.
            if text.get_bbox_patch() and artist.get_zorder() < text.get_zorder():
                continue
            inner = box.padded(-slack)
            if len(points) and inner.width > 0 and _crossed(points, inner):
                yield f"{names[text]} is over data ({type(artist).__name__})"
    for bar in figure.artists + figure.patches:
        if isinstance(bar, Rectangle) and bar.get_visible():
            for text, box in texts.items():
                if _shared(box, bar.get_window_extent(), slack):
                    yield f"{names[text]} is over a color bar"


def _texts(figure: Figure) -> list[Text]:
    """Those that are seen: tick labels outside of their axis are not."""
    hidden: set[Artist] = set()
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            room = 1e-6 * (high - low)
            for tick in [*axis.get_major_ticks(), *axis.get_minor_ticks()]:
                if not low - room <= tick.get_loc() <= high + room or not (
                    axes.axison and axes.get_visible() and axis.get_visible()
                ):
                    hidden |= {tick.label1, tick.label2}
            if not axes.axison:
                hidden.add(axis.label)
    return [
        text
        for text in figure.findobj(Text)
        if isinstance(text, Text)
        and text.get_text().strip()
        and text.get_visible()
        and text not in hidden
    ]


def _shared(one: Bbox, other: Bbox, slack: float) -> bool:
    across = min(one.x1, other.x1) - max(one.x0, other.x0)
    return across > slack and min(one.y1, other.y1) - max(one.y0, other.y0) > slack


def _data(figure: Figure) -> Iterator[tuple[Artist, np.ndarray]]:
    """Curves, marks and arrows of all axes as points in pixels, shape (N, 2)."""
    for axes in figure.axes:
        for artist in (*axes.lines, *axes.collections, *axes.patches, *axes.artists):
            if artist.get_visible() and not _rule(artist, axes):
                yield artist, _clipped(_points(artist), axes)


def _rule(artist: Artist, axes: Axes) -> bool:
    """Whether it is a rule across the axes, on which labels may stand."""
    return isinstance(artist, Line2D) and artist.get_transform() in (
        axes.get_yaxis_transform(which="grid"),
        axes.get_xaxis_transform(which="grid"),
    )


def _points(artist: Artist) -> np.ndarray:
    if isinstance(artist, PathCollection):
        return np.asarray(artist.get_offset_transform().transform(artist.get_offsets()))
    if isinstance(artist, LineCollection):
        paths = [artist.get_transform().transform_path(p) for p in artist.get_paths()]
        return np.concatenate([_dense(p.vertices) for p in paths] or [np.empty((0, 2))])
    if isinstance(artist, Line2D):
        points = artist.get_transform().transform(artist.get_xydata())
        joined = artist.get_linestyle() not in ("None", "none", "", " ")
        return _dense(points) if joined else points
    if isinstance(artist, Patch) and not isinstance(
        artist.get_transform(), IdentityTransform
    ):
        return np.asarray(
            artist.get_transform().transform_path(artist.get_path()).vertices
        )
    return np.empty((0, 2))


def _dense(points: np.ndarray) -> np.ndarray:
    """Points along the lines between points."""
    points = points[np.isfinite(points).all(axis=1)]
    parts = [np.linspace(a, b, 60) for a, b in pairwise(points)]
    return np.concatenate([points, *parts]) if len(points) < 2000 else points


def _clipped(points: np.ndarray, axes: Axes) -> np.ndarray:
    points = points[np.isfinite(points).all(axis=1)]
    box = axes.bbox.padded(1.0)
    inside = (points >= [box.x0, box.y0]) & (points <= [box.x1, box.y1])
    return points[inside.all(axis=1)]


def _crossed(points: np.ndarray, box: Bbox) -> bool:
    inside = (points > [box.x0, box.y0]) & (points < [box.x1, box.y1])
    return bool(inside.all(axis=1).any())
