"""Criteria: their definitions, the trials of a search, and their slopes."""

from __future__ import annotations

import numpy as np
import pytest

from calib_pin.estimation.identifiability import observability
from calib_pin.kinematics.spatial import Floats
from calib_pin.planning.criteria import (
    CRITERIA,
    SHARPER,
    Criterion,
    Information,
    Prediction,
)

COLUMNS, NUISANCES = 8, 3

TESTS = np.cov(np.random.default_rng(9).normal(size=(COLUMNS, 40)))
ALL: dict[str, Criterion] = {**CRITERIA, "prediction": Prediction(TESTS)}


def table(d: int, count: int, seed: int = 0) -> Floats:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(count, d, COLUMNS)) * np.linspace(0.3, 3.0, COLUMNS)


def gram(rows: Floats) -> Floats:
    U = rows.reshape(-1, rows.shape[-1])
    return U.T @ U


def factored(M: Floats, f: int = NUISANCES) -> Information:
    found = Information.of(M, f)
    assert found is not None
    return found


def projected(rows: Floats, f: int = NUISANCES) -> Floats:
    """Singular values of the robot's columns with the nuisances projected out."""
    U = rows.reshape(-1, rows.shape[-1])
    Q = np.linalg.qr(U[:, :f])[0]
    return np.linalg.svd(U[:, f:] - Q @ (Q.T @ U[:, f:]), compute_uv=False)


@pytest.mark.parametrize("f", [0, NUISANCES])
@pytest.mark.parametrize("name", ALL)
def test_value_cost_and_slope_are_by_definition(name: str, f: int) -> None:
    rows, criterion = table(3, 12), ALL[name]
    M, s = gram(rows), projected(rows, f)
    assert criterion.name == name
    cost = None
    if name == "prediction":
        # The standard deviation of the tip at rows whose mean square is `TESTS`.
        value = np.sqrt(np.trace(np.linalg.inv(M) @ TESTS))
    elif name == "condition":
        value = s[0] / s[-1]
    else:
        value = observability(s, 12)[name]
        # What is maximized is minimized as the logarithm of its inverse.
        cost = -np.log(value * np.sqrt(12) if name == "O1" else value)
    found = factored(M, f)
    assert criterion.value(found, 12) == pytest.approx(value, rel=1e-8)
    cost = np.log(value) if cost is None else cost
    assert criterion.cost(found) == pytest.approx(cost, rel=1e-8)
    # The slope of what is descended, along random directions.
    rng, size = np.random.default_rng(0), np.sqrt(np.diag(M))
    one = len(criterion.sharpnesses) == 1
    for sharpness in criterion.sharpnesses if one else (1.0, 64.0):
        _, by_M = criterion.slope(found, sharpness)
        np.testing.assert_allclose(by_M, by_M.T, atol=1e-9 * np.abs(by_M).max())
        slopes, differences = [], []
        for _ in range(6):
            dM = rng.normal(size=M.shape) * np.outer(size, size)
            dM = 1e-6 * (dM + dM.T)
            ends = (
                criterion.slope(factored(M + k * dM, f), sharpness) for k in (1, -1)
            )
            slopes.append(float(np.sum(by_M * dM)))
            differences.append(float(np.subtract(*(value for value, _ in ends))) / 2.0)
        largest = np.abs(differences).max()
        np.testing.assert_allclose(slopes, differences, atol=1e-5 * largest)


@pytest.mark.parametrize("name", ALL)
def test_smooth_cost_becomes_the_cost(name: str) -> None:
    criterion = ALL[name]
    found = factored(gram(table(3, 12)))
    cost = criterion.cost(found)
    costs = [criterion.slope(found, p)[0] for p in (*SHARPER, 256.0, 4096.0)]
    errors = np.abs(np.array(costs) - cost)
    if len(criterion.sharpnesses) == 1:
        smooth, _ = criterion.slope(found, criterion.sharpnesses[0])
        assert smooth == pytest.approx(cost, abs=1e-9)
        return
    assert criterion.sharpnesses == SHARPER
    assert errors[0] > errors[1] > errors[2]
    assert errors[-1] < 2e-3
    # Power means of r numbers are at most log(r) / p away, twice here.
    for p, error in zip((*SHARPER, 256.0, 4096.0), errors, strict=True):
        assert error <= 1.5 * np.log(COLUMNS - NUISANCES) / p
