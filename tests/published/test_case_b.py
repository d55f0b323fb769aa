"""Aoyagi et al. 2010: a seven-joint arm, a laser tracker, a network, chosen points.

The nominal table and the results of the publication are lost; `pa10` has the public
lengths, and the hidden errors are those that `aoyagi2010_study` draws.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from studies.aoyagi2010_study import (
    COMPLIANCE,
    MODELS,
    RANDOM,
    Case,
    Settings,
    genetic_set,
    noise_floor,
    observability,
    robot,
    study,
    truth,
)

SMALL = Settings(counts=(1000,))


@pytest.fixture(scope="module")
def case() -> Case:
    """One robot measured at random points."""
    return study(SMALL, {}, seed=0)[1000][RANDOM]


@pytest.mark.slow
def test_geometry_alone_stalls(case: Case) -> None:
    assert 1e-4 < case.mean("geometric") < 0.5 * case.mean("nominal")


@pytest.mark.slow
def test_the_network_comes_near_the_noise_floor(case: Case) -> None:
    assert case.mean("network") < case.mean("geometric") / 5.0
    assert case.mean("network") < 3.0 * case.floor


@pytest.mark.slow
def test_the_right_structure_reaches_the_noise_floor(case: Case) -> None:
    """The mean error of a fit differs from the floor by chance."""
    assert abs(case.mean("structure") - case.floor) < 3.0 * case.spread
    assert case.mean("structure") < 1.25 * case.floor
    assert 0.05 < case.spread / case.floor < 0.2
    # 31 of placements and frames, 35 of gears, 5 of compliance: gravity exerts no
    # torque on the first axis, which is vertical, nor on the last, in balance.
    assert case.rank == 71


def test_the_hidden_errors_are_those_of_the_reference() -> None:
    problem, theta = truth(SMALL, np.random.default_rng(0))
    values = dict(zip(problem.parameters.names, theta, strict=True))
    for joint, compliance in zip(robot().joints, COMPLIANCE, strict=True):
        for names, largest in (("x y z", 2e-3), ("rx ry rz", 3e-3)):
            found = [abs(values[f"{joint}.placement.{name}"]) for name in names.split()]
            assert min(found) > 0.0 and max(found) <= largest
        for k, amplitude in ((1, 3e-4), (2, 1e-4)):
            sine, cosine = (
                values[f"{joint}.transmission.{w}{k}"] for w in ("sin", "cos")
            )
            assert np.hypot(sine, cosine) == pytest.approx(amplitude, rel=1e-12)
        assert values[f"{joint}.compliance.k"] == compliance
    others = [n for n in values if ".gain" in n or "frame" in n]
    assert len(others) == 7 + 12 and not any(values[name] for name in others)


@pytest.mark.slow
def test_the_noise_floor_is_the_mean_error_of_many_fits() -> None:
    chain, rng = robot(), np.random.default_rng(1)
    problem, theta = truth(SMALL, rng)
    q, unseen = (chain.random_configurations(n, rng) for n in (100, 200))
    true = problem.only.error.poses(unseen, problem.only.values(theta)[0])[:, :3, 3]
    means, floors = [], []
    for _ in range(12):
        rows = calib_pin.simulate(problem, theta, rng, q=q, noise=SMALL.noise)
        fitted = calib_pin.calibrate(chain, rows, MODELS["structure"], validate=False)
        found = fitted.model.of().poses(unseen)[:, :3, 3]
        means.append(np.linalg.norm(found - true, axis=1).mean())
        floors.append(noise_floor(fitted, unseen))
    floor, spread = np.mean(floors, axis=0)
    assert abs(np.mean(means) - floor) < 3.0 * spread / np.sqrt(len(means))
    assert 0.5 < np.std(means) / spread < 1.6


@pytest.mark.slow
def test_a_genetic_selection_is_better_than_random_points() -> None:
    settings = replace(SMALL, candidates=300)
    found = genetic_set(settings, 40)
    assert found.q.shape == (40, 7)
    chain, rng = robot(), np.random.default_rng(0)
    drawn = [chain.random_configurations(40, rng) for _ in range(25)]
    random = [observability(settings, q) for q in drawn]
    assert observability(settings, found.q) > max(random)
    assert np.median(random) == pytest.approx(found.median, rel=0.05)
