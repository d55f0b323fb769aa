"""The terms of a calibration job, and the parameters that they share.

A term is what one instrument measures from one station of one chain with one tool: the
error model of the chain, from the base frame of the station to the frame of the tool,
and the measurement model. What terms have in common (joints, a station, a tool, a
reference object) has one name and one parameter. All parameters theta are ordered
stations, robot, tools, instruments: the order in which linear combinations are told,
base before joints before tool.

A station is a place of an instrument before one base link, a tool is something mounted
on one tip. Where there is only one of them it has the base or the tool frame.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib_pin.errors import OptionError, require_known
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats, adjoint, invert
from calib_pin.measurement_models import Linearization, MeasurementModel, declared
from calib_pin.measurement_models.references import ReferenceObject
from calib_pin.observations import BlockKey, Indices, Labels, Measurements, Targets
from calib_pin.observations.measurements import with_joints
from calib_pin.parameterizations import frame_pose
from calib_pin.parameterizations.error_model import ErrorModel, flexures, varying
from calib_pin.parameterizations.linearization import PoseLinearization
from calib_pin.parameters import Parameter, ParameterSet
from calib_pin.residual_models.base import LearnedCorrection
from calib_pin.setup import FrameSetup, Setup, ToolSetup

FRAME = 6
"""Parameters of a frame; an error model begins and ends with those of one."""

BASE, TOOL = "base.frame", "tool.frame"
"""Names of the frames without names."""


@dataclass(frozen=True)
class Frames:
    """The frames of a term: their names among those of all, and what is stated of them.

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

    station: str = BASE
    tool: str = TOOL
    outer: str = ""
    inner: str = ""
    base: FrameSetup = field(default_factory=FrameSetup)
    end: FrameSetup = field(default_factory=FrameSetup)
    offset: pin.SE3 = field(default_factory=pin.SE3.Identity)

    def reference(self, reference: ReferenceObject) -> str:
        """Name of a reference object among those of all terms."""
        return (self.outer if reference.outer else self.inner) + reference.name

    def place(self, reference: ReferenceObject) -> tuple[str, str]:
        """Section and name of a reference object, which tell it from all others."""
        return reference.section, self.reference(reference)


def whitened(values: Floats, sigma: Floats) -> Floats:
    """Values of components in their standard deviations, (N, d, ...) and (N, d)."""
    weight = 1.0 / sigma.reshape(*sigma.shape, *[1] * (values.ndim - 2))
    return np.asarray(zeroed(values, np.isinf(sigma)) * weight)


def zeroed(values: Floats, aside: NDArray[np.bool_]) -> Floats:
    """Values with zeros for those that are set aside, shape (N, d, ...).

    They may be so wrong that they cannot be predicted, and nothing times infinity is
    not nothing.

    Args:
        values: The values.
        aside: Components that are set aside, shape (N, d).
    """
    if not aside.any():
        return values
    return np.where(aside.reshape(*aside.shape, *[1] * (values.ndim - 2)), 0.0, values)


def compilable(model: ErrorModel) -> bool:
    """Whether nothing but the joints' own motions changes row by row.

    Compiled kernels know corrections of these alone.
    """
    return model.learned is None and len(flexures(model)) == 0


