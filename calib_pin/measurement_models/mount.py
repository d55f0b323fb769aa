"""An instrument with a stand and a mount of its own, among others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib_pin.kinematics.spatial import Floats, adjoint, invert
from calib_pin.measurement_models.base import (
    Batch,
    BatchedModel,
    Geometry,
    Linearization,
    MeasurementModel,
    ReferenceParameters,
)
from calib_pin.measurement_models.declaration import Quantity
from calib_pin.measurement_models.references import Frame, ReferenceObject
from calib_pin.observations import Measurements


@dataclass(frozen=True)
class _Wrapper(ReferenceParameters):
    """A model with another inside, whose name, numbers and targets are its own."""

    model: MeasurementModel

    @property
    def name(self) -> str:
        """That of the model."""
        return self.model.name

    @property
    def quantities(self) -> Sequence[Quantity]:
        """Those of the model."""
        return self.model.quantities

    @property
    def width(self) -> int:
        """That of the model."""
        return self.model.width

    @property
    def contact(self) -> bool:
        """That of the model."""
        return self.model.contact

    @property
    def relative(self) -> bool:
        """That of the model."""
        return self.model.relative

    @property
    def missing(self) -> str:
        """What the model lacks."""
        return self.model.missing

    @property
    def targets(self) -> Sequence[str]:
        """Those of the model."""
        return self.model.targets

    def disturb(self, values: Floats, noise: Floats) -> Floats:
        """As the model does."""
        return self.model.disturb(values, noise)


@dataclass(frozen=True)
class Mounted(_Wrapper):
    """A model that sees the poses `D T E` where others see T.

    Attributes:
        model: The model.
        stand: Pose D of the measuring frame in that of the model.
        mount: Pose E of the model's tool frame in the tool frame.
    """

    stand: Frame
    mount: Frame

    @staticmethod
    def of(model: MeasurementModel) -> Mounted:
        """A model with unknown frames of its own, named after it."""
        return Mounted(model, Frame(model.name, "base"), Frame(model.name, "tool"))

    @property
    def external(self) -> bool:
        """False: it stands in the measurement frame of the others."""
        return False

    @property
    def sees_tool(self) -> bool:
        """False: the model has a tool frame of its own."""
        return False

    @property
    def references(self) -> Sequence[ReferenceObject]:
        """Those of the model, the stand and the mount."""
        return (*self.model.references, self.stand, self.mount)

    def with_references(self, references: Sequence[ReferenceObject]) -> Mounted:
        """The same about other references."""
        *inner, stand, mount = references
        assert isinstance(stand, Frame) and isinstance(mount, Frame)
        return Mounted(self.model.with_references(inner), stand, mount)

    def predict(self, T: Floats, instrument: Floats, target: Sequence[str]) -> Floats:
        """Values of the model at its own poses."""
        inner, D, E = self._split(instrument)
        return self.model.predict(D @ T @ E, inner, target)

    def observable(
        self, T: Floats, instrument: Floats, target: Sequence[str]
    ) -> NDArray[np.bool_]:
        """Whether the model can measure at its own poses."""
        inner, D, E = self._split(instrument)
        return self.model.observable(D @ T @ E, inner, target)

    def residual(self, T: Floats, instrument: Floats, data: Measurements) -> Floats:
        """Residual of the model at its own poses."""
        inner, D, E = self._split(instrument)
        return self.model.residual(D @ T @ E, inner, data)

    def linearize(
        self, T: Floats, instrument: Floats, data: Measurements
    ) -> Linearization:
        """Twists of the stand and of the tool are carried to the model's tool."""
        inner, D, E = self._split(instrument)
        TE = T @ E
        linear = self.model.linearize(D @ TE, inner, data)
        # D = D_0 Exp(d), so that a twist d stands before T E.
        at_stand = linear.J_pose @ adjoint(invert(TE))
        by_stand = at_stand @ self.stand.twists(instrument[-12:-6])
        by_mount = linear.J_pose @ self.mount.twists(instrument[-6:])
        return replace(
            linear,
            J_pose=linear.J_pose @ adjoint(invert(E[None])),
            J_instrument=np.concatenate(
                [linear.J_instrument, by_stand, by_mount], axis=2
            ),
        )

    def batches(self, data: Measurements, weights: Floats) -> Sequence[Batch]:
        """Those of the model, with both frames around the chain."""
        if not isinstance(self.model, BatchedModel):
            return []

        def around(inner: Batch) -> Batch:
            def geometry(instrument: Floats) -> Geometry:
                found = inner.geometry(instrument[:, :-12])
                stand, mount = instrument[:, -12:-6], instrument[:, -6:]
                return replace(
                    found,
                    stand=self.stand.moved(stand),
                    mount=self.mount.moved(mount),
                )

            return replace(inner, geometry=geometry)

        return list(map(around, self.model.batches(data, weights)))

    def register(
        self, F: Floats, data: Measurements, base: pin.SE3 | None, tool: pin.SE3 | None
    ) -> tuple[Mounted, pin.SE3, pin.SE3]:
        """As the model does with frames of its own, which are then put behind T."""
        base, tool = base or pin.SE3.Identity(), tool or pin.SE3.Identity()
        D, E = self.stand.pose, self.mount.pose
        model, model_base, model_tool = self.model.register(
            F, data, None if D is None else D * base, None if E is None else tool * E
        )
        return (
            Mounted(
                model,
                replace(self.stand, pose=model_base * base.inverse()),
                replace(self.mount, pose=tool.inverse() * model_tool),
            ),
            base,
            tool,
        )

    def _split(self, instrument: Floats) -> tuple[Floats, Floats, Floats]:
        """Parameters of the model, and both frames, shape (4, 4)."""
        stand, mount = (
            self.stand.rebased(instrument[-12:-6]),
            self.mount.rebased(instrument[-6:]),
        )
        assert stand.pose is not None and mount.pose is not None
        return instrument[:-12], stand.pose.homogeneous, mount.pose.homogeneous
