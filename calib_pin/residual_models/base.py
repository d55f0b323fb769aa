"""Residual model, the base of all, its training data, and its place in a robot."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import InputError
from calib_pin.kinematics.spatial import Floats
from calib_pin.residual_models.region import TrainedRegion

Space = Literal["joint", "tip"]

PARTS = 5
"""Parts of the measurements, of which one is always held out."""

INDEPENDENT = 1e-8
"""Directions of the shift with a smaller part of the largest effect do not move."""

CHANCE = 2.0
"""Standard deviations that a gain must have; otherwise the correction is zero."""

MUCH = 0.9
"""Part of the errors of single joints' functions that functions of all joints must
leave at most: they do not carry over to other motions, and near the measurements alone
a few percent are no reason to give that up (UR10: 0.257 and 0.273 of the residuals,
but 8 mm at the edge of the region)."""

UNOBSERVED = 1e-12
"""Unit of corrections that are not observed: they stay at nothing [rad, m]."""

FREE = 1e4
"""Variance of what a free direction explains, in squares of the residual."""


@dataclass(frozen=True)
class Linearized:
    """Whitened residuals of N measurements and their derivatives.

    Attributes:
        residual: Predicted minus measured in standard deviations, shape (N, d).
        by_correction: Derivative by the correction, shape (N, d, m); m is n for joint
            positions, 6 for a body twist of the tool.
        by_shift: Derivative by the shift of the geometry, shape (N, d, P).
    """

    residual: Floats
    by_correction: Floats
    by_shift: Floats


@dataclass(frozen=True)
class Shifts:
    """Directions in which the parameters of a fit may shift, and their prior.

    The fit has taken along what it could of the effects that are to be learned, so they
    are estimated together: a shift of the parameters beside the correction. Left free
    it would fit the geometry to a correction that holds near the measurements alone. So
    errors of the robot keep the size that they are expected to have about *nominal*,
    one size for each kind of parameter, which the likelihood tells with the rest of the
    covariance.

    Attributes:
        about: Value of each direction at the fit, from nominal, shape (P,).
        kinds: For each kind of parameter what its errors of expected size contribute to
            the directions, shape (P, p) each. A direction of no kind is free.
    """

    about: Floats
    kinds: tuple[Floats, ...] = ()

    def __len__(self) -> int:
        """Number P of directions."""
        return len(self.about)

    def root(self, by_shift: Floats, square: float, sizes: Floats) -> Floats:
        """A root R of the covariance `R R^T` of the shift about nominal, shape (P, k).

        Args:
            by_shift: Derivative of the residuals by the shift, shape (N, d, P).
            square: Mean square of the residuals, of which free directions may explain
                `FREE` times as much.
            sizes: Variance of each kind, in squares of the expected size.
        """
        squares = np.einsum("ndp,ndp->p", by_shift, by_shift) * self._free
        shown = squares > 0.0
        free = np.eye(len(self))[:, shown]
        if shown.any():
            values = by_shift.shape[0] * by_shift.shape[1]
            free *= np.sqrt(square * FREE * values / squares[shown])
        kinds = zip(sizes, self.kinds, strict=True)
        return np.hstack([free, *(np.sqrt(size) * kind for size, kind in kinds)])

    @property
    def _free(self) -> NDArray[np.bool_]:
        """Whether each direction is of no kind, shape (P,)."""
        return np.asarray(~np.hstack([np.zeros((len(self), 1)), *self.kinds]).any(1))


@dataclass(frozen=True)
class TrainingRows:
    """Rows to learn from, as functions of a correction and a shift.

    The geometric fit has taken along what it could of the effects that are to be
    learned: it is biased, and no correction of the joints undoes a link that is too
    long where the arm is stretched. So a model may learn, along with the correction, a
    shift of the geometry in the P directions that the fit could tell. It belongs to the
    correction, and the fit itself is held. With P = 0 there is none.

    Attributes:
        q: Commanded joint positions, shape (N, n) [rad, m].
        groups: Rows of one label repeat one configuration and stay together, (N,).
        revolute: Whether each joint turns, shape (n,).
        by_joint: Residuals at joint positions q + dq and a shift, from dq, shape
            (N, n), and the shift, shape (P,), in units in which its directions compare.
        by_tip: Residuals at tool poses T Exp(xi) and a shift, from xi, shape (N, 6).
        values: Number d of residual components of each row.
        subset: Some of the rows alone, from their positions, ascending.
        shift: Its P directions, and what is known of them.
    """

    q: Floats
    groups: NDArray[np.int64]
    revolute: NDArray[np.bool_]
    by_joint: Callable[[Floats, Floats], Linearized]
    by_tip: Callable[[Floats, Floats], Linearized]
    values: int
    subset: Callable[[NDArray[np.int64]], TrainingRows]
    shift: Shifts = field(default_factory=lambda: Shifts(np.zeros(0)))

    def evaluate(self, space: Space) -> Callable[[Floats, Floats], Linearized]:
        """`by_joint` or `by_tip`."""
        return self.by_joint if space == "joint" else self.by_tip

    def plain(self, space: Space) -> Linearized:
        """Residuals without a correction."""
        size = self.q.shape[1] if space == "joint" else 6
        zero = np.zeros((len(self.q), size)), np.zeros(len(self.shift))
        return self.evaluate(space)(*zero)

    def folds(self, rng: np.random.Generator) -> NDArray[np.int64]:
        """Part 0 to `PARTS` - 1 of each row, groups undivided, shape (N,)."""
        names, labels = np.unique(self.groups, return_inverse=True)
        part = np.empty(len(names), np.int64)
        part[rng.permutation(len(names))] = np.arange(len(names)) % PARTS
        return np.asarray(part[labels])

    def require(self, model: str, directions: int) -> None:
        """Refuse too few measurements.

        Args:
            model: Name of the residual model.
            directions: Least number of directions that a correction describes.

        Raises:
            InputError: With the number of configurations that are needed.
        """
        distinct = len(np.unique(self.groups))
        count = (PARTS - 1) * self.values
        enough = -(-(len(self.shift) + directions) * PARTS // count)
        needed = max(4 * PARTS, enough)
        if distinct < needed:
            raise InputError(
                f"a {model} needs at least {needed} different configurations to learn "
                f"from, there are {distinct}"
            )


class ResidualModel(Protocol):
    """A learned correction of errors that geometry cannot explain."""

    @property
    def name(self) -> str:
        """Name as users write it."""
        ...

    @property
    def space(self) -> Space:
        """Kind of the correction: `joint` positions to add, or a twist of the `tip`.

        A twist acts as T <- T Exp(xi) on the tool pose.
        """
        ...

    @property
    def region(self) -> TrainedRegion:
        """Region of the training data."""
        ...

    def weight(self, q: Floats) -> Floats:
        """Weight from 1 where the model holds to 0 where it must not be used, (N,).

        Args:
            q: Commanded joint positions, shape (N, n) [rad, m].
        """
        ...

    @property
    def shift(self) -> Floats:
        """Shift of the geometry that belongs to the correction, shape (P,)."""
        ...

    def __call__(self, q: Floats) -> Floats:
        """Corrections, shape (N, n) [rad, m] or (N, 6) [m, rad].

        Args:
            q: Commanded joint positions, shape (N, n) [rad, m].
        """
        ...

    def left_out(
        self,
        rows: TrainingRows,
        masks: Sequence[NDArray[np.bool_]],
        rng: np.random.Generator,
    ) -> Sequence[ResidualModel]:
        """Models of the same kind that some measurements have no part in.

        What is searched, as a covariance is, was found with all of them.

        Args:
            rows: The N measurements that this one was learned from.
            masks: Those to leave out, shape (N,) each.
            rng: Source of whatever is learned anew.
        """
        ...

    def document(self) -> dict[str, Any]:
        """Numbers, strings and lists from which `restore` makes the same model."""
        ...


@dataclass(frozen=True)
class LearnedCorrection:
    """A residual model, with its shift of the geometry in error parameters.

    Attributes:
        model: The residual model.
        shift: Change of the P parameters of the error model, shape (P,).
    """

    model: ResidualModel
    shift: Floats

    @property
    def space(self) -> Space:
        """Space of the correction."""
        return self.model.space

    def __call__(self, q: Floats) -> Floats:
        """Corrections, shape (N, n) -> (N, n) [rad, m] or (N, 6) [m, rad]."""
        return self.model(q)

    def weight(self, q: Floats) -> Floats:
        """Weight from 1 near training configurations to 0 far away, shape (N,)."""
        return self.model.weight(q)


def convincing(before: Floats, after: Floats, part: float = 1.0) -> bool:
    """Whether predictions of left-out measurements became better by more than chance.

    Args:
        before: Whitened residuals, shape (N, d).
        after: The same with the correction learned from other measurements.
        part: Part of the former that the latter must not exceed, root mean square.
    """
    gain = (before**2 - after**2).sum(axis=1)
    better = gain.mean() > CHANCE * gain.std() / np.sqrt(len(gain))
    return bool(better) and root_mean_square(after) <= part * root_mean_square(before)


def correction_unit(at: Linearized, kinds: NDArray[np.bool_]) -> Floats:
    """Correction of each component that makes residuals of their size, (m,).

    One for all components of a kind: what hardly shows must not become large.

    Args:
        at: Residuals without a correction.
        kinds: Whether each component is of the first kind, such as an angle, (m,).
    """
    size = np.sqrt((at.residual**2).mean())
    effect = (at.by_correction**2).mean(axis=(0, 1))
    result = np.full(len(kinds), UNOBSERVED)
    for kind in (kinds, ~kinds):
        if kind.any() and effect[kind].any() and size > 0.0:
            result[kind] = size / np.sqrt(effect[kind].mean())
    return result


def root_mean_square(residual: Floats) -> float:
    """Root of the mean square of all components."""
    return float(np.sqrt((residual**2).mean()))
