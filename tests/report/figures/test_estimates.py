"""Correlations and intervals of what is known of the robot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.patches import PathPatch

from calib_pin.report.figures.estimates import (
    Estimate,
    correlation,
    of_robot,
    parameter_intervals,
)
from calib_pin.report.figures.identifiability import correlations
from calib_pin.validation.result import CalibrationResult


def estimates(result: CalibrationResult) -> list[Estimate]:
    return of_robot(result.parameters, result.groups, result.model.given)


def test_frames_are_not_of_the_robot(calibrated):
    group = replace(calibrated.groups[0], terms=(("base.frame.x", 1.0),))
    found = of_robot(calibrated.parameters, (group,), calibrated.model.given)
    assert all(not estimate.label.startswith("sum") for estimate in found)


def test_correlations_are_those_of_draws(calibrated):
    found = estimates(calibrated)
    places = {p.name: k for k, p in enumerate(calibrated.parameters)}
    R = correlation(found, places, calibrated.covariance)
    # Independently: draw parameters, add up the terms, correlate.
    scale = np.sqrt(np.maximum(np.diag(calibrated.covariance), 1e-30))
    s, V = np.linalg.eigh(calibrated.covariance / np.outer(scale, scale))
    rng = np.random.default_rng(0)
    z = rng.normal(size=(len(s), 10_000)) * np.sqrt(np.maximum(s, 0.0))[:, None]
    theta = scale[:, None] * (V @ z)
    sums = [sum(c * theta[places[name]] for name, c in e.terms) for e in found]
    np.testing.assert_allclose(R, np.corrcoef(sums), atol=0.05)
    for k, estimate in enumerate(found):
        assert R[k, k] == pytest.approx(1.0)
        assert np.std(sums[k]) == pytest.approx(estimate.sigma, rel=0.05)


def test_squares_have_the_shade_of_the_correlation(calibrated, draw):
    drawn = draw(correlations, calibrated)
    found = estimates(calibrated)
    places = {p.name: k for k, p in enumerate(calibrated.parameters)}
    R = correlation(found, places, calibrated.covariance)
    (axes,) = drawn.figure.axes
    painted = np.zeros_like(R)
    for patch in axes.get_children():
        if isinstance(patch, PathPatch):
            corners = np.asarray(patch.get_path().vertices).reshape(-1, 5, 2)
            columns, rows = corners[:, :4].mean(axis=1).round().astype(int).T
            painted[rows, columns] = float(str(patch.get_label()))
    assert np.abs(painted - np.tril(R))[np.tril_indices(len(R))].max() <= 0.0501
    assert (painted[np.triu_indices(len(R), 1)] == 0.0).all()
    labels = [text.get_text() for text in axes.texts]
    assert labels[0] == "joint_1.link-transform.mx"


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
