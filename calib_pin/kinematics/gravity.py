"""Torques of gravity on the joints of a tree, for many configurations at once.

A joint that turns about a bears the torque `a . (h x g)` of all that it carries: mass m
with the first moment h about the joint, and gravity g, both in the joint's frame. A
joint that shifts along a bears the force `m a . g`. Gravity goes out from the root, and
first moments come back to it,

    g_j = Z_j(q)^T R_j^T g,    h <- h + R_j (Z_j(q) h_j + m_j s_j(q)) + m_j p_j,

with the placement (R, p) of joint j, its turn Z and its shift s. That is the static
part of Newton and Euler's recursion (Featherstone, Rigid body dynamics algorithms,
2008, chapter 5).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from calib_pin.kinematics.spatial import Floats


class Body(NamedTuple):
    """A joint with one degree of freedom, and what moves with it and no other.

    Attributes:
        parent: Position of the joint before it in the tree, -1 for the root.
        rotation: Of its frame in that of the joint before it, shape (3, 3).
        translation: The same, shape (3, 1) [m].
        axis: Unit axis in its frame, shape (3, 1).
        crossed: The matrix of `v -> v x axis`, shape (3, 3).
        revolute: Whether the joint turns.
        mass: Mass of the body [kg].
        moment: Its first moment about the joint's frame, shape (3, 1) [kg m].
    """

    parent: int
    rotation: Floats
    translation: Floats
    axis: Floats
    crossed: Floats
    revolute: bool
    mass: float
    moment: Floats


def body(
    parent: int,
    placement: pin.SE3,
    axis: Floats,
    revolute: bool,
    inertia: pin.Inertia,
) -> Body:
    """A joint by its parent, its placement in that, its unit axis and its inertia."""
    return Body(
        parent,
        placement.rotation,
        placement.translation[:, None],
        axis[:, None],
        -pin.skew(axis),
        revolute,
        inertia.mass,
        (inertia.mass * inertia.lever)[:, None],
    )


def gravity_torques(bodies: Sequence[Body], q: Floats, gravity: Floats) -> Floats:
    """Torques that gravity exerts on the joints.

    Args:
        bodies: The n joints, each behind the one that it hangs on.
        q: Joint positions, shape (n, N) [rad, m].
        gravity: Its acceleration in the root, shape (3,) [m/s^2].

    Returns:
        Torques, shape (n, N) [Nm, N for joints that shift].
    """
    torques = np.empty(q.shape)
    for k, mass, moment, there in _carried(bodies, q, gravity):
        one = bodies[k]
        if one.revolute:
            torques[k] = (moment * (one.crossed @ there)).sum(axis=0)
        else:
            torques[k] = mass * (one.axis.T @ there)[0]
    return torques


def gravity_moments(bodies: Sequence[Body], q: Floats, gravity: Floats) -> Floats:
    """Moments of gravity about the origins of the joints, about all axes.

    Along the axis of a joint that turns it is the torque; across it the bearings hold
    it. Arguments as for `gravity_torques`.

    Returns:
        Moments in the frames that joints have before they move, shape (n, 3, N) [Nm].
    """
    moments = np.empty((len(bodies), 3, q.shape[1]))
    for k, mass, moment, there in _carried(bodies, q, gravity):
        one = bodies[k]
        if one.revolute:
            held = np.cross(moment, there, axis=0)
            moments[k] = _turned(one, np.cos(q[k]), np.sin(q[k]), held)
        else:
            moments[k] = np.cross(moment + mass * one.axis * q[k], there, axis=0)
    return moments


def _carried(
    bodies: Sequence[Body], q: Floats, gravity: Floats
) -> Iterator[tuple[int, float, Floats, Floats]]:
    """Load that each joint carries, from the last to the first.

    Yields:
        Position of the joint, mass, and in its frame the first moment and gravity,
        shapes (3, N) or (3, 1).
    """
    cosines, sines = np.cos(q), np.sin(q)
    there: list[Floats] = []
    for k, one in enumerate(bodies):
        before = gravity[:, None] if one.parent < 0 else there[one.parent]
        local = one.rotation.T @ before
        if one.revolute:
            local = _turned(one, cosines[k], -sines[k], local)
        there.append(local)
    masses = [one.mass for one in bodies]
    moments = [one.moment for one in bodies]
    for k in reversed(range(len(bodies))):
        one, moment = bodies[k], moments[k]
        yield k, masses[k], moment, there[k]
        if one.revolute:
            moment = _turned(one, cosines[k], sines[k], moment)
        else:
            moment = moment + masses[k] * one.axis * q[k]
        if one.parent >= 0:
            masses[one.parent] += masses[k]
            moment = one.rotation @ moment + masses[k] * one.translation
            moments[one.parent] = moments[one.parent] + moment


def _turned(joint: Body, cosine: Floats, sine: Floats, v: Floats) -> Floats:
    """Vectors turned about the axis of a joint, shape (3, N) or (3, 1) -> (3, N)."""
    along = joint.axis * (joint.axis.T @ v)
    turned = along + cosine * (v - along) - sine * (joint.crossed @ v)
    return np.asarray(turned)
