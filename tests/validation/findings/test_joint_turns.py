"""Joints that were read some turns away from their limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.fit import fit_model
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.kinematics.chains import Chains
from calib_pin.observations import Observations
from calib_pin.setup import Setup
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.joint_turns import joint_turns

ARM = calib_pin.load_chain("space6")
SETUP = Setup(parameters=("joint-offset",))


@pytest.fixture(scope="module")
def case() -> Case:
    problem = nominal_problem(ARM, "position", SETUP)
    rng = np.random.default_rng(1)
    zero = np.zeros(len(problem.parameters))
    rows = calib_pin.simulate(problem, zero, rng, count=30, noise=1e-4)
    return Case.of(fit_model(ARM, rows, SETUP, 0).fit, Chains.of(ARM))


def read_at(case: Case, offset: float) -> Case:
    q = case.data.q.copy()
    q[:, 4] += offset
    return replace(case, data=Observations.of(replace(case.data.only, q=q)))


@pytest.mark.parametrize("turns", [1, -2])
def test_turns_are_counted(case: Case, turns: int) -> None:
    (finding,) = joint_turns(read_at(case, -2.0 * np.pi * turns))
    assert finding.severity == "info" and finding.evidence["turns"] == turns
    entry = finding.setup["joints"][ARM.joints[4]]
    assert entry["offset"] == pytest.approx(2.0 * np.pi * turns)
    way = {1: "a turn on all", -2: "2 turns back all"}[turns]
    assert f"deg, beyond its limits; {way} of its positions" in finding.message


@pytest.mark.parametrize("offset", [0.0, 1.0])
def test_what_no_turn_explains(case: Case, offset: float) -> None:
    assert list(joint_turns(read_at(case, offset))) == []
