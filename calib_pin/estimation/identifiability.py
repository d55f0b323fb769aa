"""Which error parameters can be known: ranks, coupled groups, observability.

Everything here works on identification Jacobians whose columns are multiplied by the
scale of their parameter. Columns are never divided by their norm: a column that is
zero but for rounding would come out as good as any other.

Two ranks are kept apart. The *structural* rank belongs to the robot and the way it is
measured: the Jacobian at zero errors over many random configurations, decided near
machine precision. The *practical* rank belongs to these measurements: a direction
counts if its posterior standard deviation is below `WEAK` times its scale.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calib_pin.estimation.directions import robot_values, rounding
from calib_pin.kinematics.spatial import Floats
from calib_pin.parameterizations.base import expected_size
from calib_pin.parameters import ParameterSet

CRUMB = 1e-6
"""Ratio to the heaviest term of a sum below which a term is rounding."""

DWARFED = 100.0
"""Ratio of weights from which the first term of a sum does not set its unit."""


@dataclass(frozen=True)
class Combination:
    """A sum of parameters that is identifiable while its terms may not be.

    Attributes:
        terms: Position of each parameter and its coefficient, 1 for the first that
            matters.
        unit: Unit of the sum, that of this term.
    """

    terms: tuple[tuple[int, float], ...]
    unit: str

    def row(self, size: int) -> Floats:
        """Coefficients as a vector, shape (size,)."""
        result = np.zeros(size)
        for position, coefficient in self.terms:
            result[position] = coefficient
        return result

    def expression(self, names: tuple[str, ...]) -> str:
        """The sum as a formula with numeric coefficients."""
        text = ""
        for position, coefficient in self.terms:
            size = f"{abs(coefficient):.4g}"
            sign = " - " if coefficient < 0.0 else " + "
            text += sign + ("" if size == "1" else f"{size} ") + names[position]
        return text[3:] if text.startswith(" + ") else f"-{text[3:]}"


@dataclass(frozen=True)
class Structure:
    """Structural identifiability of a robot that is measured in one way.

    Attributes:
        singular_values: Of the scaled structural Jacobian, descending.
        rank: Number of singular values above rounding.
        robot: Singular values of the robot's directions with the nuisances projected
            out, descending.
        configurations: Number of configurations they belong to.
        relations: Rows S V^T of the rank: they carry the same relations between
            columns as the scaled structural Jacobian, without its noise; shape (rank,
            free parameters).
        parameters: The parameters.
        scaled: Whether measurements tell how large the robot is.
        alike: Parameters of stations that were left out, with those of one like them.
    """

    singular_values: Floats
    rank: int
    robot: Floats
    configurations: int
    relations: Floats
    parameters: ParameterSet
    scaled: bool = True
    alike: Mapping[int, int] = field(default_factory=dict)

    @property
    def gap(self) -> float:
        """Ratio of the last singular value kept to the first one dropped."""
        s, r = self.singular_values, self.rank
        return float(s[r - 1] / s[r]) if 0 < r < len(s) and s[r] > 0.0 else np.inf

    @cached_property
    def combinations(self) -> tuple[Combination, ...]:
        """The identifiable combinations, one per rank, in order."""
        parameters = self.parameters
        free, of_free = parameters.free, np.cumsum(parameters.free) - 1
        order = np.array([k for k in parameters.eliminated if free[k]], np.int64)
        _, C = combinations(self.relations[:, of_free[order]], self.rank)
        # The scale of a frame is that of an unknown stand, not of an error.
        sizes = [expected_size(p.unit) if p.nuisance else p.scale for p in parameters]
        return tuple(
            _readable(row, order, np.array(sizes)[order], parameters)
            for row in C / parameters.scales[order]
        )

    @cached_property
    def unidentifiable(self) -> tuple[int, ...]:
        """Positions of the free parameters without any effect."""
        used = {k for combination in self.combinations for k, _ in combination.terms}
        found = np.flatnonzero(self.parameters.free)
        return tuple(int(k) for k in found if k not in used)


def structure(
    J: Floats, parameters: ParameterSet, configurations: int = 1
) -> Structure:
    """Analyze a structural Jacobian.

    Args:
        J: Jacobian at zero errors over many random configurations, shape (M, P).
        parameters: The parameters; columns of fixed ones are ignored.
        configurations: Number of configurations that J belongs to.
    """
    free = parameters.free
    A = J[:, free] * parameters.scales[free]
    # The triangular factor has the same singular values and row space.
    _, s, Vt = np.linalg.svd(np.linalg.qr(A, mode="r"), full_matrices=False)
    tolerance = rounding(A) * (s[0] if len(s) else 0.0)
    rank = int((s > tolerance).sum())
    robot, relations = robot_values(J, parameters), s[:rank, None] * Vt[:rank]
    return Structure(s, rank, robot, configurations, relations, parameters)


def combinations(A: Floats, rank: int) -> tuple[list[int], Floats]:
    """Independent columns in their given order and how the others follow from them.

    Elimination without pivoting: a column that depends on columns before it is folded
    into them, and one that nearly does unless the rank needs it. The order is the
    reader's, so the sums are predictable; pivoting would pick other columns at every
    change of a number.

    Args:
        A: Matrix of full row rank, shape (r, P).
        rank: Its rank r.

    Returns:
        Positions of the r independent columns, and C, shape (r, P), with
        `A = A[:, pivots] @ C`.
    """
    norms = np.linalg.norm(A, axis=0)
    absent = norms <= 1e-11 * norms.max(initial=0.0)
    pivots: list[int] = []
    basis = np.empty((len(A), len(A)), order="F")
    # Columns that are clearly independent first: rounded angles in a URDF leave a
    # dependent one 1e-6 of its length, and sums about such a column are all alike.
    for threshold in (1e-3, 1e-5, 1e-7, 1e-9, 1e-10):
        for k in np.flatnonzero(~absent):
            if len(pivots) == min(rank, len(A)):
                break
            Q = basis[:, : len(pivots)]
            rest = A[:, k] - Q @ (Q.T @ A[:, k])
            rest -= Q @ (Q.T @ rest)
            length = np.linalg.norm(rest)
            if length > threshold * norms[k]:
                basis[:, len(pivots)] = rest / length
                pivots.append(int(k))
    pivots.sort()
    C = np.zeros((0, A.shape[1]))
    if pivots:
        C = np.asarray(np.linalg.lstsq(A[:, pivots], A, rcond=None)[0])
    C[:, absent] = 0.0
    return pivots, C


def observability(s: Floats, count: int) -> dict[str, float]:
    """Observability indices of singular values s_1 >= ... >= s_m > 0.

    O1 (Borm, Menq), O2 (Driels, Pathre), O3 (Nahvi et al.), O4 (Nahvi, Hollerbach),
    O5 (Sun, Hollerbach).

    Args:
        s: Singular values of the scaled identification Jacobian, shape (m,).
        count: Number of measurements n.
    """
    if len(s) == 0 or s[-1] <= 0.0:
        return dict.fromkeys(("O1", "O2", "O3", "O4", "O5"), 0.0)
    return {
        "O1": float(np.exp(np.mean(np.log(s))) / np.sqrt(count)),
        "O2": float(s[-1] / s[0]),
        "O3": float(s[-1]),
        "O4": float(s[-1] ** 2 / s[0]),
        "O5": float(1.0 / np.sum(1.0 / s)),
    }


def everett_count(revolute: NDArray[np.bool_], frames: int = 2) -> int:
    """Everett's count 4 R + 2 P + 6 of a complete model measured by full poses.

    Each of its frames beyond a base and a tool has six more.
    """
    return int(4 * revolute.sum() + 2 * (~revolute).sum() + 6 * (frames - 1))


def _readable(
    coefficients: Floats,
    order: NDArray[np.int64],
    sizes: Floats,
    parameters: ParameterSet,
) -> Combination:
    """A sum whose first term has coefficient 1, unless another dwarfs that term.

    A tool point close to the last axis, say, makes the first term a hundredth of what
    the others weigh; the sum is then a length and not a strangely large angle.

    Args:
        coefficients: Of the free parameters in the order of elimination, shape (K,).
        order: Positions of these parameters, shape (K,).
        sizes: Their sizes, shape (K,).
        parameters: The parameters.
    """
    weights = np.abs(coefficients) * sizes
    heaviest = int(np.argmax(weights))
    kept = np.flatnonzero(weights > CRUMB * weights[heaviest])
    first = int(kept[0])
    lead = heaviest if weights[heaviest] > DWARFED * weights[first] else first
    values = coefficients[kept] / coefficients[lead]
    return Combination(
        tuple(zip(order[kept].tolist(), values.tolist(), strict=True)),
        parameters[int(order[lead])].unit,
    )
