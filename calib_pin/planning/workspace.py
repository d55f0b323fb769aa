"""Where can be measured, and what: limits, line of sight, region, collisions, aims.

A tracker sees all its reflectors and an image shows all corners of a board, while a
beam meets one plane and a wire hangs on one anchor. Instruments of different kinds that
stand at one station and look at one tool measure together: an aim is what may be
measured at one configuration.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from calib_pin.errors import InputError, OptionError, RobotError, nearest
from calib_pin.estimation.nominal import DRAWS, lacking_frames
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.terms import Term
from calib_pin.kinematics.collision import Collisions
from calib_pin.kinematics.joint_space import quasi_random
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import MEASUREMENT_MODELS, MeasurementModel, declared
from calib_pin.observations import (
    UNSTATED,
    BlockKey,
    Booleans,
    Conditions,
    Indices,
    Labels,
    Signs,
)
from calib_pin.parameterizations import needed_conditions
from calib_pin.parameters import matching
from calib_pin.validation.tool_accuracy import SAMPLES

SWAY = np.array(
    [
        pin.exp6(sway * twist).homogeneous
        for twist in np.eye(6)
        for sway in (-0.02, 0.02)
    ]
)
"""Motions of the tool by 20 mm or 20 mrad, more than a robot's errors, (12, 4, 4)."""


class Aim(NamedTuple):
    """The measurements that are made of one tool at a configuration.

    Attributes:
        key: The first block of those of a chain, a station and a tool.
        target: The target of an instrument that measures one at a time, or the only one
            that there is; else empty.
        side: Sign of the last motion with which each joint shall come, n of them; empty
            where that makes no difference.
    """

    key: BlockKey
    target: str
    side: tuple[int, ...] = ()


@dataclass(frozen=True)
class Look:
    """An instrument and its targets, all that it sees at once or one at a time.

    Attributes:
        part: The instrument before its chain, about its references.
        names: The L targets.
        at_once: Whether all that it sees are measured at a configuration.
        of_aim: Position of the target of each aim, zero for all at once, -1 for aims
            without this instrument.
        sides: Side from which each joint of its chain comes for each aim, (A, n); of
            shape (0, 0) where that makes no difference.
    """

    term: Term
    names: tuple[str, ...]
    at_once: bool
    of_aim: Indices
    sides: Signs = field(default_factory=lambda: np.zeros((0, 0), np.int8))

    def conditions(self, aim: Indices) -> Conditions:
        """Conditions in which aims, shape (N,), are measured, as far as they matter."""
        return Conditions(direction=self.sides[aim]) if self.sides.size else UNSTATED

    @property
    def each(self) -> int:
        """Largest number of targets that are measured at a configuration."""
        return len(self.names) if self.at_once else 1

    def targets(self, aim: Indices) -> Indices:
        """Positions of the targets that may be measured, (N,) -> (N, each)."""
        if self.at_once:
            return np.tile(np.arange(self.each), (len(aim), 1))
        return self.of_aim[aim][:, None]

    def seen(self, q: Floats, aim: Indices) -> Booleans:
        """Which targets are seen, from wherever the real tool may be as well.

        The real robot is not quite where it should be.

        Args:
            q: Configurations of all joints, shape (N, n) [rad, m].
            aim: What is measured at each, shape (N,).

        Returns:
            True for targets that are seen, shape (N, each).
        """
        term, shape = self.term, (len(q), len(SWAY), self.each)
        if type(term.measurement).observable is MeasurementModel.observable:
            return np.ones((len(q), self.each), bool)
        T = term.error.poses(q[:, term.columns], np.zeros(len(term.error.screws)))
        swaying = np.repeat((T[:, None] @ SWAY).reshape(-1, 4, 4), self.each, axis=0)
        looked = np.repeat(self.targets(aim), len(SWAY), axis=0).reshape(-1)
        instrument = np.zeros(len(term.measurement.parameters))
        visible = term.measurement.observable(
            swaying, instrument, Labels(self.names, looked)
        )
        return np.asarray(visible.reshape(shape).all(axis=1))

    def measured(self, q: Floats, aim: Indices) -> tuple[Indices, Labels]:
        """Configuration and target of all that is seen at some, each of shape (M,)."""
        (rows,) = np.nonzero(self.of_aim[aim] >= 0)
        seen = self.seen(q[rows], aim[rows])
        codes = self.targets(aim[rows])[seen]
        return np.repeat(rows, seen.sum(axis=1)), Labels(self.names, codes)


