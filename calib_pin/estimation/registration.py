"""Closed-form starts: a problem about registered frames and instrument references."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin

from calib_pin.errors import OptionError
from calib_pin.estimation.problem import SAMPLE, Problem
from calib_pin.kinematics.spatial import Floats, invert
from calib_pin.measurement_models.references import slices
from calib_pin.observations import Measurements, trusted
from calib_pin.parameterizations import frame_pose
from calib_pin.parameters import ParameterSet
from calib_pin.setup import FrameSetup


def registered(problem: Problem, theta: Floats) -> Problem:
    """A problem about closed-form frames and instrument references.

    A pose in the setup is kept, as known or as a first guess; so is the identity for a
    frame that is partly fixed, bounded or has a prior.

    Args:
        problem: The problem.
        theta: Parameter values, shape (P,); those of the robot count.
    """
    count = len(problem.error.screws)
    few = trusted(problem.data).sample(SAMPLE)
    # A frame of the chain has six parameters at either end.
    start = (
        _given(problem.parameters, problem.setup.base_frame, slice(0, 6)),
        _given(problem.parameters, problem.setup.tool_frame, slice(count - 6, count)),
    )
    _require_loose(problem, count)
    of_robot = problem.split(theta)[0]
    F = problem.error.tip_poses(few.q, of_robot, few.payload)
    if few.start.size:
        begun = np.isfinite(few.start[:, 0])
        loads = [few.payload[k] for k in np.flatnonzero(begun)]
        F_0 = problem.error.tip_poses(few.start[begun], of_robot, loads)
        F[begun] = invert(F_0) @ F[begun]
    measurement, base, tool = problem.measurement.register(F, few, *start)
    return replace(
        problem, error=problem.error.with_frames(base, tool), measurement=measurement
    )


def _require_loose(problem: Problem, start: int) -> None:
    """Refuse fixed, bounds or prior on what has no reference to be about."""
    references = problem.measurement.references
    for reference, part in zip(references, slices(references), strict=True):
        if reference.located:
            continue
        own = slice(start + part.start, start + part.stop)
        lower, upper = (bound[own] for bound in problem.parameters.bounds)
        priors = problem.parameters.priors[own]
        free = np.array([p.free for p in reference.parameters], bool)
        held = free & ~problem.parameters.free[own]
        if held.any() or np.isfinite([lower, upper, priors]).any():
            raise OptionError(
                "fixed, bounds or prior on a part of an unknown instrument: give "
                f"its '{reference.section}' in a setup file (--setup)",
                file=problem.setup.file or None,
            )


def _given(parameters: ParameterSet, frame: FrameSetup, part: slice) -> pin.SE3 | None:
    """The pose that a frame starts from, None for a closed-form estimate.

    Fixed components, bounds and priors refer to the pose of the setup file,
    not to an estimate.
    """
    lower, upper = parameters.bounds
    tied = np.isfinite([lower[part], upper[part], parameters.priors[part]]).any()
    stated = frame.xyz is not None or frame.rpy is not None
    if stated or tied or not parameters.free[part].all():
        return frame_pose(frame)
    return None


def extended(
    problem: Problem, theta: Floats, rows: Measurements
) -> tuple[Problem, Floats]:
    """The problem of other measurements, with references for what only these name.

    Args:
        problem: The problem.
        theta: Parameter values, shape (P,).
        rows: The other measurements.

    Returns:
        The problem about its instrument, and its parameter values: those of the
        instrument are zero.
    """
    of_robot, own = problem.split(theta)
    known = problem.measurement.rebased(own)
    there = replace(problem, data=rows, measurement=known)
    T = there.poses(np.concatenate([of_robot, 0.0 * own]), rows)
    measurement = known.extended(T, rows)
    own = np.zeros(len(measurement.parameters))
    return replace(there, measurement=measurement), np.concatenate([of_robot, own])
