"""The errors of a robot that measurements tell, as a person names them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from calib_pin.estimation.directions import Directions
from calib_pin.estimation.geometric_columns import (
    KINDS,
    Columns,
    geometric_columns,
)
from calib_pin.estimation.identifiability import (
    Combination,
    Structure,
    combinations,
)
from calib_pin.estimation.system import System
from calib_pin.kinematics.spatial import Floats
from calib_pin.parameterizations.base import expected_size
from calib_pin.parameters import ParameterSet
from calib_pin.validation.result import RobotError, Term

WEAK_PART = 0.1
"""Part of a sum in directions held at nominal from which it counts as weak."""

SMALL = 1e-3
"""Weight of a term, by that of the first, below which it does not matter."""

EQUAL = 0.02
"""Difference of coefficients up to which terms of one kind are a plain sum."""


class Estimated(Protocol):
    """Estimates of parameters, those of a fit or of a plan for one."""

    @property
    def theta(self) -> Floats:
        """Parameter values, shape (P,)."""

    @property
    def covariance(self) -> Floats:
        """Their covariance, shape (P, P)."""

    @property
    def directions(self) -> Directions:
        """The directions that are estimated and those held at nominal."""


def robot_errors(
    system: System, structure: Structure, fitted: Estimated | None = None
) -> tuple[RobotError, ...]:
    """The identifiable errors of a robot, each direction once, and those in frames.

    Base, tool and instrument are eliminated first: what a frame absorbs is no error of
    the robot. Then come the directions of `geometric_columns` in their order, so that
    there are as many errors as independent ones of the robot.

    Args:
        system: The robot and how it is measured.
        structure: Its structural analysis.
        fitted: The estimates, if there are any; otherwise values are zero.
    """
    parameters = structure.parameters
    columns = geometric_columns(system, parameters)
    free = np.flatnonzero(parameters.free)
    nuisances = [int(k) for k in free if parameters[int(k)].nuisance]
    order = np.array([*nuisances, *columns.order], np.intp)
    A = np.zeros((len(structure.relations), len(parameters)))
    A[:, free] = structure.relations
    pivots, C = combinations((A @ columns.turned)[:, order], structure.rank)
    # Columns are scaled by the expected sizes; the coefficients are not.
    C = C / parameters.scales[order]
    found = []
    for pivot, row in zip(pivots, C, strict=True):
        if pivot >= len(nuisances):
            full = np.zeros(len(parameters))
            full[order] = row / row[pivot]
            found.append(_error(int(order[pivot]), full, columns, parameters, fitted))
    found += _absorbed(pivots, C, order, columns, parameters)
    ranks = {name: k for k, name in enumerate((*KINDS, *system.chains.joints))}
    last = len(ranks)
    return tuple(
        sorted(found, key=lambda e: [ranks.get(n, last) for n in (e.kind, e.of[0])])
    )


def _error(
    lead: int,
    full: Floats,
    columns: Columns,
    parameters: ParameterSet,
    fitted: Estimated | None,
) -> RobotError:
    """An identifiable error by its coefficients in the named directions, (P,)."""
    label = columns.labels[lead]
    row = columns.turned @ full
    value, sigma, status = 0.0, None, "identifiable"
    if fitted is not None:
        value = float(row @ fitted.theta)
        deviation = float(np.sqrt(max(float(row @ fitted.covariance @ row), 0.0)))
        if fitted.directions.weak_part(row, parameters) > WEAK_PART:
            status = "weak"
        elif np.isfinite(deviation):
            sigma = deviation
    sizes = np.array([expected_size(p.unit) for p in parameters])
    least = max(sigma or 0.0, float(SMALL * sizes[lead]))
    # A minus where the axis points the other way; what comes first says so.
    signs: dict[str, str] = {}
    for k in columns.order:
        if columns.labels[k].kind == label.kind and abs(abs(full[k]) - 1.0) < EQUAL:
            signs.setdefault(columns.labels[k].of, "-" if full[k] < 0.0 else "")
    kept = np.where(np.abs(row) * sizes >= least, row, 0.0)
    if not kept.any():
        kept = np.where(np.abs(row) * sizes >= 0.5 * sizes[lead], row, 0.0)
    terms = tuple((int(k), float(kept[k])) for k in np.flatnonzero(kept))
    expression = Combination(terms, parameters[lead].unit).expression(parameters.names)
    return RobotError(
        kind=label.kind,
        of=tuple(f"{sign}{of}" for of, sign in signs.items()),
        unit=parameters[lead].unit,
        value=value,
        sigma=sigma,
        status=status,
        within=(),
        expression=expression,
        terms=tuple(Term(parameters[k].name, c) for k, c in terms),
    )


def _absorbed(
    pivots: Sequence[int],
    C: Floats,
    order: NDArray[np.intp],
    columns: Columns,
    parameters: ParameterSet,
) -> Iterator[RobotError]:
    """Errors that base, tool or instrument take along, so that none is known."""
    sizes = np.array([expected_size(p.unit) for p in parameters])[order]
    nuisance = parameters.nuisance[order]
    for k, position in enumerate(order):
        if nuisance[k] or k in pivots:
            continue
        weights = {
            pivot: abs(row[k] * sizes[k] / (row[pivot] * sizes[pivot]))
            for pivot, row in zip(pivots, C, strict=True)
        }
        heavy = [p for p, weight in weights.items() if weight > SMALL]
        if heavy and all(nuisance[p] for p in heavy):
            owners = (parameters[int(order[p])].name.rpartition(".")[0] for p in heavy)
            label = columns.labels[int(position)]
            yield RobotError(
                kind=label.kind,
                of=(label.of,),
                unit=parameters[int(position)].unit,
                value=0.0,
                sigma=None,
                status="absorbed",
                within=tuple(dict.fromkeys(owners)),
                expression="",
                terms=(),
            )
