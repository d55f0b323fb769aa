"""Rows of the identification matrix and their derivative by the configuration."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import calib_pin
from calib_pin.chain import Chain
from calib_pin.errors import OptionError
from calib_pin.measurement_models import MEASUREMENT_MODELS, CurvedModel
from calib_pin.measurement_models.position import Position
from calib_pin.planning.rows import IdentificationRows
from calib_pin.problem import (
    Problem,
    assumed_sigma,
    nominal_problem,
    observable_configurations,
)
from calib_pin.setup import Setup


def make(
    chain: Chain, model: str, framed: Setup, columns: int = 7, **settings: Any
) -> IdentificationRows:
    noise = {"position": 2e-4, "orientation": 1e-3}
    setup = replace(framed, noise=noise, **settings)
    problem = nominal_problem(chain, model, setup)
    rng = np.random.default_rng(5)
    basis = rng.normal(size=(len(problem.parameters), columns))
    sigma = assumed_sigma(problem.measurement, problem.setup.noise)
    return IdentificationRows(problem, basis, 2, problem.measurement, sigma)


def configurations(
    problem: Problem, count: int = 4
) -> tuple[np.ndarray, tuple[str, ...]]:
    zero = np.zeros(len(problem.parameters))
    return observable_configurations(problem, zero, count, np.random.default_rng(2))


@pytest.mark.parametrize("model", MEASUREMENT_MODELS)
def test_rows_are_those_of_the_problem(
    model: str, special_chain: Chain, framed: Setup
) -> None:
    of = make(special_chain, model, framed)
    q, target = configurations(of.problem)
    zero = np.zeros(len(of.problem.parameters))
    _, J = of.problem.about(zero, q, target).linearize_rows(zero)
    expected = (J @ of.basis).reshape(len(q), -1, of.basis.shape[1])
    np.testing.assert_allclose(of.rows(q, target), expected, rtol=1e-10, atol=1e-9)
    np.testing.assert_allclose(of.linearize(q, target)[0], expected, atol=1e-8)


@pytest.mark.parametrize("model", MEASUREMENT_MODELS)
def test_pullback_agrees_with_central_differences(
    model: str, special_chain: Chain, framed: Setup
) -> None:
    of = make(special_chain, model, framed)
    assert isinstance(of.measurement, CurvedModel)
    q, target = configurations(of.problem)
    rows, pullback = of.linearize(q, target)
    by_rows = np.random.default_rng(0).normal(size=rows.shape)
    found = pullback(by_rows)
    expected = np.empty_like(q)
    step = 1e-6
    for k in range(q.shape[1]):
        shift = step * np.eye(q.shape[1])[k]
        change = of.rows(q + shift, target) - of.rows(q - shift, target)
        expected[:, k] = np.sum(by_rows * change, axis=(1, 2)) / (2 * step)
    assert np.abs(found - expected).max() < 1e-7 * np.abs(expected).max()


@pytest.mark.parametrize("model", MEASUREMENT_MODELS)
def test_joint_corrections_have_rows_but_no_curvature(
    model: str, special_chain: Chain, framed: Setup
) -> None:
    kinds = ("placement", "transmission", "compliance")
    of = make(special_chain, model, framed, parameters=kinds)
    assert make(special_chain, model, framed).differentiable
    assert not of.differentiable
    q, target = configurations(of.problem)
    zero = np.zeros(len(of.problem.parameters))
    _, J = of.problem.about(zero, q, target).linearize_rows(zero)
    corrections = of.problem.error.joint_corrections
    assert (np.abs(J[:, corrections]).max(axis=0) > 0.0).all()
    expected = (J @ of.basis).reshape(len(q), -1, of.basis.shape[1])
    np.testing.assert_allclose(of.rows(q, target), expected, rtol=1e-10, atol=1e-8)
    with pytest.raises(OptionError) as caught:
        of.linearize(q, target)
    assert str(caught.value) == (
        "a joint correction has no derivative by the configuration, which the method "
        "'gradient' needs; allowed: exchange, greedy, pso, ga"
    )


def test_another_instrument_in_the_same_columns(framed: Setup) -> None:
    """The tip's position in the columns of a study with a ranger."""
    ranger = make(calib_pin.load_chain("space6"), "plane-distance", framed)
    q, _ = configurations(ranger.problem)
    of = IdentificationRows(
        ranger.problem, ranger.basis, 2, Position(), np.full(3, 1.0)
    )
    rows, pullback = of.linearize(q, ("",) * len(q))
    _, J = ranger.problem.error.jacobian(q, np.zeros(len(of.problem.error.screws)))
    T = ranger.problem.error.poses(q, np.zeros(len(of.problem.error.screws)))
    expected = T[:, :3, :3] @ J[:, :3] @ ranger.basis[: J.shape[2]]
    np.testing.assert_allclose(rows, expected, atol=1e-9)
    assert pullback(rows).shape == q.shape
