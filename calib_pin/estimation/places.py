"""Where on its axis the errors of a joint are expected, wherever its frame stands.

A frame may stand anywhere on its axis, and the robot is the same. Errors that are
equally large about every frame are not: a milliradian about a frame that stands a meter
off moves the joint by a millimeter more. They are counted at the foot of the
perpendicular from the tip, and from there at that on the axis before, back to the base:
places that the axes alone tell, and that stay within the robot where axes are nearly
parallel.
"""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from calib_pin.estimation.terms import FRAME, Terms
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats, skew
from calib_pin.parameters import ParameterSet

SCREWS = 6
"""Errors that move a frame in all ways; fewer have no other place."""


def expected_places(system: Terms, parameters: ParameterSet) -> Floats:
    """Errors about the frames of joints by independent ones at their places.

    Of joints all of whose six errors are free and have no prior of their own; others
    stay as they are.

    Args:
        system: The robot and how it is measured.
        parameters: Its parameters.

    Returns:
        Matrix C of `theta = scales * C e`, shape (P, P).
    """
    result = np.eye(len(parameters))
    left = parameters.free & ~parameters.nuisance & ~np.isfinite(parameters.priors)
    for term in system.terms.values():
        places = feet(term.error.chain)
        joints = defaultdict[tuple[int, str], list[int]](list)
        for k in range(FRAME, len(term.error.screws) - FRAME):
            screw = term.error.screws[k]
            if screw.basis is None and left[term.index[k]]:
                stem = screw.parameter.name.rpartition(".")[0]
                joints[screw.frame, stem].append(k)
        for (frame, _), own in joints.items():
            index = term.index[own]
            if len(own) == SCREWS and frame <= len(places):
                twists = np.array([term.error.screws[k].twist for k in own]).T
                there = np.eye(SCREWS)
                there[:3, 3:] = skew(places[frame - 1])
                # Both in the scales of the parameters: translations, then rotations.
                scales = parameters.scales[index]
                block = np.linalg.solve(twists * scales, there * scales)
                result[np.ix_(index, index)] = block
            # What several chains share has one place.
            left[index] = False
    return result


def feet(chain: Chain) -> Floats:
    """Place of the errors of every joint, in its own frame, shape (n, 3) [m]."""
    frames, zero = chain.joint_frames(), np.zeros((1, len(chain.joints)))
    point, result = chain.poses(zero)[0, :3, 3], np.zeros((len(frames), 3))
    for k in reversed(range(len(frames))):
        turn, origin, axis = frames[k, :3, :3], frames[k, :3, 3], chain.axes[k]
        result[k] = ((point - origin) @ turn @ axis) * axis
        point = origin + turn @ result[k]
    return result
