"""Rows of the identification matrix and their derivative by the configuration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import calib_pin
from calib_pin.errors import OptionError
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import MEASUREMENT_MODELS, CurvedModel
from calib_pin.measurement_models.mixed import assumed_sigma
from calib_pin.measurement_models.position import Position
from calib_pin.planning.rows import IdentificationRows
from calib_pin.setup import Setup
from calib_pin.simulation import exact_problem

Equipped = Callable[..., Problem]
Visited = Callable[..., tuple[Floats, tuple[str, ...]]]

FREE = ("position", "pose", "plane-distance")
"""Models whose rows need not name anything."""

# Nothing is planned relative to another configuration.
NAMED = sorted({"position", *MEASUREMENT_MODELS} - {*FREE[1:], "relative-distance"})

MIXED = "position+fixed-point+plane-contact+camera"
NOISE = {"position": 2e-4, "orientation": 1e-3}
CORRECTED = ("placement", "transmission", "compliance")


def make(problem: Problem, columns: int = 7) -> IdentificationRows:
    rng = np.random.default_rng(5)
    basis = rng.normal(size=(len(problem.parameters), columns))
    sigma = assumed_sigma(problem.measurement, problem.setup.noise)
    return IdentificationRows(problem, basis, 2, problem.measurement, sigma)


def framed_rows(
    chain: Chain, model: str, framed: Setup, **settings: Any
) -> IdentificationRows:
    setup = replace(framed, noise=NOISE, **settings)
    return make(nominal_problem(chain, model, setup))


@pytest.fixture
def equipped_rows(equipped_problem: Equipped) -> Callable[..., IdentificationRows]:
    """On one chain: what a model adds knows nothing of the chain."""

    def rows(model: str, **settings: Any) -> IdentificationRows:
        chain = calib_pin.load_chain("space6")
        return make(equipped_problem(chain, model, noise=NOISE, **settings))

    return rows


def configurations(
    problem: Problem, visited: Visited, count: int = 4
) -> tuple[np.ndarray, tuple[str, ...]]:
    zero = np.zeros(len(problem.parameters))
    return visited(problem, zero, count, np.random.default_rng(2))


def rows_of_the_problem(
    of: IdentificationRows, q: Floats, target: tuple[str, ...]
) -> Floats:
    zero = np.zeros(len(of.problem.parameters))
    _, J = exact_problem(of.problem, zero, q, target).linearize_rows(zero)
    count = len(q) * len(of.sigma)  # Known distances stand behind them.
    return np.asarray((J[:count] @ of.basis).reshape(len(q), -1, of.basis.shape[1]))


def check_rows(of: IdentificationRows, visited: Visited) -> None:
    q, target = configurations(of.problem, visited)
    expected = rows_of_the_problem(of, q, target)
    # Rows in pixels are some thousand times as large as those in meters.
    size = max(1.0, 1e-6 * np.abs(expected).max())
    np.testing.assert_allclose(
        of.rows(q, target), expected, rtol=1e-10, atol=1e-9 * size
    )
    found = of.linearize(q, target)[0]
    np.testing.assert_allclose(found, expected, atol=1e-8 * size)


def check_pullback(of: IdentificationRows, visited: Visited) -> None:
    assert isinstance(of.measurement, CurvedModel)
    q, target = configurations(of.problem, visited)
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


@pytest.mark.parametrize("model", FREE)
def test_rows_are_those_of_the_problem(
    model: str, special_chain: Chain, framed: Setup, visited: Visited
) -> None:
    check_rows(framed_rows(special_chain, model, framed), visited)


@pytest.mark.parametrize("model", NAMED)
def test_rows_with_named_points_and_places(
    model: str, equipped_rows: Callable[..., IdentificationRows], visited: Visited
) -> None:
    check_rows(equipped_rows(model), visited)


@pytest.mark.parametrize("model", FREE)
def test_pullback_agrees_with_central_differences(
    model: str, special_chain: Chain, framed: Setup, visited: Visited
) -> None:
    check_pullback(framed_rows(special_chain, model, framed), visited)


@pytest.mark.parametrize("model", NAMED)
def test_pullback_with_named_points_and_places(
    model: str, equipped_rows: Callable[..., IdentificationRows], visited: Visited
) -> None:
    check_pullback(equipped_rows(model), visited)


def check_corrections(
    plain: IdentificationRows, of: IdentificationRows, visited: Visited
) -> None:
    assert plain.differentiable
    assert not of.differentiable
    q, target = configurations(of.problem, visited)
    zero = np.zeros(len(of.problem.parameters))
    _, J = exact_problem(of.problem, zero, q, target).linearize_rows(zero)
    corrections = of.problem.error.joint_corrections
    assert (np.abs(J[:, corrections]).max(axis=0) > 0.0).all()
    expected = rows_of_the_problem(of, q, target)
    np.testing.assert_allclose(of.rows(q, target), expected, rtol=1e-10, atol=1e-8)
    with pytest.raises(OptionError, match=r"joint correction .* no derivative"):
        of.linearize(q, target)


@pytest.mark.parametrize("model", FREE)
def test_joint_corrections_have_rows_but_no_curvature(
    model: str, special_chain: Chain, framed: Setup, visited: Visited
) -> None:
    plain = framed_rows(special_chain, model, framed)
    of = framed_rows(special_chain, model, framed, parameters=CORRECTED)
    check_corrections(plain, of, visited)


@pytest.mark.parametrize("model", NAMED)
def test_corrections_with_named_points_and_places(
    model: str, equipped_rows: Callable[..., IdentificationRows], visited: Visited
) -> None:
    plain, of = (equipped_rows(model, parameters=p) for p in (("dh",), CORRECTED))
    check_corrections(plain, of, visited)


def test_mixed_measurements_have_rows_but_no_curvature(
    equipped_rows: Callable[..., IdentificationRows], visited: Visited
) -> None:
    of = equipped_rows(MIXED)
    assert not of.differentiable
    q, target = configurations(of.problem, visited, 20)
    expected = rows_of_the_problem(of, q, target)
    np.testing.assert_allclose(of.rows(q, target), expected, rtol=1e-10, atol=1e-8)
    assert {name.partition(":")[0] for name in target} == set(MIXED.split("+"))
    with pytest.raises(OptionError, match=r"'position\+.*camera' has no derivative"):
        of.linearize(q, target)


def test_another_instrument_in_the_same_columns(
    framed: Setup, visited: Visited
) -> None:
    """The tip's position in the columns of a study with a ranger."""
    ranger = framed_rows(calib_pin.load_chain("space6"), "plane-distance", framed)
    q, _ = configurations(ranger.problem, visited)
    of = IdentificationRows(
        ranger.problem, ranger.basis, 2, Position(), np.full(3, 1.0)
    )
    rows, pullback = of.linearize(q, ("",) * len(q))
    _, J = ranger.problem.error.jacobian(q, np.zeros(len(of.problem.error.screws)))
    T = ranger.problem.error.poses(q, np.zeros(len(of.problem.error.screws)))
    expected = T[:, :3, :3] @ J[:, :3] @ ranger.basis[: J.shape[2]]
    np.testing.assert_allclose(rows, expected, atol=1e-9)
    assert pullback(rows).shape == q.shape
