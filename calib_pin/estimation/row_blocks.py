"""Residual rows beside the measurements: known distances, expected sizes, priors.

Known distances between points, those of a gauge or of the sockets of one plate, say
nothing of the robot by themselves. A ball in two sockets a known distance apart is what
gives a robot without any other length its scale.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import OptionError
from calib_pin.estimation.identifiability import inverse_root
from calib_pin.estimation.terms import FRAME, Terms
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats, skew
from calib_pin.measurement_models.references import (
    Anchor,
    Plane,
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
        distances: Known distances and angles.
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


@dataclass(frozen=True)
class KnownDistances:
    """D distances and angles between reference objects of a measurement model.

    Attributes:
        stated: The distances and angles.
        ends: Both ends of each.
        columns: Where three parameters of both ends stand among all, shape (D, 2, 3);
            -1 where they are no parameters.
    """

    stated: tuple[DistanceSetup, ...]
    ends: tuple[tuple[ReferenceObject, ReferenceObject], ...]
    columns: NDArray[np.int64]

    @staticmethod
    def of(
        known: Sequence[DistanceSetup],
        references: Mapping[tuple[str, str], ReferenceObject],
        names: Sequence[str],
    ) -> KnownDistances:
        """Those whose both ends are among some references.

        Args:
            known: Known distances and angles.
            references: Reference objects by section and name among all.
            names: Names of all parameters.
        """
        position = {name: k for k, name in enumerate(names)} if known else {}
        found: dict[str, tuple[ReferenceObject, list[int]]] = {}
        # A point of the tool yields its name to a place of the same name.
        for (section, name), reference in references.items() if known else ():
            hidden = section == "targets" and name in found
            if hidden or not isinstance(reference, PLACES) or not reference.located:
                continue
            # The known points of a camera have no parameters.
            three = [*reference.components][:3]
            own = [f"{name}.{reference.kind}.{component}" for component, *_ in three]
            found[name] = reference, [position.get(name, -1) for name in own]
        whole = tuple(k for k in known if all(name in found for name in k.between))
        pairs = [(found[k.between[0]], found[k.between[1]]) for k in whole]
        columns = np.array([(a[1], b[1]) for a, b in pairs], np.int64)
        ends = tuple((a[0], b[0]) for a, b in pairs)
        return KnownDistances(whole, ends, columns.reshape(-1, 2, 3))

    def __len__(self) -> int:
        """Number of distances and angles D."""
        return len(self.stated)

    def lengths(self, theta: Floats) -> Floats:
        """Their predicted values, (..., P) -> (..., D) [m, rad].

        Args:
            theta: Parameter values, one vector or many.
        """
        found = [self._compared(k, v)[0] for k, v in enumerate(self._values_of(theta))]
        return np.stack(found, -1) if found else np.empty((*theta.shape[:-1], 0))

    def residual(self, theta: Floats) -> Floats:
        """Whitened residuals, predicted minus known, (..., P) -> (..., D)."""
        numbers = np.array([(known.value, known.sigma) for known in self.stated])
        values, sigma = numbers.reshape(-1, 2).T
        return np.asarray((self.lengths(theta) - values) / sigma)

    def jacobian(self, theta: Floats) -> Floats:
        """Derivative of the whitened residuals by the parameters, shape (D, P)."""
        result = np.zeros((len(self), len(theta)))
        for k, own in enumerate(self._values_of(theta)):
            _, *slopes = self._compared(k, own)
            for end, reference in enumerate(self.ends[k]):
                columns = self.columns[k, end]
                if columns[0] >= 0:
                    by_values = slopes[end] @ _slope(reference, own[end])
                    result[k, columns] = by_values / self.stated[k].sigma
        return result

    def with_parallels(self, theta: Floats) -> Floats:
        """Parameters with which planes of a known distance are parallel, shape (P,).

        Others that are hardly tilted meet far away. A robot that grows about there
        touches them as before, and the scale would seem unobservable.

        Raises:
            OptionError: If planes are not nearly parallel.
        """
        result = theta.copy()
        for k, (one, other) in enumerate(self.ends):
            known, columns = self.stated[k], self.columns[k]
            flat = isinstance(one, Plane) and isinstance(other, Plane)
            if not flat or known.unit == "rad" or columns.min() < 0:
                continue
            assert isinstance(one, Plane) and isinstance(other, Plane)
            a, b = one.turned(result[columns[0]])[0], other.turned(result[columns[1]])
            angle = float(np.arccos(min(abs(float(a @ b[0])), 1.0)))
            if angle > PARALLEL:
                raise OptionError(
                    f"planes at {np.degrees(angle):.1f} deg have no distance; only "
                    "parallel ones have",
                    value=list(known.between),
                )
            at = _half_way(one, other)[:3]
            normal, height = np.sign(a @ b[0]) * a, float(b[0] @ at + b[1])
            result[columns[1]] = other.towards(normal, at, height)
        return result

    def _values_of(self, theta: Floats) -> Iterator[Floats]:
        """Parameters of both ends of each, shape (2, ..., 3)."""
        # What is no parameter finds a zero behind the others.
        padded = np.append(theta, np.zeros((*theta.shape[:-1], 1)), axis=-1)
        for columns in self.columns:
            yield np.moveaxis(padded[..., columns], -2, 0)

    def _compared(self, k: int, values: Floats) -> tuple[Floats, Floats, Floats]:
        """Distance or angle (...,), and its derivatives by both ends, (..., 4) each.

        Args:
            k: Which one it is.
            values: Parameters of both ends, shape (2, ..., 3).
        """
        one, other = self.ends[k]
        a, b = _placed(one, values[0]), _placed(other, values[1])
        flat = isinstance(one, Plane), isinstance(other, Plane)
        if self.stated[k].unit == "rad":
            return _angle(a, b)
        if flat == (True, True):
            # Of planes that are not quite parallel it depends on where one looks.
            sign = np.where(np.sum(a[..., :3] * b[..., :3], axis=-1) < 0.0, -1.0, 1.0)
            at, turned = _half_way(one, other), sign[..., None]
            height, by_a, by_b = (a - turned * b) @ at, at, -turned * at
        elif any(flat):
            height, by_a, by_b = np.sum(a * b, axis=-1), b, a
        else:
            length = np.linalg.norm(b - a, axis=-1)
            # Points in one place have no direction to part in.
            by_b = (b - a) / np.where(length > 0.0, length, np.inf)[..., None]
            return length, -by_b, by_b
        side = np.where(height < 0.0, -1.0, 1.0)
        return np.abs(height), side[..., None] * by_a, side[..., None] * by_b


PARALLEL = 0.1
"""Largest angle between planes that are meant to be parallel [rad]."""

PLACES = (Point, Sphere, Anchor, Plane)
"""Reference objects between which distances may be known."""


def _placed(reference: ReferenceObject, values: Floats) -> Floats:
    """The coordinates of a point and 1, or a plane's normal and offset, (..., 4)."""
    if isinstance(reference, Plane):
        normal, offset, _ = reference.turned(values)
        return np.concatenate([normal, offset[..., None]], axis=-1)
    assert isinstance(reference, Point | Sphere | Anchor) and reference.xyz is not None
    ones = np.ones((*values.shape[:-1], 1))
    return np.concatenate([reference.xyz + values, ones], axis=-1)


