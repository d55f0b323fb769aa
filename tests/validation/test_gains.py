"""The paired test: its numbers, and its probabilities where there is no gain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.evidence import Gain
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.statistics.distributions import student_tail
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.side_by_side import concatenate
from calib_pin.setup import FrameSetup, Setup
from calib_pin.validation.gains import gains
from calib_pin.validation.model_errors import ModelErrors

SETUP = Setup(parameters=("joint-offset",), tool_frame=FrameSetup((0.05, 0.08, 0.1)))


def measured(count: int, model: str = "pose") -> Problem:
    problem = nominal_problem(calib_pin.load_chain("space6"), model, SETUP)
    rows = calib_pin.simulate(
        problem,
        np.zeros(len(problem.parameters)),
        np.random.default_rng(0),
        count=count,
        noise=1e-4,
    )
    return replace(problem, data=rows)


def part(before: Floats, after: Floats, variance: float = 1e-8) -> ModelErrors:
    positions = np.arange(len(before))
    return ModelErrors(positions, before, after, np.full(before.shape, variance))


def test_numbers_of_a_gain() -> None:
    problem = measured(8)
    rng = np.random.default_rng(1)
    before, after = 3e-4 * rng.normal(size=(8, 6)), 2e-4 * rng.normal(size=(8, 6))
    label = np.array([0, 0, 1, 2, 2, 2, 3, 4])
    found = gains("set", problem, problem.data, [part(before, after)], label)
    assert [(g.method, g.quantity) for g in found] == [
        ("set", "all"),
        ("set", "position"),
        ("set", "orientation"),
    ]
    _, position, _ = found
    sizes = np.linalg.norm(before[:, :3], axis=1) - np.linalg.norm(after[:, :3], axis=1)
    means = np.array([sizes[label == k].mean() for k in range(5)])
    error = means.std(ddof=1) / np.sqrt(5)
    assert position.configurations == 5
    assert position.mean == pytest.approx(means.mean())
    assert position.deviation == pytest.approx(error)
    assert position.better == pytest.approx(student_tail(means.mean() / error, 4))
    assert position.better + position.worse == pytest.approx(1.0)
    assert position.ratio == pytest.approx(np.sqrt(np.mean(after[:, :3] ** 2) / 1e-8))


def test_rows_that_are_set_aside_do_not_count() -> None:
    problem = measured(6)
    before, after = np.full((6, 6), 2e-4), np.full((6, 6), 1e-4)
    after[2] = 1.0
    weight = np.array([1.0, 1.0, 0.0, 1.0, 1.0, 1.0])
    rows = replace(problem.data, weight=weight)
    label = np.arange(6)
    for g in gains("set", problem, rows, [part(before, after)], label):
        assert g.configurations == 5 and g.mean > 0.0 and g.ratio == pytest.approx(1.0)
    nothing = replace(rows, weight=np.zeros(6))
    assert gains("set", problem, nothing, [part(before, after)], label) == ()


def test_what_cannot_be_predicted_settles_it() -> None:
    problem = measured(4)
    finite, lost = np.full((4, 6), 1e-4), np.full((4, 6), 1e-4)
    lost[1] = np.inf
    label = np.arange(4)

    def first(before: Floats, after: Floats) -> Gain:
        return gains("set", problem, problem.data, [part(before, after)], label)[0]

    assert first(finite, lost).worse == 0.0
    assert first(lost, finite).better == 0.0
    both = first(lost, lost)
    assert both.mean == 0.0 and both.better == both.worse == 0.5


def test_rows_of_a_mix_count_by_what_they_have() -> None:
    poses, points = measured(5).data, measured(7, "position").data
    mixed = concatenate([points, poses])
    setup = replace(SETUP, tool_frame=FrameSetup((0.05, 0.08, 0.1)))
    problem = nominal_problem(calib_pin.load_chain("space6"), mixed.model, setup)
    problem = replace(problem, data=mixed)
    errors = np.where(np.isfinite(problem.sigma), 1e-4, np.nan)
    found = gains("set", problem, mixed, [part(2.0 * errors, errors)], np.arange(12))
    counts = {g.quantity: g.configurations for g in found}
    assert counts["all"] == 12 and sorted(counts.values()) == [5, 5, 7, 12]
    assert all(g.mean > 0.0 and g.ratio == pytest.approx(1.0) for g in found)


def test_probabilities_without_a_gain_are_uniform() -> None:
    problem = measured(20)
    rng = np.random.default_rng(2)
    found = []
    for _ in range(400):
        before, after = 1e-4 * rng.normal(size=(2, 20, 6))
        label = np.arange(20)
        found.append(gains("set", problem, problem.data, [part(before, after)], label))
    better = np.array([every[0].better for every in found])
    for level in (0.05, 0.2, 0.5):
        # Four standard deviations of a binomial of 400.
        chance = 4.0 * np.sqrt(level * (1.0 - level) / 400)
        assert abs(np.mean(better < level) - level) < chance