@dataclass(frozen=True)
class Term:
    """Measurements of one instrument from one station of one chain with one tool.

    A vector theta of parameter values belongs to its reference frames and to the
    reference values of its instrument; `rebased` moves both.

    Attributes:
        error: The error model about its reference frames.
        measurement: The measurement model about its reference values.
        key: What its measurements have in common.
        frames: Its frames, as they are named among all.
        columns: Position of each joint of its chain among those of all chains, (n,).
        index: Position of each of its parameters among all, shape (p,).
    """

    error: ErrorModel
    measurement: MeasurementModel
    key: BlockKey
    frames: Frames
    columns: Indices
    index: NDArray[np.intp]

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Its parameters by the names that they have among all."""
        station, tool = self.frames.station, self.frames.tool
        result = list(self.error.parameters.parameters)
        first, last = range(FRAME), range(len(result) - FRAME, len(result))
        for k, screw in enumerate(self.error.screws):
            name = result[k].name
            if k in first or k in last:
                frame = station if k in first else tool
                name = f"{frame}.{name.rpartition('.')[2]}"
            elif screw.frame == 0:  # Of the instrument, as the frame of its station.
                name = f"{station.rpartition('.')[0]}.{name.partition('.')[2]}"
            result[k] = replace(result[k], name=name)
        for reference in self.measurement.references:
            name, length = self.frames.reference(reference), len(reference.name)
            for parameter in reference.parameters:
                result.append(replace(parameter, name=name + parameter.name[length:]))
        return tuple(result)

    @property
    def components(self) -> int:
        """Residual components d of a measurement."""
        return int(self.measurement.quantities[-1].columns.stop)

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

    def on_chain(self, at: Measurements) -> Measurements:
        """Configurations of all joints with those of its chain alone."""
        return with_joints(at, self.error.chain.joints)

    def poses(self, theta: Floats, at: Measurements) -> Floats:
        """Tool poses as of `RowByRow`, shape (N, 4, 4).

        Args:
            theta: Values of all parameters, shape (P,).
            at: Configurations of its chain.
        """
        return RowByRow(self, self.on_chain(at)).poses(theta)

    def linearized(
        self, T: Floats, instrument: Floats, q: Floats, target: Targets
    ) -> Linearization:
        """Linearization of the measurement model where it measures what it predicts.

        Args:
            T: Tool poses in the measurement frame, shape (N, 4, 4).
            instrument: Instrument parameters, shape (K,).
            q: Joint positions of its chain, shape (N, n) [rad, m].
            target: Target of each measurement.
        """
        # Derivatives are those of residuals, so a model is told what was measured.
        model, joints = self.measurement, self.error.chain.joints
        values, names = model.predict(T, instrument, target), Labels.of(target)
        data = Measurements(joints, q, model.name, values, target=names)
        return model.linearize(T, instrument, data)

    def rebased(self, theta: Floats) -> Self:
        """The same term about other values of its frames and its instrument.

        Args:
            theta: Values of all parameters, shape (P,).
        """
        robot, instrument = self.values(theta)
        base, *_, tool = self.error.corrections(robot)
        error = self.error.with_frames(self.error.base * base, self.error.tool * tool)
        measurement = self.measurement.rebased(instrument)
        return replace(self, error=error, measurement=measurement)


class RowByRow:
    """Measurements of a term by Pinocchio, a residual row for each value.

    Args:
        term: The term.
        data: The measurements, with the joints of the term's chain.
        sigma: Standard deviations of their residual components, shape (N, d), or (1, d)
            where those of all are equal; by default they are not whitened.
    """

    def __init__(
        self, term: Term, data: Measurements, sigma: Floats | None = None
    ) -> None:
        """Prepare nothing: what does not change is computed where it is needed."""
        self._term, self._data = term, data
        self._sigma = np.ones((1, 1)) if sigma is None else sigma

    def poses(self, theta: Floats) -> Floats:
        """Tool poses in the measurement frame, shape (N, 4, 4).

        Those of relative measurements are in the tool at their start.

        Args:
            theta: Values of all parameters, shape (P,).
        """
        error, robot = self._term.error, self._term.values(theta)[0]
        T, *start = (error.poses(q, robot, basis) for q, basis in self._ends)
        return np.asarray(invert(start[0]) @ T) if start else T

    def linear_poses(
        self, theta: Floats
    ) -> tuple[Floats, PoseLinearization, PoseLinearization | None]:
        """The poses, with those where measurements end and where relative ones start.

        The latter two have derivatives, as if they were absolute.
        """
        error, robot = self._term.error, self._term.values(theta)[0]
        poses, *start = (error.linearize(q, robot, basis) for q, basis in self._ends)
        if not start:
            return poses.T, poses, None
        return invert(start[0].T) @ poses.T, poses, start[0]

    def points(self, theta: Floats) -> Floats:
        """Tool points in the measurement frame, shape (N, 3)."""
        q, basis = self._ends[0]
        return self._term.error.poses(q, self._term.values(theta)[0], basis)[:, :3, 3]

    def errors(self, theta: Floats) -> Floats:
        """Residuals in their units, predicted minus measured, shape (N, d)."""
        T, instrument = self.poses(theta), self._term.values(theta)[1]
        return self._term.measurement.residual(T, instrument, self._data)

    def factorize(self, theta: Floats) -> tuple[Floats, Floats]:
        """Whitened residual, shape (N d,), and Jacobian, shape (N d, p)."""
        term, (T, poses, start) = self._term, self.linear_poses(theta)
        linear = term.measurement.linearize(T, term.values(theta)[1], self._data)
        parts = linear.residual, linear.J_pose, linear.J_instrument
        r, J_pose, J_instrument = (whitened(values, self._sigma) for values in parts)
        J_error = poses.derivative(J_pose)
        if start is not None:
            # The twist of T_0^-1 T is that of T without that of T_0, transformed by the
            # adjoint.
            J_error -= start.derivative(J_pose @ adjoint(invert(T)))
        J = np.concatenate([J_error, J_instrument], axis=2)
        return r.reshape(-1), J.reshape(-1, len(term.index))

    @cached_property
    def _ends(self) -> list[tuple[Floats, Floats]]:
        """Configurations, and of relative measurements where they start.

        With the basis functions of joint corrections, which depend on commands alone.
        """
        at, basis = self._data, self._term.error.basis
        ends = [(at.q, basis(at.q, at.conditions))]
        if at.start.size:
            ends.append((at.start, basis(at.start, at.conditions.at_start)))
        return ends


class Block(NamedTuple):
    """A block of measurements with its term.

    Attributes:
        term: The term.
        data: The measurements, with the joints of the term's chain.
        rows: Where they stand among all measurements.
        values: Where their residual components stand among all.
    """

    term: Term
    data: Measurements
    rows: slice
    values: slice

    def table(self, flat: Floats) -> Floats:
        """Components of all measurements as a table of these, (M,) -> (N, d)."""
        return np.asarray(flat[self.values].reshape(len(self.data), -1))


@dataclass(frozen=True)
class Terms:
    """The terms of all blocks, about their references.

    A vector theta of parameter values belongs to these references; `rebased` moves
    both.

    Attributes:
        chains: The chains that are measured.
        terms: The term of each block, by what its measurements have in common.
        given: All parameters, before a setup fixes or bounds any.
    """

    chains: Chains
    terms: Mapping[BlockKey, Term]
    given: ParameterSet

    @property
    def only(self) -> Term:
        """The only term; the first of several."""
        return next(iter(self.terms.values()))

    @property
    def by_chain(self) -> Mapping[str, Term]:
        """The first term of each chain that has joints, by the chain's name."""
        result: dict[str, Term] = {}
        for key, term in self.terms.items():
            if term.error.chain.joints:
                result.setdefault(key.chain, term)
        return result

    def of_chain(self, name: str | None = None) -> Term:
        """The first term of a chain, by default of the first that has joints.

        Raises:
            OptionError: If there is no such chain.
        """
        if name is None:
            return next(iter(self.by_chain.values()), self.only)
        require_known("chain", name, dict.fromkeys(key.chain for key in self.terms))
        return next(term for term in self.terms.values() if term.key.chain == name)

    def rebased(self, theta: Floats) -> tuple[Self, Floats]:
        """The same terms about other values of frames and instruments.

        Args:
            theta: Parameter values, shape (P,).

        Returns:
            They with these in its references, and values about them, shape (P,):
            zero for frames and instruments, those of the robot as they are.
        """
        terms = {key: term.rebased(theta) for key, term in self.terms.items()}
        return replace(self, terms=terms), np.where(self.referred, 0.0, theta)

    def learning(self, learned: LearnedCorrection) -> Self:
        """The same terms with a learned correction.

        Args:
            learned: The correction, with a shift of all parameters, shape (P,).
        """
        terms = {}
        for key, term in self.terms.items():
            correction = replace(learned, shift=learned.shift[term.of_error])
            terms[key] = replace(term, error=replace(term.error, learned=correction))
        return replace(self, terms=terms)

    @cached_property
    def referred(self) -> NDArray[np.bool_]:
        """True for frames and instruments, whose values references hold, (P,)."""
        result = self.given.nuisance.copy()
        for term in self.terms.values():
            # How an instrument drifts belongs to no reference.
            result[term.index[varying(term.error)]] = False
        return result

    def predict(self, theta: Floats, at: Measurements) -> Floats:
        """Noise-free values in the layout of `Measurements.values`, shape (N, D).

        Args:
            theta: Parameter values, shape (P,).
            at: Configurations of one block.
        """
        term = self.terms[at.key]
        instrument = term.values(theta)[1]
        return term.measurement.predict(term.poses(theta, at), instrument, at.target)

    def observable(self, theta: Floats, at: Measurements) -> NDArray[np.bool_]:
        """Whether an instrument can measure at each configuration, shape (N,).

        Arguments as for `predict`.
        """
        term = self.terms[at.key]
        T, instrument = term.poses(theta, at), term.values(theta)[1]
        return term.measurement.observable(T, instrument, at.target)

    def spread(self, term: Term, J: Floats) -> Floats:
        """Columns of the parameters of a term among those of all, (..., p) -> (..., P).

        Several parameters of a term may be one: those of a mimic joint and its leader.
        """
        index, count = term.index, len(self.given)
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
        """The reference objects of all terms, by section and name among all."""
        return {
            term.frames.place(reference): reference
            for term in self.terms.values()
            for reference in term.measurement.references
        }


