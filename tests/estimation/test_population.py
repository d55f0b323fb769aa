"""Costs of a whole population against those of its members one by one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, Literal

import numpy as np
import pytest

from calib_pin.compiled.blocks import BLOCK
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.many_rows import PopulationCost
from calib_pin.estimation.problem import Problem, RowByRow, reweighted
from calib_pin.io.urdf import load_chain
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import MEASUREMENT_MODELS
from calib_pin.measurement_models.position import Position
from calib_pin.observations import Observations
from calib_pin.setup import (
    CameraSetup,
    FrameSetup,
    Payload,
    PlaneSetup,
    PointSetup,
    Setup,
)
from calib_pin.simulation import exact_problem

Measured = Callable[..., Problem]

PRIOR = {"joint_2.*": 1e-3}
BENDING = ("placement", "compliance", "cross-compliance")
LOAD = {"load": Payload(2.0, (0.05, -0.1, 0.2))}


class Unbatched(Position):
    """A measurement model that no kernel knows."""

    batches = None  # type: ignore[assignment]


@dataclass(frozen=True)
class Bent:
    """Something learned."""

    space: Literal["joint", "tip"] = "joint"
    shift: Floats = field(default_factory=lambda: np.zeros(1))

    def __call__(self, q: Floats) -> Floats:
        return 0.01 * np.cos(q)

    def weight(self, q: Floats) -> Floats:
        return np.ones(len(q))


def members(problem: Problem, count: int) -> Floats:
    """Random parameters, the nominal ones among them."""
    shape = count, len(problem.parameters)
    theta = 0.02 * np.random.default_rng(1).normal(size=shape)
    theta[-1] = 0.0
    return np.asarray(theta)


def assert_costs(problem: Problem, theta: Floats, evaluator: str = "kernel") -> Floats:
    """The costs, which are those of the members."""
    costs = PopulationCost(problem)
    assert costs.evaluator == evaluator
    found = costs(theta)
    expected = [problem.cost(member) for member in theta]
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=0)
    return found


@pytest.mark.parametrize("model", MEASUREMENT_MODELS)
def test_every_model_and_kind_of_correction(
    model: str, measured: Measured, framed: Setup
) -> None:
    """Every member moves the joints in its own way, some of them far."""
    odd = sorted(MEASUREMENT_MODELS).index(model) % 2
    kinds = ["dh", "transmission"] if odd else ["placement", "compliance"]
    given: dict[str, Any] = {"payloads": framed.payloads}
    given["gear_ratios"] = framed.gear_ratios
    bare, problem = (
        measured(load_chain("space6"), model, kinds, 40, **given, prior=prior)
        for prior in ({}, PRIOR)
    )
    theta = members(problem, 4)
    corrected = problem.only.index[problem.only.error.joint_corrections]
    theta[1, corrected] *= 30.0
    found = assert_costs(problem, theta)
    rows = problem.further.residual(theta)
    assert rows.shape[1] > 4
    added = found - PopulationCost(bare)(theta)
    expected = 0.5 * np.sum(rows**2, axis=1)
    np.testing.assert_allclose(added, expected, rtol=0, atol=1e-9 * found.max())
    # The corrections do something.
    theta[:, corrected] = 0.0
    assert (np.abs(PopulationCost(problem)(theta) - found)[:-1] > 1.0).all()


@pytest.mark.parametrize("mount", ["hand", "world"])
def test_cameras_on_the_hand_and_beside_the_robot(mount: str) -> None:
    """The chain of one on the hand is passed from the base to the tool."""
    chain, rng = load_chain("space6"), np.random.default_rng(0)
    q = chain.random_configurations(1, rng) + 0.1 * rng.normal(size=(30, 6))
    seen = chain.poses(q[:1])[0] @ np.array([0.0, 0.0, 4.0, 1.0])
    led = (0.03, -0.02, 0.05) if mount == "world" else tuple(seen[:3])
    base = FrameSetup((0.1, -0.2, 4.0), (np.pi, 0.1, 0.2), estimate=True)
    setup = Setup(
        camera=CameraSetup(mount, focal=(900.0, 900.0), center=(640.0, 480.0)),
        base_frame=base if mount == "world" else FrameSetup(),
        targets={"led": PointSetup(led)},
    )
    problem = nominal_problem(chain, "camera", setup)
    zero = np.zeros(len(problem.parameters))
    rows = exact_problem(problem, zero, q, ("led",) * 30).data
    assert_costs(replace(problem, data=rows), 0.1 * members(problem, 4)[:3])


def test_what_no_kernel_knows_is_evaluated_in_a_loop(measured: Measured) -> None:
    """Models without a batch form, what was learned, and places that bend."""
    problem = measured(load_chain("space6"), "position", ["placement"], 40, prior=PRIOR)
    theta, term = members(problem, 3), problem.only
    plain = PopulationCost(problem)(theta)
    unbatched = problem.with_terms({term.key: replace(term, measurement=Unbatched())})
    found = assert_costs(unbatched, theta, "loop")
    np.testing.assert_allclose(found, plain, rtol=1e-10)
    learned = replace(term, error=replace(term.error, learned=Bent()))
    found = assert_costs(problem.with_terms({term.key: learned}), theta, "loop")
    assert np.abs(found - plain).min() > 1.0
    bending = measured(load_chain("space6"), "pose", BENDING, 20, payloads=LOAD)
    assert_costs(bending, members(bending, 2), "loop")


@pytest.mark.parametrize("model", ["pose", "camera"])
def test_the_number_of_threads_changes_no_bit(
    model: str, measured: Measured, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("calib_pin.estimation.many_rows.WORTHWHILE", 1)
    problem = measured(load_chain("space6"), model, ["placement"], 301)
    theta = members(problem, 7)
    one, *others = (PopulationCost(problem, k)(theta).tobytes() for k in (1, 2, 3))
    assert others == [one, one]


def test_a_member_costs_the_same_in_any_company(measured: Measured) -> None:
    problem = measured(load_chain("space6"), "pose", ["placement"], 50)
    theta = members(problem, 4)
    costs = PopulationCost(problem)
    together = costs(theta)
    for k in range(4):
        assert costs(theta[k : k + 1])[0] == together[k]
    np.testing.assert_array_equal(costs(theta[::-1]), together[::-1])
    assert costs(theta[:0]).shape == (0,)


def test_planes_in_any_order(measured: Measured) -> None:
    problem = measured(load_chain("space6"), "plane-distance", ["placement"], 400)
    names = problem.data.target
    assert sum(a != b for a, b in pairwise(names)) > 100
    assert list(names).count("wall") % BLOCK and names.count("floor") % BLOCK
    theta = members(problem, 3)
    expected = PopulationCost(problem)(theta)
    order = np.random.default_rng(2).permutation(400)
    for again in (order, np.argsort(names, kind="stable")):
        rows = Observations.of(problem.data.only.rows(again))
        found = PopulationCost(replace(problem, data=rows))(theta)
        np.testing.assert_allclose(found, expected, rtol=1e-10)
    # Of one that no row looks at the parameters stay.
    wall = np.flatnonzero(np.array(names) == "wall")
    assert_costs(replace(problem, data=problem.data.rows(wall)), theta)


@pytest.mark.parametrize("offset", [-1.0, 0.0])
def test_a_beam_along_the_plane(
    offset: float, urdf_of: Callable[..., str], chain_of: Callable[..., Chain]
) -> None:
    """The distance is infinite, or 0/0 in the plane: no exception, no warning."""
    chain = chain_of(urdf_of({"name": "j", "parent": "a", "child": "b"}))
    setup = Setup(
        parameters=("placement",),
        base_frame=FrameSetup(estimate=False),
        planes={"wall": PlaneSetup((1.0, 0.0, 0.0), offset)},
    )
    problem = nominal_problem(chain, "plane-distance", setup)
    rows = problem.data.only.rows(np.zeros(3, int))
    data = Observations.of(replace(rows, values=np.ones((3, 1))))
    problem = replace(problem, data=data)
    # The beam runs along z until the second member tilts it.
    tilted = problem.parameters.vector({"tool.frame.ry": 0.5, "j.placement.x": 0.1})
    found = PopulationCost(problem)(np.array([0.0 * tilted, tilted, 0.0 * tilted]))
    assert not np.isfinite(found[[0, 2]]).any()
    assert found[1] == pytest.approx(problem.cost(tilted), rel=1e-10)


@pytest.mark.parametrize("model", ["pose", "relative-distance"])
def test_very_many_measurements_that_bend_go_piece_by_piece(
    model: str, measured: Measured, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of the same residuals and normal equations, in the memory of one piece."""
    piece = 64
    count = 2 * piece + 11
    monkeypatch.setattr("calib_pin.estimation.problem.PIECE", piece)
    stated = {"payloads": LOAD, "prior": PRIOR}
    plain = measured(load_chain("space6"), model, BENDING, count, **stated)
    theta = 0.1 * members(plain, 2)[0]
    assert not plain.many
    # Neither other weights nor other references need more than that.
    weight = 1.0 + np.arange(count) % 3
    expected = [
        (few.errors(theta), few.cost(theta), *few.linearize(theta))
        for few in (plain, reweighted(plain, weight), plain.rebased(theta)[0])
    ]
    monkeypatch.setattr("calib_pin.estimation.problem.MANY", 1)
    pieces = replace(plain)
    (other,) = pieces._evaluators
    assert isinstance(other, RowByRow)
    assert pieces.many
    changed = (pieces, reweighted(pieces, weight), pieces.rebased(theta)[0])
    for many, (errors, cost, r, J) in zip(changed, expected, strict=True):
        np.testing.assert_array_equal(many.errors(theta), errors)
        assert many.cost(theta) == pytest.approx(cost, rel=1e-10)
        whole = np.column_stack([J, r])
        size = np.linalg.norm(whole, axis=0)
        size[size == 0.0] = 1.0
        reduced, slope = many.linearize(theta)
        assert len(reduced) < len(r)
        rows = np.column_stack([slope, reduced])
        products = (M.T @ M / np.outer(size, size) for M in (rows, whole))
        np.testing.assert_allclose(*products, rtol=0, atol=1e-11)
