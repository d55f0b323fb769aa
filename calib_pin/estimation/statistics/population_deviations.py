"""Errors that the robots of a type have in common, and those of one of them.

Of thousands of errors some stand out by chance. Those that are told apart here are
chosen so that of them at most one in twenty does (false discovery rate: Benjamini and
Hochberg 1995).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib_pin.compiled.threads import serial_blas
from calib_pin.estimation.statistics.distributions import chi_square_tail, f_tail
from calib_pin.estimation.statistics.population_prior import Population
from calib_pin.kinematics.spatial import Floats

RATE = 0.05
"""Part of the errors that are told apart which chance may have made."""

TOLD = 0.01
"""Part of a spread that the measurements of a robot must tell to count."""


@dataclass(frozen=True)
class CommonError:
    """An error that the robots of a type may have in common.

    Attributes:
        name: Name of the parameter.
        unit: Its unit.
        mean: Mean of the robots.
        sigma: Its standard deviation.
        chance: Probability of so large a mean by chance.
        significant: Whether it differs from zero, see `RATE`. Of errors that only
            their sum shows none does by itself.
    """

    name: str
    unit: str
    mean: float
    sigma: float
    chance: float
    significant: bool


@dataclass(frozen=True)
class JointDeviation:
    """How far a joint of one robot is from the mean of its type.

    Attributes:
        joint: Name of the joint.
        parameter: Name of its error that is farthest from the mean.
        spreads: Distance of that error from its mean in spreads, as far as the robot's
            measurements tell it; with its sign.
        chance: Probability of so large deviations of all errors of the joint by chance.
        significant: Whether the joint stands out among all joints of all robots.
    """

    joint: str
    parameter: str
    spreads: float
    chance: float
    significant: bool


def common_errors(population: Population) -> tuple[CommonError, ...]:
    """The mean errors of a type, in the order of the parameters."""
    first, found = population.evidences[0], population.likelihood
    sigma = np.sqrt(np.diag(found.covariance))
    dof = np.maximum(population.robots - 1.0, 1.0)
    squares = ((found.mean / sigma) ** 2).tolist()
    chances = np.array(
        [f_tail(square, 1.0, d) for square, d in zip(squares, dof, strict=True)]
    )
    numbers = np.column_stack(
        [first.scales * found.mean, first.scales * sigma, chances]
    )
    return tuple(
        CommonError(name, unit, mean, deviation, chance, flag)
        for name, unit, (mean, deviation, chance), flag in zip(
            first.names,
            first.units,
            numbers.tolist(),
            discoveries(chances).tolist(),
            strict=True,
        )
    )


@serial_blas
def joint_deviations(
    population: Population,
) -> tuple[tuple[JointDeviation, ...], ...]:
    """How far every joint of every robot is from the mean, robot by robot."""
    first, found = population.evidences[0], population.likelihood
    owners = [name.rsplit(".", 2)[0] for name in first.names]
    joints = {
        joint: np.flatnonzero([owner == joint for owner in owners])
        for joint in dict.fromkeys(owners)
    }
    spread = np.sqrt(population.variances)
    # Of deviations in spreads: the estimates, and the covariance that they have.
    estimates = spread * found.scores
    covariances = spread[:, None] * found.known * spread
    chances = np.array(
        [
            [_chance(u[own], C[np.ix_(own, own)]) for own in joints.values()]
            for u, C in zip(estimates, covariances, strict=True)
        ]
    )
    flags = discoveries(chances.ravel()).reshape(chances.shape)
    result = []
    for u, p, flag in zip(estimates, chances, flags, strict=True):
        row = []
        for k, (joint, own) in enumerate(joints.items()):
            far = int(own[np.argmax(np.abs(u[own]))])
            deviation = float(u[far])
            row.append(
                JointDeviation(
                    joint, first.names[far], deviation, float(p[k]), bool(flag[k])
                )
            )
        result.append(tuple(row))
    return tuple(result)


def discoveries(chances: Floats, rate: float = RATE) -> NDArray[np.bool_]:
    """Which of many tests are told apart, at a false discovery rate, shape (n,).

    Args:
        chances: Probability by chance of each, shape (n,).
        rate: Part of those told apart that may be chance.

    Examples:
        >>> discoveries(np.array([0.001, 0.04, 0.6, 0.024])).tolist()
        [True, False, False, True]
    """
    order = np.argsort(chances, kind="stable")
    limits = rate * np.arange(1, len(chances) + 1) / max(len(chances), 1)
    passed = np.flatnonzero(chances[order] <= limits)
    result = np.zeros(len(chances), bool)
    if len(passed):
        result[order[: passed[-1] + 1]] = True
    return result


def _chance(u: Floats, covariance: Floats) -> float:
    """Probability of so large deviations, along what the measurements tell of them."""
    values, vectors = np.linalg.eigh(covariance)
    told = values > TOLD
    square = float(np.sum((vectors[:, told].T @ u) ** 2 / values[told]))
    return chi_square_tail(square, int(told.sum())) if told.any() else 1.0
