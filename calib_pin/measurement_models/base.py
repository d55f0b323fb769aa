"""What a measurement model is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, Self, runtime_checkable

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib_pin.kinematics.spatial import Floats, skew
from calib_pin.measurement_models.features import Feature, slices
from calib_pin.observations import Measurements
from calib_pin.parameters import Parameter

__all__ = [
    "Batch",
    "BatchedModel",
    "Curvature",
    "CurvedModel",
    "ExternalInstrument",
    "Linearization",
    "MeasurementModel",
    "Quantity",
    "ReferenceObjects",
    "References",
    "rotation_curvature",
    "tool_references",
]


@dataclass(frozen=True)
class Quantity:
    """One physical quantity within the residual.

    Attributes:
        name: Name in reports, such as `position`.
        unit: `m`, `rad` or `px`.
        columns: The residual components that belong to it.
        sigma: Standard deviation assumed where none is stated.
        noise: Name under which a setup states another; default its own.
    """

    name: str
    unit: str
    columns: slice
    sigma: float
    noise: str = ""

    def errors(self, residual: Floats) -> Floats:
        """Size of the error of each row that has this quantity, (N, d) -> (n,).

        The others have NaN.
        """
        sizes = np.linalg.norm(residual[:, self.columns], axis=1)
        return np.asarray(sizes[~np.isnan(sizes)])


@dataclass(frozen=True)
class Linearization:
    """Residuals of N rows and their derivatives.

    Attributes:
        residual: Predicted minus measured, shape (N, d).
        J_pose: Derivative by the body twist of the tool, shape (N, d, 6).
        J_instrument: Derivative by the model's own parameters, shape (N, d, K).
    """

    residual: Floats
    J_pose: Floats
    J_instrument: Floats


class MeasurementModel(Protocol):
    """How the tool pose becomes a measured value.

    A member is frozen; its own parameters are those of its features (a plane, say),
    deviations from references that these carry, and `register` returns it about better
    references.
    """

    @property
    def name(self) -> str:
        """Name as users write it."""
        ...

    @property
    def quantities(self) -> Sequence[Quantity]:
        """The quantities of the residual, in order."""
        ...

    @property
    def measuring_frame(self) -> bool:
        """Whether values belong to a frame of the instrument's own.

        Then the base frame is unknown unless the setup says otherwise.
        """
        ...

    @property
    def width(self) -> int:
        """Columns D of measured values."""
        ...

    @property
    def contact(self) -> bool:
        """Whether nothing is measured but that the residual is zero, up to noise.

        Rows then are configurations at which the tool touches something.
        """
        ...

    @property
    def relative(self) -> bool:
        """Whether poses are those of the tool in the tool at a row's start."""
        ...

    @property
    def sees_tool(self) -> bool:
        """Whether rows depend on the tool frame, and not on known offsets from it.

        Then the tool frame is unknown unless the setup says otherwise.
        """
        ...

    @property
    def missing(self) -> str:
        """What a study without measurements lacks; empty where nothing."""
        ...

    @property
    def targets(self) -> Sequence[str]:
        """Names of what rows can look at; empty where they need not say."""
        ...

    @property
    def features(self) -> Sequence[Feature]:
        """What rows refer to, in the order of the model's own parameters."""
        ...

    def with_features(self, features: Sequence[Feature]) -> MeasurementModel:
        """The same model about other references of the same features."""
        ...

    def extended(self, T: Floats, data: Measurements) -> MeasurementModel:
        """The model with places for what rows name and it does not know.

        Only what was not there when it was fitted gets a place: the socket of rows
        that were set aside, say, where the robot finds its ball on average.

        Args:
            T: Tool poses in the measuring frame, shape (N, 4, 4).
            data: The rows.
        """
        ...

    @property
    def parameters(self) -> Sequence[Parameter]:
        """The model's own parameters."""
        ...

    def rebased(self, own: Floats) -> MeasurementModel:
        """The same model with its own parameters moved into its references.

        Args:
            own: Values of the model's own parameters, shape (K,).
        """
        ...

    def predict(self, T: Floats, own: Floats, target: Sequence[str]) -> Floats:
        """Noise-free values in the layout of `Measurements.values`, shape (N, D).

        Args:
            T: Tool poses in the measuring frame, shape (N, 4, 4).
            own: Values of the model's own parameters, shape (K,).
            target: Name of the target of each row.
        """
        ...

    def observable(
        self, T: Floats, own: Floats, target: Sequence[str]
    ) -> NDArray[np.bool_]:
        """Whether the instrument can measure at each pose at all, shape (N,)."""
        ...

    def disturb(self, values: Floats, noise: Floats) -> Floats:
        """Values with noise of the residual components added, shape (N, d)."""
        ...

    def residual(self, T: Floats, own: Floats, data: Measurements) -> Floats:
        """Signed residual, predicted minus measured, shape (N, d)."""
        ...

    def linearize(self, T: Floats, own: Floats, data: Measurements) -> Linearization:
        """Residual and its derivatives."""
        ...

    def register(
        self, F: Floats, data: Measurements, base: pin.SE3 | None, tool: pin.SE3 | None
    ) -> tuple[MeasurementModel, pin.SE3, pin.SE3]:
        """Closed-form references from nominal tip poses; no first guess is needed.

        Args:
            F: Nominal tip poses in the base link, shape (N, 4, 4).
            data: The rows to fit.
            base: The base frame where it is known, or None to estimate it.
            tool: The tool frame where it is known, or None to estimate it.

        Returns:
            The model about its registered references, the base and the tool frame.
        """
        ...


