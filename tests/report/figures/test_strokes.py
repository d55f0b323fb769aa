"""Hundreds of marks are one path, and look like those of a line."""

from __future__ import annotations

import io

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from calib_pin.report.figures.canvas import AFTER, BEFORE, marks
from calib_pin.report.figures.strokes import LARGEST, Marks, thinned, thinning


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


def test_few_rows_are_all_drawn() -> None:
    assert thinned(5, 5, [np.ones(5)]).tolist() == [0, 1, 2, 3, 4]
    assert thinning(5, 5) == ""


def test_the_worst_rows_are_always_drawn() -> None:
    rng = np.random.default_rng(0)
    sizes = [rng.uniform(size=50_000), rng.uniform(size=50_000)]
    sizes[0][::7] = np.nan
    sizes[1][1234] = np.inf
    drawn = thinned(50_000, 20_000, sizes, [7, 49_999])
    assert len(drawn) == len(set(drawn)) == 20_000
    assert (np.diff(drawn) > 0).all()
    assert {7, 49_999, 1234} <= set(drawn)
    for size in sizes:
        worst = np.argsort(np.nan_to_num(size, nan=-1.0))[-LARGEST:]
        assert set(worst) <= set(drawn)
    # Evenly over all rows.
    counts, _ = np.histogram(drawn, 10, (0, 50_000))
    assert counts.min() > 1900 and counts.max() < 2100
    assert (drawn == thinned(50_000, 20_000, sizes, [7, 49_999])).all()
    assert "20000 of 50000 measurements" in thinning(20_000, 50_000)


def test_rows_that_do_not_fit_take_half_of_all() -> None:
    always = list(range(0, 2000, 2))
    drawn = thinned(2000, 100, [np.arange(2000.0)], always)
    assert len(drawn) == 100
    assert set(always[:50]) <= set(drawn) and 1999 in drawn
