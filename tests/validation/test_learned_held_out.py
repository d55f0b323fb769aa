from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

import calib_pin
from calib_pin.estimation.fit import fit_model
from calib_pin.setup import FrameSetup, PointSetup, Setup
from calib_pin.validation.learned_held_out import learned_left_out
from calib_pin.validation.model_errors import ModelErrors, model_errors
from calib_pin.validation.splits import Grouping, folds

TOOL = FrameSetup((0.05, 0.08, 0.1))
SETUP = Setup(parameters=("placement",), tool_frame=TOOL, learned="gaussian-process")


def test_parts_promise_what_new_measurements_have(
    simulated: Callable[..., Any],
) -> None:
    waves = replace(SETUP, parameters=("placement", "transmission"), learned=None)
    problem, truth = simulated("position", waves, 80, 0.5, seed=3, noise=1e-5)
    chain, rows = problem.chains[""], problem.data
    model = fit_model(chain, rows, SETUP, 0)
    assert model.learned is not None
    masks = folds(Grouping.of(rows, SETUP), model.fit, 0)
    parts = [part for part in learned_left_out(model, masks, 0) if part is not None]
    assert sorted(ModelErrors.joined(parts).positions) == list(range(80))
    rng = np.random.default_rng(9)
    fresh = calib_pin.simulate(problem, truth, rng, count=300, noise=1e-5)
    plain = replace(model, problem=model.fit.problem, theta=model.fit.theta)
    found, new, without = (
        np.sqrt((errors.after**2).mean())
        for errors in (
            ModelErrors.joined(parts),
            model_errors(model, fresh, np.arange(300)),
            model_errors(plain, fresh, np.arange(300)),
        )
    )
    # A fold of five learns from four fifths, and 80 errors scatter by a tenth.
    assert 0.9 < found / new < 1.5 and new < 0.5 * without


def test_a_part_with_all_of_a_target_takes_a_fit(simulated: Callable[..., Any]) -> None:
    sockets = {"a": PointSetup((0.4, 0.1, 0.2)), "b": PointSetup((0.3, -0.2, 0.3))}
    kinds = ("joint-offset", "transmission")
    truth = replace(SETUP, parameters=kinds, sockets=sockets, learned=None)
    problem, _ = simulated("fixed-point", truth, 60, 1.0, noise=1e-5)
    rows, setup = problem.data, replace(SETUP, parameters=("joint-offset",))
    model = fit_model(problem.chains[""], rows, setup, 0)
    target = np.array(rows.only.target)
    every, some = target == "a", (target == "a") & (np.arange(60) < 30)
    first, second = learned_left_out(model, [every, some], 0)
    assert first is None and second is not None
    np.testing.assert_array_equal(second.positions, np.flatnonzero(some))
