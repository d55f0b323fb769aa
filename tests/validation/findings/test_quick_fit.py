"""Fits in a few steps: where they start, and what they keep."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import calib_pin
from calib_pin.estimation.formulation import make_problem, nominal_problem
from calib_pin.setup import DistanceSetup, FrameSetup, PointSetup, Setup
from calib_pin.validation.findings.quick_fit import QuickFit

ARM = calib_pin.load_chain("space6")


def test_known_distances_are_kept() -> None:
    """Wrong joint positions draw sockets together that know no distance."""
    sockets = {f"s/{k}": PointSetup((0.6, 0.1 * k, 0.4)) for k in range(3)}
    tool = FrameSetup((0.05, 0.08, 0.12))
    setup = Setup(tool_frame=tool, sockets=sockets)
    problem = nominal_problem(ARM, "fixed-point", setup)
    rng, zero = np.random.default_rng(0), np.zeros(len(problem.parameters))
    rows = calib_pin.simulate(problem, zero, rng, count=60, noise=1e-4).only
    reversed_joint = replace(rows, q=rows.q * [1, 1, -1, 1, 1, 1])
    between = (("s/0", "s/1"), ("s/1", "s/2"))
    distances = tuple(DistanceSetup(ends, 0.1, 1e-5) for ends in between)
    problem = make_problem(ARM, reversed_joint, Setup(distances=distances))
    trial = QuickFit.of(problem, 4)
    lengths = trial.problem.known_distances.lengths(trial.theta)
    np.testing.assert_allclose(lengths, 0.1, atol=5e-3)


def test_steps_that_lead_away_are_not_taken() -> None:
    """The two first ones leave more than the nominal robot: 1.1 and 1.2 times."""
    problem = nominal_problem(ARM, "position", Setup())
    rng, zero = np.random.default_rng(0), np.zeros(len(problem.parameters))
    rows = calib_pin.simulate(problem, zero, rng, count=80, noise=1e-4).only
    reversed_joint = replace(rows, q=rows.q * [1, 1, 1, -1, 1, 1])
    problem = make_problem(ARM, reversed_joint, Setup())
    start = QuickFit.of(problem, 0).rms
    assert QuickFit.of(problem, 1).rms <= start
    assert QuickFit.of(problem, 2).rms <= start
