"""Aims: the measurements that may be made at one configuration.

A tracker sees all its reflectors and an image shows all corners of a board, while a
beam meets one plane and a wire hangs on one anchor. Instruments of different kinds that
stand at one station and look at one tool measure together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from calib_pin.errors import OptionError
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.terms import Term
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
        for key in keys:
            term = problem.terms[key]
            if term.error.chain.joints:
                names = tuple(term.measurement.targets) or ("",)
                places.setdefault(key[1:], {})[key] = names
        if not places:
            raise OptionError("nothing that is measured moves with the robot")
        aims: list[Aim] = []
        members: dict[BlockKey, dict[int, int]] = {}
        for group in places.values():
            shared = [key for key in group if declared(key.model).at_once]
            single = [
                (key, name) for key in group if key not in shared for name in group[key]
            ]
            distinct = {name for key in shared for name in group[key]}
            only = distinct.pop() if len(distinct) == 1 else ""
            for key, name in single or [(shared[0], only)]:
                if single:
                    place = group[key].index(name)
                    members.setdefault(key, {})[len(aims)] = place
                for other in shared:
                    members.setdefault(other, {})[len(aims)] = 0
                aims.append(Aim(next(iter(group)), name))
        looks = []
        for key, of_aim in members.items():
            codes = np.full(len(aims), -1)
            codes[list(of_aim)] = list(of_aim.values())
            names, at_once = places[key[1:]][key], declared(key.model).at_once
            looks.append(Look(problem.terms[key], names, at_once, codes))
        looks.sort(key=lambda look: not look.at_once)
        sides = sides_tried(problem)
        if not len(sides):
            return Aims(tuple(aims), tuple(looks))
        count = len(aims)
        return Aims(
            tuple(aim._replace(side=tuple(side)) for aim in aims for side in sides),
            tuple(
                replace(
                    look,
                    of_aim=np.repeat(look.of_aim, len(sides)),
                    sides=np.tile(sides[:, look.term.columns], (count, 1)),
                )
                for look in looks
            ),
        )


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
