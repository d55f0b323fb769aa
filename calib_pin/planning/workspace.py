"""Constraints of configurations: limits, line of sight, region, collisions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib_pin.errors import InputError, OptionError, RobotError, nearest
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.collision import Collisions
from calib_pin.kinematics.spatial import Floats
from calib_pin.parameters import matching

Booleans = NDArray[np.bool_]

DRAWS = 400
"""Quasi-random configurations tried for each candidate that is wanted."""

LEAST_DRAWS = 60_000
"""Quasi-random configurations tried before the first that is allowed."""

MARGIN = 0.01
"""Distance kept from the limits of the URDF, at most 1 % of the range [rad, m]."""

TIDY = 1e6
"""Reciprocal of the last digit of planned joint positions [1/rad, 1/m]."""

SWAY = np.array(
    [
        pin.exp6(sway * twist).homogeneous
        for twist in np.eye(6)
        for sway in (-0.02, 0.02)
    ]
)
"""Motions of the tool by 20 mm or 20 mrad, more than a robot's errors, (12, 4, 4)."""

BLOCK = 1000
"""Configurations that are tried at once."""


@dataclass(frozen=True)
class Candidates:
    """Configurations that may be measured.

    Attributes:
        q: Joint positions, shape (C, n) [rad, m].
        target: Target of each.
        tried: Number of configurations within the limits that were tried for them.
    """

    q: Floats
    target: tuple[str, ...]
    tried: int

    def require(self, count: int) -> None:
        """Check that there are enough of them.

        Raises:
            OptionError: If there are fewer than wanted.
        """
        if len(self.q) < count:
            raise OptionError(
                f"{len(self.q)} of the tried configurations may be measured, fewer "
                f"than the {count} wanted",
                allowed="fewer configurations, wider limits, or a shorter distance",
            )


