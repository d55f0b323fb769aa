"""How a search converged, the model ladder, and the accuracy of the tip."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.patches import PathPatch

from calib_pin.estimation.evidence import FoundCurve
from calib_pin.report.figures.canvas import Drawn
from calib_pin.report.figures.searches import convergence, model_ladder
from calib_pin.report.figures.workspace import tip_by_count, tip_in_workspace
from calib_pin.validation.result import CalibrationResult
from calib_pin.validation.summaries import Candidate, ModelSelection


def test_convergence_is_the_history(
    calibrated: CalibrationResult, draw: Callable[..., Drawn]
) -> None:
    drawn = draw(convergence, calibrated)
    (axes,) = drawn.figure.axes
    assert np.asarray(axes.lines[0].get_ydata()).tolist() == [50.0, 20.0, 5.0, 5.0]
    assert axes.get_yscale() == "log" and "in 3 generations" in drawn.reading
    assert (
        convergence(replace(calibrated, solver=replace(calibrated.solver, history=())))
        is None
    )
    assert (
        convergence(
            replace(
                calibrated, solver=replace(calibrated.solver, history=(np.inf, np.inf))
            )
        )
        is None
    )
    assert (
        convergence(
            replace(calibrated, solver=replace(calibrated.solver, history=(0.0, 0.0)))
        )
        is None
    )
    drawn = draw(
        convergence,
        replace(
            calibrated, solver=replace(calibrated.solver, history=(np.inf, 3.0, 0.0))
        ),
    )
    assert np.asarray(drawn.figure.axes[0].lines[0].get_xdata()).tolist() == [1]


def test_tip_errors_are_in_millimeters(
    calibrated: CalibrationResult, draw: Callable[..., Drawn]
) -> None:
    tip = calibrated.accuracy.tip
    assert tip is not None
    counts, errors = tip.by_count.curve
    drawn = draw(tip_by_count, calibrated)
    (axes,) = drawn.figure.axes
    _, curve, own = axes.lines
    np.testing.assert_allclose(curve.get_xdata(), counts)
    np.testing.assert_allclose(curve.get_ydata(), 1e3 * errors)
    (legend,) = drawn.figure.legends
    assert legend.get_texts()[2].get_text().startswith("40 measured")
    assert np.asarray(own.get_xdata()).tolist() == [40]
    ticks = [label.get_text() for label in axes.get_yticklabels()]
    assert "0.1" in ticks and not any("10" in tick for tick in ticks)
    last = replace(tip, by_count=FoundCurve((counts[-1:], errors[-1:])))
    assert (
        tip_by_count(
            replace(calibrated, accuracies={"": replace(calibrated.accuracy, tip=last)})
        )
        is None
    )


def test_the_workspace_shows_all_samples(
    calibrated: CalibrationResult, draw: Callable[..., Drawn]
) -> None:
    tip = calibrated.accuracy.tip
    assert tip is not None
    drawn = draw(tip_in_workspace, calibrated)
    assert f"rms {1e3 * tip.rms[0]:.4f} mm" in drawn.reading
    for axes in drawn.figure.axes:
        patches = [p for p in axes.get_children() if isinstance(p, PathPatch)]
        count = sum(len(p.get_path().vertices) for p in patches)
        assert count == 2 * 2 * len(tip.points), "a dot and its rim"
    endless = replace(tip, position=np.full(len(tip.points), np.inf))
    assert (
        tip_in_workspace(
            replace(
                calibrated, accuracies={"": replace(calibrated.accuracy, tip=endless)}
            )
        )
        is None
    )


def test_rungs_have_their_score_and_its_deviation(
    calibrated: CalibrationResult, draw: Callable[..., Drawn]
) -> None:
    drawn = draw(model_ladder, calibrated)
    (axes,) = drawn.figure.axes
    points = [bars.lines[0] for bars in axes.containers]
    assert [float(np.asarray(p.get_xdata())[0]) for p in points] == [20.0, 1.0]
    (segment,) = axes.containers[0].lines[2][0].get_segments()
    assert segment[:, 0].tolist() == [18.0, 22.0]
    labels = [text.get_text() for text in axes.texts]
    assert "geometric (selected)" in labels and "0.1000 mm" in labels
    assert labels[-2:] == ["+ compliance", "not tried"]
    assert axes.get_xscale() == "log", "one rung dwarfs the other"
    assert "geometric" in drawn.reading


@pytest.mark.parametrize("score", [0.0, 1.0])
def test_rungs_alike_have_a_linear_axis(
    calibrated: CalibrationResult, draw: Callable[..., Drawn], score: float
) -> None:
    rung = Candidate("a\nname", (), None, 7, (("x", "m", 1e-3),), score, 0.1 * score)
    drawn = draw(
        model_ladder, replace(calibrated, model_selection=ModelSelection((rung,), 0))
    )
    (axes,) = drawn.figure.axes
    assert axes.get_xscale() == "linear" and axes.get_xlim()[0] == 0.0
    assert drawn.svg()
    untried = ModelSelection((Candidate("a", (), None, reason="too few rows"),), 0)
    assert model_ladder(replace(calibrated, model_selection=untried)) is None
