"""Costs of a whole population against those of its members one by one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Literal

import numpy as np
import pytest

from calib_pin.compiled.blocks import BLOCK
from calib_pin.estimation.configurations import asked, named_targets
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.population import PopulationCost
from calib_pin.estimation.problem import Problem
from calib_pin.io.urdf import load_chain
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import MEASUREMENT_MODELS
from calib_pin.measurement_models.position import Position
from calib_pin.observations import BlockKey, Measurements, Observations
from calib_pin.setup import DistanceSetup, FrameSetup, PlaneSetup, Setup

Measured = Callable[..., Problem]

SEVERAL = ("pose", "fixed-point", "relative-distance", "camera")


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


@pytest.mark.parametrize("prior", [{}, {"joint_2.*": 1e-3, "*.dh.*": 5e-3}])
@pytest.mark.parametrize("model", MEASUREMENT_MODELS)
def test_costs_of_members_with_priors(
    model: str, prior: dict[str, float], measured: Measured
) -> None:
    chain = load_chain("space6")
    problem = measured(chain, model, ["dh"], 300, prior=prior)
    theta = members(problem, 5)
    costs = PopulationCost(problem)
    assert costs.evaluator == "kernel"
    found = costs(theta)
    expected = [problem.cost(member) for member in theta]
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=0)
    # What the priors add.
    bare = PopulationCost(measured(chain, model, ["dh"], 300))(theta)
    rows = problem.further.residual(theta)
    assert rows.shape == (5, 24 if prior else 0)
    added = 0.5 * np.sum(rows**2, axis=1)
    np.testing.assert_allclose(found - bare, added, rtol=0, atol=1e-11 * found.max())


def test_a_model_without_a_batch_form_is_evaluated_in_a_loop(
    measured: Measured,
) -> None:
    prior = {"*.placement.*": 1e-3}
    problem = measured(load_chain("space6"), "position", ["placement"], 40, prior=prior)
    theta = members(problem, 3)
    unbatched = replace(problem.only, measurement=Unbatched())
    plain = PopulationCost(problem.with_parts({unbatched.key: unbatched}))
    assert plain.evaluator == "loop"
    compiled = PopulationCost(problem)
    np.testing.assert_allclose(plain(theta), compiled(theta), rtol=1e-12, atol=0)


def test_known_distances_cost_as_well(measured: Measured) -> None:
    chain, known = load_chain("space6"), DistanceSetup(("left/0", "left/1"), 0.7, 1e-3)
    bare, told = (
        measured(chain, "fixed-point", ["dh"], 30, distances=distances)
        for distances in ((), (known,))
    )
    theta = members(told, 4)
    expected = [told.cost(member) for member in theta]
    found = PopulationCost(told)(theta)
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=0)
    a, b = (told.setup.sockets[name].xyz for name in known.between)
    between = np.array(b) - a + (theta[:, -3:] - theta[:, -6:-3])
    added = 0.5 * ((np.linalg.norm(between, axis=1) - 0.7) / 1e-3) ** 2
    np.testing.assert_allclose(
        found - PopulationCost(bare)(theta), added, rtol=1e-9, atol=1e-9 * found.max()
    )


@pytest.mark.parametrize(
    "kinds", [["transmission"], ["placement", "compliance"]], ids=lambda k: k[-1]
)
@pytest.mark.parametrize("model", MEASUREMENT_MODELS)
def test_joint_corrections(
    model: str, kinds: list[str], measured: Measured, framed: Setup
) -> None:
    """Every member moves the joints in its own way, some of them far."""
    problem = measured(
        load_chain("space6"),
        model,
        kinds,
        40,
        payloads=framed.payloads,
        gear_ratios=framed.gear_ratios,
        prior={"joint_2.*": 1e-3},
    )
    theta = members(problem, 4)
    corrected = problem.only.index[problem.only.error.joint_corrections]
    theta[1, corrected] *= 30.0
    costs = PopulationCost(problem)
    assert costs.evaluator == "kernel"
    expected = [problem.cost(member) for member in theta]
    np.testing.assert_allclose(costs(theta), expected, rtol=1e-12, atol=0)
    # The corrections do something.
    bare = theta.copy()
    bare[:, corrected] = 0.0
    assert (np.abs(costs(bare) - expected)[:-1] > 1.0).all()


@pytest.mark.parametrize("mount", ["hand", "world"])
def test_models_side_by_side(
    mount: Literal["hand", "world"],
    equipped: Setup,
    equipped_problem: Callable[..., Problem],
) -> None:
    """Blocks with frames of their own, starts of their own, and a known distance."""
    assert equipped.camera is not None
    problem = equipped_problem(
        load_chain("space6"),
        [BlockKey(model) for model in SEVERAL],
        camera=replace(equipped.camera, mount=mount),
        parameters=("placement", "transmission"),
    )
    zero, rng, blocks = np.zeros(len(problem.parameters)), np.random.default_rng(5), []
    for key in problem.parts:
        names = named_targets(problem, key)
        q = problem.chains.random_configurations(20 * len(names), rng)
        at = asked(problem, key, q, names * 20)
        # Points behind the camera have no pixel.
        seen = np.isfinite(problem.predict(zero, at)).all(axis=1)
        assert seen.mean() > 0.3
        nothing = Measurements(
            joints=problem.chains.joints,
            q=q,
            values=np.zeros((len(q), problem.parts[key].measurement.width)),
            target=at.target,
            conditions=at.conditions,
            start=at.start,
            **key._asdict(),
        )
        blocks.append(nothing.rows(seen))
    problem = replace(problem, data=Observations(tuple(blocks)))
    theta = 0.1 * members(problem, 5)
    costs = PopulationCost(problem)
    assert costs.evaluator == "kernel"
    expected = [problem.cost(member) for member in theta]
    np.testing.assert_allclose(costs(theta), expected, rtol=1e-11, atol=0)


def test_what_was_learned_is_evaluated_in_a_loop(measured: Measured) -> None:
    problem = measured(load_chain("space6"), "position", ["placement"], 40)
    theta = members(problem, 3)
    part = problem.only
    learned = replace(part, error=replace(part.error, learned=Bent()))
    bent = problem.with_parts({part.key: learned})
    costs = PopulationCost(bent)
    assert costs.evaluator == "loop"
    found = costs(theta)
    np.testing.assert_array_equal(found, [bent.cost(member) for member in theta])
    assert np.abs(found - PopulationCost(problem)(theta)).min() > 1.0


@pytest.mark.parametrize("model", MEASUREMENT_MODELS)
def test_the_number_of_threads_changes_no_bit(
    model: str, measured: Measured, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("calib_pin.estimation.population.WORTHWHILE", 1)
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
        other = replace(problem, data=rows)
        np.testing.assert_allclose(PopulationCost(other)(theta), expected, rtol=1e-12)


def test_a_plane_that_no_row_looks_at(measured: Measured) -> None:
    problem = measured(load_chain("space6"), "plane-distance", ["placement"], 60)
    wall = np.flatnonzero(np.array(problem.data.target) == "wall")
    # Both planes stay in the model, with parameters.
    problem = replace(problem, data=problem.data.rows(wall))
    theta = members(problem, 3)
    expected = [problem.cost(member) for member in theta]
    found = PopulationCost(problem)(theta)
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=0)


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
    assert found[1] == pytest.approx(problem.cost(tilted), rel=1e-12)