def assembled(terms: Sequence[Term]) -> tuple[dict[BlockKey, Term], ParameterSet]:
    """Terms that share what has one name, and all parameters.

    A reference object of several terms has the parameters of all: a point that is known
    to a camera and estimated by a tracker is estimated.

    Args:
        terms: The terms; their index is made here.

    Raises:
        OptionError: If a parameter of a joint means something else in another chain.
    """
    terms = with_shared_references(terms)
    groups: list[dict[str, Parameter]] = [{}, {}, {}, {}]
    twists: dict[tuple[str, str], Floats] = {}
    for term in terms:
        inner = len(term.error.screws)
        ends = (0, FRAME, inner - FRAME, inner, len(term.parameters))
        for group, start, stop in zip(groups, ends[:-1], ends[1:], strict=True):
            for parameter in term.parameters[start:stop]:
                group.setdefault(parameter.name, parameter)
        for screw in term.error.screws[FRAME:-FRAME]:
            name = screw.parameter.name
            # Joints that mimic one another each have a motion of their own, and several
            # may share a parameter that bends them.
            joint = (*term.error.chain.joints, "")[screw.frame - 1]
            separate = joint in term.error.chain.mimics or screw.basis is not None
            other = twists.setdefault((name, joint if separate else ""), screw.twist)
            if np.abs(screw.twist - other).max() > 1e-9:
                reason = f"'{name}' is another motion in the chain '{term.key.chain}'"
                allowed = "parameters such as 'placement', which no chain changes"
                raise OptionError(reason, allowed=allowed)
    given = ParameterSet(tuple(p for group in groups for p in group.values()))
    position = {name: k for k, name in enumerate(given.names)}
    result = {}
    for term in terms:
        index = np.array([position[p.name] for p in term.parameters], np.intp)
        result[term.key] = replace(term, index=index)
    return result, given


