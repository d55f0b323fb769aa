"""Errors of rows that were not fitted, by a problem that was."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import InputError
from calib_pin.estimation.known_distances import KnownDistances
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.solve import least_squares
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Measurements
from calib_pin.validation.result import FoundDistance

__all__ = ["Unseen", "found_distances", "placed"]


@dataclass(frozen=True)
class Unseen:
    """Errors of rows in the units of the residual.

    Attributes:
        positions: Where they stand among all rows, shape (N,).
        before: Errors of the nominal robot, base, tool and instrument fitted, shape
            (N, d); NaN for what a row of mixed measurements does not have.
        after: Errors of the trained model, shape (N, d).
        variance: The variance of these that the fit predicts, shape (N, d): noise, and
            what it leaves uncertain; NaN where nobody asked.
        distances: Known distances between places that were not fitted.
        placed: Names of these places, which stand where the rows put them.
        reason: Why the fit that they check says little of the robot; empty where it
            is a good one.
    """

    positions: NDArray[np.intp]
    before: Floats
    after: Floats
    variance: Floats
    distances: tuple[FoundDistance, ...] = ()
    placed: tuple[str, ...] = ()
    reason: str = ""

    @staticmethod
    def empty(components: int, reason: str) -> Unseen:
        """That of no rows, and why."""
        none = np.zeros((0, components))
        return Unseen(np.zeros(0, np.intp), none, none, none, reason=reason)

    def counted(self, weight: Floats) -> Unseen:
        """Those that are not set aside; all of them where no other is left.

        Args:
            weight: Weight of all rows that the positions belong to, shape (N',).
        """
        kept = weight[self.positions] > 0.0
        if kept.all() or not kept.any():
            return self
        return replace(
            self,
            positions=self.positions[kept],
            before=self.before[kept],
            after=self.after[kept],
            variance=self.variance[kept],
        )


def found_distances(
    before: tuple[Problem, Floats],
    after: tuple[Problem, Floats],
    known: Collection[str] | None,
) -> tuple[FoundDistance, ...]:
    """Known distances beside those that the nominal and the calibrated robot find.

    Args:
        before: The problem of the nominal robot, and its parameter values.
        after: That of the calibrated robot.
        known: Names of what was fitted, where this is about what was not.
    """
    stated = [
        distance
        for distance in after[0].setup.distances
        if known is None or not set(known).intersection(distance.between)
    ]
    (first, nominal), (second, found) = (
        (distances, distances.lengths(problem.split(theta)[1]))
        for problem, theta in (before, after)
        for distances in [KnownDistances.of(stated, problem.measurement.features)]
    )
    assert first.stated == second.stated
    return tuple(
        FoundDistance(d.between, d.value, d.sigma, float(n), float(f), known is None)
        for d, n, f in zip(first.stated, nominal, found, strict=True)
    )


def placed(
    problem: Problem, theta: Floats, rows: Measurements
) -> tuple[Problem, Floats]:
    """A fitted problem at other rows, with a place for what only these name.

    Nothing but the new places is fitted, and known distances between them do not
    count: they are there to be found.

    Args:
        problem: The problem.
        theta: Parameter values, shape (P,).
        rows: The other rows.

    Returns:
        The problem of these rows, and its parameter values.

    Raises:
        InputError: If a new place uses up all that its rows say.
    """
    known = set(problem.parameters.names)
    problem, theta = problem.extended(theta, rows)
    new = [k for k, name in enumerate(problem.parameters.names) if name not in known]
    if not new:
        return problem, theta
    plain = replace(problem, setup=replace(problem.setup, distances=()))
    _require_check(plain, theta, new)
    basis = np.diag(problem.parameters.scales)[:, new]
    return problem, least_squares(plain, theta, basis).x


def _require_check(problem: Problem, theta: Floats, new: Sequence[int]) -> None:
    """Refuse rows that have nothing left to say once their place is found.

    Raises:
        InputError: If there are such; their errors would all be zero.
    """
    count, size = len(problem.data), problem.components
    _, J = problem.linearize_rows(theta)
    J = J[: count * size].reshape(count, size, -1)
    owners: dict[str, list[int]] = {}
    for k in new:
        owners.setdefault(problem.parameters.names[k].rsplit(".", 2)[0], []).append(k)
    for name, columns in owners.items():
        rows = np.flatnonzero(J[:, :, columns].any(axis=(1, 2)))
        A = J[rows][:, :, columns].reshape(-1, len(columns))
        values = replace(problem, data=problem.data.rows(rows)).distinct_values
        if values <= np.linalg.matrix_rank(A):
            data = problem.data
            error = partial(data.error, int(rows[0])) if len(rows) else InputError
            raise error(
                f"the rows of '{name}', which was not fitted, say no more than where "
                "it is; measure it in more configurations",
                column="target",
            )
