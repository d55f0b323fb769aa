"""Residual rows beside the measurements: known distances, expected sizes, priors.

Known distances between points, those of a gauge or of the sockets of one plate, say
nothing of the robot by themselves. A ball in two sockets a known distance apart is what
gives a robot without any other length its scale.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calib_pin.estimation.directions import inverse_root
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.references import (
    Anchor,
    Point,
    ReferenceObject,
    Sphere,
)
from calib_pin.parameters import ParameterSet
from calib_pin.setup import DistanceSetup, JointPrior


@dataclass(frozen=True)
class Expected:
    """A normal prior about zero on directions of the robot's errors.

    Attributes:
        directions: Of the parameters divided by their scale, shape (P, k).
        sizes: Standard deviation of every parameter, in scales, shape (P,).
        scales: Scales of the parameters, shape (P,).
    """

    directions: Floats
    sizes: Floats
    scales: Floats

    def __len__(self) -> int:
        """Number p of rows, at most k."""
        return len(self._rows)

    def residual(self, theta: Floats) -> Floats:
        """Independent sums in standard deviations, (..., P) -> (..., p)."""
        return np.asarray(theta @ self._rows.T)

    def jacobian(self, theta: Floats) -> Floats:
        """Their derivative, shape (p, P)."""
        return self._rows

    @cached_property
    def _rows(self) -> Floats:
        root = inverse_root(self.sizes[:, None] * self.directions)
        return np.asarray(root.T @ self.directions.T / self.scales)


@dataclass(frozen=True)
class Priors:
    """A normal prior on parameters, on each alone or on several together.

    Attributes:
        rows: W of `W (theta - mean)`, whose p components have the deviation one, shape
            (p, P); zero for parameters without a prior.
        mean: The most likely values, shape (P,).
    """

    rows: Floats
    mean: Floats

    @staticmethod
    def alone(sigma: Floats) -> Priors:
        """Priors about zero on single parameters.

        Args:
            sigma: Standard deviations, infinite where there is none, shape (P,).
        """
        known = np.isfinite(sigma)
        return Priors(np.diag(1.0 / sigma)[known], np.zeros(len(sigma)))

    @staticmethod
    def together(prior: JointPrior, parameters: ParameterSet) -> Priors:
        """The prior by robots of the same type, or by an older calibration.

        Args:
            prior: The prior; what the parameters lack of it is left out.
            parameters: The parameters; those that are not free have none.
        """
        free = {p.name for p in parameters if p.free and not p.nuisance}
        known = [k for k, name in enumerate(prior.names) if name in free]
        index = [parameters.index(prior.names[k]) for k in known]
        mean = np.zeros(len(parameters))
        mean[index] = [prior.parameters[k].mean for k in known]
        # Of parameters in their scales, lengths and angles are alike.
        scales = parameters.scales[index]
        covariance = np.array(prior.covariance)[np.ix_(known, known)]
        half = np.linalg.cholesky(covariance / np.outer(scales, scales))
        rows = np.zeros((len(known), len(parameters)))
        rows[:, index] = np.linalg.solve(half, np.diag(1.0 / scales))
        return Priors(rows, mean)

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.rows)

    def residual(self, theta: Floats) -> Floats:
        """Distances from the mean in standard deviations, (..., P) -> (..., p)."""
        return np.asarray((theta - self.mean) @ self.rows.T)

    def jacobian(self, theta: Floats) -> Floats:
        """Their derivative, shape (p, P)."""
        return self.rows


@dataclass(frozen=True)
class Blocks:
    """Whitened residual rows of several kinds, one behind the other.

    Attributes:
        blocks: The blocks, none of them empty.
    """

    blocks: Sequence[KnownDistances | Expected | Priors]

    def __len__(self) -> int:
        """Number p of rows."""
        return sum(map(len, self.blocks))

    @property
    def priors(self) -> int:
        """Number of rows of priors on parameters, the last ones."""
        return sum(len(block) for block in self.blocks if isinstance(block, Priors))

    def residual(self, theta: Floats) -> Floats:
        """All rows, (..., P) -> (..., p)."""
        empty = np.empty((*theta.shape[:-1], 0))
        rows = [block.residual(theta) for block in self.blocks]
        return np.concatenate([empty, *rows], axis=-1)

    def jacobian(self, theta: Floats) -> Floats:
        """Their derivative, shape (p, P)."""
        empty = np.empty((0, len(theta)))
        rows = [block.jacobian(theta) for block in self.blocks]
        return np.concatenate([empty, *rows])


@dataclass(frozen=True)
class KnownDistances:
    """D distances between reference objects of a measurement model.

    Attributes:
        stated: The distances.
        ends: Places of both ends about the references, shape (D, 2, 3) [m].
        columns: Where the coordinates of both ends stand among the parameters, shape
            (D, 2, 3); -1 where they are no parameters.
    """

    stated: tuple[DistanceSetup, ...]
    ends: Floats
    columns: NDArray[np.int64]

    @staticmethod
    def of(
        distances: Sequence[DistanceSetup],
        references: Mapping[tuple[str, str], ReferenceObject],
        names: Sequence[str],
    ) -> KnownDistances:
        """Those of the distances whose both ends are among some references.

        Args:
            distances: Known distances.
            references: Reference objects by section and name among all.
            names: Names of all parameters.
        """
        if not distances:
            return KnownDistances((), np.zeros((0, 2, 3)), np.zeros((0, 2, 3), int))
        position = {name: k for k, name in enumerate(names)}
        found: dict[str, tuple[Floats, NDArray[np.int64]]] = {}
        # A point of the tool yields its name to a place of the same name.
        for (section, name), reference in references.items():
            hidden = section == "targets" and name in found
            if hidden or not isinstance(reference, Point | Sphere | Anchor):
                continue
            if reference.xyz is not None:
                # The known points of a camera have no parameters.
                columns = [
                    position.get(f"{name}.{reference.kind}.{c}", -1) for c in "xyz"
                ]
                found[name] = reference.xyz, np.array(columns)
        known = tuple(d for d in distances if all(name in found for name in d.between))
        ends = [[found[name][0] for name in d.between] for d in known]
        positions = [[found[name][1] for name in d.between] for d in known]
        return KnownDistances(
            known,
            np.array(ends).reshape(-1, 2, 3),
            np.array(positions, np.int64).reshape(-1, 2, 3),
        )

    def __len__(self) -> int:
        """Number of distances D."""
        return len(self.stated)

    def lengths(self, theta: Floats) -> Floats:
        """The distances that the model predicts, (..., P) -> (..., D) [m].

        Args:
            theta: Parameter values, one vector or many.
        """
        return np.asarray(np.linalg.norm(self._vectors(theta), axis=-1))

    def residual(self, theta: Floats) -> Floats:
        """Whitened residuals, predicted minus known, (..., P) -> (..., D)."""
        return np.asarray((self.lengths(theta) - self._values) / self._sigma)

    def jacobian(self, theta: Floats) -> Floats:
        """Derivative of the whitened residuals by the parameters, shape (D, P)."""
        vectors = self._vectors(theta)
        result = np.zeros((len(self), len(theta)))
        for k, (vector, columns) in enumerate(zip(vectors, self.columns, strict=True)):
            length = float(np.linalg.norm(vector))
            # Points in one place have no direction to part in.
            direction = vector / (length or np.inf) / self._sigma[k]
            for end, sign in zip(columns, (-1.0, 1.0), strict=True):
                if end[0] >= 0:
                    result[k, end] = sign * direction
        return result

    @cached_property
    def _values(self) -> Floats:
        return np.array([distance.value for distance in self.stated])

    @cached_property
    def _sigma(self) -> Floats:
        return np.array([distance.sigma for distance in self.stated])

    def _vectors(self, theta: Floats) -> Floats:
        """From one end to the other, shape (..., D, 3) [m]."""
        # What is no parameter finds a zero behind the others.
        padded = np.zeros((*theta.shape[:-1], theta.shape[-1] + 1))
        padded[..., :-1] = theta
        ends = self.ends + padded[..., self.columns]
        return np.asarray(ends[..., 1, :] - ends[..., 0, :])