def with_shared_references(
    terms: Sequence[Term], located: Mapping[tuple[str, str], ReferenceObject] = {}
) -> list[Term]:
    """Terms whose reference objects of one name and section are the same.

    The one with most parameters is taken, of these one that is located.

    Args:
        terms: The terms.
        located: Objects that have been located, by section and name; they win.
    """
    best: dict[tuple[str, str], ReferenceObject] = {}
    for term in terms:
        for reference in term.measurement.references:
            key = term.frames.place(reference)
            other = best.setdefault(key, reference)
            rank = len(reference.parameters), reference.located
            if rank > (len(other.parameters), other.located):
                best[key] = reference
    best |= {key: value for key, value in located.items() if key in best}
    result = []
    for term in terms:
        shared = [best[term.frames.place(r)] for r in term.measurement.references]
        measurement = term.measurement.with_references(shared)
        result.append(replace(term, measurement=measurement))
    return result


def frames_of_blocks(
    chains: Chains, keys: Sequence[BlockKey], setup: Setup
) -> dict[BlockKey, Frames]:
    """The names of the frames of blocks of measurements, and what is stated of them.

    Args:
        chains: The chains that are measured.
        keys: The blocks.
        setup: The frames that the user states.
    """
    stations = {k: (owner_of(k, keys, k.station), chains[k.chain].base) for k in keys}
    tools = {k: (owner_of(k, keys, k.tool), chains[k.chain].tip) for k in keys}
    default = chains[""] if "" in chains.names else None
    link = default.base if default else stations[keys[0]][1]
    bases = _owners(set(stations.values()), link)
    ends = _owners(set(tools.values()), default.tip if default else "")
    result = {}
    for key in keys:
        station, tool = bases[stations[key]], ends[tools[key]]
        place = f"{station}.station" if station else BASE
        base = _frame_setup(setup.stations, station, key.station, setup.base_frame)
        end = _frame_setup(setup.tools, tool, key.tool, setup.tool_frame)
        offset = pin.SE3.Identity()
        for _ in setup.tools:
            if not isinstance(end, ToolSetup) or end.on is None:
                break
            # It is known on another one.
            offset = frame_pose(end) * offset
            tool, end = end.on, setup.tools.get(end.on, FrameSetup())
        mount = f"{tool}.tool" if tool else TOOL
        result[key] = Frames(place, mount, base=base, end=end, offset=offset)
    return result


