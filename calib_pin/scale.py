"""Whether measurements tell how large a robot is.

A robot whose lengths are all longer by one factor moves like the nominal one, only
larger. What it leaves at angles or in the sockets of a ball is the same.
"""

from __future__ import annotations

import numpy as np

from calib_pin.problem import Problem
from calib_pin.spatial import Floats

__all__ = ["scale_observable"]

EXPLAINED = 1e-6
"""Part of a change of scale that rounding leaves where parameters express it."""


def scale_observable(problem: Problem, theta: Floats) -> bool:
    """Whether some row of a problem changes when the robot grows.

    It does not if some change of the parameters moves the tool as if all lengths grew
    by one factor, and yet changes no row. A robot whose lengths are not all estimated
    cannot grow; its scale is known.

    Args:
        problem: The problem at configurations that its instrument can measure.
        theta: Parameter values with the robot at nominal, shape (P,).
    """
    of_robot, _ = problem.split(theta)
    free = problem.parameters.free
    _, J = problem.linearize_rows(theta)
    data = problem.data
    factors = problem.error.factors(data.q, data.payload)
    poses = problem.error.linearize(data.q, of_robot, factors)
    twists = poses.derivative(np.tile(np.eye(6), (len(poses.T), 1, 1)))
    by_parameters: Floats = np.zeros((twists[:, :, 0].size, len(theta)))
    by_parameters[:, : len(of_robot)] = twists.reshape(-1, len(of_robot))
    # In the base link: where that stands in a measuring frame is no length of it.
    names = problem.parameters.names
    by_parameters[:, [name.startswith("base.frame.") for name in names]] = 0.0
    grown = np.zeros((len(poses.T), 6))
    R, p = poses.to_base[:, :3, :3], poses.to_base[:, :3, 3]
    grown[:, :3] = np.einsum("nji,nj->ni", R, p)
    scales = problem.parameters.scales
    rows = (J * scales)[:, free]
    moved = (by_parameters * scales)[:, free]
    size = np.linalg.norm(rows) / max(float(np.linalg.norm(moved)), 1e-300)
    A = np.concatenate([rows / (size or 1.0), moved])
    b = np.concatenate([np.zeros(len(rows)), grown.reshape(-1)])
    z = np.linalg.lstsq(A, b, rcond=1e-13)[0]
    left = float(np.linalg.norm(A @ z - b))
    return left > EXPLAINED * float(np.linalg.norm(b))
