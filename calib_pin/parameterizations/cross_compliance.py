"""Compliance of bearings and links across the axes of joints (elastostatic errors)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations.conditions import UNSTATED, Conditions
from calib_pin.parameterizations.base import (
    BasisFunction,
    Parameterization,
    Screw,
)
from calib_pin.parameterizations.loads import LEAST, Loads

DEFLECTION = 3e-4
"""Expected deflection across a joint under its usual moment [rad].

Bearings and links are some times stiffer than drives.
"""


@dataclass(frozen=True)
class CrossCompliance(Loads, Parameterization):
    """`<joint>.cross-compliance.kx|ky`: a joint that gives across its axis [rad/Nm].

    Virtual springs about two axes that are at right angles to the joint's own, fixed in
    the link before it: where the joint turns about z they are x and y of its frame. The
    joint turns about them by `k M(q)`, M being the moment of gravity about the axis, at
    the commanded configuration and nominal geometry, of all that the joint carries. A
    link that bends does so as well: its end stands aslant by what it carries there. A
    joint that shifts tilts in its guide.
    """

    name = "cross-compliance"
    geometric = False

    def screws(self, chain: Chain) -> Sequence[Screw]:
        """Two screws about axes across every joint.

        Raises:
            OptionError: If nothing that has a mass loads any joint across its axis.
        """
        if not chain.joints:
            return []
        axes = np.array([_transverse(axis) for axis in chain.axes])
        functions = _Moments(chain, self, axes)
        usual = self.usual(functions, chain, self.name)
        scales = DEFLECTION / np.maximum(usual, LEAST * usual.max())
        return [
            Screw(
                self.parameter(joint, name, "rad/Nm", float(scales[2 * k + i])),
                k + 1,
                np.concatenate([np.zeros(3), axes[k, i]]),
                BasisFunction(functions, 2 * k + i),
            )
            for k, joint in enumerate(chain.joints)
            for i, name in enumerate(("kx", "ky"))
        ]


@dataclass(frozen=True, eq=False)
class _Moments:
    """Moments of gravity about two axes, shape (n, 2, 3), across each joint."""

    chain: Chain
    load: Loads
    axes: Floats

    def __call__(self, q: Floats, conditions: Conditions = UNSTATED) -> Floats:
        moments = self.load.loads(self.chain.gravity_moments, q, conditions)
        across = np.einsum("nka,kia->nki", moments, self.axes)
        return np.asarray(across.reshape(len(q), 2 * len(self.axes)))


def _transverse(axis: Floats) -> Floats:
    """Two unit axes at right angles to one, shape (2, 3): x and y for z."""
    first = np.eye(3)[int(np.argmin(np.abs(axis)))]
    first = first - (first @ axis) * axis
    first = first / np.linalg.norm(first)
    return np.array([first, np.cross(axis, first)])
