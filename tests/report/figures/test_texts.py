"""No text of any figure is over another, over marks, or outside of the figure."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import RendererAgg
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox

from calib_pin.report.figures import NAMES, Drawn
from calib_pin.report.figures import drawn as draw_all
from calib_pin.report.figures.canvas import drawing
from calib_pin.report.figures.workspace import views
from calib_pin.setup import LimitSetup
from calib_pin.validation.result import CalibrationResult
from tests.report.figures.test_figures import hostile
from tests.report.figures.test_robots import outlook, visits_of
from tests.report.results import KINDS, in_pixels, with_rows, with_stations

__all__ = ["hostile"]

LIMIT = LimitSetup(position=1e-3, repeatability=2e-4)

SLACK = 0.5
"""Overlap that nobody sees [px]."""


class Seen(RendererAgg):
    """A renderer that remembers where texts are."""

    def draw_text(self, gc: Any, x: Any, y: Any, s: str, *more: Any, **told: Any):
        self.texts = getattr(self, "texts", [])
        text = told.get("mtext") or more[-1]
        self.texts.append((s, text.get_window_extent(self).padded(-SLACK)))


def faults(figure: Figure) -> Iterator[str]:
    """Texts over texts, over marks, or outside of the figure."""
    seen = Seen(*figure.bbox.size, figure.dpi)
    with drawing():
        figure.draw(seen)
    texts: list[tuple[str, Bbox]] = [(s, box) for s, box in seen.texts if s.strip()]
    for (one, box), (other, beside) in combinations(texts, 2):
        if box.overlaps(beside):
            yield f"'{one}' is over '{other}'"
    marks = [
        line.get_transform().transform(line.get_xydata())
        for axes in figure.axes
        for line in axes.lines
        if line.get_marker() not in ("", "None", None) and len(line.get_xydata())
    ]
    for text, box in texts:
        if figure.bbox.count_contains(box.corners()) < 4:
            yield f"'{text}' leaves the figure"
        if any(box.count_contains(points) for points in marks):
            yield f"'{text}' is over marks"


def told(drawn: Sequence[Drawn]) -> list[tuple[str, list[str]]]:
    """Names of the figures that have faults, with these."""
    found = [(one.name, [*faults(one.figure)]) for one in drawn]
    return [(name, of) for name, of in found if of]


BROKEN: dict[str, Callable[[Figure, Axes], Any]] = {
    "'one' is over 'other'": lambda f, _: [
        f.text(0.5, 0.9, word) for word in ("one", "other")
    ],
    "'0.50' is over '0.52'": lambda _, axes: axes.set_xticks([0.50, 0.52]),
    "'middle' is over marks": lambda _, axes: axes.text(0.45, 0.5, "middle"),
    "'too long' leaves the figure": lambda f, _: f.text(0.9, 0.95, "too long"),
}
"""What breaks a figure, by the fault that it has then."""


@pytest.mark.parametrize("fault", [None, *BROKEN])
def test_the_checker_finds(fault):
    figure = Figure(figsize=(4.0, 3.0))
    axes = figure.add_axes((0.2, 0.2, 0.7, 0.6))
    axes.plot([0.0, 0.5, 1.0], [0.0, 0.52, 1.0], "o")
    if fault is not None:
        BROKEN[fault](figure, axes)
    found = [*faults(figure)]
    assert found == [] if fault is None else fault in found


def test_of_a_calibration(drawn):
    assert told(drawn) == []
    assert {f.name for f in drawn} == {*NAMES["calibration"]}


def test_of_colors_with_long_numbers():
    values = np.linspace(0.0030, 0.0051, 20)
    with drawing():
        figure, _ = views(np.outer(300 * values, np.ones(3)), values, "one [mm]")
    assert [*faults(figure)] == []


def scaled(result: CalibrationResult, factor: float) -> CalibrationResult:
    """Errors as of a robot of another size."""
    rows = result.fitted
    fitted = replace(rows, before=factor * rows.before, after=factor * rows.after)
    return replace(result, fitted=fitted, held_out=fitted)


def alike(result: CalibrationResult) -> CalibrationResult:
    """Errors that are almost the same, so that an axis has but a short way."""
    after = np.full_like(result.fitted.after, 1.00001e-3)
    fitted = replace(result.fitted, before=1.0001 * after, after=after)
    return replace(result, fitted=fitted, held_out=fitted)


OTHERS: dict[str, Callable[[CalibrationResult], CalibrationResult]] = {
    "row": lambda result: with_rows(result, [0]),
    "alike": alike,
    "far": lambda result: scaled(in_pixels(result), 1e5),
    "tiny": lambda result: scaled(result, 1e-4),
    "huge": lambda result: scaled(result, 1e3),
    "stations": lambda result: with_stations(result, 3),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", OTHERS)
def test_of_other_results(calibrated, name):
    assert told([*draw_all("calibration", OTHERS[name](calibrated))]) == []


@pytest.mark.slow
def test_of_many_measurements_and_of_a_joint_with_a_long_name(many, hostile):
    assert told([*draw_all("calibration", many(3000))]) == []
    assert told([*draw_all("calibration", hostile)]) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", ["hands", "lost motion", "distances", "camera"])
def test_of_all_kinds_of_calibrations(name, calibrated_robot):
    assert told([*draw_all("calibration", KINDS[name](calibrated_robot))]) == []


def others(counts: Sequence[int], trials: Sequence[Sequence[float]]) -> Iterator[Drawn]:
    """All figures that are not of a calibration."""
    for count in counts:
        far, near = (visits_of(offset, count) for offset in (5e-3, 2e-5))
        tests = {"nominal": far, "calibrated": near}
        yield from draw_all("acceptance", tests, LIMIT)
        yield from draw_all("acceptance", {"robot": far}, LIMIT)
    for chances in trials:
        met = [outlook(n, c) for n, c in zip((12, 30), chances, strict=True)]
        yield from draw_all("outlook", met, LIMIT)


def test_of_everything_else():
    found = [*others((4,), ([0.5, 1.0],))]
    assert told(found) == []
    kinds = {*NAMES} - {"calibration"}
    assert {f.name for f in found} == {name for kind in kinds for name in NAMES[kind]}


@pytest.mark.slow
def test_of_everything_else_in_other_sizes():
    assert told([*others((1, 12, 20, 21), ([0.0, 0.0],))]) == []
