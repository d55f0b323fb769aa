"""No text of any figure is over another, over data, or outside of the figure."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

import calib_pin
from calib_pin.measurement_models import Quantity
from calib_pin.planning.plan import Plan
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
    plan_figures,
)
from calib_pin.setup import LimitSetup
from calib_pin.validation.result import CalibrationResult
from calib_pin.validation.tip_drift import TipDrift
from tests.report.figures.test_acceptance import visits_of
from tests.report.figures.test_by_block import with_blocks, with_stations
from tests.report.figures.test_figures import hostile, one_row, without
from tests.report.figures.test_fleet import outlook, row
from tests.report.figures.texts import faults, faults_of
from tests.report.test_written_result import CASES

__all__ = ["hostile"]

LIMIT = LimitSetup(position=1e-3, repeatability=2e-4)


def told(drawn: Sequence[Drawn]) -> dict[str, list[str]]:
    """Faults by figure, of the figures that have some."""
    found = {figure.name: faults(figure) for figure in drawn}
    return {name: of for name, of in found.items() if of}


# --- the checker -------------------------------------------------------------------


def drawing_of() -> tuple[Figure, plt.Axes]:
    figure = Figure(figsize=(4.0, 3.0))
    axes = figure.add_axes((0.2, 0.2, 0.7, 0.6))
    axes.plot([0.0, 1.0], [0.0, 1.0])
    return figure, axes


def over_each_other() -> Figure:
    figure, axes = drawing_of()
    axes.set_title("a title")
    figure.text(0.5, 0.83, "another text", ha="center")
    return figure


def over_a_label_of_a_tick() -> Figure:
    figure, axes = drawing_of()
    axes.set_xticks([0.50, 0.52], ["0.50", "0.52"])
    return figure


def over_a_curve() -> Figure:
    figure, axes = drawing_of()
    axes.text(0.5, 0.5, "middle", ha="center", va="center")
    return figure


def legend_over_marks() -> Figure:
    figure, axes = drawing_of()
    axes.plot([0.05, 0.2], [0.9, 0.95], "o", label="some marks there")
    axes.legend(loc="upper left")
    return figure


def outside() -> Figure:
    figure, _ = drawing_of()
    figure.text(0.9, 0.95, "a text that is too long")
    return figure


def over_a_color_bar() -> Figure:
    figure, _ = drawing_of()
    bar = Rectangle((0.2, 0.9), 0.5, 0.05, transform=figure.transFigure)
    figure.add_artist(bar)
    figure.text(0.3, 0.91, "caption")
    return figure


def left_behind() -> Figure:
    figure, _ = drawing_of()
    figure.text(1.0, 2.8, "in inches", transform=figure.dpi_scale_trans)
    return figure


@pytest.mark.parametrize(
    ("figure", "fault"),
    [
        (over_each_other, "'a title' is over 'another text'"),
        (over_a_label_of_a_tick, "'0.50' is over '0.52'"),
        (over_a_curve, "'middle' is over data (Line2D)"),
        (legend_over_marks, "'some marks there' is over data (Line2D)"),
        (outside, "'a text that is too long' leaves the figure"),
        (over_a_color_bar, "'caption' is over a color bar"),
        (left_behind, "Text(1.0, 2.8, 'in inches') stays"),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_the_checker_finds(figure: Callable[[], Figure], fault: str) -> None:
    assert faults_of(drawing_of()[0]) == []
    assert any(found.startswith(fault) for found in faults_of(figure()))


# --- the figures -------------------------------------------------------------------


def test_of_a_calibration(calibrated: CalibrationResult) -> None:
    assert told([*calibration_figures(calibrated)]) == {}


def scaled(result: CalibrationResult, factor: float) -> CalibrationResult:
    """Errors as of a robot of another size."""
    rows = result.fitted
    fitted = replace(rows, before=factor * rows.before, after=factor * rows.after)
    return replace(result, fitted=fitted, held_out=fitted)


def alike(result: CalibrationResult) -> CalibrationResult:
    """Errors that are almost the same, so that an axis has but a short way."""
    rows = result.fitted
    after = np.full_like(rows.after, 1.00001e-3)
    return scaled(
        replace(result, fitted=replace(rows, before=1.0001 * after, after=after)), 1.0
    )


def in_pixels(result: CalibrationResult) -> CalibrationResult:
    """No position: the errors are colors."""
    pixels = Quantity("pixel", "px", slice(0, 2), 0.5)
    fitted = replace(result.fitted, quantities=(pixels,))
    return replace(result, fitted=fitted, held_out=fitted)


@pytest.mark.parametrize(
    "changed",
    [
        one_row,
        without,
        alike,
        in_pixels,
        lambda result: scaled(in_pixels(result), 1e5),
        lambda result: scaled(result, 1e-4),
        lambda result: scaled(result, 1e3),
        lambda result: with_blocks(result, 7),
        lambda result: with_stations(result, 2),
        lambda result: with_stations(result, 3),
    ],
    ids=["row", "rest", "alike", "px", "far", "tiny", "huge", "blocks", "two", "three"],
)
def test_of_other_results(
    calibrated: CalibrationResult,
    changed: Callable[[CalibrationResult], CalibrationResult],
) -> None:
    assert told([*calibration_figures(changed(calibrated))]) == {}


def test_of_many_measurements(many: Callable[[int], CalibrationResult]) -> None:
    assert told([*calibration_figures(many(3000))]) == {}


def test_of_a_joint_with_a_long_name(hostile: CalibrationResult) -> None:
    assert told([*calibration_figures(hostile)]) == {}


QUICK = ("camera", "blocks")


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=[pytest.mark.slow][n in QUICK :]) for n in CASES],
)
def test_of_all_kinds_of_calibrations(name: str) -> None:
    assert told([*calibration_figures(CASES[name]())]) == {}


def test_of_a_plan(planned: Plan) -> None:
    assert told([*plan_figures(planned)]) == {}


@pytest.mark.slow
@pytest.mark.parametrize("criterion", ["O1", "O2", "O3", "prediction"])
def test_of_plans(criterion: str) -> None:
    chain = calib_pin.load_chain("space7")
    plan = calib_pin.plan(
        chain, "pose", 20, method="greedy", candidates=200, criterion=criterion
    )
    assert told([*plan_figures(plan)]) == {}


def others() -> Iterator[tuple[str, Iterator[Drawn]]]:
    """All figures that are not of a calibration or of a plan."""
    rng = np.random.default_rng(0)
    for size in (1e-6, 1e-3, 3.0):
        points, drift = rng.normal(size=(200, 3)), size * rng.uniform(0, 1, 200)
        drift[0] *= 30.0  # More at the end.
        found = TipDrift(np.zeros((200, 6)), points, drift, drift, ("base",))
        yield "comparison", comparison_figures(found)
    for count in (1, 4, 20, 60):
        tests = {
            "nominal": visits_of(5e-3, count),
            "calibrated": visits_of(2e-5, count),
        }
        yield "acceptance", acceptance_figures(Judged(tests, LIMIT))
        near = {"robot": visits_of(1e-3, count)}
        yield "acceptance", acceptance_figures(Judged(near, LIMIT, path=True))
    rows = [row(f"r{k}", 1e-3 * k, 1e-4 * k) for k in range(1, 6)]
    rows += [row(f"c{k}", 3.0 * k, 1.0, "pixel") for k in range(1, 6)]
    yield "fleet", fleet_figures(rows)
    for chances in ([0.5, 1.0], [0.0, 0.0]):
        trials = [outlook(n, c) for n, c in zip((12, 30), chances, strict=True)]
        yield "outlook", outlook_figures(Foreseen(trials, LIMIT))


def test_of_everything_else() -> None:
    found = [(name, figure) for name, figures in others() for figure in figures]
    assert told([figure for _, figure in found]) == {}
    drawn = {figure.name for _, figure in found}
    kinds = {
        name
        for kind in NAMES
        if kind not in ("calibration", "plan")
        for name in NAMES[kind]
    }
    assert drawn == kinds


def test_every_figure_is_looked_at(
    calibrated: CalibrationResult, planned: Plan
) -> None:
    drawn = [*calibration_figures(calibrated), *plan_figures(planned)]
    for changed in (in_pixels(calibrated), with_blocks(calibrated, 3)):
        drawn += calibration_figures(changed)
    assert {figure.name for figure in drawn} == {*NAMES["calibration"], *NAMES["plan"]}
