"""What measurements refer to beside the robot: points, planes, spheres, anchors.

A reference object is frozen and carries a reference, that it may lack until it is
registered; its parameters are deviations from that. Measurements name it as their
target. Whatever has parameters beside the robot's is a reference object, so that a
measurement model is only the formula that relates a tool pose to some of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Protocol, Self

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib_pin.errors import InputError, nearest
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Measurements
from calib_pin.parameters import Parameter
from calib_pin.setup import (
    AnchorSetup,
    CameraSetup,
    FrameSetup,
    PlaneSetup,
    PointSetup,
    SphereSetup,
    Triple,
)

METER = 1.0
"""Scale of an unknown place [m]: where something stands is no error of a robot."""


Stated = PointSetup | PlaneSetup | SphereSetup | AnchorSetup | CameraSetup | FrameSetup
"""A reference as a setup file would state it."""


class ReferenceObject(Protocol):
    """Something with a name that rows refer to."""

    @property
    def name(self) -> str:
        """Name that rows give."""
        ...

    @property
    def section(self) -> str:
        """Where it stands in a setup file, such as `planes`."""
        ...

    @property
    def located(self) -> bool:
        """Whether it has a reference."""
        ...

    @property
    def parameters(self) -> Sequence[Parameter]:
        """Its parameters, deviations from the reference."""
        ...

    def rebased(self, values: Floats) -> Self:
        """The same about moved references; shape (K,)."""
        ...

    def stated(self) -> Stated:
        """Its reference as a setup file would state it."""
        ...


def nuisances(
    owner: str,
    kind: str,
    components: Iterable[tuple[str, str, bool]],
    outer: bool = True,
) -> tuple[Parameter, ...]:
    """Parameters `<owner>.<kind>.<component>` of a reference object.

    Args:
        owner: Name of the object.
        kind: Kind of the object.
        components: Name, unit, and whether it is estimated.
        outer: Whether it stands where the base does and not on the tool.
    """
    return tuple(
        Parameter(f"{owner}.{kind}.{name}", unit, METER, True, outer, free)
        for name, unit, free in components
    )


@dataclass(frozen=True)
class Point:
    """A point: of the tool in the tool frame, or of a socket in the measuring frame.

    Attributes:
        name: Name that rows give.
        kind: `target` for a point of the tool or of a board, `socket` for a socket.
        xyz: Reference, shape (3,) [m]; None until it is registered.
        estimate: Whether it is estimated.
    """

    name: str
    kind: str
    xyz: Floats | None = None
    estimate: bool = True

    @property
    def section(self) -> str:
        """`targets` or `sockets`."""
        return f"{self.kind}s"

    @property
    def located(self) -> bool:
        """Whether its place is given or registered."""
        return self.xyz is not None

    @property
    def parameters(self) -> Sequence[Parameter]:
        """`<name>.<kind>.x|y|z`."""
        free = self.estimate
        components = ((c, "m", free) for c in "xyz")
        return nuisances(self.name, self.kind, components, self.kind != "target")

    def at(self, values: Floats) -> Floats:
        """Its place, shape (3,) [m]."""
        assert self.xyz is not None
        return np.asarray(self.xyz + values)

    def rebased(self, values: Floats) -> Point:
        """Moved by (x, y, z)."""
        return replace(self, xyz=self.at(values))

    def stated(self) -> PointSetup:
        """Its place."""
        return PointSetup(triple(self.xyz), self.estimate)


@dataclass(frozen=True)
class Sphere:
    """A sphere in the measuring frame.

    Attributes:
        name: Name that rows give as their target.
        xyz: Center, shape (3,) [m]; None until it is registered.
        radius: Radius [m]; None until it is registered.
        estimate: Whether the center is estimated.
        estimate_radius: Whether the radius is.
    """

    name: str
    xyz: Floats | None = None
    radius: float | None = None
    estimate: bool = True
    estimate_radius: bool = True

    section = "spheres"

    @property
    def located(self) -> bool:
        """Whether center and radius are given or registered."""
        return self.xyz is not None and self.radius is not None

    @property
    def parameters(self) -> Sequence[Parameter]:
        """`<sphere>.sphere.x|y|z|r`."""
        center = [(c, "m", self.estimate) for c in "xyz"]
        radius = ("r", "m", self.estimate_radius)
        return nuisances(self.name, "sphere", [*center, radius])

    def rebased(self, values: Floats) -> Sphere:
        """Moved by (x, y, z) and larger by r."""
        assert self.xyz is not None and self.radius is not None
        radius = self.radius + float(values[3])
        return replace(self, xyz=self.xyz + values[:3], radius=radius)

    def stated(self) -> SphereSetup:
        """Its center and radius."""
        return SphereSetup(
            triple(self.xyz), self.radius, self.estimate, self.estimate_radius
        )


@dataclass(frozen=True)
class Anchor:
    """A fixed point that distances are measured from, with the bias of its readings.

    Attributes:
        name: Name that rows give as their target.
        xyz: Place in the measuring frame, shape (3,) [m]; None until registered.
        bias: What is added to every true distance [m].
        estimate: Whether the place is estimated.
        estimate_bias: Whether the bias is.
    """

    name: str
    xyz: Floats | None = None
    bias: float = 0.0
    estimate: bool = True
    estimate_bias: bool = False

    section = "anchors"

    @property
    def located(self) -> bool:
        """Whether its place is given or registered."""
        return self.xyz is not None

    @property
    def parameters(self) -> Sequence[Parameter]:
        """`<anchor>.anchor.x|y|z|bias`."""
        site = [(c, "m", self.estimate) for c in "xyz"]
        return nuisances(
            self.name, "anchor", [*site, ("bias", "m", self.estimate_bias)]
        )

    def rebased(self, values: Floats) -> Anchor:
        """Moved by (x, y, z), with another bias."""
        assert self.xyz is not None
        return replace(
            self, xyz=self.xyz + values[:3], bias=self.bias + float(values[3])
        )

    def stated(self) -> AnchorSetup:
        """Its place and bias."""
        return AnchorSetup(
            triple(self.xyz), self.bias, self.estimate, self.estimate_bias
        )


@dataclass(frozen=True)
class Frame:
    """A frame of an instrument that is one among others.

    Attributes:
        name: Name of the instrument.
        kind: `base` for where it stands, `tool` for its place on the tool.
        pose: Reference; None until it is registered.
        estimate: Whether it is estimated.
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
    def parameters(self) -> Sequence[Parameter]:
        """`<name>.<kind>.x..rz`, screws in their order as those of the two frames."""
        names = ("x", "y", "z", "rx", "ry", "rz")
        units = zip(names, ("m",) * 3 + ("rad",) * 3, strict=True)
        components = ((c, u, self.estimate) for c, u in units)
        return nuisances(self.name, self.kind, components, self.kind == "base")

    def rebased(self, values: Floats) -> Frame:
        """Moved by the screws."""
        assert self.pose is not None
        pose = self.pose
        for k in np.flatnonzero(values):
            pose = pose * pin.exp6(np.eye(6)[k] * values[k])
        return replace(self, pose=pose)

    def moved(self, values: Floats) -> Floats:
        """Links (R | p) at many values of the screws, shape (S, 6) -> (S, 12)."""
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
        """Its pose."""
        assert self.pose is not None
        roll, pitch, yaw = map(float, pin.rpy.matrixToRpy(self.pose.rotation))
        xyz = triple(self.pose.translation)
        return FrameSetup(xyz, (roll, pitch, yaw), self.estimate)


