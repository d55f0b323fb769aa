"""The pure error of each quantity: the scatter of repeated configurations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib_pin.estimation.problem import Problem, repeated
from calib_pin.estimation.statistics.distributions import chi_square_tail, f_tail
from calib_pin.kinematics.spatial import Floats

REPEATED = 4
"""Degrees of freedom from which repetitions tell the pure error, to a factor of two."""


@dataclass(frozen=True)
class PureError:
    """The pure error of a quantity, relative to the variance that is given.

    Repetitions tell noise from what the model lacks. With squares and degrees of
    freedom of the residuals (S, f) and of the repetitions among themselves (S_p, f_p),
    noise alone makes

        F = (S - S_p) / (f - f_p) / (S_p / f_p)

    a value of Fisher's F; far larger values are lack of fit (Draper and Smith, Applied
    Regression Analysis). What the model lacks is the same in all repetitions, a random
    effect of the configuration with the variance u of `E[S] = s f + u tr(Z^T R Z)`,
    where s is the pure variance, R projects on the residuals and Z sums over
    repetitions.

    Attributes:
        variance: Its variance.
        dof: Its degrees of freedom.
        trace: `tr(Z^T R Z)`, what a unit variance of configurations adds to squares.
    """

    variance: float
    dof: float
    trace: float

    @property
    def test(self) -> float:
        """Probability of a value so far from the given one by chance, two-sided."""
        above = chi_square_tail(self.variance * self.dof, self.dof)
        return 2.0 * min(above, 1.0 - above)

    def lack_of_fit(self, squares: float, redundancy: float) -> float | None:
        """Probability that noise leaves more; None where nothing is left over.

        Args:
            squares: Sum of squares of all residuals.
            redundancy: Their degrees of freedom.
        """
        between = redundancy - self.dof
        if between < 1.0 or self.variance <= 0.0:
            return None
        excess = max(squares - self.variance * self.dof, 0.0)
        return f_tail(excess / between / self.variance, between, self.dof)

    def unmodeled(self, squares: float, redundancy: float) -> float:
        """Variance of what configurations have in common; arguments as above."""
        excess = max(squares - self.variance * redundancy, 0.0)
        return excess / self.trace if self.trace > 0.0 else 0.0


def pure_errors(
    problem: Problem, theta: Floats, leverages: Floats
) -> tuple[PureError | None, ...]:
    """The pure error of every quantity; None where too few values are repeated.

    Contacts are not measured but made, and say nothing by being repeated.

    Args:
        problem: The problem.
        theta: Its solution, shape (P,).
        leverages: Leverage of every measured value, shape (M,).
    """
    layout = problem.layout
    used, label = repetitions(problem)
    sizes = np.bincount(label)
    count = len(layout.components)
    if not (sizes > 1).any():
        return (None,) * count
    weight = problem.data.weight[layout.row]
    residual = problem.errors(theta) / problem.given_sigma
    # The columns of Z are as long as repetitions are many.
    many = np.ones(len(problem.data))
    many[used] = sizes[label]
    # A component of a repetition, of all those that are used.
    of_row = np.full(len(problem.data), -1)
    of_row[used] = label
    place = of_row[layout.row] * layout.width + layout.column
    found: list[PureError | None] = []
    for k in range(count):
        own = layout.component == k
        rows = own & (of_row[layout.row] >= 0)
        r, w = residual[rows], weight[rows]
        _, group = np.unique(place[rows], return_inverse=True)
        total = np.bincount(group, w)
        mean = np.bincount(group, w * r) / np.where(total > 0.0, total, 1.0)
        squares = float(np.sum(w * (r - mean[group]) ** 2))
        dof = float((w > 0.0).sum() - (total > 0.0).sum())
        trace = weight[own].sum() - many[layout.row[own]] @ leverages[own]
        enough = dof >= REPEATED
        found.append(PureError(squares / dof, dof, float(trace)) if enough else None)
    return tuple(found)


def repetitions(problem: Problem) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows that can be repetitions, and the configuration of each, shape (n,) both."""
    labels = repeated(problem)
    used = problem.data.weight > 0.0
    for _, data, own, _ in problem.blocks:
        # Of contacts the joint positions are measured, and from another start it is
        # another distance.
        if not data.values.shape[1] or data.start.size:
            used[own] = False
    rows = np.flatnonzero(used)
    return rows, np.unique(labels[rows], return_inverse=True)[1]
