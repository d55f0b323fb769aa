"""The training region of a residual model, and the fading outside."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from calib_pin.kinematics.spatial import Floats
from calib_pin.residual_models.documents import Array

ANCHORS = 1000
"""Training configurations that a region remembers; more do not change its shape."""

PIECE = 512
"""Configurations handled at once, so that intermediate values stay in the cache."""


@dataclass(frozen=True)
class Angles:
    """Joint positions as angles, on whose circle all models are functions.

    A prismatic joint's range becomes half a turn, so that its ends stay apart; far
    beyond them the angle stands still and never comes round.

    Attributes:
        center: Position of angle zero, shape (n,); zero for a joint that turns.
        rate: Angle per position, shape (n,); one for a joint that turns.
        farthest: Largest angle of a prismatic joint, shape (n,) [rad]; zero for a
            joint that turns, which has none.
    """

    center: Annotated[Floats, Array("n")]
    rate: Annotated[Floats, Array("n", positive=True)]
    farthest: Annotated[Floats, Array("n")]

    @staticmethod
    def of(q: Floats, revolute: NDArray[np.bool_]) -> Angles:
        """The angles for training configurations.

        Args:
            q: Joint positions, shape (N, n) [rad, m].
            revolute: Whether each joint turns, shape (n,).
        """
        lower, upper = q.min(axis=0), q.max(axis=0)
        # A joint that never moved teaches nothing; any scale will do.
        width = np.where(upper > lower, upper - lower, 1.0)
        return Angles(
            center=np.where(revolute, 0.0, 0.5 * (lower + upper)),
            rate=np.where(revolute, 1.0, np.pi / width),
            farthest=np.where(revolute, 0.0, 3.0),
        )

    def __call__(self, q: Floats) -> Floats:
        """Angles, shape (N, n) -> (N, n) [rad]."""
        angle = (q - self.center) * self.rate
        ends = np.clip(angle, -self.farthest, self.farthest)
        return np.where(self.farthest > 0.0, ends, angle)

    def points(self, q: Floats) -> Floats:
        """Sines, then cosines of the angles, shape (N, n) -> (N, 2 n)."""
        angle = self(q)
        return np.concatenate([np.sin(angle), np.cos(angle)], axis=1)


@dataclass(frozen=True)
class TrainedRegion:
    """The configurations near those of the training.

    Near means two things: closer to some training configuration than these are to each
    other, as points (sin, cos); and every joint within the arc of the circle that it
    covered, because a joint that hardly moved has no part in the distance.

    Attributes:
        angles: Joint positions as angles.
        anchors: Training configurations, shape (K, n) [rad, m].
        reach: Distance up to which a point is near; at twice that it is far.
        middle: Middle of the arc of each joint, shape (n,) [rad].
        half: Half the arc, with a margin, shape (n,) [rad].
        fade: Angle beyond the arc at which a joint is far, shape (n,) [rad].
    """

    angles: Angles
    anchors: Annotated[Floats, Array("K n")]
    reach: Annotated[float, Array(positive=True)]
    middle: Annotated[Floats, Array("n")]
    half: Annotated[Floats, Array("n", positive=True)]
    fade: Annotated[Floats, Array("n", positive=True)]

    @staticmethod
    def of(
        q: Floats, revolute: NDArray[np.bool_], rng: np.random.Generator
    ) -> TrainedRegion:
        """The region of training configurations.

        Args:
            q: Joint positions, shape (N, n) [rad, m].
            revolute: Whether each joint turns, shape (n,).
            rng: Chooses the configurations that are kept of very many.
        """
        angles = Angles.of(q, revolute)
        anchors = np.unique(q, axis=0)
        if len(anchors) > ANCHORS:
            anchors = anchors[np.sort(rng.permutation(len(anchors))[:ANCHORS])]
        points = angles.points(anchors)
        squares = _squares(points, points)
        np.fill_diagonal(squares, np.inf)
        spacing = np.sqrt(squares.min(axis=1)) if len(anchors) > 1 else np.ones(1)
        middle, half = _arcs(angles(q))
        return TrainedRegion(
            angles=angles,
            anchors=anchors,
            reach=max(1.25 * float(np.quantile(spacing, 0.99)), 1e-3),
            middle=middle,
            # Extremes of a sample fall short of those of its population.
            half=half + np.maximum(0.1 * half, 0.01),
            fade=np.maximum(0.3 * half, 0.05),
        )

    def weight(self, q: Floats) -> Floats:
        """Weight of a correction, 1 inside to 0 far outside, shape (N,)."""
        points, near = self._points, self.angles.points(q)
        nearest = np.empty(len(q))
        for start in range(0, len(q), PIECE):
            piece = slice(start, start + PIECE)
            nearest[piece] = _squares(near[piece], points).min(axis=1)
        result = _fading(np.sqrt(nearest) / self.reach - 1.0)
        turn = self.angles(q) - self.middle
        away = np.abs((turn + np.pi) % (2.0 * np.pi) - np.pi)
        return np.asarray(result * _fading((away - self.half) / self.fade).prod(axis=1))

    def inside(self, q: Floats) -> NDArray[np.bool_]:
        """Whether a correction counts fully, shape (N,)."""
        return np.asarray(self.weight(q) == 1.0)

    @cached_property
    def _points(self) -> Floats:
        return self.angles.points(self.anchors)


def _squares(a: Floats, b: Floats) -> Floats:
    """Squared distances of points (sin, cos), shape (A, 2 n), (B, 2 n) -> (A, B)."""
    # Both have the length sqrt(n).
    return np.asarray(np.maximum(a.shape[1] - 2.0 * (a @ b.T), 0.0))


def _fading(excess: Floats) -> Floats:
    """Smooth step from 1 at 0 and below to 0 at 1 and above."""
    t = 1.0 - np.clip(excess, 0.0, 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t))


def _arcs(angle: Floats) -> tuple[Floats, Floats]:
    """Middle and half width of what covers a circle but for its largest gap, (n,)."""
    turned = np.sort(angle % (2.0 * np.pi), axis=0)
    following = np.concatenate([turned[1:], turned[:1] + 2.0 * np.pi])
    gap = following - turned
    widest, joints = gap.argmax(axis=0), np.arange(angle.shape[1])
    half = np.pi - 0.5 * gap[widest, joints]
    return following[widest, joints] + half, half
