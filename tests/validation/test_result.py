"""What a result offers: figures, a summary, tables, and a data frame."""

from __future__ import annotations

import sys
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure

import calib_pin
from calib_pin.kinematics.chain import Chain
from calib_pin.observations import BlockKey, Measurements, Observations
from calib_pin.parameterizations import frame_pose
from calib_pin.report.figures import NAMES
from calib_pin.setup import FrameSetup, PlaneSetup, Setup
from calib_pin.validation.result import Accuracy, CalibrationResult
from tests.shared import simulated

TOOL = FrameSetup((0.05, 0.1, 0.1), (0.3, 0.2, 0.1))
BASE = FrameSetup((1.0, -2.0, 0.3), (0.4, -0.3, 2.0))
WALL = {"wall": PlaneSetup((0.1, 0.2, 1.0), 1.5)}


def measured(
    model: str, count: int = 45, size: float = 1.0
) -> tuple[Chain, Measurements]:
    setup = Setup(
        tool_frame=TOOL,
        base_frame=BASE if model != "plane-distance" else FrameSetup(),
        planes=WALL,
    )
    problem, _ = simulated(model, setup, count, size, 5, noise=None)
    return problem.chains[""], problem.data.only


@pytest.fixture(scope="module")
def position() -> CalibrationResult:
    return calib_pin.calibrate(*measured("position"))


def test_sizes_are_those_of_the_accuracy(position: CalibrationResult) -> None:
    (error,) = position.errors
    assert position.held_out is not None
    for rows, stages in (
        (position.fitted, (error.before, error.after)),
        (position.held_out, (error.validation_before, error.validation_after)),
    ):
        found = rows.sizes(rows.quantities[0])
        for sizes, accuracy in zip(found, stages, strict=True):
            assert len(sizes) == len(rows) == 45
            assert accuracy is not None
            np.testing.assert_allclose(sizes.mean(), accuracy.mean, rtol=1e-9)
            assert sizes.max() == accuracy.max
            assert (
                np.mean(sizes <= accuracy.p95) >= 0.95 > np.mean(sizes < accuracy.p95)
            )


def test_unseen_rows_keep_the_order_of_the_file(position: CalibrationResult) -> None:
    """Folds are drawn at random; what is shown stands where the row does."""
    assert position.held_out is not None
    np.testing.assert_array_equal(position.held_out.rows.q, position.fitted.rows.q)
    # Predicted by other fits, but of the same rows: nearly the same before.
    np.testing.assert_allclose(
        position.held_out.before, position.fitted.before, atol=3e-3
    )
    assert not np.array_equal(position.held_out.after, position.fitted.after)


def test_distances_have_errors_of_one_column() -> None:
    chain, rows = measured("plane-distance", 60, 0.0)
    result = calib_pin.calibrate(
        chain, rows, Setup(planes=WALL, parameters=("joint-offset",)), validate=False
    )
    assert result.held_out is None
    assert result.fitted.after.shape == result.fitted.sigma.shape == (60, 1)


def test_percentiles_of_what_cannot_be_predicted() -> None:
    sizes = np.array([1.0] * 18 + [2.0, np.inf])
    assert Accuracy.of(sizes).p95 == 2.0
    assert Accuracy.of(sizes[:1]).p95 == 1.0


def test_every_block_has_its_own_columns() -> None:
    """Two trackers, one of which measures poses, and a distance sensor."""
    chain, _ = measured("position")
    stations = {"a": BASE, "b": FrameSetup((-1.0, 0.5, 0.2), (0.1, 0.2, -1.0))}
    setup = Setup(
        parameters=("joint-offset",), tool_frame=TOOL, stations=stations, planes=WALL
    )
    keys = [
        BlockKey("position", station="a"),
        BlockKey("pose", station="b"),
        BlockKey("plane-distance", station="a"),
    ]
    data = Observations.of(
        *(
            simulated(keys, setup, n, 1.0, 5, again=n, key=key, noise=1e-5)[0].data
            for key, n in zip(keys, (30, 20, 10), strict=True)
        )
    )
    result = calib_pin.calibrate(chain, data, setup, validate=False)
    errors, tool = result.fitted, frame_pose(TOOL).homogeneous
    assert errors.rows.keys == tuple(keys)
    near = (chain.poses(data.q) @ tool)[:, :3, 3]
    np.testing.assert_allclose(errors.points, near, atol=0.05)
    # The table has a cell where a measurement has the number.
    table = errors.table("train")
    assert table["station"] == ["a"] * 30 + ["b"] * 20 + ["a"] * 10
    assert table["model"][29:31] == ["position", "pose"]
    for stage in ("before", "after", "sigma", "stated"):
        cells = np.isfinite([table[f"{c}.{stage}"] for c in errors.components])
        np.testing.assert_array_equal(cells.sum(axis=0), [3] * 30 + [6] * 20 + [1] * 10)
    cells = np.isfinite([table[f"measured.{k + 1}"] for k in range(7)])
    np.testing.assert_array_equal(cells.sum(axis=0), [3] * 30 + [7] * 20 + [1] * 10)


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


def test_a_summary_has_verdict_and_accuracy(result) -> None:
    assert "GOOD: position error" in repr(result) and "nominal" in repr(result)


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
