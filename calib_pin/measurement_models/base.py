"""The interface of measurement models, and what they share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar, Protocol, Self, runtime_checkable

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.declaration import Declaration, Quantity
from calib_pin.measurement_models.references import ReferenceObject, slices
from calib_pin.observations import Booleans, Indices, Measurements, Targets
from calib_pin.parameters import Parameter
from calib_pin.setup import Setup


@dataclass(frozen=True)
class Linearization:
    """Residuals of N measurements and their derivatives.

    Attributes:
        residual: Predicted minus measured, shape (N, d).
        J_pose: Derivative by the body twist of the tool, shape (N, d, 6).
        J_instrument: Derivative by the model's parameters, shape (N, d, K).
    """

    residual: Floats
    J_pose: Floats
    J_instrument: Floats


class MeasurementModel(ABC):
    """How the tool pose becomes a measured value.

    A member is frozen; its parameters are those of its reference objects (a plane,
    say), deviations from references that these carry, and `register` returns it about
    better references. Unless it says otherwise it can measure at every pose, has no
    reference objects, nothing to be named, and noise adds to its values.
    """

    declaration: ClassVar[Declaration]
    """Name, columns, components and scope, as users and other rooms see them."""

    @classmethod
    @abstractmethod
    def from_setup(cls, setup: Setup, targets: Sequence[str]) -> Self:
        """The model as a setup states it.

        Args:
            setup: The setup of the user.
            targets: The targets that measurements name, each once.

        Raises:
            OptionError: If the setup lacks something, or states it wrongly.
        """

    @property
    def name(self) -> str:
        """Name as users write it."""
        return self.declaration.name

    @property
    def quantities(self) -> Sequence[Quantity]:
        """The quantities of the residual, in order."""
        return self.declaration.quantities

    @property
    def width(self) -> int:
        """Columns D of measured values."""
        return len(self.declaration.values)

    @property
    def sees_tool(self) -> bool:
        """Whether measurements depend on the tool frame, not on known offsets from it.

        Then the tool frame is unknown unless the setup says otherwise.
        """
        return True

    @property
    def missing(self) -> str:
        """Things that a study without measurements lacks; empty where none."""
        return ""

    @property
    def targets(self) -> Sequence[str]:
        """Names of what measurements can look at; empty where they need not say."""
        return ()

    @property
    def references(self) -> Sequence[ReferenceObject]:
        """The objects that measurements refer to, in the order of the parameters."""
        return ()

    def with_references(self, references: Sequence[ReferenceObject]) -> Self:
        """The same model with its reference objects about other references."""
        return self

    @property
    def parameters(self) -> Sequence[Parameter]:
        """The parameters of the reference objects."""
        return tuple(p for reference in self.references for p in reference.parameters)

    def rebased(self, instrument: Floats) -> Self:
        """The same model with its parameters, shape (K,), moved into its references."""
        parts = zip(self.references, slices(self.references), strict=True)
        return self.with_references([o.rebased(instrument[part]) for o, part in parts])

    def extended(self, T: Floats, data: Measurements) -> Self:
        """The model with sites for what measurements name and it does not know.

        Only what was not there when it was fitted gets a site: the socket of
        measurements that were set aside, say, where the robot finds its ball on
        average.

        Args:
            T: Tool poses in the measurement frame, shape (N, 4, 4).
            data: The measurements.
        """
        return self

    @abstractmethod
    def predict(self, T: Floats, instrument: Floats, target: Targets) -> Floats:
        """Noise-free values in the layout of `Measurements.values`, shape (N, D).

        Args:
            T: Tool poses in the measurement frame, shape (N, 4, 4).
            instrument: Values of the model's parameters, shape (K,).
            target: Name of the target of each measurement.
        """

    def observable(self, T: Floats, instrument: Floats, target: Targets) -> Booleans:
        """Whether the instrument can measure at each pose at all, shape (N,)."""
        return np.ones(len(T), bool)

    def disturb(self, values: Floats, noise: Floats) -> Floats:
        """Values with noise of the residual components added; contacts have none."""
        return values + noise if values.shape[1] else values

    def residual(self, T: Floats, instrument: Floats, data: Measurements) -> Floats:
        """Signed residual, predicted minus measured, shape (N, d)."""
        return self.predict(T, instrument, data.target) - data.values

    @abstractmethod
    def linearize(
        self, T: Floats, instrument: Floats, data: Measurements
    ) -> Linearization:
        """Residual and its derivatives."""

    @abstractmethod
    def register(
        self, F: Floats, data: Measurements, base: pin.SE3 | None, tool: pin.SE3 | None
    ) -> tuple[Self, pin.SE3, pin.SE3]:
        """Closed-form references from nominal tip poses; no first guess is needed.

        Args:
            F: Nominal tip poses in the base link, shape (N, 4, 4).
            data: The measurements to fit.
            base: The base frame where it is known, or None to estimate it.
            tool: The tool frame where it is known, or None to estimate it.

        Returns:
            The model about its registered references, the base and the tool frame.
        """


@dataclass(frozen=True)
class Geometry:
    """Both sides of a comparison, for the S members of a population.

    Attributes:
        points: Points that are carried through the chain, shape (S, J, 3) [m].
        sites: References that these are compared with, shape (S, L, w), see `kernels`.
    """

    points: Floats
    sites: Floats


@dataclass(frozen=True)
class Batch:
    """Some measurements as a compiled kernel costs them for a whole population.

    Attributes:
        comparison: One of `kernels.COMPARISONS`.
        rows: Positions of the N rows in the data, shape (N,).
        point: Which point of the references each looks at, shape (N,).
        site: Which site that is compared with, shape (N,).
        values: Measured values, shape (N, D).
        weights: Reciprocal standard deviations of the residual, shape (N, d).
        geometry: That of members, from the model's parameters (S, K).
    """

    comparison: str
    rows: NDArray[np.intp]
    point: Indices
    site: Indices
    values: Floats
    weights: Floats
    geometry: Callable[[Floats], Geometry]


@runtime_checkable
class BatchedModel(Protocol):
    """A measurement model that a compiled kernel can evaluate."""

    def batches(self, data: Measurements, weights: Floats) -> Sequence[Batch]:
        """The batch form of some measurements; empty where they have none.

        Args:
            data: The measurements.
            weights: Reciprocal standard deviations of the residual, shape (N, d).
        """
        ...
