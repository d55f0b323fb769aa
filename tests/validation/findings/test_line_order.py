"""Joint positions that stand at other lines than their measurements."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.fit import fit_model
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.kinematics.chains import Chains
from calib_pin.observations import Measurements, Observations
from calib_pin.setup import Setup
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.explanations import explain
from calib_pin.validation.findings.hypotheses import setup_lines
from calib_pin.validation.findings.line_order import line_order

ARM = calib_pin.load_chain("space6")
SETUP = Setup(parameters=("joint-offset",))


def simulated(q: np.ndarray) -> Measurements:
    problem = nominal_problem(ARM, "position", Setup())
    rng = np.random.default_rng(3)
    truth = calib_pin.draw_errors(problem.parameters, rng)
    rows = calib_pin.simulate(problem, truth, rng, q=q, noise=1e-4).only
    return replace(
        rows, lines=np.arange(2, len(rows) + 2), files=("a.csv",) * len(rows)
    )


def lines_for(rows: Measurements) -> dict[str, object] | None:
    case = Case.of(fit_model(ARM, Observations.of(rows), SETUP, 0).fit, Chains.of(ARM))
    found = explain(case, (line_order,))
    return None if found is None else setup_lines(case, found.faults)


RANDOM = simulated(ARM.random_configurations(40, np.random.default_rng(5)))


@pytest.mark.parametrize("lines", [1, -7])
def test_joints_that_stand_below_or_above(lines: int) -> None:
    wrong = replace(RANDOM, q=np.roll(RANDOM.q, lines, axis=0))
    assert lines_for(wrong) == {"reading": {"shift": lines}}


def test_a_shift_along_a_path() -> None:
    ends = ARM.random_configurations(2, np.random.default_rng(5))
    part = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, 60))[:, None]
    rows = simulated((1.0 - part) * ends[0] + part * ends[1])
    wrong = replace(rows.rows(np.arange(57)), q=rows.q[3:])
    assert lines_for(wrong) == {"reading": {"shift": -3}}


def test_reversed_order() -> None:
    wrong = replace(RANDOM, q=RANDOM.q[::-1])
    assert lines_for(wrong) == {"reading": {"reversed": True}}


def test_no_order_at_all() -> None:
    order = np.random.default_rng(1).permutation(len(RANDOM))
    assert lines_for(replace(RANDOM, q=RANDOM.q[order])) is None
    assert lines_for(RANDOM) is None