def prefixed(terms: Iterable[Term]) -> list[Term]:
    """Terms whose reference objects have names that differ between stations and tools.

    An object is another one at another station, or on another tool, whatever its name;
    then the station or the tool stands before that.
    """
    terms = list(terms)
    where: dict[tuple[str, str], set[str]] = {}
    for term in terms:
        for reference in term.measurement.references:
            place = term.frames.station if reference.outer else term.frames.tool
            where.setdefault((reference.section, reference.name), set()).add(place)
    several = [places for places in where.values() if len(places) > 1]
    named = set().union(*several) - {BASE, TOOL}
    result = []
    for term in terms:
        ends = term.frames.station, term.frames.tool
        owners = [f"{p.rpartition('.')[0]}/" if p in named else "" for p in ends]
        frames = replace(term.frames, outer=owners[0], inner=owners[1])
        result.append(replace(term, frames=frames))
    return result


def owner_of(key: BlockKey, keys: Sequence[BlockKey], given: str) -> str:
    """Name of a station or a tool, that of the model where it follows nothing.

    A camera among others is at a place of its own and looks at something of its own.
    """
    alone = all(other.model == key.model for other in keys)
    follows = declared(key.model).tracks or not declared(key.model).external
    return given or ("" if alone or follows else key.model)


def _owners(places: set[tuple[str, str]], default: str) -> dict[tuple[str, str], str]:
    """The owner of each frame, empty for the one without a name.

    Args:
        places: Stations or tools, with the link that each stands before or is on.
        default: The link that need not be named.
    """
    if len(places) == 1:
        return dict.fromkeys(places, "")
    links, result = Counter(name for name, _ in places), {}
    for name, link in places:
        known = link == default or (name and links[name] == 1)
        result[name, link] = "/".join(filter(None, (name, "" if known else link)))
    return result


def _frame_setup(
    frames: Mapping[str, FrameSetup], owner: str, name: str, default: FrameSetup
) -> FrameSetup:
    """Frame that a setup states, by its owner or by the name in measurements."""
    if owner in frames or name in frames:
        return frames[owner if owner in frames else name]
    return FrameSetup() if owner else default