@dataclass(frozen=True)
class Workspace:
    """The configurations that may be measured.

    Attributes:
        problem: Chain, frames and instrument.
        lower: Lower position limits, shape (n,) [rad, m].
        upper: Upper position limits, shape (n,) [rad, m].
        point: The measured point in the tip, whose place the region limits, SE3.
        collisions: Collisions to avoid; None if no shapes are known.
        distance: Least distance between two configurations of a set: the largest
            difference of a joint [rad, m].
    """

    problem: Problem
    lower: Floats
    upper: Floats
    point: pin.SE3
    collisions: Collisions | None = None
    distance: float = 0.0

    @staticmethod
    def create(
        problem: Problem,
        collisions: Collisions | None = None,
        distance: float = 0.0,
        point: pin.SE3 | None = None,
    ) -> Workspace:
        """The workspace of a problem, with the limits of its setup.

        Args:
            problem: Chain, frames and instrument.
            collisions: Collisions to avoid.
            distance: Least distance between configurations [rad, m].
            point: The measured point in the tip; default the origin of the tool.

        Raises:
            RobotError: If limits of the URDF cross.
            OptionError: If limits of the setup match no joint or leave nothing, or
                the distance is negative.
        """
        if not 0.0 <= distance < np.inf:
            raise OptionError(
                "the distance between configurations is out of range",
                value=distance,
                allowed="0 or more",
            )
        lower, upper = _limits(problem)
        point = problem.error.tool if point is None else point
        return Workspace(problem, lower, upper, point, collisions, distance)

    @property
    def targets(self) -> tuple[str, ...]:
        """The targets that configurations look at in turn."""
        return tuple(self.problem.measurement.targets) or ("",)

    def inside(self, q: Floats, target: Sequence[str]) -> Booleans:
        """Whether each configuration may be measured.

        Args:
            q: Configurations, shape (N, n) [rad, m].
            target: Target of each.

        Returns:
            True for those within the limits, measurable and free, shape (N,).
        """
        return np.asarray(sum(self._refusals(q, target).values()) == 0)

    def allowed(self, q: Floats, target: Sequence[str]) -> Booleans:
        """The same as `inside`, for a set that must also keep its distances."""
        return self.inside(q, target) & self.apart(q)

    def apart(self, q: Floats) -> Booleans:
        """Whether each configuration of a set keeps its distance from all others.

        Args:
            q: Configurations, shape (K, n) [rad, m].
        """
        if self.distance == 0.0:
            return np.ones(len(q), bool)
        between = np.abs(q[:, None] - q[None]).max(axis=2)
        np.fill_diagonal(between, np.inf)
        return np.asarray((between >= self.distance).all(axis=1))

    def candidates(
        self,
        count: int,
        rng: np.random.Generator,
        progress: Callable[[str, float], bool | None] | None = None,
        least: int = 0,
    ) -> Candidates:
        """Quasi-random configurations, evenly spread over what is allowed.

        Args:
            count: Number of candidates wanted; fewer come where little is allowed.
            rng: Source of chance for the start of the sequence.
            progress: Told the name of this stage and the part that is done; returns
                True to be content with the least number.
            least: Number without which nothing can be planned.

        Raises:
            InputError: If none of many is allowed; says what refused them.
        """
        n = len(self.lower)
        shift, taken = rng.random(n), 0
        found, targets = np.empty((0, n)), list[str]()
        refused: dict[str, int] = {}
        names, budget = self.targets, max(LEAST_DRAWS, DRAWS * count)
        # Where nothing is allowed, more of the same would be a loop.
        while len(found) < count and taken < (budget if len(found) else LEAST_DRAWS):
            part = max(len(found) / count, taken / budget)
            enough = progress is not None and progress("candidates", part)
            if enough and len(found) >= max(least, 1):
                break
            q = self.lower + _quasi_random(shift, taken, BLOCK) * (
                self.upper - self.lower
            )
            target = [names[(taken + k) % len(names)] for k in range(BLOCK)]
            taken += BLOCK
            refusals = self._refusals(q, target)
            for reason, rows in refusals.items():
                refused[reason] = refused.get(reason, 0) + int(rows.sum())
            free = np.flatnonzero(sum(refusals.values()) == 0)
            if self.distance > 0.0:
                free = self._spread(q, free, found, count)
            free = free[: count - len(found)]
            found = np.concatenate([found, q[free]])
            targets += [target[k] for k in free]
        if not len(found):
            reasons = ", ".join(f"{n} {why}" for why, n in refused.items() if n)
            raise InputError(
                f"none of {taken} configurations within the joint limits can be "
                f"planned: {reasons}",
                allowed="wider limits, a larger region, or fewer obstacles",
            )
        return Candidates(found, tuple(targets), taken)

    def _refusals(self, q: Floats, target: Sequence[str]) -> dict[str, Booleans]:
        """Configurations by what first refuses them, each of shape (N,)."""
        problem, error = self.problem, self.problem.error
        of_robot, instrument = problem.split(np.zeros(len(problem.parameters)))
        beyond = np.asarray(((q < self.lower) | (q > self.upper)).any(axis=1))
        refusals: dict[str, Booleans] = {"beyond the limits": beyond}
        left = ~beyond
        F = error.tip_poses(q, of_robot)
        if problem.setup.region is not None:
            measured = F @ self.point.homogeneous
            within = problem.setup.region.contains(measured[:, :3, 3])
            refusals["outside the region"] = left & ~within
            left &= within
        T = error.base.homogeneous @ F @ error.tool.homogeneous
        # The real robot must be seen there too, and it is not quite where it should be.
        swaying = (T[:, None] @ SWAY).reshape(-1, 4, 4)
        repeated = [name for name in target for _ in SWAY]
        each = problem.measurement.observable(swaying, instrument, repeated)
        seen = np.asarray(each.reshape(-1, len(SWAY)).all(axis=1))
        refusals["not measurable"] = left & ~seen
        left &= seen
        if self.collisions is not None:
            free = np.ones(len(q), bool)
            free[left] = self.collisions.free(q[left])
            refusals["in collision"] = ~free
        return refusals

    def _spread(
        self, q: Floats, free: NDArray[np.intp], found: Floats, count: int
    ) -> NDArray[np.intp]:
        """The free configurations that keep their distance from all before them."""
        kept: list[int] = []
        if len(found):
            between = np.abs(q[free, None] - found[None]).max(axis=2)
            free = free[between.min(axis=1) >= self.distance]
        for k in free:
            if len(found) == count:
                break
            if (np.abs(found - q[k]).max(axis=1) >= self.distance).all():
                kept.append(int(k))
                found = np.concatenate([found, q[k : k + 1]])
        return np.array(kept, np.intp)


def _limits(problem: Problem) -> tuple[Floats, Floats]:
    """Joint limits of the chain, narrowed by the setup."""
    chain, setup = problem.error.chain, problem.setup
    if chain.inverted:
        raise RobotError(
            f"inverted limits of joint '{chain.inverted[0]}': lower is above upper",
            file=chain.robot.file,
        )
    # Controllers complain at the very limit.
    margin = np.minimum(MARGIN, 0.01 * (chain.upper - chain.lower))
    lower, upper = chain.lower + margin, chain.upper - margin
    for pattern, (low, high) in setup.limits.items():
        meant = matching(pattern, chain.joints)
        if not meant:
            raise OptionError(
                f"limits match no joint of the chain: '{pattern}'"
                f"{nearest(pattern, chain.joints)}",
                allowed=", ".join(chain.joints),
            )
        for k in meant:
            lower[k], upper[k] = max(lower[k], low), min(upper[k], high)
            if lower[k] > upper[k]:
                raise OptionError(
                    f"limits of '{chain.joints[k]}' leave nothing",
                    value=[low, high],
                    allowed=f"a part of {chain.lower[k]:.4g} to {chain.upper[k]:.4g}",
                )
    # Rounded inwards, where there is room: people read these numbers.
    tidy = np.ceil(lower * TIDY) / TIDY, np.floor(upper * TIDY) / TIDY
    room = tidy[0] < tidy[1]
    return np.where(room, tidy[0], lower), np.where(room, tidy[1], upper)


def _quasi_random(shift: Floats, begin: int, count: int) -> Floats:
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
