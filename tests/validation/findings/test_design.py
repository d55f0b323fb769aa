"""Configurations that are too much alike are told, others are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.fit import fit_model
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.kinematics.chains import Chains
from calib_pin.measurement_models.readings import with_positions
from calib_pin.setup import FrameSetup, Setup
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.design import design
from calib_pin.validation.findings.unmoved_joints import unmoved_joints


@pytest.fixture(scope="module")
def found(moved_job):
    """The findings at other configurations, which need no other measurements."""
    job = moved_job((), ())
    fitted = fit_model(job.chain, job.plain, Setup(), 0).fit
    case = Case.of(fitted, Chains.of(job.chain))

    def of(change):
        data = with_positions(case.data, change(case.data.q.copy()))
        fit = replace(case.fit, problem=replace(case.fit.problem, data=data))
        other = replace(case, data=data, fit=fit)
        return {f.code: f for f in (*unmoved_joints(other), *design(other))}

    return of


def still(q, part=0.0):
    q[:, 3] = 0.3 + part * q[:, 3]
    return q


def test_random_configurations(found) -> None:
    assert found(lambda q: q) == {}


def test_a_joint_that_never_moved(found) -> None:
    (finding,) = found(still).values()
    assert (finding.code, finding.severity) == ("unmoved-joints", "warning")
    assert finding.message.endswith("stay at nominal: joint_4")
    assert "calib-pin plan" in finding.remedy


@pytest.mark.parametrize(("part", "severity"), [(0.02, "warning"), (0.2, "info")])
def test_a_small_range(found, part, severity) -> None:
    (finding,) = found(lambda q: still(q, part)).values()
    assert (finding.code, finding.severity) == ("small-range", severity)
    assert "joint_4 from " in finding.message
    assert finding.evidence["joint_4"] == pytest.approx(part, rel=0.15)


@pytest.mark.parametrize(("directions", "severity"), [(1, "warning"), (3, "info")])
def test_joints_that_move_together(found, directions, severity) -> None:
    def together(q):
        mixed = np.random.default_rng(1).normal(size=(directions, q.shape[1]))
        return q[:, :directions] @ mixed

    finding = found(together)["joints-move-together"]
    assert finding.severity == severity
    assert f"in only {directions} independent direction" in finding.message


@pytest.fixture(scope="module")
def judged():
    """Findings of a whole calibration by the configurations that were measured."""
    chain = calib_pin.load_chain("example:ur10_robot", base="base_link", tip="tool0")
    setup = Setup(tool_frame=FrameSetup((0.05, 0.08, 0.12), (0.2, -0.3, 0.1)))
    problem = nominal_problem(chain, "position", setup)
    theta = calib_pin.draw_errors(problem.parameters, np.random.default_rng(0))

    def of(q):
        rng = np.random.default_rng(1)
        rows = calib_pin.simulate(problem, theta, rng, q=q, noise=1e-4)
        result = calib_pin.calibrate(chain, rows, Setup(), validate=False)
        return {f.code: f for f in result.findings}

    return of


def on_a_path(count):
    """Configurations along a smooth motion of all joints."""
    t = np.linspace(0.0, 2.0 * np.pi, count)[:, None]
    k = np.arange(6.0)
    return sum(0.5 * np.sin(turns * t + turns * k + k**2) for turns in (1, 2, 3))


def test_all_on_one_path(judged) -> None:
    finding = judged(on_a_path(80))["one-path"]
    assert finding.severity == "warning"
    assert "all configurations lie on one path" in finding.message
    assert "times those where it was measured" in finding.message


def test_spread_configurations_in_the_order_of_a_path_are_fine(judged) -> None:
    """What counts is what the measurements leave open, not their order."""
    q = np.random.default_rng(2).uniform(-np.pi, np.pi, (60, 6))
    assert judged(q[np.argsort(q[:, 0])]) == {}


def test_a_third_of_the_range_is_a_warning_where_far_more_is_expected(judged) -> None:
    q = np.random.default_rng(2).uniform(-1.0, 1.0, (60, 6))
    finding = judged(q)["small-range"]
    assert finding.severity == "warning"
    assert "less than 40 % of the range; over the workspace errors" in finding.message


@pytest.mark.parametrize("count", [3, 6])
def test_few_configurations_are_too_few_and_nothing_else(judged, count) -> None:
    """Three anywhere lie in a tenth of a joint's range, and move in two directions."""
    rng = np.random.default_rng(3)
    q = rng.uniform(-np.pi, np.pi, (count, 6))
    q[:, 5] = 0.5 + 0.3 * q[:, 5] if count == 3 else q[:, 5]
    assert set(judged(np.repeat(q, 20, axis=0))) == {"few-configurations"}


def test_few_configurations_at_one_place_are_told(judged) -> None:
    q = np.random.default_rng(2).uniform(-0.1, 0.1, (6, 6))
    assert {"few-configurations", "small-range"} <= set(
        judged(np.repeat(q, 20, axis=0))
    )
