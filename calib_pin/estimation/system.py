"""A robot before several instruments: the parts, and the parameters that they share.

Every block of measurements has a part of its own: the error model of its chain, from
the base frame of its station to the frame of its tool, and its measurement model. What
parts have in common (joints, a station, a tool, a reference object) has one name and
one parameter. All parameters theta are ordered stations, robot, tools, instruments: the
order in which linear combinations are told, base before joints before tool.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib_pin.errors import OptionError
from calib_pin.estimation.model import Configured, Model
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.references import ReferenceObject
from calib_pin.observations import BlockKey, Indices, Measurements
from calib_pin.parameterizations.error_model import varying
from calib_pin.parameters import Parameter, ParameterSet
from calib_pin.setup import FrameSetup

FRAME = 6
"""Parameters of a frame; an error model begins and ends with those of one."""


@dataclass(frozen=True)
class Scope:
    """How the parameters of a part that belong to no joint are named among all.

    Attributes:
        station: Owner and kind of its base frame, such as `day1.station`.
        tool: The same of its tool frame, or of the tool that this one is known on.
        outer: Prefix of the reference objects that stand still, empty where only one
            station has such.
        inner: The same of those that the tool carries.
        base: What the setup states of the base frame.
        end: The same of the tool frame.
        offset: Pose of the tool in the tool that it is known on.
    """

    station: str = "base.frame"
    tool: str = "tool.frame"
    outer: str = ""
    inner: str = ""
    base: FrameSetup = field(default_factory=FrameSetup)
    end: FrameSetup = field(default_factory=FrameSetup)
    offset: pin.SE3 = field(default_factory=pin.SE3.Identity)

    def reference(self, reference: ReferenceObject) -> str:
        """Name of a reference object among those of all parts."""
        return (self.outer if reference.outer else self.inner) + reference.name

    def place(self, reference: ReferenceObject) -> tuple[str, str]:
        """Section and name of a reference object, which tell it from all others."""
        return reference.section, self.reference(reference)


@dataclass(frozen=True)
class Part(Model):
    """The model of one block of measurements.

    Attributes:
        key: What these have in common.
        scope: How its parameters are named among all.
        columns: Position of each joint of its chain among those of all chains, (n,).
        index: Position of each of its parameters among all, shape (p,).
    """

    key: BlockKey
    scope: Scope
    columns: Indices
    index: NDArray[np.intp]

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Its parameters by the names that they have among all."""
        own = self.error.parameters.parameters
        ends = {0: self.scope.station, len(own) - FRAME: self.scope.tool}
        result = list(own)
        for start, name in ends.items():
            for k in range(start, start + FRAME):
                component = own[k].name.rpartition(".")[2]
                result[k] = replace(own[k], name=f"{name}.{component}")
        for k, screw in enumerate(self.error.screws[FRAME:-FRAME], start=FRAME):
            if screw.frame == 0:  # Of the instrument, as the frame of its station.
                station = self.scope.station.rpartition(".")[0]
                rest = own[k].name.partition(".")[2]
                result[k] = replace(own[k], name=f"{station}.{rest}")
        for reference in self.measurement.references:
            name, length = self.scope.reference(reference), len(reference.name)
            result += [
                replace(parameter, name=name + parameter.name[length:])
                for parameter in reference.parameters
            ]
        return tuple(result)

    @property
    def of_error(self) -> NDArray[np.intp]:
        """Positions of the parameters of its error model among all."""
        return self.index[: len(self.error.screws)]

    @property
    def of_instrument(self) -> NDArray[np.intp]:
        """Positions of the parameters of its measurement model among all."""
        return self.index[len(self.error.screws) :]

    def values(self, theta: Floats) -> tuple[Floats, Floats]:
        """Values of its error model and of its measurement model among all, (..., P).

        Args:
            theta: Values of all parameters, one vector or many.
        """
        return theta[..., self.of_error], theta[..., self.of_instrument]

    def of_chain(self, at: Configured) -> Configured:
        """Configurations of all joints with those of its chain alone."""
        if np.array_equal(self.columns, np.arange(at.q.shape[1])):
            return at
        own: dict[str, Any] = {
            "q": at.q[:, self.columns],
            "start": at.start[:, self.columns] if at.start.size else at.start,
            "conditions": at.conditions.of_joints(self.columns),
        }
        if isinstance(at, Measurements):
            own["joints"] = self.error.chain.joints
        return replace(at, **own)


