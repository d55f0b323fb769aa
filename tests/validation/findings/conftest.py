"""Measurements of robots with errors, and jobs of which something was changed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.setup import FrameSetup, Setup
from tests.shared import simulated


@pytest.fixture(scope="session")
def erring():
    """Makes measurements: `erring(robot, setup, seed, model, changes, ...)`.

    The robot has errors of its geometry, and beside these the changes alone, by name;
    further arguments are those of `simulate`.
    """

    def make(robot, setup, seed, model="position", changes=None, noise=1e-4, **how):
        chain = calib_pin.load_chain(robot) if isinstance(robot, str) else robot
        problem = nominal_problem(chain, model, setup)
        rng, names = np.random.default_rng(seed), problem.parameters.names
        theta = calib_pin.draw_errors(problem.parameters, rng)
        effects = {name for name in setup.parameters if name != "placement"}
        theta[[name.split(".")[1] in effects for name in names]] = 0.0
        for name, change in (changes or {}).items():
            theta[names.index(name)] += change
        return calib_pin.simulate(problem, theta, rng, noise=noise, **how)

    return make


@pytest.fixture(scope="session")
def ur10(erring):
    """Makes measurements of a UR10 that errs by some millimeters."""
    chain = calib_pin.load_chain("example:ur10_robot", base="base_link", tip="tool0")
    frame = FrameSetup((0.05, 0.08, 0.12), (0.2, -0.3, 0.1))
    setup, same = Setup(tool_frame=frame), {"robot": chain, "again": 1, "noise": 1e-4}

    def measured(count=0, **how):
        return simulated("position", setup, count, 1.0, **same, **how)[0].data

    return measured


@pytest.fixture(scope="module")
def told(moved_job):
    """The findings of a job's measurements of which something was changed."""

    def of(change, **more):
        job = moved_job((), (), 55, **more)
        block = replace(job.plain.only, sigma=None)
        rows = replace(block, **change(block))
        result = calib_pin.calibrate(job.chain, rows, validate=False)
        return {finding.code: finding for finding in result.findings}

    return of
