"""Configurations that are too much alike are told, others are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib_pin.estimation.fit import fit_model
from calib_pin.kinematics.chains import Chains
from calib_pin.measurement_models.readings import with_positions
from calib_pin.setup import Setup
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
