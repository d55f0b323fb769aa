"""Directions of the robot that a fit may move.

A redundant model has directions that nothing can see, and real measurements leave some
more that they can hardly tell. Moving them would shift links by centimeters for nothing
in return, so they stay at nominal.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib_pin.kinematics.spatial import Floats
from calib_pin.parameters import ParameterSet

WEAK = 10.0
"""Posterior standard deviation, in scales, from which a direction is left alone."""

RANK = 1e-12
"""Singular values below this part of the largest are rounding."""


@dataclass(frozen=True)
class Directions:
    """Directions that a fit may move, in parameters divided by their scale.

    Attributes:
        nuisances: Unit vectors of the free nuisances, shape (P, f).
        robot: Robot directions that are estimated, shape (P, r).
        weak: Robot directions that stay at nominal, shape (P, w).
        revealed: Number of the robot directions, the last ones, that nominal geometry
            hides and that are estimated all the same; 0 for errors of expected size.
    """

    nuisances: Floats
    robot: Floats
    weak: Floats
    revealed: int = 0

    @property
    def basis(self) -> Floats:
        """Moved directions, shape (P, f + r)."""
        return np.column_stack([self.nuisances, self.robot])

    @property
    def every(self) -> Floats:
        """Moved directions and those held at nominal, shape (P, f + r + w)."""
        return np.column_stack([self.nuisances, self.robot, self.weak])

    @property
    def hidden(self) -> Floats:
        """Robot directions that nominal geometry hides, shape (P, revealed)."""
        return self.robot[:, self.robot.shape[1] - self.revealed :]

    @property
    def count(self) -> int:
        """Number of directions that are moved."""
        return int(self.nuisances.shape[1] + self.robot.shape[1])

    def weak_part(self, row: Floats, parameters: ParameterSet) -> float:
        """Part of a sum of robot parameters that lies in directions held at nominal.

        Args:
            row: Coefficients of the sum, shape (P,).
            parameters: The parameters.
        """
        scaled = np.where(parameters.nuisance, 0.0, row * parameters.scales)
        length = np.linalg.norm(scaled)
        if length == 0.0:
            return 0.0
        return float(np.linalg.norm(self.weak.T @ scaled) / length)


def nuisance_basis(parameters: ParameterSet) -> Floats:
    """The free parameters of base, tool and instrument by their scales, (P, f)."""
    return np.diag(parameters.scales)[:, parameters.free & parameters.nuisance]


def visible_directions(J: Floats, parameters: ParameterSet) -> Floats:
    """Robot directions that change something which the nuisances cannot absorb.

    The solution stays in these directions: what a frame can absorb, the frame
    absorbs, and what nothing can see keeps its nominal value.

    Args:
        J: Jacobian at zero errors over many random configurations, with the rows of
            the priors, shape (M, P).
        parameters: The parameters.

    Returns:
        Orthonormal directions of the parameters divided by their scale, shape (P, r).
    """
    _, Vt = _visible(J, parameters)
    result = np.zeros((len(parameters), len(Vt)))
    # Rounding must not move, by 1e-20, parameters that nothing moves.
    robot = parameters.free & ~parameters.nuisance
    result[robot] = np.where(np.abs(Vt) < 1e-13, 0.0, Vt).T
    return result


def visible_nuisances(J: Floats, parameters: ParameterSet) -> Floats:
    """Directions of base, tool and instrument that change something.

    Args:
        J: Jacobian as for `visible_directions`, shape (M, P).
        parameters: The parameters.

    Returns:
        Orthonormal directions of the parameters divided by their scale, shape (P, f).
    """
    free = parameters.free & parameters.nuisance
    A = (J * parameters.scales)[:, free]
    # The rows of A have the range of its transpose.
    directions = column_space(np.asarray(np.linalg.qr(A, mode="r")).T)
    result = np.zeros((len(parameters), directions.shape[1]))
    result[free] = directions
    return result


def practical_directions(
    J: Floats,
    r: Floats,
    count: int,
    parameters: ParameterSet,
    robot: Floats,
    sigma0: float | None = None,
) -> Directions:
    """Choose the robot directions that these measurements can estimate.

    The nuisances are projected out of the whitened, scaled Jacobian; a right singular
    direction with singular value s then has the posterior standard deviation
    `sigma0 / s`, in scales.

    Args:
        J: Whitened Jacobian at zero robot errors, shape (M, P).
        r: Whitened residual there, shape (M,); predicts sigma0 where it is None.
        count: Residual components; more than M where J and r are a reduced system.
        parameters: The parameters.
        robot: Structurally visible robot directions, shape (P, r).
        sigma0: Standard deviation of unit weight of a fit, where one is known.
    """
    A = J * parameters.scales
    U = _absorbed(A, parameters)
    system = np.column_stack([A @ robot, r])
    system -= U @ (U.T @ system)
    # The triangular factor holds the same problem in few rows.
    triangle = np.asarray(np.linalg.qr(system, mode="r"))
    rest = triangle[:, -1]
    left, s, Vt = np.linalg.svd(triangle[:, :-1], full_matrices=True)
    if sigma0 is None:
        # By the linear prediction of sigma0 with those that are better determined: to
        # start with few keeps a poor linearization from moving what no data hold.
        dof = count - U.shape[1] - 1 - np.arange(len(s))
        squares = rest @ rest - np.cumsum((left.T[: len(s)] @ rest) ** 2)
        predicted = np.sqrt(np.maximum(squares, 0.0) / np.maximum(dof, 1))
        kept = int(np.cumprod((s * WEAK > predicted) & (dof > 0)).sum())
    else:
        kept = int((s * WEAK > sigma0).sum())
    kept = min(kept, int((s > rounding(A) * s.max(initial=0.0)).sum()))
    nuisance = np.eye(len(parameters))[:, parameters.free & parameters.nuisance]
    return Directions(nuisance, robot @ Vt[:kept].T, robot @ Vt[kept:].T)


def appearing(
    directions: Directions,
    J: Floats,
    r: Floats,
    parameters: ParameterSet,
    sigma0: float,
) -> tuple[Floats, float]:
    """Robot directions that the errors themselves have made visible.

    Special geometry hides them at nominal: parallel or intersecting axes. Away from it
    they show, the more the larger the errors are.

    Args:
        directions: Directions that the fit moved, and those held at nominal.
        J: Whitened Jacobian at its solution, shape (M, P).
        r: Whitened residual there, shape (M,).
        parameters: The parameters.
        sigma0: Standard deviation of unit weight of the fit.

    Returns:
        Directions that these measurements can estimate beside those, shape (P, k), and
        the part of the sum of squares that they explain to first order.
    """
    robot = np.eye(len(parameters))[:, parameters.free & ~parameters.nuisance]
    known = np.column_stack([directions.robot, directions.weak])
    hidden = column_space(robot - known @ (known.T @ robot))
    A = J * parameters.scales
    moved = column_space(A @ directions.basis)
    columns = A @ hidden
    projected = columns - moved @ (moved.T @ columns)
    U, s, Vt = np.linalg.svd(projected, full_matrices=False)
    shown = s * WEAK > sigma0
    result = hidden @ Vt[shown].T
    # Rounding must not move, by 1e-20, parameters that nothing moves.
    result[np.abs(result) < 1e-13] = 0.0
    return result, float(np.sum((U[:, shown].T @ r) ** 2))


def half_covariance(J: Floats, basis: Floats, parameters: ParameterSet) -> Floats:
    """Factor H of the covariance `H H^T` of least squares at unit weight.

    It belongs to the references that the Jacobian is taken about, and so does what is
    multiplied by it. The columns of `J H` are orthonormal.

    Args:
        J: Whitened Jacobian at the solution, shape (M, P).
        basis: Directions that were moved, of the scaled parameters, shape (P, k).
        parameters: The parameters.

    Returns:
        The factor, shape (P, rank).
    """
    scaled = parameters.scales[:, None] * basis
    A = J @ scaled
    # What nothing shows, or was eliminated, costs nothing.
    used = A.any(axis=0)
    return np.asarray(scaled[:, used] @ inverse_root(A[:, used]))


def inverse_root(A: Floats) -> Floats:
    """Factor F of the pseudoinverse `(A^T A)^+ = F F^T`, (M, k) -> (k, rank)."""
    triangle = np.linalg.qr(A, mode="r")
    _, s, Vt = np.linalg.svd(triangle, full_matrices=False)
    rank = int((s > RANK * s.max(initial=0.0)).sum())
    return np.asarray(Vt[:rank].T / s[:rank])


def robot_singular_values(
    directions: Directions, J: Floats, parameters: ParameterSet
) -> Floats:
    """Singular values of the moved robot directions, the nuisances projected out.

    Args:
        directions: Directions that were fitted.
        J: Whitened Jacobian at its solution, shape (M, P).
        parameters: The parameters.
    """
    A = J * parameters.scales
    columns = projected(A @ directions.robot, A, parameters)
    return np.asarray(np.linalg.svd(np.linalg.qr(columns, mode="r"), compute_uv=False))


def robot_values(J: Floats, parameters: ParameterSet) -> Floats:
    """Nonzero singular values of `visible_directions`, descending, shape (r,)."""
    return _visible(J, parameters)[0]


def _visible(J: Floats, parameters: ParameterSet) -> tuple[Floats, Floats]:
    """Singular values and right vectors of what nuisances cannot absorb, (r,), (r, R).

    Of the scaled columns of the R robot parameters, without rounding.
    """
    A = J * parameters.scales
    own = A[:, parameters.free & ~parameters.nuisance]
    triangle = np.linalg.qr(projected(own, A, parameters), mode="r")
    _, s, Vt = np.linalg.svd(triangle, full_matrices=False)
    # Relative to what stood there before: the projection leaves rounding behind.
    longest = np.linalg.eigvalsh(own.T @ own).max(initial=0.0) ** 0.5
    seen = s > rounding(A) * longest
    return s[seen], Vt[seen]


def rounding(A: Floats) -> float:
    """Relative size of singular values that rounding alone produces."""
    return float(10.0 * max(A.shape, default=1) * np.finfo(float).eps)


def projected(columns: Floats, A: Floats, parameters: ParameterSet) -> Floats:
    """Columns with what the nuisances can absorb of them taken away.

    Args:
        columns: Scaled columns, or residuals, shape (M, k).
        A: Whitened Jacobian times the scales, shape (M, P).
        parameters: The parameters.
    """
    U = _absorbed(A, parameters)
    return columns - U @ (U.T @ columns)


def _absorbed(A: Floats, parameters: ParameterSet) -> Floats:
    """Orthonormal basis of the columns of the nuisances in A, (M, P) -> (M, k)."""
    return column_space(A[:, parameters.free & parameters.nuisance])


def column_space(A: Floats) -> Floats:
    """Orthonormal basis of the columns of A, rounding left out."""
    # Those of stations that were eliminated are zero, and may be very many.
    A = A[:, A.any(axis=0)]
    if A.shape[1] == 0:
        return np.zeros((len(A), 0))
    U, s, _ = np.linalg.svd(A, full_matrices=False)
    return np.asarray(U[:, s > rounding(A) * s[0]])
