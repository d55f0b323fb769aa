"""Correlations and intervals of what is known of the robot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib_pin.report.figures.estimates import (
    Estimate,
    of_robot,
    parameter_intervals,
)
from calib_pin.validation.result import CalibrationResult


def estimates(result: CalibrationResult) -> list[Estimate]:
    return of_robot(result.parameters, result.groups, result.model.given)


def test_frames_are_not_of_the_robot(calibrated):
    group = replace(calibrated.groups[0], terms=(("base.frame.x", 1.0),))
    found = of_robot(calibrated.parameters, (group,), calibrated.model.given)
    assert all(not estimate.label.startswith("sum") for estimate in found)


def test_intervals_are_two_deviations_in_display_units(calibrated, draw):
    changed = tuple(
        replace(p, value=1.5 * p.sigma) if p.name == "joint_1.link-transform.mx" else p
        for p in calibrated.parameters
    )
    result = replace(calibrated, parameters=changed)
    drawn = draw(parameter_intervals, result)
    lengths, angles = drawn.figure.axes
    assert lengths.get_xlabel() == "estimate [mm]"
    assert angles.get_xlabel() == "estimate [deg]"
    found = [e for e in estimates(result) if e.unit == "m"]
    sure, unsure = (
        next(line for line in lengths.lines if line.get_label() == label)
        for label in ("differs from zero", "may be zero")
    )
    doubtful = [k for k, e in enumerate(found) if abs(e.value) < 2.0 * e.sigma]
    assert 0 in doubtful and len(doubtful) < 0.2 * len(found)
    assert np.asarray(unsure.get_ydata()).tolist() == doubtful
    lines = np.asarray(sure.get_ydata())
    values = [1e3 * found[k].value for k in lines]
    np.testing.assert_allclose(sure.get_xdata(), values)
    reach = [s[1, 0] - s[0, 0] for c in lengths.collections for s in c.get_segments()]
    sigmas = sorted(4e3 * e.sigma for e in found)
    np.testing.assert_allclose(sorted(r for r in reach if r < 0.9), sigmas)
