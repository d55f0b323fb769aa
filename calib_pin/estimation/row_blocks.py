"""Residual rows beside the measurements: known distances, expected sizes, priors.

Known distances between points, those of a gauge or of the sockets of one plate, say
nothing of the robot by themselves. A ball in two sockets a known distance apart is what
gives a robot without any other length its scale.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calib_pin.estimation.identifiability import inverse_root
from calib_pin.estimation.terms import FRAME, Terms
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats, skew
from calib_pin.measurement_models.references import (
    Anchor,
    Point,
    ReferenceObject,
    Sphere,
)
from calib_pin.parameters import ParameterSet
from calib_pin.setup import DistanceSetup, JointPrior


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
    def expected(
        directions: Floats, sizes: Floats, scales: Floats, places: Floats
    ) -> Priors:
        """A prior about zero on directions of the robot's errors.

        Args:
            directions: Of the parameters divided by their scale, shape (P, k).
            sizes: Standard deviation of every parameter, in scales, shape (P,).
            scales: Scales of the parameters, shape (P,).
            places: Errors by independent ones of these sizes, in scales, see
                `places`, shape (P, P).
        """
        root = inverse_root(sizes[:, None] * (places.T @ directions))
        return Priors(root.T @ directions.T / scales, np.zeros(len(scales)))

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
class Further:
    """The residual rows behind those of measurements, one kind behind the other.

    Attributes:
        distances: Known distances.
        expected: Expected sizes of the robot's errors; None where there are none.
        priors: Priors on parameters.
    """

    distances: KnownDistances
    expected: Priors | None
    priors: Priors

    def __len__(self) -> int:
        """Number p of rows."""
        return sum(map(len, self._kinds))

    def residual(self, theta: Floats) -> Floats:
        """All rows, (..., P) -> (..., p)."""
        return np.concatenate([kind.residual(theta) for kind in self._kinds], axis=-1)

    def jacobian(self, theta: Floats) -> Floats:
        """Their derivative, shape (p, P)."""
        return np.concatenate([kind.jacobian(theta) for kind in self._kinds])

    @cached_property
    def _kinds(self) -> Sequence[KnownDistances | Priors]:
        expected = () if self.expected is None else (self.expected,)
        return self.distances, *expected, self.priors


LARGE = 4.0
"""Way from the first axis to the tip [m] up to which errors of lengths have one size.

