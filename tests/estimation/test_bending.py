"""Models whose places bend row by row, where compiled kernels would be used."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calib_pin.estimation.evaluators import InPieces, RowByRow, compiled
from calib_pin.estimation.population import PopulationCost
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.segments import Segments
from calib_pin.estimation.variants import reweighted
from calib_pin.io.urdf import load_chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import MEASUREMENT_MODELS
from calib_pin.parameterizations.error_model import flexures
from calib_pin.setup import Setup

Measured = Callable[..., Problem]
KINDS = ["placement", "compliance", "cross-compliance"]
PIECE = 64


@pytest.fixture
def bending(
    measured: Measured, framed: Setup, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., Problem]:
    """A problem in so few measurements; many are taken as very many."""
    monkeypatch.setattr("calib_pin.estimation.evaluators.PIECE", PIECE)

    def make(model: str, count: int, *, many: bool = False) -> Problem:
        stated = {"payloads": framed.payloads, "prior": {"joint_2.*": 1e-3}}
        problem = measured(load_chain("space6"), model, KINDS, count, **stated)
        entries = len(problem.sigma) * len(problem.parameters)
        limit = entries if many else 2 * entries
        monkeypatch.setattr("calib_pin.estimation.problem.MANY", limit)
        return replace(problem)

    return make


def some(problem: Problem) -> Floats:
    rng = np.random.default_rng(1)
    sizes = np.where(problem.parameters.nuisance, 0.01, problem.parameters.scales)
    return np.asarray(sizes * rng.normal(size=len(sizes)))


@pytest.mark.parametrize("model", MEASUREMENT_MODELS)
def test_populations_are_evaluated_one_by_one(
    model: str, bending: Callable[..., Problem]
) -> None:
    problem = bending(model, 20)
    costs, theta = PopulationCost(problem), some(problem)
    assert costs.evaluator == "loop"
    bent = problem.only.index[flexures(problem.only.error)]
    still = theta.copy()
    still[bent] = 0.0
    found = costs(np.array([theta, still]))
    assert found[0] == problem.cost(theta) and found[1] != found[0]
    with pytest.raises(ValueError, match="cannot bend"):
        Segments.of(problem.only.error)


@pytest.mark.parametrize("model", ["position", "pose", "relative-distance"])
def test_very_many_measurements_go_piece_by_piece(
    model: str, bending: Callable[..., Problem]
) -> None:
    """Of the same residuals and normal equations, in the memory of one piece."""
    count = 2 * PIECE + 11
    plain = bending(model, count)
    (one,), theta = plain.evaluators, some(plain)
    assert isinstance(one, RowByRow)
    # Neither other weights nor other references need more than that.
    weight = 1.0 + np.arange(count) % 3
    expected = [
        (few.errors(theta), few.cost(theta), *few.linearize(theta))
        for few in (plain, reweighted(plain, weight), plain.rebased(theta)[0])
    ]
    pieces = bending(model, count, many=True)
    (other,) = pieces.evaluators
    assert (
        isinstance(other, InPieces) and pieces.many and not compiled(pieces.evaluators)
    )
    for many, (errors, cost, r, J) in zip(
        (pieces, reweighted(pieces, weight), pieces.rebased(theta)[0]),
        expected,
        strict=True,
    ):
        np.testing.assert_array_equal(many.errors(theta), errors)
        assert many.cost(theta) == pytest.approx(cost, rel=1e-13)
        for reduced, slope in (many.linearize(theta), many.factorize(theta)):
            assert len(reduced) < len(r)
            rows, whole = np.column_stack([slope, reduced]), np.column_stack([J, r])
            size = np.linalg.norm(whole, axis=0)
            size[size == 0.0] = 1.0
            products = (M.T @ M / np.outer(size, size) for M in (rows, whole))
            np.testing.assert_allclose(*products, rtol=0, atol=1e-11)
