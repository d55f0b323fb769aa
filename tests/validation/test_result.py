"""What a result offers in a notebook: figures, a summary, and a data frame."""

from __future__ import annotations

import sys
from types import SimpleNamespace

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
def test_figures_by_name(result: calib_pin.CalibrationResult) -> None:
    figures = result.figures()
    assert set(figures) < set(NAMES["calibration"])
    assert {"errors-per-measurement", "parameter-intervals"} < set(figures)
    assert all(isinstance(figure, Figure) for figure in figures.values())


def test_a_summary_has_verdict_accuracy_and_parameters(
    result: calib_pin.CalibrationResult,
) -> None:
    page = result._repr_html_()
    assert "<b>GOOD</b>: position error" in page
    known = [p.name for p in result.parameters if p.sigma is not None]
    assert known and all(f"<td>{name}<td>" in page for name in known)


def test_a_data_frame_has_every_measurement(
    result: calib_pin.CalibrationResult, monkeypatch: pytest.MonkeyPatch
) -> None:
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
