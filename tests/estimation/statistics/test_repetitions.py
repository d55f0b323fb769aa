"""Pure error and lack of fit from repeated configurations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.evidence import VarianceComponent
from calib_pin.estimation.fit import fit
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.setup import FrameSetup, Setup

CHAIN = calib_pin.load_chain("space6")
SETUP = Setup(parameters=("joint-offset",), tool_frame=FrameSetup((0.05, 0.08, 0.12)))


def component(
    seed: int, noise: float, shared: float, repeats: int, *, stated: float | None = None
) -> VarianceComponent:
    """Of positions with noise, and with errors that repetitions have in common."""
    problem = nominal_problem(CHAIN, "position", SETUP)
    rng = np.random.default_rng(seed)
    truth = calib_pin.draw_errors(problem.parameters, rng)
    rows = calib_pin.simulate(
        problem, truth, rng, count=40, noise=noise, repeats=repeats
    )
    each = shared * rng.normal(size=(40, 3))
    rows = replace(
        rows,
        values=rows.values + each[rows.groups()],
        sigma=None if stated is None else np.full((len(rows), 3), stated),
    )
    (found,) = fit(replace(problem, data=rows), np.random.default_rng(0)).noise
    return found


def test_pure_error_is_the_noise_whatever_the_model_lacks() -> None:
    found = component(0, 5e-5, 4e-4, 4)
    # 360 degrees of freedom: three deviations are 11 %.
    assert found.pure == pytest.approx(5e-5, rel=0.11)
    assert found.lack_of_fit is not None and found.lack_of_fit < 1e-9
    # 109 redundancies between configurations: three deviations are 20 %.
    assert found.unmodeled == pytest.approx(4e-4, rel=0.2)
    assert found.estimate == pytest.approx(np.hypot(4e-4, 5e-5), rel=0.2)
    assert found.interval[0] < 4.03e-4 < found.interval[1]


def test_repetitions_test_what_is_stated() -> None:
    right, wrong = (component(1, 5e-5, 0.0, 3, stated=s) for s in (5e-5, 2e-5))
    assert right.pure_test is not None and right.pure_test > 0.01
    assert wrong.pure_test is not None and wrong.pure_test < 1e-9


def test_noise_alone_lacks_nothing() -> None:
    """Of 24, more than 4 are below 5 % once in a hundred."""
    found = [component(seed, 1e-4, 0.0, 3).lack_of_fit for seed in range(24)]
    assert sum(p is not None and p < 0.05 for p in found) <= 4
    assert 0.3 < np.mean([p for p in found if p is not None]) < 0.7


def test_without_repetitions_nothing_is_told_apart() -> None:
    found = component(2, 1e-4, 0.0, 1)
    assert found.pure is None and found.lack_of_fit is None
    assert found.unmodeled is None and found.pure_test is None