@dataclass(frozen=True)
class Aims:
    """The aims that there are, and the instruments that measure them.

    Attributes:
        each: The aims.
        looks: The instruments; those that measure one target at a time are last.
    """

    each: tuple[Aim, ...]
    looks: tuple[Look, ...]

    @staticmethod
    def of(problem: Problem, keys: Sequence[BlockKey]) -> Aims:
        """The aims of blocks.

        Args:
            problem: Chains, frames and instruments.
            keys: The blocks that are planned; of what stands still nothing is.

        Raises:
            OptionError: If none of them is of a chain that moves.
        """
        places: dict[tuple[str, ...], dict[BlockKey, tuple[str, ...]]] = {}
        codes: dict[BlockKey, list[int]] = {}
        for key in keys:
            term = problem.terms[key]
            if term.error.chain.joints:
                names = tuple(term.measurement.targets) or ("",)
                places.setdefault(key[1:], {})[key], codes[key] = names, []
        if not places:
            raise OptionError("nothing that is measured moves with the robot")
        aims: list[Aim] = []
        for group in places.values():
            shared = [key for key in group if declared(key.model).at_once]
            distinct = {name for key in shared for name in group[key]}
            only = distinct.pop() if len(distinct) == 1 else ""
            single = [
                (key, place, name)
                for key in (key for key in group if key not in shared)
                for place, name in enumerate(group[key])
            ]
            for block, place, name in single or [(shared[0], 0, only)]:
                aims.append(Aim(next(iter(group)), name))
                for key, of_aim in codes.items():
                    together = 0 if key in shared else -1
                    of_aim.append(place if key == block else together)
        sides = sides_tried(problem)
        every = sides.tolist() or [()]
        looks = [
            Look(
                problem.terms[key],
                places[key[1:]][key],
                declared(key.model).at_once,
                np.repeat(of_aim, len(every)),
                np.tile(sides[:, problem.terms[key].columns], (len(aims), 1)),
            )
            for key, of_aim in codes.items()
        ]
        looks.sort(key=lambda look: not look.at_once)
        turned = (aim._replace(side=tuple(side)) for aim in aims for side in every)
        return Aims(tuple(turned), tuple(looks))


def sides_tried(problem: Problem) -> Signs:
    """Sides from which joints may come to a configuration, shape (S, n).

    None where that makes no difference. They are rows of a Hadamard matrix (Sylvester
    1867): each joint comes from either side equally often, whatever the others do.
    """
    count = len(problem.chains.joints)
    if "direction" not in needed_conditions(problem.setup.parameters):
        return np.zeros((0, count), np.int8)
    H = np.ones((1, 1), np.int8)
    while len(H) <= count:
        H = np.block([[H, H], [H, -H]])
    return H[:, 1 : count + 1]


def require_plannable(keys: Sequence[BlockKey]) -> None:
    """Refuse instruments that do not measure one configuration at any pose.

    Raises:
        OptionError: If there is one.
    """
    for key in keys:
        if not declared(key.model).plannable:
            raise OptionError(
                "configurations are planned for instruments that measure each of them "
                "by itself and without contact",
                value=str(key),
                allowed=", ".join(
                    m for m in MEASUREMENT_MODELS if declared(m).plannable
                ),
            )


LEAST_DRAWS = 60_000
"""Quasi-random configurations tried before the first that is allowed."""

MARGIN = 0.01
"""Distance kept from the limits of the URDF, at most 1 % of the range [rad, m]."""

TIDY = 1e6
"""Reciprocal of the last digit of planned joint positions [1/rad, 1/m]."""

BLOCK = 1000
"""Configurations that are tried at once."""


@dataclass(frozen=True)
class Candidates:
    """Configurations that may be measured.

    Attributes:
        q: Joint positions, shape (C, n) [rad, m].
        aim: Position of what is measured there among those of the workspace, (C,).
        drawn: Position of each among the configurations that were tried, (C,).
    """

    q: Floats
    aim: Indices
    drawn: Indices

    @property
    def tried(self) -> int:
        """Number of configurations that were tried for them."""
        return int(self.drawn[-1]) + 1


