"""Rows of the identification matrix and their derivative by the configuration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.nominal import (
    jacobian_at,
    observable_configurations,
    unmeasured,
)
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import MEASUREMENT_MODELS
from calib_pin.observations import BlockKey, Indices
from calib_pin.planning.rows import IdentificationRows
from calib_pin.planning.workspace import Aims
from calib_pin.setup import PointSetup, Setup
from tests.shared import FRAMED, equipped_problem

MIXED = tuple(map(BlockKey, ("position", "plane-distance", "camera")))
NOISE = {"position": 2e-4, "orientation": 1e-3}


def make(problem: Problem, columns: int = 7) -> IdentificationRows:
    rng = np.random.default_rng(5)
    basis = rng.normal(size=(len(problem.parameters), columns))
    return IdentificationRows(problem, basis, 2, Aims.of(problem, problem.data.keys))


@pytest.fixture
def equipped_rows() -> Callable[..., IdentificationRows]:
    """On one chain: what a model adds knows nothing of the chain."""

    def rows(model: str | tuple[BlockKey, ...], **settings: Any) -> IdentificationRows:
        chain = calib_pin.load_chain("space6")
        return make(equipped_problem(chain, model, noise=NOISE, **settings), 40)

    return rows


def configurations(of: IdentificationRows, count: int = 4) -> tuple[Floats, Indices]:
    """Configurations for every aim, of which contacts are not closed."""
    problem, aims = of.problem, of.aims.each
    zero, rng = np.zeros(len(problem.parameters)), np.random.default_rng(2)
    if problem.only.measurement.declaration.contact:
        q = problem.chains.random_configurations(count * len(aims), rng)
    else:
        key = problem.only.key
        q = observable_configurations(problem, key, zero, count * len(aims), rng).q
    return q, np.arange(len(q)) % len(aims)


def rows_at(problem: Problem, aims: Aims, q: Floats, aim: Indices) -> Floats:
    """Rows of one configuration, target by target, shape (M, P)."""
    zero, rows = np.zeros(len(problem.parameters)), []
    for look in aims.looks:
        if look.of_aim[aim[0]] < 0:
            continue
        seen = look.seen(q, aim)[0] | (not look.at_once)
        names = [look.names[code] for code in look.targets(aim)[0][seen]]
        at = unmeasured(problem, look.term.key, np.repeat(q, len(names), axis=0), names)
        J = jacobian_at(problem, zero, [at])
        rows.append(J[: len(J) - len(problem.further)])
    return np.concatenate(rows)


def rows_of_the_problem(of: IdentificationRows, q: Floats, aim: Indices) -> Floats:
    """Their information, measurement by measurement, shape (N, m, m)."""
    at = ((of.problem, of.aims, q[[k]], aim[[k]]) for k in range(len(q)))
    rows = (rows_at(*each) @ of.basis for each in at)
    return np.array([U.T @ U for U in rows])


def information(rows: Floats) -> Floats:
    return np.asarray(np.swapaxes(rows, 1, 2) @ rows)


def check_rows(of: IdentificationRows) -> None:
    q, aim = configurations(of)
    expected = rows_of_the_problem(of, q, aim)
    # Images are reduced to as many rows by a factorization of them.
    tolerance = 1e-10 * np.abs(expected).max()
    found = of.rows(q, aim)
    assert found.shape[1] <= of.basis.shape[1]
    np.testing.assert_allclose(information(found), expected, atol=tolerance)
    if of.differentiable:
        found = of.linearize(q, aim)[0]
        np.testing.assert_allclose(information(found), expected, atol=tolerance)


def check_pullback(of: IdentificationRows) -> None:
    assert of.differentiable
    q, aim = configurations(of)
    rows, pullback = of.linearize(q, aim)
    by_rows = np.random.default_rng(0).normal(size=rows.shape)
    found = pullback(by_rows)
    expected = np.empty_like(q)
    step = 1e-6
    for k in range(q.shape[1]):
        shift = step * np.eye(q.shape[1])[k]
        ends = (of.problem.chains.follow(q + s * shift) for s in (1, -1))
        change = np.subtract(*(of.linearize(end, aim)[0] for end in ends))
        expected[:, k] = np.sum(by_rows * change, axis=(1, 2)) / (2 * step)
    assert np.abs(found - expected).max() < 1e-7 * np.abs(expected).max()


# Nothing is planned relative to another configuration.
@pytest.mark.parametrize(
    "model", [*sorted({*MEASUREMENT_MODELS} - {"relative-distance"}), MIXED]
)
def test_rows_and_their_slopes_are_those_of_the_problem(
    model: str | tuple[BlockKey, ...], equipped_rows: Callable[..., IdentificationRows]
) -> None:
    """On one chain: what a model adds knows nothing of the chain."""
    check_rows(equipped_rows(model))
    check_pullback(equipped_rows(model))


def test_chains_of_all_kinds(special_chain: Chain) -> None:
    of = make(nominal_problem(special_chain, "pose", replace(FRAMED, noise=NOISE)))
    check_rows(of)
    check_pullback(of)


@pytest.mark.parametrize("model", ["pose", "plane-distance"])
def test_joint_corrections_have_rows_but_no_slopes(
    model: str, equipped_rows: Callable[..., IdentificationRows]
) -> None:
    of = equipped_rows(model, parameters=("placement", "transmission", "compliance"))
    assert not of.differentiable
    check_rows(of)


def test_an_image_has_no_more_rows_than_unknowns() -> None:
    """Of 30 corners, 60 pixels: rows with the information of all of them."""
    corners = {
        f"c{k}": PointSetup((0.03 * (k % 6), 0.03 * (k // 6), 0.1)) for k in range(30)
    }
    chain = calib_pin.load_chain("space6")
    problem = equipped_problem(chain, "camera", targets=corners)
    of = make(problem, 40)
    q, aim = configurations(of)
    assert len(problem.parameters) > 40 and of.rows(q, aim).shape[1:] == (15, 40)
    check_rows(of)


def test_chains_share_the_columns_of_their_joints(tree: Chains) -> None:
    """Each arm moves with the torso, and not with the other arm."""
    keys = [BlockKey("pose", "left"), BlockKey("pose", "right")]
    of = make(nominal_problem(tree, keys, Setup()), 60)
    check_rows(of)
    check_pullback(of)
    q, aim = configurations(of)
    rows, pullback = of.linearize(q, aim)
    found = pullback(rows)
    names = tree.joints
    left, right = (
        [k for k, name in enumerate(names) if name.startswith(side)]
        for side in ("left", "right")
    )
    assert not found[aim == 0][:, right].any() and not found[aim == 1][:, left].any()
    assert found[:, names.index("torso")].all()
    # The finger of the left hand follows its wrist.
    assert not found[:, names.index("left_finger")].any()
