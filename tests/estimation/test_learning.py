"""What a residual model is given to learn from, and what becomes of its correction."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal, Self

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.fit import fit_model, training_rows
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import MEASUREMENT_MODELS
from calib_pin.observations import Observations
from calib_pin.residual_models import RESIDUAL_MODELS, TrainingRows
from calib_pin.setup import FrameSetup, Setup
from calib_pin.validation.held_out import left_out
from calib_pin.validation.model_errors import fitted_errors
from calib_pin.validation.splits import Grouping, folds

Measured = Callable[..., Problem]

RELATIVE = "relative-distance"
SETUP = Setup(parameters=("joint-offset",), tool_frame=FrameSetup((0.05, 0.08, 0.1)))


def measured_rows(repeats: int = 1) -> tuple[Chain, Observations]:
    """Positions of `space6`; the readings of a configuration differ by noise."""
    chain = calib_pin.load_chain("space6")
    problem = nominal_problem(chain, "position", SETUP)
    rng = np.random.default_rng(1)
    truth = calib_pin.draw_errors(problem.parameters, rng)
    rows = calib_pin.simulate(
        problem, truth, rng, count=40, noise=5e-5, repeats=repeats
    )
    # Readings of one configuration need not stand side by side.
    return chain, Observations.of(rows.only.rows(rng.permutation(len(rows))))


KINDS = ["placement", "transmission"]


@pytest.mark.parametrize("space", ["joint", "tip"])
def test_derivatives_of_training_rows(
    space: str, special_chain: Chain, measured: Measured, framed: Setup
) -> None:
    geared = {"gear_ratios": framed.gear_ratios}
    check_training_rows(measured(special_chain, "pose", KINDS, 5, **geared), space)


@pytest.mark.parametrize("model", sorted({*MEASUREMENT_MODELS} - {"pose", RELATIVE}))
def test_derivatives_of_every_model(model: str, measured: Measured) -> None:
    """On one chain: what a model adds knows nothing of the chain."""
    space = ("joint", "tip")[sorted(MEASUREMENT_MODELS).index(model) % 2]
    chain = calib_pin.load_chain("space6")
    check_training_rows(measured(chain, model, KINDS, 5), space)


def check_training_rows(problem: Problem, space: str) -> None:
    rng = np.random.default_rng(4)
    theta = 0.02 * rng.normal(size=len(problem.parameters))
    error = problem.only.error
    directions = np.zeros((len(theta), 3))
    directions[: len(error.screws)] = rng.normal(size=(len(error.screws), 3))
    rows = training_rows(problem, theta, directions)
    assert rows.shifts == 3
    np.testing.assert_array_equal(rows.q, problem.data.q)
    np.testing.assert_array_equal(rows.groups, problem.data.groups())
    chain = error.chain
    np.testing.assert_array_equal(rows.revolute, chain.revolute)
    call = rows.by_joint if space == "joint" else rows.by_tip
    size = len(chain.joints) if space == "joint" else 6
    correction, shift = np.zeros((5, size)), 0.01 * rng.normal(size=3)
    if space == "joint":
        # Twists of the tip do not add up; their derivative is that at zero.
        correction = 0.02 * rng.normal(size=(5, size))
    at = call(correction, shift)
    step = 1e-6

    def difference(by_correction: Floats, by_shift: Floats) -> Floats:
        ahead, behind = (
            call(correction + s * by_correction, shift + s * by_shift).residual
            for s in (step, -step)
        )
        return np.asarray((ahead - behind) / (2.0 * step))

    still = np.zeros_like(correction), np.zeros(3)
    steps = [(np.tile(row, (5, 1)), still[1]) for row in np.eye(size)]
    steps += [(still[0], row) for row in np.eye(3)]
    found = np.stack([difference(*step) for step in steps], axis=2)
    expected = np.concatenate([at.by_correction, at.by_shift], axis=2)
    largest = np.abs(expected).max(axis=(0, 1)) + np.abs(expected).max()
    assert (np.abs(found - expected) <= 2e-7 * largest).all()
    # Nothing learned leaves the residual of the problem.
    plain = call(*still).residual
    expected = problem.blocks[0].table(problem.errors(theta) / problem.sigma)
    np.testing.assert_allclose(plain, expected, rtol=0, atol=1e-9)


@dataclass(frozen=True)
class Steps:
    """A correction of all joints by one number, whoever is left out."""

    size: float
    shift: Floats
    memory: Memory
    space: Literal["joint", "tip"] = "joint"

    @property
    def region(self) -> Self:
        return self

    def weight(self, q: Floats) -> Floats:
        return np.ones(len(q))

    def __call__(self, q: Floats) -> Floats:
        return np.full_like(q, self.size)

    def left_out(
        self, rows: TrainingRows, masks: list[Any], rng: np.random.Generator
    ) -> list[Self]:
        self.memory.rows.append(rows)
        self.memory.masks.append(masks)
        return [self for _ in masks]


class Memory:
    """A residual model that remembers what it was given."""

    def __init__(self) -> None:
        self.rows: list[TrainingRows] = []
        self.masks: list[list[Any]] = []

    def __call__(
        self, rows: TrainingRows, rng: np.random.Generator, *, progress: Any = None
    ) -> Steps:
        self.rows.append(rows)
        return Steps(0.001, np.zeros(rows.shifts), self)


@pytest.fixture
def memory(monkeypatch: pytest.MonkeyPatch) -> Memory:
    result = Memory()
    monkeypatch.setitem(RESIDUAL_MODELS, "memory", result)  # type: ignore[arg-type]
    return result


def test_what_was_learned_is_on_top_of_the_fit(memory: Memory) -> None:
    chain, rows = measured_rows()
    plain = fit_model(chain, rows, SETUP, 3)
    learned = fit_model(chain, rows, replace(SETUP, learned="memory"), 3)
    np.testing.assert_array_equal(learned.fit.theta, plain.fit.theta)
    assert learned.fit.problem.only.error.learned is None
    # It learned from what the fit has left, about the fitted frames.
    (given,) = memory.rows
    # Not those that turn the tool, which no position shows.
    assert given.shifts == learned.fit.rank
    zero = np.zeros((len(rows), 6)), np.zeros(given.shifts)
    sigma = plain.fit.problem.sigma
    left = plain.fit.problem.errors(plain.fit.theta) / sigma
    table = plain.fit.problem.blocks[0].table
    np.testing.assert_allclose(
        given.by_joint(*zero).residual, table(left), rtol=0, atol=1e-8
    )
    # And it predicts.
    corrected = given.by_joint(np.full((len(rows), 6), 0.001), zero[1]).residual
    found = fitted_errors(learned, rows)
    before, after = found.before, found.after
    np.testing.assert_allclose(after / table(sigma), corrected, rtol=0, atol=1e-8)
    np.testing.assert_array_equal(before, fitted_errors(plain, rows).before)


def test_left_out_measurements_have_no_part(memory: Memory) -> None:
    """The correction is asked once, and no part of the measurements is fitted."""
    chain, rows = measured_rows(repeats=2)
    model = fit_model(chain, rows, replace(SETUP, learned="memory"), 7)
    masks = folds(Grouping.of(rows, SETUP), model.fit, 0)
    parts = left_out(model, masks, 7)
    (given, asked), (found,) = memory.rows, memory.masks
    np.testing.assert_array_equal(given.q, asked.q)
    np.testing.assert_array_equal(found, masks)
    whole = fitted_errors(model, rows)
    for part, mask in zip(parts, masks, strict=True):
        assert part is not None
        np.testing.assert_array_equal(part.positions, np.flatnonzero(mask))
        # The geometry stands on that of the fit: what is learned is its own matter.
        np.testing.assert_allclose(part.after, whole.after[mask], rtol=0, atol=1e-8)
        # Base and tool of the nominal robot are those of the others.
        assert np.abs(part.before).mean() > np.abs(whole.before[mask]).mean()