@dataclass(frozen=True)
class Workspace:
    """The configurations that may be measured.

    Attributes:
        problem: Chains, frames and instruments.
        lower: Lower position limits, shape (n,) [rad, m].
        upper: Upper position limits, shape (n,) [rad, m].
        aims: What can be measured at a configuration.
        points: The measured point in the tip, whose place the region limits, by the
            block of an aim; default the origin of the tool.
        collisions: Collisions to avoid; None if no shapes are known.
    """

    problem: Problem
    lower: Floats
    upper: Floats
    aims: Aims
    points: Mapping[BlockKey, pin.SE3]
    collisions: Collisions | None = None

    @staticmethod
    def create(
        problem: Problem,
        collisions: Collisions | None = None,
        aims: Aims | None = None,
        points: Mapping[BlockKey, pin.SE3] | None = None,
    ) -> Workspace:
        """The workspace of a problem, with the limits of its setup.

        Args:
            problem: Chains, frames and instruments.
            collisions: Collisions to avoid.
            aims: What can be measured at a configuration; default by all instruments.
            points: The measured points, see `points`.

        Raises:
            RobotError: If limits of the URDF cross.
            OptionError: If limits of the setup match no joint or leave nothing.
        """
        lower, upper = joint_limits(problem)
        aims = aims or Aims.of(problem, tuple(problem.terms))
        return Workspace(problem, lower, upper, aims, points or {}, collisions)

    @property
    def bounds(self) -> Floats:
        """Lower and upper limit of each joint, shape (n, 2) [rad, m]."""
        return np.column_stack([self.lower, self.upper])

    def settled(self, q: Floats, aim: Indices) -> Floats:
        """Configurations where other chains rest and mimic joints follow.

        Args:
            q: Configurations, shape (N, n) [rad, m].
            aim: What is measured at each, shape (N,).
        """
        moving, rest = self._moving
        return self.problem.chains.follow(np.where(moving[aim], q, rest))

    def inside(self, q: Floats, aim: Indices) -> Booleans:
        """Whether each configuration may be measured.

        Args:
            q: Configurations, shape (N, n) [rad, m].
            aim: What is measured at each, shape (N,).

        Returns:
            True for those within the limits, measurable and free, shape (N,).
        """
        return np.asarray(sum(self.refusals(q, aim).values()) == 0)

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
        shift, draws = rng.random(len(self.lower)), 0
        q, aim, drawn = np.empty((0, len(shift))), np.empty(0, int), np.empty(0, int)
        refused: dict[str, int] = {}
        budget = max(LEAST_DRAWS, DRAWS * count)
        # Where nothing is allowed, more of the same would be a loop.
        while len(q) < count and draws < (budget if len(q) else LEAST_DRAWS):
            part = max(len(q) / count, draws / budget)
            enough = progress is not None and progress("candidates", part)
            if enough and len(q) >= max(least, 1):
                break
            new, of_new, places, reasons = self._block(shift, draws)
            draws += BLOCK
            for reason, number in reasons.items():
                refused[reason] = refused.get(reason, 0) + number
            q, aim = np.concatenate([q, new]), np.concatenate([aim, of_new])
            drawn = np.concatenate([drawn, places])
        if not len(q):
            why = ", ".join(f"{n} {reason}" for reason, n in refused.items() if n)
            allowed = "wider limits, a larger region, or fewer obstacles"
            if refused.get("not measurable") == draws:
                lacking = lacking_frames(self.problem, self.problem.terms)
                allowed = f"a setup with {lacking}" if lacking else allowed
            raise InputError(
                f"none of {draws} configurations within the joint limits can be "
                f"planned: {why}",
                file=self.problem.setup.file or None,
                allowed=allowed,
            )
        return Candidates(q[:count], aim[:count], drawn[:count])

    def _block(
        self, shift: Floats, begin: int
    ) -> tuple[Floats, Indices, Indices, dict[str, int]]:
        """Try the configurations of the sequence from one on.

        Returns:
            Those that may be measured, shape (C, n), what is measured at each, where
            they are in the sequence, and the number of the others by what refused them.
        """
        unit = quasi_random(shift, begin, BLOCK)
        q = self.lower + unit * (self.upper - self.lower)
        aim = (begin + np.arange(BLOCK)) % len(self.aims.each)
        q = self.settled(q, aim)
        refusals = self.refusals(q, aim)
        free = sum(refusals.values()) == 0
        refused = {reason: int(rows.sum()) for reason, rows in refusals.items()}
        return q[free], aim[free], begin + np.flatnonzero(free), refused

    def unmeasurable(self, candidates: Candidates) -> tuple[str, ...]:
        """The targets that no candidate can measure."""
        every, seen = dict[str, None](), set[str]()
        for look in self.aims.looks:
            every |= dict.fromkeys(look.names)
            seen |= {*look.measured(candidates.q, candidates.aim)[1]}
        return tuple(name for name in every if name not in seen)

    def refusals(self, q: Floats, aim: Indices) -> dict[str, Booleans]:
        """Configurations by what first refuses them, each of shape (N,)."""
        beyond = np.asarray(((q < self.lower) | (q > self.upper)).any(axis=1))
        refusals: dict[str, Booleans] = {"beyond the limits": beyond}
        remaining = ~beyond
        if self.problem.setup.region is not None:
            refusals["outside the region"] = remaining & ~self._in_region(q, aim)
            remaining &= ~refusals["outside the region"]
        visible = np.zeros(len(q), bool)
        for look in self.aims.looks:
            rows = np.flatnonzero(look.of_aim[aim] >= 0)
            sighted = look.seen(q[rows], aim[rows]).any(axis=1)
            # One that measures a certain target must see that; of others any will do.
            visible[rows] = visible[rows] | sighted if look.at_once else sighted
        refusals["not measurable"] = remaining & ~visible
        remaining &= visible
        if self.collisions is not None:
            free = np.ones(len(q), bool)
            free[remaining] = self.collisions.free(q[remaining])
            refusals["in collision"] = ~free
        return refusals

    def _in_region(self, q: Floats, aim: Indices) -> Booleans:
        """Whether the measured points are in the region, shape (N,)."""
        within, region = np.ones(len(q), bool), self.problem.setup.region
        assert region is not None
        for key in dict.fromkeys(one.key for one in self.aims.each):
            error = self.problem.terms[key].error
            rows = np.flatnonzero([self.aims.each[k].key == key for k in aim])
            local = q[rows][:, self.problem.terms[key].columns]
            F = error.tip_poses(local, np.zeros(len(error.screws)))
            points = F @ self.points.get(key, error.tool).homogeneous
            within[rows] = region.contains(points[:, :3, 3])
        return within

    @cached_property
    def _moving(self) -> tuple[Booleans, Floats]:
        """Whether each joint moves for each aim, (A, n), and where it rests, (n,)."""
        chains = self.problem.chains
        moving = np.zeros((len(self.aims.each), len(chains.joints)), bool)
        for row, aim in zip(moving, self.aims.each, strict=True):
            row[self.problem.terms[aim.key].columns] = True
            for name, mimic in chains.mimics.items():
                if row[chains.joints.index(name)]:
                    row[chains.joints.index(mimic.leader)] = True
        rest = np.clip(np.zeros((1, len(self.lower))), self.lower, self.upper)
        if self.collisions is None or moving.all() or self.collisions.free(rest).all():
            return moving, rest[0]
        # Arms that hang through the body would refuse all: the nearest that do not.
        q = chains.random_configurations(SAMPLES, np.random.default_rng(0))
        q = np.round(np.clip(q, self.lower, self.upper) * TIDY) / TIDY
        free = q[self.collisions.free(q)]
        if len(free):
            rest = free[[np.abs(free - rest).max(axis=1).argmin()]]
        return moving, rest[0]


def joint_limits(problem: Problem) -> tuple[Floats, Floats]:
    """Joint limits of the chains, narrowed by the setup."""
    chain, setup = problem.chains, problem.setup
    inverted = [joint for name in chain.names for joint in chain[name].inverted]
    if inverted:
        raise RobotError(
            f"inverted limits of joint '{inverted[0]}': lower is above upper",
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