@dataclass(frozen=True)
class System:
    """The parts of all blocks, about their references.

    A vector theta of parameter values belongs to these references; `rebased` moves
    both.

    Attributes:
        chains: The chains that are measured.
        parts: The part of each block, by what its measurements have in common.
        given: All parameters, before a setup fixes or bounds any.
    """

    chains: Chains
    parts: Mapping[BlockKey, Part]
    given: ParameterSet

    @property
    def only(self) -> Part:
        """The only part; the first of several."""
        return next(iter(self.parts.values()))

    @property
    def moving(self) -> Part:
        """The first part whose chain has joints."""
        return next(iter(self.by_chain.values()), self.only)

    @property
    def by_chain(self) -> Mapping[str, Part]:
        """The first part of each chain that has joints, by the chain's name."""
        found: dict[str, Part] = {}
        for key, part in self.parts.items():
            if part.error.chain.joints:
                found.setdefault(key.chain, part)
        return found

    def with_parts(self, parts: Mapping[BlockKey, Part]) -> Self:
        """The same with parts about other references, and of the same parameters."""
        return replace(self, parts=parts)

    def of_chain(self, name: str) -> Part:
        """The first part of a chain."""
        return next(part for part in self.parts.values() if part.key.chain == name)

    def rebased(self, theta: Floats) -> tuple[Self, Floats]:
        """The same system about other values of frames and instruments.

        Args:
            theta: Parameter values, shape (P,).

        Returns:
            The system with these in its references, and values about them, shape (P,):
            zero for frames and instruments, those of the robot as they are.
        """
        parts = {
            key: part.rebased(theta[part.index])[0] for key, part in self.parts.items()
        }
        return self.with_parts(parts), np.where(self.referred, 0.0, theta)

    @cached_property
    def referred(self) -> NDArray[np.bool_]:
        """True for frames and instruments, whose values references hold, (P,)."""
        result = self.given.nuisance.copy()
        for part in self.parts.values():
            # How an instrument drifts belongs to no reference.
            result[part.index[varying(part.error)]] = False
        return result

    def predict(self, theta: Floats, at: Configured) -> Floats:
        """Noise-free values in the layout of `Measurements.values`, shape (N, D).

        Args:
            theta: Parameter values, shape (P,).
            at: Configurations of one block.
        """
        part = self.parts[at.key]
        return part.predict(theta[part.index], part.of_chain(at))

    def observable(self, theta: Floats, at: Configured) -> NDArray[np.bool_]:
        """Whether an instrument can measure at each configuration, shape (N,).

        Arguments as for `predict`.
        """
        part = self.parts[at.key]
        return part.observable(theta[part.index], part.of_chain(at))

    def jacobian(self, theta: Floats, at: Configured, sigma: Floats) -> Floats:
        """Whitened Jacobian of noise-free measurements of a block, shape (N, d, P).

        Args:
            theta: Parameter values, shape (P,).
            at: Configurations of one block.
            sigma: Standard deviations of the residual components, shape (N, d).
        """
        part = self.parts[at.key]
        J = part.jacobian(theta[part.index], part.of_chain(at), sigma)
        return self.spread(part, J)

    def spread(self, part: Part, J: Floats) -> Floats:
        """Columns of the parameters of a part among those of all, (..., p) -> (..., P).

        Several parameters of a part may be one: those of a mimic joint and its leader.
        """
        index, count = part.index, len(self.given)
        if np.array_equal(index, np.arange(count)):
            return J
        result = np.zeros((*J.shape[:-1], count))
        if len(np.unique(index)) == len(index):
            result[..., index] = J
        else:
            for k, position in enumerate(index):
                result[..., position] += J[..., k]
        return result

    @cached_property
    def references(self) -> Mapping[tuple[str, str], ReferenceObject]:
        """The reference objects of all parts, by section and name among all."""
        return {
            part.scope.place(reference): reference
            for part in self.parts.values()
            for reference in part.measurement.references
        }


def assembled(parts: Sequence[Part]) -> tuple[dict[BlockKey, Part], ParameterSet]:
    """Parts that share what has one name, and all parameters.

    A reference object of several parts has the parameters of all: a point that is known
    to a camera and estimated by a tracker is estimated.

    Args:
        parts: The parts; their index is made here.

    Raises:
        OptionError: If a parameter of a joint means something else in another chain.
    """
    parts = with_shared_references(parts)
    found: list[dict[str, Parameter]] = [{}, {}, {}, {}]
    twists: dict[tuple[str, str], Floats] = {}
    for part in parts:
        inner = len(part.error.screws)
        ends = (0, FRAME, inner - FRAME, inner, len(part.parameters))
        for group, start, stop in zip(found, ends[:-1], ends[1:], strict=True):
            for parameter in part.parameters[start:stop]:
                group.setdefault(parameter.name, parameter)
        for screw in part.error.screws[FRAME:-FRAME]:
            name = screw.parameter.name
            # Joints that mimic one another each have a motion of their own, and several
            # may share a parameter that bends them.
            joint = (*part.error.chain.joints, "")[screw.frame - 1]
            own = joint in part.error.chain.mimics or screw.basis is not None
            other = twists.setdefault((name, joint if own else ""), screw.twist)
            if np.abs(screw.twist - other).max() > 1e-9:
                raise OptionError(
                    f"'{name}' is another motion in the chain '{part.key.chain}' than "
                    "in one before it",
                    allowed="parameters such as 'placement', which no chain changes",
                )
    given = ParameterSet(tuple(p for group in found for p in group.values()))
    position = {name: k for k, name in enumerate(given.names)}
    return {
        part.key: replace(
            part, index=np.array([position[p.name] for p in part.parameters], np.intp)
        )
        for part in parts
    }, given


def with_shared_references(
    parts: Sequence[Part], found: Mapping[tuple[str, str], ReferenceObject] = {}
) -> list[Part]:
    """Parts whose reference objects of one name and section are the same.

    The one with most parameters is taken, of these one that is located.

    Args:
        parts: The parts.
        found: Objects that have been located, by section and name; they win.
    """
    best: dict[tuple[str, str], ReferenceObject] = {}
    for part in parts:
        for reference in part.measurement.references:
            key = part.scope.place(reference)
            other = best.setdefault(key, reference)
            rank = len(reference.parameters), reference.located
            if rank > (len(other.parameters), other.located):
                best[key] = reference
    best |= {key: value for key, value in found.items() if key in best}
    return [
        replace(
            part,
            measurement=part.measurement.with_references(
                [
                    best[part.scope.place(reference)]
                    for reference in part.measurement.references
                ]
            ),
        )
        for part in parts
    ]
