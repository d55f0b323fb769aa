"""Positions of joints: their limits, and the mimic joints that follow others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from calib_pin.kinematics.spatial import Floats
from calib_pin.kinematics.tree import turns

WIDEST = 1e3
"""Range from which limits count as none [rad, m]."""

FREE_TRAVEL = 1.0
"""Travel of a prismatic joint either way where its URDF states no limits [m]: that of
the usual linear axis that carries a robot."""


@dataclass(frozen=True)
class Mimic:
    """How a mimic joint follows another: `position = factor * leader + offset`.

    Attributes:
        leader: Joint with a drive of its own.
        factor: Its factor (rad/m, m/rad between a revolute and a prismatic joint).
        offset: Position of the mimic joint where the leader is at zero [rad, m].
    """

    leader: str
    factor: float = 1.0
    offset: float = 0.0


class JointSpace:
    """Joint positions within their limits, of some joints and of all that these follow.

    Args:
        model: Pinocchio model of the whole tree.
        joints: Names of revolute, continuous and prismatic joints.
        mimics: The mimic joints of the tree by name.

    Attributes:
        joints: Names of the n joints: those given, then leaders that are not given.
        mimics: The mimic joints among them.
        revolute: True for revolute and continuous joints, shape (n,).
        lower: Lower position limits, shape (n,) [rad, m]; where there is none, half a
            turn back, or `FREE_TRAVEL` for a prismatic joint. A leader goes only as far
            as its mimic joints here can follow, and these as far as it goes.
        upper: Upper position limits, shape (n,) [rad, m]; the same forward.
        limited: True where the URDF states limits, of a leader also where those of its
            mimic joints narrow it, shape (n,).
        inverted: Names of joints with inverted limits in the URDF; they count as none.
        unlimited: Names of joints that should have limits and have none in the URDF,
            inverted ones, or some that no joint has.
    """

    def __init__(
        self, model: pin.Model, joints: Sequence[str], mimics: Mapping[str, Mimic]
    ) -> None:
        """Read the limits, and narrow those of leaders."""
        self.mimics = {name: mimics[name] for name in joints if name in mimics}
        leaders = (mimic.leader for mimic in self.mimics.values())
        self.joints: tuple[str, ...] = tuple(dict.fromkeys([*joints, *leaders]))
        ids = [model.getJointId(name) for name in self.joints]
        self.revolute = np.array([turns(model, name) for name in self.joints], bool)
        single = np.array([model.nqs[j] == 1 for j in ids], bool)
        index = np.array([model.idx_qs[j] for j in ids], np.intp)
        lower, upper = model.lowerPositionLimit[index], model.upperPositionLimit[index]
        # People who mean no limit write two zeros.
        valid = (upper > lower) | ((upper == lower) & (upper != 0.0))
        limited = single & valid & (np.abs(upper - lower) < WIDEST)
        self.inverted: tuple[str, ...] = tuple(
            self.joints[j] for j in np.flatnonzero(single & (lower > upper))
        )
        self.unlimited: tuple[str, ...] = tuple(
            self.joints[j]
            for j in np.flatnonzero(single & ~limited)
            if self.joints[j] not in self.mimics
        )
        free = np.where(self.revolute, np.pi, FREE_TRAVEL)
        self.lower: Floats = np.where(limited, lower, -free)
        self.upper: Floats = np.where(limited, upper, free)
        self.limited = limited.copy()
        self._followers = [
            (self.joints.index(name), self.joints.index(mimic.leader), mimic)
            for name, mimic in self.mimics.items()
        ]
        for follower, leader, mimic in self._followers:
            if limited[follower] and mimic.factor:
                ends = np.array([self.lower[follower], self.upper[follower]])
                low, high = np.sort((ends - mimic.offset) / mimic.factor)
                low = max(low, self.lower[leader])
                high = min(high, self.upper[leader])
                # Limits that a mimic joint never keeps are a slip of the URDF.
                if low < high:
                    self.lower[leader], self.upper[leader] = low, high
                    self.limited[leader] = True
        ends = self.follow(np.array([self.lower, self.upper]))
        self.lower, self.upper = ends.min(axis=0), ends.max(axis=0)

    def follow(self, q: Floats) -> Floats:
        """Joint positions (N, n) [rad, m], with mimic joints where leaders put them."""
        result = np.array(q, float)
        for follower, leader, mimic in self._followers:
            result[:, follower] = mimic.factor * result[:, leader] + mimic.offset
        return result

    def random_configurations(self, count: int, rng: np.random.Generator) -> Floats:
        """Configurations drawn uniformly within the limits, shape (count, n)."""
        shape = (count, len(self.joints))
        return self.follow(rng.uniform(self.lower, self.upper, shape))


def quasi_random(shift: Floats, begin: int, count: int) -> Floats:
    """Members of an additive recurrence in the unit cube, shape (count, n).

    `x_k = shift + k a (mod 1)` with `a_j = g^-j` and g the root of `g^(n+1) = g + 1`,
    the generalized golden ratio (Roberts 2018): low discrepancy for any number.
    """
    n = len(shift)
    ratio = 2.0
    for _ in range(60):
        ratio = (1.0 + ratio) ** (1.0 / (n + 1))
    steps = ratio ** -np.arange(1.0, n + 1)
    return np.asarray((shift + np.arange(begin, begin + count)[:, None] * steps) % 1.0)
