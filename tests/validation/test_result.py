"""What a result offers in a notebook: figures, a summary, and a data frame."""

from __future__ import annotations

import sys
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure

import calib_pin
from calib_pin.report.figures import NAMES


@pytest.fixture(scope="module")
def result() -> calib_pin.CalibrationResult:
    chain = calib_pin.load_chain("space7")
    setup = calib_pin.read_setup(calib_pin.robot_file("space7", "setup.yaml"))
    file = calib_pin.robot_file("space7", "measurements.csv")
    rows = calib_pin.read_measurements(file, chain)
    return calib_pin.calibrate(chain, rows, setup)


@pytest.mark.slow
def test_figures_by_name(result) -> None:
    figures = result.figures()
    assert set(figures) <= set(NAMES["calibration"])
    assert {"errors-per-measurement", "residuals-by-joint"} < set(figures)
    assert all(isinstance(figure, Figure) for figure in figures.values())


def test_a_summary_has_verdict_accuracy_and_parameters(result) -> None:
    page = result._repr_html_()
    assert "<b>GOOD</b>: position error" in page
    known = [p.name for p in result.parameters if p.sigma is not None]
    assert known and all(f"<td>{name}<td>" in page for name in known)


def test_a_data_frame_has_every_measurement(result, monkeypatch) -> None:
    """Pandas need not be installed: what it is given is what is tested."""
    frames: list[dict[str, list[object]]] = []
    stand_in = SimpleNamespace(
        DataFrame=dict, concat=lambda parts, **_: frames.extend(parts) or "frame"
    )
    monkeypatch.setitem(sys.modules, "pandas", stand_in)
    assert result.to_frame() == "frame"
    assert {len(column) for column in frames[0].values()} == {len(result.fitted)}
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(calib_pin.CalibPinError, match="pip install pandas"):
        result.to_frame()


def test_predictions_have_the_uncertainty_of_the_tool(result) -> None:
    """At the configurations of the workspace it is the one that the report tells."""
    tip = result.accuracy.tip
    assert tip is not None and result.accuracy.workspace is not None
    unmodeled = np.square(result.accuracy.workspace.unmodeled)
    found = result.predict(tip.q)
    assert np.array_equal(found.poses, result.model.of().poses(tip.q))
    C = found.covariance
    assert np.allclose(C, C.transpose(0, 2, 1), rtol=0.0, atol=1e-9 * C.max())
    for k, deviation in enumerate((tip.position, tip.orientation)):
        own = np.trace(C[:, 3 * k : 3 * k + 3, 3 * k : 3 * k + 3], axis1=1, axis2=2)
        assert np.allclose(np.sqrt(own - unmodeled[k]), deviation, rtol=1e-6)
    # Along the axes of the measurement frame: turned with the robot in front of it.
    one = result.predict(tip.q[0])
    assert one.covariance.shape == (1, 6, 6)
    assert np.allclose(one.covariance[0], C[0], rtol=1e-9, atol=0.0)
