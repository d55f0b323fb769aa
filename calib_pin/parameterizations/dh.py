"""Denavit-Hartenberg errors of any URDF, derived from the axes of its joints.

Standard DH with Hayati's angle (Liu et al. 2012):

    A_i = Rz(theta_i) Tz(d_i) Tx(a_i) Rx(alpha_i) Ry(beta_i)

z is the axis of joint i, x the common normal that points to the axis of joint i + 1
(along z_i x z_i+1 where they meet) and y, at the foot of the normal on that axis,
completes the frame. Where the two axes are parallel the common normal can slide along
them: a small tilt moves it by meters, so beta_i (a turn about y) takes the place of
d_i. Errors of A_i are exact as an ordered product of screws, because Rz and Tz
commute, Tx and Rx commute, and beta is nominally zero.
The lines are read off the URDF; its own frames need not follow the convention.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats, adjoint, invert
from calib_pin.parameterizations.base import Parameterization, Screw

PARALLEL = 0.05
"""Sine of the angle below which neighboring axes count as parallel (3 degrees)."""


class DenavitHartenberg(Parameterization):
    """`<joint>.dh.theta|d|a|alpha|beta`: errors of the joint's own matrix A_i.

    Attributes:
        full: All five errors for every joint. Otherwise beta only where the next axis
            is (nearly) parallel, instead of d. Behind the last joint the next line is
            the z axis of the tip, and d stays.
    """

    name = "dh"
    full: ClassVar[bool] = False

    def screws(self, chain: Chain) -> Sequence[Screw]:
        """Four or five screws per moving joint, placed on the link behind it."""
        count = len(chain.joints)
        frames = chain.joint_frames()
        tip = chain.poses(np.zeros((1, count)))[0]
        lines = [
            (frame[:3, :3] @ axis, frame[:3, 3])
            for frame, axis in zip(frames, chain.axes, strict=True)
        ]
        lines.append((tip[:3, 2], tip[:3, 3]))

        result: list[Screw] = []
        for i, joint in enumerate(chain.joints):
            last = i == count - 1
            twists = _link_twists(lines[i], lines[i + 1], tip[:3, 0], last=last)
            parallel = _sine(lines[i][0], lines[i + 1][0]) < PARALLEL and not last
            if not self.full:
                twists.pop("d" if parallel else "beta")
            # The link behind joint i ends in the placement of joint i + 1. If joint i
            # is traversed from child to parent, the link begins with the inverse
            # placement of joint i, where the product stands inverted.
            backwards = bool(chain.reversed[i])
            index = i + 1 if backwards else i + 2
            origin = tip if index == count + 1 else frames[index - 1]
            to_frame = adjoint(invert(origin))
            sign = -1.0 if backwards else 1.0
            link = [
                Screw(
                    self.parameter(
                        joint, component, "m" if component in "da" else "rad"
                    ),
                    index,
                    sign * to_frame @ twist,
                )
                for component, twist in twists.items()
            ]
            result += reversed(link) if backwards else link
        return result


class FullDenavitHartenberg(DenavitHartenberg):
    """All five errors of every joint's matrix, redundant at neighboring joints."""

    name = "dh-full"
    kind = DenavitHartenberg.kind
    full = True


Line = tuple[Floats, Floats]


def _sine(a: Floats, b: Floats) -> float:
    return float(np.linalg.norm(np.cross(a, b)))


def _link_twists(
    this: Line, following: Line, tip_x: Floats, *, last: bool
) -> dict[str, Floats]:
    """Unit twists of theta, d, a, alpha, beta in base coordinates.

    Args:
        this: Direction and a point of the axis of joint i.
        following: Direction and a point of the axis of joint i + 1.
        tip_x: Direction that settles x where the two axes coincide.
        last: Whether the following line is the z axis of the tip.
    """
    z, point = this
    z_next, point_next = following
    if _sine(z, z_next) < PARALLEL:
        # Hayati: x lies in the plane perpendicular to z through the joint's origin;
        # behind the last joint, which keeps d, through the origin of the tip.
        foot = point + np.dot(point_next - point, z) * z if last else point
        reach = np.dot(foot - point_next, z) / np.dot(z_next, z)
        foot_next = point_next + reach * z_next
        x = foot_next - foot
        if np.linalg.norm(x) < 1e-9:
            x = tip_x - np.dot(tip_x, z) * z
            if np.linalg.norm(x) < 1e-3:
                # Of components that are equal but for rounding, the first.
                x = np.cross(z, np.eye(3)[np.argmin(np.round(np.abs(z), 9))])
    else:
        x = np.cross(z, z_next)
        # Feet of the common normal: point + s z + t x = point_next + u z_next.
        s, _, u = np.linalg.solve(np.column_stack([z, x, -z_next]), point_next - point)
        foot, foot_next = point + s * z, point_next + u * z_next
        if np.dot(foot_next - foot, x) < -1e-9:
            x = -x  # a is a length: x points at the next axis.
    x = x / np.linalg.norm(x)
    y = np.cross(z_next, x)
    return {
        "theta": _turn(z, point),
        "d": _shift(z),
        "a": _shift(x),
        "alpha": _turn(x, foot),
        "beta": _turn(y / np.linalg.norm(y), foot_next),
    }


def _turn(direction: Floats, point: Floats) -> Floats:
    return np.concatenate([np.cross(point, direction), direction])


def _shift(direction: Floats) -> Floats:
    return np.concatenate([direction, np.zeros(3)])
