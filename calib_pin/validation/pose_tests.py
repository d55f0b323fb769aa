"""Acceptance tests of robots: commanded poses by models, attained ones measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import InputError
from calib_pin.estimation.problem import error_table
from calib_pin.kinematics.chains import Chains
from calib_pin.observations import Indices, Observations
from calib_pin.setup import Setup
from calib_pin.validation.acceptance import Acceptance, acceptance
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.evaluation import prepared

MODELS = ("position", "pose")
"""Measurement models that tell where a point is."""


@dataclass(frozen=True)
class Tested:
    """An acceptance test.

    Attributes:
        tests: The test by the robot that the commanded poses are of, `nominal` before
            `calibrated`.
        about: The robot, the poses and the frame, in a sentence.
    """

    tests: Mapping[str, Acceptance]
    about: str

    def table(self) -> dict[str, Sequence[object]]:
        """A table by robot and pose, in SI units."""
        rows = [
            (name, pose) for name, test in self.tests.items() for pose in test.poses
        ]
        table: dict[str, Sequence[object]] = {
            "robot": [name for name, _ in rows],
            "pose": [pose.pose for _, pose in rows],
            "visits": [pose.visits for _, pose in rows],
        }
        for key, of in (
            ("AP", [pose.accuracy for _, pose in rows]),
            ("RP", [pose.repeatability for _, pose in rows]),
        ):
            table[f"{key} [m]"] = [i.value for i in of]
            table[f"{key}_low [m]"] = [i.low for i in of]
            table[f"{key}_high [m]"] = [i.high for i in of]
        table["vAP [m]"] = [
            "" if pose.directions is None else pose.directions for _, pose in rows
        ]
        return table


@serial_blas
def tested(
    robot: Chains | CalibratedModel,
    rows: Observations,
    setup: Setup,
    *,
    registration: bool = False,
    numbers: Indices | None = None,
) -> Tested:
    """Test a robot on repeated visits of poses.

    Args:
        robot: A robot, whose base and tool are registered on the visits, or a
            calibrated one, beside which the nominal one is told.
        rows: The visits, of positions or poses, in their order.
        setup: Known quantities of frames and instrument, for a robot.
        registration: Register a calibrated robot on these measurements.
        numbers: Number of the pose of each visit, see `acceptance`.

    Raises:
        InputError: If they are of something else, or no pose was visited often enough.
    """
    if len(rows.blocks) != 1 or rows.blocks[0].model not in MODELS:
        told = ", ".join(dict.fromkeys(block.model for block in rows.blocks))
        raise InputError(
            "an acceptance test needs positions or poses from one station",
            value=told,
            allowed=" or ".join(MODELS),
        )
    block = rows.blocks[0]
    subjects: dict[str, Chains | CalibratedModel]
    if isinstance(robot, CalibratedModel):
        chains, setup = robot.chains, robot.setup
        subjects = {"nominal": chains, "calibrated": robot}
    else:
        chains, registration = robot, True
        subjects = {"robot": robot}
    tests = {}
    for name, subject in subjects.items():
        ready = prepared(subject, rows, setup, registration=registration)
        residual = error_table(ready.problem, ready.theta)
        attained = block.values[:, :3]
        tests[name] = acceptance(
            attained,
            attained + residual[:, :3],
            rows.groups(),
            -residual[:, 3:6] if block.model == "pose" else None,
            numbers,
        )
    last = tests[name]
    visits = sum(pose.visits for pose in last.poses)
    how = "registered on these measurements" if registration else "as calibrated"
    about = (
        f"{chains.robot.name}: {visits} visits of {len(last.poses)} poses; base and "
        f"tool {how}."
    )
    single = len(np.unique(rows.groups())) - len(last.poses)
    if single:
        about += f" {single} poses with fewer than three visits are left out."
    return Tested(tests, about)
