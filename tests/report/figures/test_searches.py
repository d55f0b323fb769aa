"""How a search converged, the model ladder, and the accuracy of the tip."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from matplotlib.patches import PathPatch

from calib_pin.estimation.evidence import FoundCurve
from calib_pin.report.figures.searches import convergence, model_ladder
from calib_pin.report.figures.workspace import tip_by_count, tip_in_workspace
from calib_pin.validation.result import Candidate, ModelSelection
from tests.report.results import changed


def test_convergence_is_the_history(calibrated, draw):
    drawn = draw(convergence, calibrated)
    (axes,) = drawn.figure.axes
    assert np.asarray(axes.lines[0].get_ydata()).tolist() == [50.0, 20.0, 5.0, 5.0]
    assert axes.get_yscale() == "log"
    for history in ((), (np.inf, np.inf), (0.0, 0.0)):
        assert convergence(changed(calibrated, history=history)) is None
    drawn = draw(convergence, changed(calibrated, history=(np.inf, 3.0, 0.0)))
    assert np.asarray(drawn.figure.axes[0].lines[0].get_xdata()).tolist() == [1]


def test_tip_errors_are_in_millimeters(calibrated, draw):
    tip = calibrated.accuracy.tip
    assert tip is not None
    counts, errors = tip.by_count.curve
    drawn = draw(tip_by_count, calibrated)
    (axes,) = drawn.figure.axes
    _, curve, own = axes.lines
    np.testing.assert_allclose(curve.get_xdata(), counts)
    np.testing.assert_allclose(curve.get_ydata(), 1e3 * errors)
    assert np.asarray(own.get_xdata()).tolist() == [40]
    ticks = [label.get_text() for label in axes.get_yticklabels()]
    assert "0.1" in ticks and not any("10" in tick for tick in ticks)
    last = replace(tip, by_count=FoundCurve(counts[-1:], errors[-1:]))
    assert tip_by_count(changed(calibrated, tip=last)) is None


def test_the_workspace_shows_all_samples(calibrated, draw):
    tip = calibrated.accuracy.tip
    assert tip is not None
    drawn = draw(tip_in_workspace, calibrated)
    assert f"rms {1e3 * tip.rms[0]:.4f} mm" in drawn.reading
    for axes in drawn.figure.axes:
        patches = [p for p in axes.get_children() if isinstance(p, PathPatch)]
        count = sum(len(p.get_path().vertices) for p in patches)
        assert count == 2 * 2 * len(tip.points), "a dot and its rim"
    endless = replace(tip, position=np.full(len(tip.points), np.inf))
    assert tip_in_workspace(changed(calibrated, tip=endless)) is None


def test_rungs_have_their_score_and_its_deviation(calibrated, draw):
    drawn = draw(model_ladder, calibrated)
    (axes,) = drawn.figure.axes
    points = [bars.lines[0] for bars in axes.containers]
    assert [float(np.asarray(p.get_xdata())[0]) for p in points] == [20.0, 1.0]
    (segment,) = axes.containers[0].lines[2][0].get_segments()
    assert segment[:, 0].tolist() == [18.0, 22.0]
    labels = [text.get_text() for text in axes.texts]
    assert "0.1000 mm" in labels and "+ compliance" in labels
    assert axes.get_xscale() == "log", "one rung dwarfs the other"
    assert "geometric" in drawn.reading


def test_rungs_alike_have_a_linear_axis(calibrated, draw):
    rung = Candidate("a\nname", (), None, 7, (("x", "m", 1e-3, 1e-3),), 0.0, 0.0)
    selection = ModelSelection(rung.name, "near", {}, (rung,))
    drawn = draw(model_ladder, replace(calibrated, model_selection=selection))
    (axes,) = drawn.figure.axes
    assert axes.get_xscale() == "linear" and axes.get_xlim()[0] == 0.0
    blank = Candidate("a", (), None, reason="too few rows")
    untried = ModelSelection("a", "near", {}, (blank,))
    assert model_ladder(replace(calibrated, model_selection=untried)) is None
