"""The report of an acceptance test: what stands in its tables."""

from __future__ import annotations

import numpy as np
import pytest

from calib_pin.report.acceptance_text import acceptance_report
from calib_pin.report.blocks import Table
from calib_pin.setup import LimitSetup
from calib_pin.validation.acceptance import acceptance


def test_orientations_have_a_row_for_each_axis() -> None:
    order, rng = np.tile([0, 1], 10), np.random.default_rng(0)
    angles = np.array([[1e-3, 0.0, -2e-3], [0.0, 3e-3, 0.0]])[order]
    angles = angles + 1e-5 * rng.normal(size=angles.shape)
    deviations = 1e-4 * rng.normal(size=(20, 3))
    test = acceptance(deviations, np.hstack([deviations, angles]), order)
    blocks = [*acceptance_report({"nominal": test}, LimitSetup(), "about")]
    (table,) = (b for b in blocks if isinstance(b, Table) and b.title == "Orientations")
    cells = [[cell.text for cell in row] for row in table.rows]
    assert [row[:2] for row in cells] == [
        [name, axis]
        for pose in test.poses
        for name, axis in zip((f"P{pose.pose}", "", ""), "xyz", strict=True)
    ]
    means = np.rad2deg([*angles[order == 0].mean(0), *angles[order == 1].mean(0)])
    assert [float(row[2]) for row in cells] == pytest.approx(means, abs=1e-3)
    assert len({len(row) for row in cells}) == 1 == len({len(table.columns)})
