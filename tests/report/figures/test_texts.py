"""No text of any figure is over another, over data, or outside of the figure."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from calib_pin.report.figures import (
    NAMES,
    Drawn,
    Foreseen,
    Judged,
    acceptance_figures,
    calibration_figures,
    comparison_figures,
    fleet_figures,
    outlook_figures,
)
from calib_pin.report.figures.plans import criterion_by_count
from calib_pin.report.figures.workspace import error_vectors
from calib_pin.setup import LimitSetup
from calib_pin.validation.result import CalibrationResult
from calib_pin.validation.tip_drift import TipDrift
from tests.report.figures.test_acceptance import visits_of
from tests.report.figures.test_figures import hostile
from tests.report.figures.test_fleet import outlook, row
from tests.report.figures.texts import faults, faults_of
from tests.report.results import (
    KINDS,
    in_pixels,
    with_rows,
    with_stations,
)

__all__ = ["hostile"]

LIMIT = LimitSetup(position=1e-3, repeatability=2e-4)


def told(drawn: Sequence[Drawn]) -> list[tuple[str, list[str]]]:
    """Names of the figures that have faults, with these."""
    found = [(figure.name, faults(figure)) for figure in drawn]
    return [(name, of) for name, of in found if of]


# --- the checker -------------------------------------------------------------------


def over_each_other(figure: Figure, axes: plt.Axes) -> None:
    axes.set_title("a title")
    figure.text(0.5, 0.83, "another text", ha="center")


def legend_over_marks(figure: Figure, axes: plt.Axes) -> None:
    axes.plot([0.05, 0.2], [0.9, 0.95], "o", label="some marks there")
    axes.legend(loc="upper left")


def over_a_color_bar(figure: Figure, axes: plt.Axes) -> None:
    bar = Rectangle((0.2, 0.9), 0.5, 0.05, transform=figure.transFigure)
    figure.add_artist(bar)
    figure.text(0.3, 0.91, "caption")


BROKEN: dict[str, Callable[[Figure, plt.Axes], Any]] = {
    "'a title' is over 'another text'": over_each_other,
    "'0.50' is over '0.52'": lambda _, axes: axes.set_xticks([0.50, 0.52]),
    "'middle' is over data (Line2D)": lambda _, axes: axes.text(0.5, 0.5, "middle"),
    "'some marks there' is over data (Line2D)": legend_over_marks,
    "'too long' leaves the figure": lambda f, _: f.text(0.9, 0.95, "too long"),
    "'caption' is over a color bar": over_a_color_bar,
    "Text(1.0, 2.8, 'inches') stays": lambda figure, _: figure.text(
        1.0, 2.8, "inches", transform=figure.dpi_scale_trans
    ),
}
"""What breaks a figure, by the fault that it has then."""


@pytest.mark.parametrize("fault", [None, *BROKEN])
def test_the_checker_finds(fault):
    figure = Figure(figsize=(4.0, 3.0))
    axes = figure.add_axes((0.2, 0.2, 0.7, 0.6))
    axes.plot([0.0, 1.0], [0.0, 1.0])
    if fault is None:
        assert faults_of(figure) == []
    else:
        BROKEN[fault](figure, axes)
        assert any(found.startswith(fault) for found in faults_of(figure))


# --- the figures -------------------------------------------------------------------


def test_of_a_calibration_and_a_plan(calibrated, planned, drawn, draw):
    rest = [
        draw(error_vectors, in_pixels(calibrated)),
        draw(criterion_by_count, replace(planned, criterion="O1")),
    ]
    assert told([*drawn, *rest]) == []
    names = {figure.name for figure in (*drawn, *rest)}
    assert names == {*NAMES["calibration"], *NAMES["plan"]}


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
    assert told([*calibration_figures(OTHERS[name](calibrated))]) == []


@pytest.mark.slow
def test_of_many_measurements(many):
    assert told([*calibration_figures(many(3000))]) == []


@pytest.mark.slow
def test_of_a_joint_with_a_long_name(hostile):
    assert told([*calibration_figures(hostile)]) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", ["hands", "lost motion", "distances", "camera"])
def test_of_all_kinds_of_calibrations(name, calibrated_robot):
    assert told([*calibration_figures(KINDS[name](calibrated_robot))]) == []


def others(
    sizes: Sequence[float], counts: Sequence[int], trials: Sequence[Sequence[float]]
) -> Iterator[Drawn]:
    """All figures that are not of a calibration or of a plan."""
    rng = np.random.default_rng(0)
    for size in sizes:
        points, drift = rng.normal(size=(200, 3)), size * rng.uniform(0, 1, 200)
        drift[0] *= 30.0  # More at the end.
        found = TipDrift(np.zeros((200, 6)), points, drift, drift, ("base",))
        yield from comparison_figures(found)
    for count in counts:
        far, near = (visits_of(offset, count) for offset in (5e-3, 2e-5))
        tests = {"nominal": far, "calibrated": near}
        yield from acceptance_figures(Judged(tests, LIMIT))
        yield from acceptance_figures(Judged({"robot": far}, LIMIT, path=True))
    rows = [row(f"r{k}", 1e-3 * k, 1e-4 * k) for k in range(1, 6)]
    rows += [row(f"c{k}", 3.0 * k, 1.0, "pixel") for k in range(1, 6)]
    yield from fleet_figures(rows)
    for chances in trials:
        met = [outlook(n, c) for n, c in zip((12, 30), chances, strict=True)]
        yield from outlook_figures(Foreseen(met, LIMIT))


def test_of_everything_else():
    found = [*others((1e-3,), (4,), ([0.5, 1.0],))]
    assert told(found) == []
    kinds = {*NAMES} - {"calibration", "plan"}
    assert {f.name for f in found} == {name for kind in kinds for name in NAMES[kind]}


@pytest.mark.slow
def test_of_everything_else_in_other_sizes():
    assert told([*others((1e-6, 3.0), (1, 12, 21), ([0.0, 0.0],))]) == []


@pytest.mark.slow
def test_of_many_poses_with_names():
    assert told([*others((), (20,), ())]) == []