The largest industrial arms reach 3 m.
"""

PLACES = (Point, Sphere, Anchor)
"""Reference objects between which distances may be known."""


@dataclass(frozen=True)
class KnownDistances:
    """D distances between reference objects of a measurement model.

    Attributes:
        stated: The distances.
        places: Both ends of each at its reference, shape (D, 2, 3) [m].
        columns: Where the parameters of both ends stand among all, shape (D, 2, 3); -1
            where they are no parameters.
    """

    stated: tuple[DistanceSetup, ...]
    places: Floats
    columns: NDArray[np.int64]

    @staticmethod
    def of(
        known: Sequence[DistanceSetup],
        references: Mapping[tuple[str, str], ReferenceObject],
        names: Sequence[str],
    ) -> KnownDistances:
        """Those whose both ends are among some references.

        Args:
            known: Known distances.
            references: Reference objects by section and name among all.
            names: Names of all parameters.
        """
        position = {name: k for k, name in enumerate(names)} if known else {}
        points: dict[str, tuple[Floats, list[int]]] = {}
        # A point of the tool yields its name to a place of the same name.
        for (section, name), reference in references.items() if known else ():
            hidden = section == "targets" and name in points
            if hidden or not isinstance(reference, PLACES) or reference.xyz is None:
                continue
            # The known points of a camera have no parameters.
            three = [*reference.components][:3]
            coordinates = [f"{name}.{reference.kind}.{c}" for c, *_ in three]
            points[name] = reference.xyz, [position.get(n, -1) for n in coordinates]
        whole = tuple(k for k in known if all(name in points for name in k.between))
        pairs = [[points[name] for name in k.between] for k in whole]
        places = np.array([[xyz for xyz, _ in pair] for pair in pairs], float)
        columns = np.array([[index for _, index in pair] for pair in pairs], np.int64)
        return KnownDistances(
            whole, places.reshape(-1, 2, 3), columns.reshape(-1, 2, 3)
        )

    def __len__(self) -> int:
        """Number of distances D."""
        return len(self.stated)

    def lengths(self, theta: Floats) -> Floats:
        """Their predicted values, (..., P) -> (..., D) [m].

        Args:
            theta: Parameter values, one vector or many.
        """
        return np.asarray(np.linalg.norm(self._end_vectors(theta), axis=-1))

    def residual(self, theta: Floats) -> Floats:
        """Whitened residuals, predicted minus known, (..., P) -> (..., D)."""
        values = np.array([known.value for known in self.stated])
        return np.asarray((self.lengths(theta) - values) / self._sigma)

    def jacobian(self, theta: Floats) -> Floats:
        """Derivative of the whitened residuals by the parameters, shape (D, P)."""
        apart = self._end_vectors(theta)
        lengths = np.linalg.norm(apart, axis=-1)
        # Points in one place have no direction to part in.
        weights = np.where(lengths > 0.0, lengths, np.inf) * self._sigma
        result = np.zeros((len(self), len(theta) + 1))
        slopes = apart / weights[:, None]
        for row, slope, (one, other) in zip(result, slopes, self.columns, strict=True):
            row[one], row[other] = -slope, slope
        return result[:, :-1]

    def _end_vectors(self, theta: Floats) -> Floats:
        """From one end of each to the other, (..., P) -> (..., D, 3) [m]."""
        # What is no parameter finds a zero behind the others.
        padded = np.append(theta, np.zeros((*theta.shape[:-1], 1)), axis=-1)
        ends = self.places + padded[..., self.columns]
        return np.asarray(ends[..., 1, :] - ends[..., 0, :])

    @property
    def _sigma(self) -> Floats:
        return np.array([known.sigma for known in self.stated])


def expected_places(system: Terms, parameters: ParameterSet) -> Floats:
    """Errors about the frames of joints by independent ones at their places.

    Of joints all of whose six errors are free and have no prior of their own; others
    stay as they are.

    Args:
        system: The robot and how it is measured.
        parameters: Its parameters.

    Returns:
        Matrix C of `theta = scales * C e`, shape (P, P).
    """
    result = np.eye(len(parameters))
    remaining = parameters.free & ~parameters.nuisance & ~np.isfinite(parameters.priors)
    for term in system.terms.values():
        places = feet(term.error.chain)
        joints = defaultdict[tuple[int, str], list[int]](list)
        for k in range(FRAME, len(term.error.screws) - FRAME):
            screw = term.error.screws[k]
            if screw.basis is None and remaining[term.index[k]]:
                stem = screw.parameter.name.rpartition(".")[0]
                joints[screw.frame, stem].append(k)
        for (frame, _), members in joints.items():
            index = term.index[members]
            if len(members) == FRAME and frame <= len(places):
                twists = np.array([term.error.screws[k].twist for k in members]).T
                # Both in the scales of the parameters: translations, then rotations.
                scales = parameters.scales[index]
                block = np.linalg.solve(twists * scales, places[frame - 1] * scales)
                result[np.ix_(index, index)] = block
            # What several chains share has one place.
            remaining[index] = False
    return result


def feet(chain: Chain) -> Floats:
    """Twists in the frame of every joint by those about its place, shape (n, 6, 6).

    A frame may stand anywhere on its axis, and the robot is the same. Errors that are
    equally large about every frame are not: a milliradian about a frame that stands a
    meter off moves the joint by a millimeter more. They are counted at the foot of the
    perpendicular from the tip, and from there at that on the axis before, back to the
    base: places that the axes alone tell, and that stay within the robot where axes are
    nearly parallel.

    Lengths of a crane are off by more than those of an arm, while its angles are not:
    beyond `LARGE` translations grow with the way from place to place.
    """
    frames, zero, reach = chain.joint_frames(), np.zeros((1, len(chain.joints))), 0.0
    point, result = chain.poses(zero)[0, :3, 3], np.tile(np.eye(6), (len(frames), 1, 1))
    for k in reversed(range(len(frames))):
        turn, origin, axis = frames[k, :3, :3], frames[k, :3, 3], chain.axes[k]
        place = ((point - origin) @ turn @ axis) * axis
        result[k, :3, 3:] = skew(place)
        point, last = origin + turn @ place, point
        reach += float(np.linalg.norm(last - point))
    result[:, :3, :3] *= max(1.0, reach / LARGE)
    return result
