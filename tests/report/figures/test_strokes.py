"""Hundreds of marks are one path, and look like those of a line."""

from __future__ import annotations

import io

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from calib_pin.report.figures.canvas import AFTER, BEFORE, marks
from calib_pin.report.figures.strokes import Marks


def saved(kind: type[Line2D], style: dict[str, object], file: str) -> bytes:
    figure = Figure(figsize=(2, 2))
    axes = figure.add_axes((0.1, 0.1, 0.8, 0.8))
    axes.set_axis_off()
    axes.set(xlim=(0, 5), ylim=(0, 5))
    axes.add_line(kind([1, 2, np.nan, 4], [2, 4, 3, 1], **style))  # type: ignore[arg-type]
    stream = io.BytesIO()
    figure.savefig(stream, format=file, dpi=100)
    return stream.getvalue()


@pytest.mark.parametrize(
    "style",
    [
        marks(BEFORE, "o", 12.0, hollow=True),
        marks(AFTER, "s", 12.0),
        marks(AFTER, "^", 12.0),
    ],
    ids=["rings", "squares", "triangles"],
)
def test_marks_look_like_those_of_a_line(style: dict[str, object]) -> None:
    from matplotlib.image import imread

    pictures = [
        np.asarray(imread(io.BytesIO(saved(kind, style, "png"))))
        for kind in (Marks, Line2D)
    ]
    assert (pictures[1][:, :, :3] < 0.5).any()
    # A line's marks are moved to whole pixels. Half a pixel along the edge of a
    # triangle of 17 pixels is a fifth of its area.
    ink = [1.0 - picture[:, :, :3].mean() for picture in pictures]
    assert ink[0] == pytest.approx(ink[1], rel=0.2)
    places = [np.argwhere(p[:, :, :3].min(axis=2) < 0.9).mean(axis=0) for p in pictures]
    assert np.abs(places[0] - places[1]).max() < 1.0


def test_marks_are_one_path() -> None:
    found = saved(Marks, marks(AFTER, "s"), "svg").decode()
    assert "<use" not in found
    assert saved(Line2D, marks(AFTER, "s"), "svg").decode().count("<use") == 3


def test_nothing_to_mark_is_nothing_drawn() -> None:
    figure = Figure()
    line = figure.add_subplot().add_line(Marks([np.nan], [1.0], **marks(AFTER, "s")))
    figure.savefig(io.BytesIO(), format="svg")
    assert line.get_marker() == "s"