def slices(references: Sequence[ReferenceObject]) -> list[slice]:
    """Where the parameters of each reference object stand among those of all."""
    ends = np.cumsum([0, *(len(reference.parameters) for reference in references)])
    return [slice(int(a), int(b)) for a, b in pairwise(ends)]


def locate(
    names: Sequence[str],
    references: Sequence[ReferenceObject],
    what: str,
    data: Measurements | None = None,
    alone: bool = True,
) -> NDArray[np.int64]:
    """Position of the reference object that each measurement names.

    Args:
        names: Name of each row.
        references: The reference objects.
        what: What they are called in messages.
        data: Tells where a wrong name stands.
        alone: Whether the name may be left out where there is one.

    Raises:
        InputError: If there is none of a name.
    """
    known = {reference.name: k for k, reference in enumerate(references)}
    if alone and len(known) == 1:
        known[""] = 0
    try:
        # Rows are many, and this is done at every evaluation.
        return np.fromiter(map(known.__getitem__, names), np.int64, len(names))
    except KeyError as missing:
        name = str(missing.args[0])
    row = list(names).index(name)
    error = InputError if data is None else partial(data.error, row)
    raise error(
        f"there is no {what} '{name}'{nearest(name, known)}"
        if name
        else f"the row names no {what}",
        column="target",
        allowed=", ".join(reference.name for reference in references),
    )


def triple(values: Floats | None) -> Triple | None:
    """Coordinates as a setup file states them; None where there are none."""
    if values is None:
        return None
    x, y, z = (float(value) for value in values)
    return x, y, z
