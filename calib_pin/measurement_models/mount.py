"""One of several instruments, with its own base frame and its own mount on the tool."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from calib_pin.kinematics.spatial import Floats, adjoint, invert
from calib_pin.measurement_models.base import (
    Batch,
    BatchedModel,
    Geometry,
    Linearization,
    MeasurementModel,
)
from calib_pin.measurement_models.declaration import Declaration
from calib_pin.measurement_models.references import (
    ReferenceObject,
    triple,
)
from calib_pin.observations import Booleans, Measurements, Targets
from calib_pin.setup import FrameSetup


@dataclass(frozen=True)
class Frame(ReferenceObject):
    """The base frame or the mount of one of several instruments.

    Attributes:
        name: Name of the instrument.
        kind: `base` for its stand, `tool` for its mount on the tool.
        pose: Pose D or E as in `Mounted`; None until it is registered.
        estimate: Whether the pose is estimated.
    """

    name: str
    kind: str
    pose: pin.SE3 | None = None
    estimate: bool = True

    @property
    def section(self) -> str:
        """`<kind> frames`; a setup file does not state it."""
        return f"{self.kind} frames"

    @property
    def located(self) -> bool:
        """Whether it is registered."""
        return self.pose is not None

    @property
    def outer(self) -> bool:
        """Whether it is the stand, and not the mount."""
        return self.kind == "base"

    @property
    def components(self) -> Iterable[tuple[str, str, bool]]:
        """Name, unit and freedom of the screws, in the order of the robot's frames."""
        names = ("x", "y", "z", "rx", "ry", "rz")
        units = ("m",) * 3 + ("rad",) * 3
        return ((c, u, self.estimate) for c, u in zip(names, units, strict=True))

    def rebased(self, values: Floats) -> Frame:
        """The frame moved by screws, shape (6,) [m, rad]."""
        assert self.pose is not None
        pose = self.pose
        for k in np.flatnonzero(values):
            pose = pose * pin.exp6(np.eye(6)[k] * values[k])
        return replace(self, pose=pose)

    def moved(self, values: Floats) -> Floats:
        """Poses (R | p) by rows at S values of the screws, shape (S, 6) -> (S, 12)."""
        from calib_pin.compiled import link_kernels

        assert self.pose is not None
        reference = self.pose.homogeneous[:3].reshape(1, 12)
        result, first = np.empty((len(values), 1, 12)), np.zeros(6, np.int64)
        screws = first, np.arange(6), np.eye(6)
        link_kernels.links(reference, *screws, np.ascontiguousarray(values), result)
        return result[:, 0]

    def twists(self, values: Floats) -> Floats:
        """Body twists of the frame by its parameters, shape (6, 6)."""
        result, behind = np.eye(6), pin.SE3.Identity()
        for k in reversed(range(6)):
            result[:, k] = behind.toActionMatrixInverse()[:, k]
            behind = pin.exp6(np.eye(6)[k] * values[k]) * behind
        return result

    def stated(self) -> FrameSetup:
        """Its pose as a setup file states it."""
        assert self.pose is not None
        roll, pitch, yaw = map(float, pin.rpy.matrixToRpy(self.pose.rotation))
        xyz = triple(self.pose.translation)
        return FrameSetup(xyz, (roll, pitch, yaw), self.estimate)


@dataclass(frozen=True)
class Mounted(MeasurementModel):
    """A model that measures the poses `D T E` instead of the tool poses T.

    T is the pose of the common tool frame in the common measurement frame; the model
    has a measurement frame and a tool frame of its own.

    Attributes:
        model: The model.
        stand: Pose D of the common measurement frame in that of the model.
        mount: Pose E of the model's tool frame in the common tool frame.
    """

    model: MeasurementModel
    stand: Frame
    mount: Frame

    sees_tool = False

    @staticmethod
    def of(model: MeasurementModel) -> Mounted:
        """A model with unknown frames of its own, named after it."""
        return Mounted(model, Frame(model.name, "base"), Frame(model.name, "tool"))

    @property
    def declaration(self) -> Declaration:
        """Declaration of the model, which is no longer external."""
        return replace(self.model.declaration, external=False)

    @property
    def missing(self) -> str:
        """Inputs that the model lacks in a study without data; empty if none."""
        return self.model.missing

    @property
    def targets(self) -> Sequence[str]:
        """Targets of the model."""
        return self.model.targets

    def disturb(self, values: Floats, noise: Floats) -> Floats:
        """As the model does."""
        return self.model.disturb(values, noise)

    @property
    def references(self) -> Sequence[ReferenceObject]:
        """References of the model, then the stand and the mount."""
        return (*self.model.references, self.stand, self.mount)

    def with_references(self, references: Sequence[ReferenceObject]) -> Mounted:
        """The same model with other references, in the order of `references`."""
        *inner, stand, mount = references
        assert isinstance(stand, Frame) and isinstance(mount, Frame)
        return Mounted(self.model.with_references(inner), stand, mount)

    def predict(self, T: Floats, instrument: Floats, target: Targets) -> Floats:
        """Values of the model at its own poses."""
        inner, D, E = self._split(instrument)
        return self.model.predict(D @ T @ E, inner, target)

    def observable(self, T: Floats, instrument: Floats, target: Targets) -> Booleans:
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
        """Linearization at `D T E`, with twists of T and of the stand transformed."""
        inner, D, E = self._split(instrument)
        TE = T @ E
        linear = self.model.linearize(D @ TE, inner, data)
        # D = D_0 Exp(d): the adjoint of (T E)^-1 transforms the twist d to the tool.
        J_d = linear.J_pose @ adjoint(invert(TE))
        J_stand = J_d @ self.stand.twists(instrument[-12:-6])
        J_mount = linear.J_pose @ self.mount.twists(instrument[-6:])
        return replace(
            linear,
            J_pose=linear.J_pose @ adjoint(invert(E[None])),
            J_instrument=np.concatenate(
                [linear.J_instrument, J_stand, J_mount], axis=2
            ),
        )

    def batches(self, data: Measurements, weights: Floats) -> Sequence[Batch]:
        """Batches of the model, with both frames around the chain."""
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
        """Register the model with its own frames, and derive stand and mount."""
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
        """Parameters of the model, and the poses D and E, shape (4, 4)."""
        stand, mount = (
            self.stand.rebased(instrument[-12:-6]),
            self.mount.rebased(instrument[-6:]),
        )
        assert stand.pose is not None and mount.pose is not None
        return instrument[:-12], stand.pose.homogeneous, mount.pose.homogeneous
