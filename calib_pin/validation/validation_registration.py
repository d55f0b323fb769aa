"""Registration of a fitted problem on other measurements, which check it, say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from calib_pin.errors import InputError
from calib_pin.estimation.problem import Problem, distinct_values
from calib_pin.estimation.registration import extended
from calib_pin.estimation.solve import least_squares
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Measurements


@dataclass(frozen=True)
class Registered:
    """A fitted problem registered on other measurements.

    Attributes:
        problem: The problem of these measurements.
        theta: Its parameter values, shape (P,).
        new: Positions of the parameters of reference objects that only these
            measurements name.
        refitted: Positions of further parameters that were estimated anew from them.
    """

    problem: Problem
    theta: Floats
    new: tuple[int, ...] = ()
    refitted: tuple[int, ...] = ()


def registered(
    problem: Problem, theta: Floats, measurements: Measurements
) -> Registered:
    """A fitted problem on other measurements, with what only these name registered.

    A socket, say, that only these measurements name is estimated from them. Nothing
    else is fitted, and known distances between new reference objects do not count:
    they are there to be found.

    Args:
        problem: The problem.
        theta: Parameter values, shape (P,).
        measurements: The other measurements.

    Raises:
        InputError: If a new reference object uses up all that its measurements say.
    """
    known = set(problem.parameters.names)
    problem, theta = extended(problem, theta, measurements)
    names = problem.parameters.names
    new = tuple(k for k, name in enumerate(names) if name not in known)
    if not new:
        return Registered(problem, theta)
    plain = replace(problem, setup=replace(problem.setup, distances=()))
    _require_redundancy(plain, theta, new)
    basis = np.diag(problem.parameters.scales)[:, list(new)]
    return Registered(problem, least_squares(plain, theta, basis).x, new)


def _require_redundancy(problem: Problem, theta: Floats, new: Sequence[int]) -> None:
    """Refuse measurements that a new reference object uses up.

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
        values = distinct_values(replace(problem, data=problem.data.rows(rows)))
        if values <= np.linalg.matrix_rank(A):
            data = problem.data
            error = partial(data.error, int(rows[0])) if len(rows) else InputError
            raise error(
                f"the measurements of '{name}', which was not fitted, say no more than "
                "where it is; measure it in more configurations",
                column="target",
            )