@dataclass(frozen=True)
class References:
    """What rows look at, for the S members of a population.

    Attributes:
        points: Points that are carried through the chain, shape (S, J, 3) [m].
        places: What these are compared with, shape (S, L, w), see `kernels`.
        stand: What stands before the chain, links (R | p), shape (S, 12).
        mount: The same behind it.
    """

    points: Floats
    places: Floats
    stand: Floats | None = None
    mount: Floats | None = None


@dataclass(frozen=True)
class Batch:
    """What a compiled kernel needs to cost a whole population on some rows.

    Attributes:
        comparison: One of `kernels.COMPARISONS`.
        rows: Positions of the N rows in the data, shape (N,).
        point: Which point of the references each looks at, shape (N,).
        place: Which place that is compared with, shape (N,).
        values: What was measured, shape (N, D).
        weights: Reciprocal standard deviations of the residual, shape (N, d).
        references: Those of members, from the model's own parameters (S, K).
        inward: Whether points are carried from the base to the tool.
    """

    comparison: str
    rows: NDArray[np.intp]
    point: NDArray[np.int64]
    place: NDArray[np.int64]
    values: Floats
    weights: Floats
    references: Callable[[Floats], References]
    inward: bool = False


def tool_references(own: Floats) -> References:
    """The origin of the tool, compared with values alone."""
    return References(np.zeros((len(own), 1, 3)), np.zeros((len(own), 1, 3)))


@runtime_checkable
class BatchedModel(Protocol):
    """A measurement model that a compiled kernel can evaluate."""

    def batches(self, data: Measurements, weights: Floats) -> Sequence[Batch]:
        """The batch form of some rows; empty where they have none.

        Args:
            data: The rows.
            weights: Reciprocal standard deviations of the residual, shape (N, d).
        """
        ...


@dataclass(frozen=True)
class Curvature:
    """How a linearization at noise-free values changes as the tool moves.

    Attributes:
        J_pose: Derivative of `Linearization.J_pose` by the tool's body twist,
            shape (N, d, 6, 6), the twist last.
        J_instrument: The same of `Linearization.J_instrument`, shape (N, d, K, 6).
    """

    J_pose: Floats
    J_instrument: Floats


@runtime_checkable
class CurvedModel(Protocol):
    """A measurement model whose rows can be differentiated by the configuration."""

    def curvature(self, T: Floats, own: Floats, target: Sequence[str]) -> Curvature:
        """Second derivatives where the measured values are the predicted ones.

        Args:
            T: Tool poses in the measuring frame, shape (N, 4, 4).
            own: Values of the model's own parameters, shape (K,).
            target: Name of the target of each row.
        """
        ...


def rotation_curvature(R: Floats) -> Floats:
    """Derivative of rotations by a body twist, (N, 3, 3) -> (N, 3, 3, 6)."""
    result = np.zeros((len(R), 3, 3, 6))
    # R Exp(w) = R + R [w]x
    result[..., 3:] = np.einsum("naj,cjb->nabc", R, skew(np.eye(3)))
    return result


class ReferenceObjects:
    """What models share that have features: parameters, and moves into references."""

    @property
    def features(self) -> Sequence[Feature]:
        """None."""
        return ()

    def with_features(self, features: Sequence[Feature]) -> Self:
        """Itself: there is nothing to replace."""
        return self

    @property
    def parameters(self) -> Sequence[Parameter]:
        """Those of the features."""
        return tuple(p for feature in self.features for p in feature.parameters)

    def rebased(self, own: Floats) -> Self:
        """Every feature moved by its own parameters."""
        features = self.features
        return self.with_features(
            [
                feature.rebased(own[part])
                for feature, part in zip(features, slices(features), strict=True)
            ]
        )

    def extended(self, T: Floats, data: Measurements) -> Self:
        """Itself: rows can name nothing new."""
        return self

    @property
    def contact(self) -> bool:
        """No: something is measured."""
        return False

    @property
    def relative(self) -> bool:
        """No: poses are those of the tool."""
        return False


class ExternalInstrument(ReferenceObjects):
    """What models share whose instrument stands anywhere.

    It measures in a frame of its own, at every pose.
    """

    @property
    def measuring_frame(self) -> bool:
        """The instrument's own."""
        return True

    @property
    def missing(self) -> str:
        """Nothing."""
        return ""

    @property
    def targets(self) -> Sequence[str]:
        """None: all rows look at the tool."""
        return ()

    @property
    def sees_tool(self) -> bool:
        """Yes."""
        return True

    def observable(
        self, T: Floats, own: Floats, target: Sequence[str]
    ) -> NDArray[np.bool_]:
        """Everywhere."""
        return np.ones(len(T), bool)
