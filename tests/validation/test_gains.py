"""The paired test of gains, PRESS against refits, and predicted variances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.evidence import Gain
from calib_pin.estimation.fit import fit
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.statistics.distributions import student_tail
from calib_pin.kinematics.spatial import Floats
from calib_pin.setup import FrameSetup, Setup
from calib_pin.validation.held_out import gains
from calib_pin.validation.model_errors import ModelErrors, predicted_variance

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
    found = gains("set", problem, [part(before, after)], label)
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
    label = np.arange(6)
    some = replace(problem, data=problem.data.weighted(weight))
    for g in gains("set", some, [part(before, after)], label):
        assert g.configurations == 5 and g.mean > 0.0 and g.ratio == pytest.approx(1.0)
    nothing = replace(problem, data=problem.data.weighted(np.zeros(6)))
    assert gains("set", nothing, [part(before, after)], label) == ()


def test_what_cannot_be_predicted_settles_it() -> None:
    problem = measured(4)
    finite, lost = np.full((4, 6), 1e-4), np.full((4, 6), 1e-4)
    lost[1] = np.inf
    label = np.arange(4)

    def first(before: Floats, after: Floats) -> Gain:
        return gains("set", problem, [part(before, after)], label)[0]

    assert first(finite, lost).worse == 0.0
    assert first(lost, finite).better == 0.0
    both = first(lost, lost)
    assert both.mean == 0.0 and both.better == both.worse == 0.5


NOISE = 5e-5


def test_predicted_variance_is_that_of_new_errors() -> None:
    """Sum of squares by its expectation over 10 fits of 10 configurations each."""
    problem = nominal_problem(calib_pin.load_chain("space6"), "position", SETUP)
    truth = calib_pin.draw_errors(problem.parameters, np.random.default_rng(0))
    ratios = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        train, new = (
            calib_pin.simulate(problem, truth, rng, count=count, noise=NOISE)
            for count in (10, 20)
        )
        fitted = fit(replace(problem, data=train), np.random.default_rng(0))
        there = replace(fitted.problem, data=new)
        variance = predicted_variance(fitted, there, fitted.theta)
        assert (variance > there.sigma**2).all()
        ratios.append(np.mean(there.errors(fitted.theta) ** 2) / np.mean(variance))
    # Errors of one fit share its 24 unknowns, so that a ratio scatters by 0.35.
    assert np.mean(ratios) == pytest.approx(1.0, abs=4 * 0.35 / np.sqrt(10))
