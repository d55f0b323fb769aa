"""The part of a calibration that counts for the prior of other robots.

Priors that it had itself are left out, and so nothing counts twice.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import InputError
from calib_pin.estimation.robot_rows import robot_rows
from calib_pin.estimation.statistics.population_prior import RobotEvidence
from calib_pin.kinematics.robot_types import robot_type
from calib_pin.validation.result import CalibrationResult


@serial_blas
def robot_evidence(result: CalibrationResult) -> RobotEvidence:
    """The equations for the errors of its robot that a calibration amounts to.

    Args:
        result: The calibration, of this program or read from its folder.

    Raises:
        InputError: If it does not say what was measured, how large the noise is, or
            learned more than errors of parameters.
    """
    if refuse := _refusal(result):
        raise InputError(refuse, file=result.provenance.file or None)
    model, noise = result.model, result.statistics.noise
    units = np.array([component.factor for component in noise])
    problem = replace(model.problem(result.fitted.rows), units=units)
    told = robot_rows(problem, model.theta, noise)
    own = [p for p, of in zip(problem.parameters, told.robot, strict=True) if of]
    return RobotEvidence(
        robot=robot_type(model.chains),
        names=tuple(p.name for p in own),
        units=tuple(p.unit for p in own),
        scales=np.array([p.scale for p in own]),
        rows=told.rows,
        values=told.values,
        noise={c.quantity: c.estimate for c in noise if c.estimate > 0.0},
    )


def _refusal(result: CalibrationResult) -> str:
    """Why a calibration tells nothing of its robot; empty where it does."""
    if result.model.setup.learned is not None:
        return "a calibration with a learned correction tells a fleet nothing"
    if not np.isfinite(result.fitted.after).any():
        return "the calibration does not say what was measured"
    if not result.statistics.noise:
        return "the calibration does not know its noise: its measurements are too few"
    return ""
