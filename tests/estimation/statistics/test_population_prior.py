"""Mean and spread of a population, of which each robot shows a part."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib_pin.estimation.statistics.population_prior import (
    Cause,
    Explanation,
    RobotEvidence,
    explained,
    prior_of_type,
)
from calib_pin.kinematics.spatial import Floats
from calib_pin.setup.population import JointType, RobotType

TYPE = RobotType("arm", (JointType("a", (0.0, 0.0, 1.0), ()),))
NAMES = tuple(f"j{k // 3}.placement.{'xyz'[k % 3]}" for k in range(9))
SCALES = np.array([1e-3] * 6 + [2e-3] * 3)
MEAN = np.array([1.0, -0.5, 0.0, 2.0, 0.0, 0.3, -1.0, 0.0, 0.7])
SPREAD = np.array([0.1, 0.3, 0.2, 0.5, 0.1, 0.4, 0.2, 0.3, 0.2])
HIDDEN = 7
"""An error that no robot shows; and of the first two only their sum shows."""


def equations(rng: np.random.Generator, noise: float = 0.1) -> Floats:
    """What the measurements of a robot see, fewer rows than errors."""
    W = rng.normal(size=(6, len(NAMES))) / noise
    W[:, 1] = W[:, 0]
    W[:, HIDDEN] = 0.0
    return W


def evidence(theta: Floats, W: Floats, rng: np.random.Generator) -> RobotEvidence:
    """That of a robot with some errors, in scales."""
    values = W @ theta + rng.normal(size=len(W))
    units = ("m",) * len(NAMES)
    return RobotEvidence(TYPE, NAMES, units, SCALES, W, values, {"position": 1e-4})


def robots(count: int, seed: int = 0) -> list[RobotEvidence]:
    """Robots of the type."""
    rng = np.random.default_rng(seed)
    return [
        evidence(MEAN + SPREAD * rng.normal(size=len(NAMES)), equations(rng), rng)
        for _ in range(count)
    ]


def test_mean_and_spread_are_recovered() -> None:
    """Of 120 robots."""
    prior = prior_of_type(robots(120))
    assert prior.robots == 120 and prior.noise == {"position": 1e-4}
    mean, sigma, spread, known_from = np.transpose(
        [(p.mean, p.sigma, p.spread, p.robots) for p in prior.parameters]
    )
    mean, sigma, spread = mean / SCALES, sigma / SCALES, spread / SCALES
    free = np.array([2, 3, 4, 5, 6, 8])
    z = (mean - MEAN)[free] / sigma[free]
    assert np.abs(z).max() < 3.5 and np.abs(sigma[free]).max() < 0.1
    # The relative deviation of a variance of n normal values is sqrt(2 / n).
    error = 2.0 * np.log(spread / SPREAD)[free] / np.sqrt(2 / known_from[free])
    assert np.abs(error).max() < 3.5
    assert (known_from[free] > 30).all() and (known_from <= 300).all()
    # Of two a sum is known well, and its terms are not.
    assert abs(mean[:2].sum() - MEAN[:2].sum()) < 3.5 * 0.05
    assert sigma[0] > 0.5
    assert np.sum(spread[:2] ** 2) == pytest.approx(np.sum(SPREAD[:2] ** 2), rel=0.3)
    # What no robot shows keeps the mean zero and the spread of all errors together.
    assert abs(mean[HIDDEN]) < 1e-12 and sigma[HIDDEN] == pytest.approx(1.0)
    assert abs(known_from[HIDDEN]) < 1e-9
    assert spread.min() < spread[HIDDEN] < spread.max()


COUNT = 24


def innovations(seed: int, sizes, jump=0.0) -> Explanation:
    """Innovations by a prior, two causes of true sizes, and a jump of one effect."""
    rng = np.random.default_rng(seed)
    half = 0.3 * rng.normal(size=(COUNT, 10))
    E = rng.normal(size=(COUNT, 30))
    direction = np.random.default_rng(7).normal(size=(COUNT, 1))
    values = (
        half @ rng.normal(size=10)
        + sizes[0] * E @ rng.normal(size=30)
        + sizes[1] * rng.normal(size=COUNT)
        + jump * direction[:, 0]
    )
    causes = (Cause("drift", E, 0.1, 2.0), Cause("noise", np.eye(COUNT), 1.0, 50.0))
    return Explanation(values, half @ half.T, causes)


def jump_of(sizes=(0.3, 30.0)) -> Cause:
    direction = np.random.default_rng(7).normal(size=(COUNT, 1))
    return Cause("jump", direction, sizes=np.geomspace(*sizes, 12))


def test_the_likeliest_sizes_are_a_maximum() -> None:
    """Of the likelihood with what was expected, by differences."""
    first = innovations(3, (0.4, 1.2))
    found, told = first.fitted()
    assert 2.0 < sum(told) < COUNT and min(told) > 0.0

    def height(k: int, factor: float) -> float:
        causes = list(found.causes)
        causes[k] = replace(causes[k], size=factor * causes[k].size)
        there = replace(found, causes=tuple(causes))
        return there.likelihood + first.expected(there)

    for k in (0, 1):
        best = height(k, 1.0)
        assert height(k, 1.05) < best and height(k, 0.95) < best
    # A few effects tell the one, beside two that expected a quarter of it.
    assert 0.2 < found.causes[0].size < 0.8
    assert found.causes[1].size == pytest.approx(1.2, rel=0.4)


def test_stated_sizes_stay_and_others_have_a_limit() -> None:
    first = innovations(0, (3.0, 1.0))
    drift, noise = first.causes
    fixed = replace(first, causes=(replace(drift, worth=np.inf), noise))
    assert fixed.fitted()[0].causes[0].size == drift.size
    free = first.fitted()[0].causes[0].size
    bounded = replace(first, causes=(replace(drift, most=0.5 * free), noise))
    assert bounded.fitted()[0].causes[0].size == pytest.approx(0.5 * free)


def test_effects_are_those_of_a_linear_normal_model() -> None:
    first = innovations(1, (0.1, 1.0), jump=5.0)
    cause = replace(jump_of(), size=4.0)
    both = replace(first, causes=(*first.causes, cause))
    value, covariance = both.effects(cause)
    inverse = np.linalg.inv(first.covariance)
    E = cause.effects
    information = E.T @ inverse @ E + 1.0 / 4.0**2
    assert covariance == pytest.approx(1.0 / information)
    assert value == pytest.approx(E.T @ inverse @ first.values / information[0, 0])
    assert value[0] == pytest.approx(5.0, abs=4.0 * covariance[0, 0] ** 0.5)


def test_a_jump_is_told_and_none_is_invented() -> None:
    for jump, count in ((6.0, 1), (0.0, 0)):
        causes = [innovations(k, (0.1, 1.0), jump) for k in range(3)]
        told = [len(explained(one, [jump_of()], 50.0, 2)[1]) for one in causes]
        assert told == [count] * 3


def test_the_cause_that_explains_it_wins() -> None:
    """A wide one that holds the narrow one has less evidence, and explains as much."""
    wide = np.column_stack([jump_of().effects, np.eye(COUNT)[:, :5]])
    others = [Cause("wide", wide, sizes=jump_of().sizes), jump_of()]
    first = innovations(2, (0.1, 1.0), jump=6.0)
    found, sparse, evidence = explained(first, others, 50.0, 2)
    assert [cause.name for cause in sparse] == ["jump"] and evidence > np.log(50.0)
    assert found.causes[0].size < 0.4
    without = found.without({"jump"})
    assert without.misfit(wide) <= without.misfit(sparse[0].effects) < without.square


def test_a_cause_that_others_have_made_needless_is_dropped() -> None:
    """The sum of two explains most at first."""
    E = np.random.default_rng(7).normal(size=(COUNT, 3)) * [9.0, 7.0, 4.0]
    causes = [
        Cause(name, effects[:, None], sizes=np.geomspace(0.01, 3.0, 12))
        for name, effects in (("all", E.sum(1)), ("one", E[:, 0]), ("two", E[:, 1]))
    ]
    first = innovations(2, (0.1, 1.0))
    drift, noise = first.causes
    first = replace(
        first,
        values=first.values + E[:, :2].sum(1),
        causes=(replace(drift, worth=np.inf), noise),
    )
    (best,) = explained(first, causes, 50.0, 1)[1]
    assert best.name == "all"
    _, sparse, _ = explained(first, causes, 50.0, 4)
    assert {cause.name for cause in sparse} == {"one", "two"}