def _slope(reference: ReferenceObject, values: Floats) -> Floats:
    """Derivative of that by the parameters, shape (4, 3)."""
    result = np.eye(4, 3)
    if isinstance(reference, Plane):
        result = np.zeros((4, 3))
        result[:3, :2], result[3, 2] = reference.turned(values)[2], 1.0
    return result


def _half_way(*planes: ReferenceObject) -> Floats:
    """Where the distance of planes is taken: between where they were measured, (4,)."""
    found = [p.center for p in planes if isinstance(p, Plane) and p.center is not None]
    return np.append(np.mean(found or [np.zeros(3)], axis=0), 1.0)


def _angle(a: Floats, b: Floats) -> tuple[Floats, Floats, Floats]:
    """The smaller angle of planes, with its derivatives, see `KnownDistances`."""
    cosine = np.sum(a[..., :3] * b[..., :3], axis=-1)
    sine = np.linalg.norm(np.cross(a[..., :3], b[..., :3]), axis=-1)
    side = np.where(cosine < 0.0, -1.0, 1.0)
    slope = (-side / np.maximum(sine, 1e-12))[..., None] * [1.0, 1.0, 1.0, 0.0]
    return np.arctan2(sine, side * cosine), slope * b, slope * a


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
    left = parameters.free & ~parameters.nuisance & ~np.isfinite(parameters.priors)
    for term in system.terms.values():
        places = feet(term.error.chain)
        joints = defaultdict[tuple[int, str], list[int]](list)
        for k in range(FRAME, len(term.error.screws) - FRAME):
            screw = term.error.screws[k]
            if screw.basis is None and left[term.index[k]]:
                stem = screw.parameter.name.rpartition(".")[0]
                joints[screw.frame, stem].append(k)
        for (frame, _), own in joints.items():
            index = term.index[own]
            if len(own) == FRAME and frame <= len(places):
                twists = np.array([term.error.screws[k].twist for k in own]).T
                there = np.eye(FRAME)
                there[:3, 3:] = skew(places[frame - 1])
                # Both in the scales of the parameters: translations, then rotations.
                scales = parameters.scales[index]
                block = np.linalg.solve(twists * scales, there * scales)
                result[np.ix_(index, index)] = block
            # What several chains share has one place.
            left[index] = False
    return result


def feet(chain: Chain) -> Floats:
    """Place of the errors of every joint, in its own frame, shape (n, 3) [m].

    A frame may stand anywhere on its axis, and the robot is the same. Errors that are
    equally large about every frame are not: a milliradian about a frame that stands a
    meter off moves the joint by a millimeter more. They are counted at the foot of the
    perpendicular from the tip, and from there at that on the axis before, back to the
    base: places that the axes alone tell, and that stay within the robot where axes are
    nearly parallel.
    """
    frames, zero = chain.joint_frames(), np.zeros((1, len(chain.joints)))
    point, result = chain.poses(zero)[0, :3, 3], np.zeros((len(frames), 3))
    for k in reversed(range(len(frames))):
        turn, origin, axis = frames[k, :3, :3], frames[k, :3, 3], chain.axes[k]
        result[k] = ((point - origin) @ turn @ axis) * axis
        point = origin + turn @ result[k]
    return result
