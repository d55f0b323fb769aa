"""The nominal robot: its frames fitted, where it can be measured, its structure.

A robot whose lengths are all longer by one factor moves like the nominal one, only
larger. What it leaves at angles or in the sockets of a ball is the same.

A structure is that of random configurations at which an instrument can measure. A
camera must see its points and a beam must meet its plane, so configurations are drawn
until enough of them can be measured. For a contact measurement, the tool is brought
into contact.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import InputError, OptionError
from calib_pin.estimation.identifiability import (
    Structure,
    column_space,
    nuisance_basis,
    structure,
)
from calib_pin.estimation.problem import (
    EXACT,
    SAMPLE,
    Problem,
    assumed_sigma,
    current_units,
    fitted_components,
    representative,
    station_kinds,
)
from calib_pin.estimation.solve import Solution, least_squares
from calib_pin.estimation.terms import (
    FRAME,
    Block,
    RowByRow,
    Term,
    assembled,
    with_shared_references,
)
from calib_pin.kinematics.spatial import Floats, adjoint, invert
from calib_pin.measurement_models import measurement_model
from calib_pin.measurement_models.references import ReferenceObject
from calib_pin.observations import (
    UNSTATED,
    BlockKey,
    Conditions,
    Labels,
    Measurements,
    Observations,
    Targets,
    approached,
    trusted,
)
from calib_pin.parameterizations import frame_pose, frame_screws
from calib_pin.parameterizations.base import LENGTH_SCALE
from calib_pin.parameterizations.linearization import PoseLinearization
from calib_pin.parameters import ParameterSet
from calib_pin.setup import WORLD, FrameSetup

LEAST = 50
"""Least number of configurations that show a structure."""

MOST = 5000
"""Most parameters that are analyzed, in gigabytes and minutes already."""

UNKNOWN = 0.01
"""Standard deviation of the scale from which it counts as unobservable.

The tip of an arm of a meter is then off by a centimeter.
"""


@serial_blas
def register(problem: Problem, theta: Floats) -> tuple[Problem, Solution]:
    """Fit only base, tool and instrument; the robot keeps its values.

    Args:
        problem: The problem.
        theta: Parameter values, shape (P,); those of the robot count.

    Returns:
        The problem about its registered references and the least-squares result.
    """
    parameters = problem.parameters
    problem = registered(problem, theta)
    start = np.where(parameters.nuisance, 0.0, theta)
    return problem, least_squares(problem, start, nuisance_basis(parameters))


@serial_blas
def analyze_structure(
    problem: Problem, theta: Floats, rng: np.random.Generator
) -> tuple[Structure, Floats]:
    """Structure at zero robot errors over random configurations.

    Args:
        problem: The problem about its registered references.
        theta: Parameter values with the robot at nominal, shape (P,).
        rng: Random generator.

    Returns:
        The structure of the data alone, and the whitened Jacobian with the rows of the
        priors, shape (M, P).

    Raises:
        OptionError: If there are too many parameters.
    """
    keys = representative(problem)
    blocks, at = len(keys), list[Measurements]()
    parameters = len(problem.parameters) - len(_omitted(problem, keys))
    if parameters > MOST:
        raise OptionError(
            "the chain and its references have too many parameters",
            file=problem.setup.file or None,
            value=parameters,
            allowed=f"at most {MOST}; a shorter chain (--base, --tip)",
        )
    for key in keys:
        # Each quantity alone may have to show its structure.
        quantities = problem.terms[key].measurement.quantities
        least = min(q.columns.stop - q.columns.start for q in quantities)
        enough = -(-3 * parameters // (blocks * least))
        count = max(-(-LEAST // blocks), enough)
        at.append(observable_configurations(problem, key, theta, count, rng))
    return structure_at(problem, theta, at)


@serial_blas
def structure_at(
    problem: Problem, theta: Floats, at: Sequence[Measurements]
) -> tuple[Structure, Floats]:
    """Structure at zero robot errors of given configurations.

    Args:
        problem: The problem about its registered references.
        theta: Parameter values with the robot at nominal, shape (P,).
        at: Configurations of blocks.

    Returns:
        The structure, and the whitened Jacobian with the rows of the priors, (M, P).

    Raises:
        InputError: If the measured values have no derivative.
    """
    J, count = jacobian_at(problem, theta, at), sum(map(len, at))
    omitted = _omitted(problem, [block.key for block in at])
    shown = problem.parameters.without(omitted)
    if not np.isfinite(J).all():
        reason = "the measured values have no derivative, like a distance of zero"
        raise InputError(f"{reason}; check the base and tip links")
    result = structure(J[: len(J) - len(problem.further.priors)], shown, count)
    known = scale_deviation(problem, theta, at, J) < UNKNOWN
    scaled = known or not _has_lengths(problem, theta, at)
    return replace(result, scaled=scaled, equivalent=omitted), J


def jacobian_at(problem: Problem, theta: Floats, at: Sequence[Measurements]) -> Floats:
    """Whitened Jacobian of noise-free measurements and of all further rows, (M, P).

    Args:
        problem: The problem.
        theta: Parameter values, shape (P,).
        at: Configurations of blocks.
    """
    rows, units, layout = [], current_units(problem), problem.layout
    for block in at:
        term = problem.terms[block.key]
        exact = replace(term.on_chain(block), values=problem.predict(theta, block))
        sigma = assumed_sigma(term, problem.setup) * units[layout.of_keys[block.key]]
        _, J = RowByRow(term, exact, sigma[None]).factorize(theta)
        rows.append(problem.spread(term, J))
    return np.concatenate([*rows, problem.further.jacobian(theta)])


def scale_deviation(
    problem: Problem, theta: Floats, at: Sequence[Measurements], J: Floats
) -> float:
    """Standard deviation of the logarithm of a robot's size.

    Of all changes of the parameters that move every tool as if every length grew by one
    factor, up to fixed displacements of bases and tools, the one is taken that the
    residual rows (with known distances and priors) notice least. A robot whose lengths
    are not all estimated cannot grow; its scale is known.

    Args:
        problem: The problem.
        theta: Parameter values with the robot at nominal, shape (P,).
        at: Configurations that its instruments can measure.
        J: The whitened Jacobian there, with all further rows, shape (M, P).

    Returns:
        The deviation; zero where the robot cannot grow, infinite where no row changes.
    """
    free = problem.parameters.free.copy()
    free[list(_omitted(problem, [block.key for block in at]))] = False
    scales = problem.parameters.scales
    by_all, displaced, b = _tool_twists(problem, theta, at)
    twists, frames = np.column_stack([by_all[:, free], displaced]), displaced.shape[1]
    rows = np.column_stack([(J * scales)[:, free], np.zeros((len(J), frames))])
    _, s, Vt = np.linalg.svd(np.linalg.qr(twists, mode="r"))
    rank = int((s > 1e-11 * s[0]).sum())
    # Minimum-norm growth, and all that changes without moving the tool.
    z = Vt[:rank].T @ ((Vt[:rank] @ (twists.T @ b)) / s[:rank] ** 2)
    if np.linalg.norm(twists @ z - b) > EXACT * np.linalg.norm(b):
        return 0.0
    still = rows @ Vt[rank:].T
    noticed = rows @ z
    noticed = noticed - still @ np.linalg.lstsq(still, noticed, rcond=1e-11)[0]
    size = float(np.linalg.norm(noticed))
    # What rounding leaves of large terms is nothing noticed.
    least = EXACT * float(np.linalg.norm(rows * z))
    return 1.0 / size if size > least else np.inf


def _tool_twists(
    problem: Problem, theta: Floats, at: Sequence[Measurements]
) -> tuple[Floats, Floats, Floats]:
    """Twists of every tool as parameters change, frames are moved, and lengths grow.

    Returns:
        By scaled parameters, shape (6 N, P), by displacements of the F bases and tools,
        (6 N, 6 F), and by the logarithm of the robot's size, (6 N,).
    """
    named = [problem.terms[block.key].frames for block in at]
    ends = dict.fromkeys([*(s.station for s in named), *(s.tool for s in named)])
    first_of = {name: 6 * k for k, name in enumerate(ends)}
    changes, frames, growths = [], [], []
    for block in at:
        term = problem.terms[block.key]
        _, poses, _ = RowByRow(term, term.on_chain(block)).linear_poses(theta)
        count = len(poses.T)
        by_error = poses.derivative(np.tile(np.eye(6), (count, 1, 1)))
        by_parameters = np.zeros((6 * count, len(term.index)))
        by_parameters[:, : by_error.shape[2]] = by_error.reshape(6 * count, -1)
        changes.append(problem.spread(term, by_parameters) * problem.parameters.scales)
        displaced = np.zeros((6 * count, 6 * len(ends)))
        first, last = first_of[term.frames.station], first_of[term.frames.tool]
        displaced[:, first : first + 6] = adjoint(invert(poses.to_base)).reshape(-1, 6)
        on_tool = term.frames.offset.toActionMatrixInverse()
        displaced[:, last : last + 6] = np.tile(on_tool, (count, 1))
        frames.append(displaced)
        growths.append(_growth_twists(poses, poses.to_base).reshape(-1))
    return np.concatenate(changes), np.concatenate(frames), np.concatenate(growths)


def _has_lengths(problem: Problem, theta: Floats, at: Sequence[Measurements]) -> bool:
    """Whether a robot has lengths that are larger than errors of lengths are.

    Two axes that meet have none: as they grow, base and tool stand elsewhere.
    """
    # A tool in a socket stays there: joints that move apart take it away.
    apart = []
    for block in at:
        q = np.column_stack([np.roll(x, k) for k, x in enumerate(block.q.T)])
        apart.append(replace(block, q=q))
    _, displaced, b = _tool_twists(problem, theta, apart)
    Q = column_space(displaced)
    length = float(np.linalg.norm(b - Q @ (Q.T @ b))) / np.sqrt(len(b) / 6)
    return bool(length > LENGTH_SCALE)


def _omitted(problem: Problem, keys: Sequence[BlockKey]) -> dict[int, int]:
    """Parameters of stations that none of some blocks is measured from.

    With each the same parameter of a station of its kind that is.
    """
    used = {problem.terms[key].frames.station for key in keys}
    local, result = problem.station_parameters, dict[int, int]()
    for stations in station_kinds(problem).values() if local else ():
        shown = [station for station in stations if station in used]
        for station in (name for name in stations if name not in used):
            pairs = local[station].tolist(), local[shown[-1]].tolist()
            result |= zip(*pairs, strict=True)
    return result


def growth(problem: Problem, theta: Floats) -> Floats:
    """Derivative of the whitened residuals by the logarithm of the robot's size.

    All lengths from the bases to the tips grow by one factor; bases and tools stay.

    Args:
        problem: The problem.
        theta: Parameter values, shape (P,).

    Returns:
        The derivative, component by component as in `Problem.sigma`, shape (M,).
    """
    changes = []
    for term, data, _, _ in problem.blocks:
        T, poses, start = RowByRow(term, data).linear_poses(theta)
        grown = _growth_twists(poses, poses.to_base @ invert(poses.to_tip))
        if start is not None:
            # The twist of T_0^-1 T is that of T without that of T_0, transformed there.
            begins = _growth_twists(start, start.to_base @ invert(start.to_tip))
            grown -= (adjoint(invert(T)) @ begins[:, :, None])[:, :, 0]
        J_pose = term.measurement.linearize(T, term.values(theta)[1], data).J_pose
        changes.append((J_pose @ grown[:, :, None]).reshape(-1))
    return np.asarray(np.concatenate(changes) / problem.sigma)


def _growth_twists(poses: PoseLinearization, to_point: Floats) -> Floats:
    """Body twists of the tool as a point on it, (N, 4, 4), leaves the base, (N, 6)."""
    twists = np.zeros((len(to_point), 6))
    R, p = poses.to_base[:, :3, :3], to_point[:, :3, 3]
    twists[:, :3] = np.einsum("nji,nj->ni", R, p)
    return twists


DRAWS = 400
"""Most random draws for each that is wanted: a camera on a small arm sees its board
from one configuration of two hundred."""

AT_ONCE = 4
"""Candidates per round for each missing configuration; at least K in all."""

PATIENCE = 25
"""Rounds after which a missing configuration tries other targets."""

NEWTON = 15
"""Largest number of Newton steps to a contact; a random start needs five to ten."""

TOUCHING = 1e-13
"""Gap below which the tool touches: numerically zero [m]."""

FARTHEST = 0.5
"""Longest step of a joint on the way to a contact [rad, m]."""


def unmeasured(
    problem: Problem,
    key: BlockKey,
    q: Floats,
    target: Targets,
    conditions: Conditions = UNSTATED,
    start: Floats | None = None,
) -> Measurements:
    """Configurations at which to evaluate the model of a block; nothing is measured.

    Args:
        problem: The problem; its measurements name the payloads.
        key: The block.
        q: Positions of all joints, shape (K, n) [rad, m].
        target: Target of each.
        conditions: What holds at each. Where it states none the payloads are
            `payloads_in_turn`, joints come as from one to the next, and temperatures
            and times are spread over those of the measurements.
        start: Start configurations of relative measurements, shape (K, n) [rad, m];
            default the configuration before each.
    """
    if start is None:
        relative = problem.terms[key].measurement.declaration.relative
        start = np.roll(q, 1, axis=0) if relative else np.zeros((0, 0))
    if not len(conditions.payload):
        names = payloads_in_turn(problem, key, len(q))
        conditions = replace(conditions, payload=Labels.of(names))
    if not conditions.direction.size:
        conditions = replace(conditions, direction=approached(q), source="order")
    blocks = [b for b in problem.data.blocks if b.key == key]
    for name in ("temperature", "time"):
        known = [getattr(b.conditions, name) for b in blocks]
        if known and len(known[0]) and not len(getattr(conditions, name)):
            rows = np.linspace(0.0, len(known[0]) - 1.0, len(q)).astype(np.intp)
            conditions = replace(conditions, **{name: known[0][rows]})
    return Measurements(
        problem.chains.joints,
        q,
        values=np.zeros((len(q), 0)),
        target=Labels.of(target),
        conditions=conditions,
        start=start,
        **key._asdict(),
    )


def named_targets(problem: Problem, key: BlockKey) -> tuple[str, ...]:
    """The targets that the measurements of a block name."""
    return next((b.target.distinct for b in problem.data.blocks if b.key == key), ("",))


def payloads_in_turn(problem: Problem, key: BlockKey, count: int) -> tuple[str, ...]:
    """Default payloads: those of the data in turn, length `count`.

    Each stays for as many configurations as there are targets, so that every payload
    meets every target.
    """
    names = problem.data.payload.distinct or ("",)
    targets = len(named_targets(problem, key))
    return tuple(names[k // targets % len(names)] for k in range(count))


def observable_configurations(
    problem: Problem,
    key: BlockKey,
    theta: Floats,
    count: int,
    rng: np.random.Generator,
    payload: Targets = (),
) -> Measurements:
    """Random configurations within the limits at which an instrument can measure.

    Configurations of contact measurements are moved until the tool touches.

    Args:
        problem: Chains, frames, instruments; its data only name the targets.
        key: The block of the instrument.
        theta: Parameter values, shape (P,).
        count: Number K of configurations.
        rng: Random generator.
        payload: Payload of each; default `payloads_in_turn`.

    Raises:
        InputError: If too few configurations can be measured.
    """
    names = named_targets(problem, key)
    target = [names[i % len(names)] for i in range(count)]
    loads = tuple(payload) or payloads_in_turn(problem, key, count)
    declared = problem.terms[key].measurement.declaration
    result: Floats = np.empty((count, len(problem.chains.joints)))
    missing, tries = np.arange(count), 0
    while len(missing) and tries < DRAWS:
        tries += 1
        if tries > PATIENCE:
            # Some targets are hardly ever observable; others take their place.
            for i in missing:
                target[i] = names[(i + tries) % len(names)]
        size = max(count, AT_ONCE * len(missing)) if tries > 1 else count
        wanted = np.resize(missing, size)
        q = problem.chains.random_configurations(len(wanted), rng)
        targets, payloads = [target[i] for i in wanted], [loads[i] for i in wanted]
        at = unmeasured(problem, key, q, targets, Conditions(Labels.of(payloads)))
        if declared.contact:
            q, seen = brought_to_contact(problem, theta, at)
        else:
            seen = problem.observable(theta, at)
        # Of several for one the first that can be measured.
        index, first = np.unique(wanted[seen], return_index=True)
        result[index] = q[seen][first]
        missing = np.setdiff1d(missing, index)
    if len(missing):
        few = f"only {count - len(missing)} of {count} configurations that can be "
        few += f"measured ({key.model}) were found within the joint limits"
        lacking = lacking_frames(problem, (key,))
        reason = f"give {lacking}: without, {few}" if lacking else few
        raise InputError(reason, file=problem.setup.file or None)
    return unmeasured(problem, key, result, target, Conditions(Labels.of(loads)))


def lacking_frames(problem: Problem, keys: Iterable[BlockKey]) -> str:
    """The frames of blocks of which a setup gives no first guess, for a message."""
    lacking: dict[str, None] = {}
    for key in keys:
        frames = problem.terms[key].frames
        if frames.base.xyz is None:
            lacking[f"stations.{key.station}" if key.station else "frames.base"] = None
        if frames.end.xyz is None:
            lacking[f"tools.{key.tool}" if key.tool else "frames.tool"] = None
    return f"{' and '.join(lacking)} (first guess, xyz and rpy)" if lacking else ""


def brought_to_contact(
    problem: Problem, theta: Floats, at: Measurements, gap: Floats | None = None
) -> tuple[Floats, NDArray[np.bool_]]:
    """Configurations moved until the tool touches, by damped Newton steps.

    Args:
        problem: Chains, frames, instruments.
        theta: Parameter values, shape (P,).
        at: N configurations of a block of contact measurements.
        gap: Residual to leave, shape (N, d); default zero.

    Returns:
        The configurations, shape (N, n) [rad, m], and the mask of those that lie within
        the joint limits and touch, shape (N,).
    """
    term = problem.terms[at.key]
    robot, instrument = term.values(theta)
    chain, full = term.error.chain, at.q.copy()
    q = full[:, term.columns]
    touches, active = np.zeros(len(q), bool), np.arange(len(q))
    for _ in range(NEWTON):
        names, conditions = at.target[active], at.conditions.rows(active)
        T, J_q = term.error.kinematics(q[active], robot, conditions)
        linear = term.linearized(T, instrument, q[active], names)
        error = -linear.residual if gap is None else gap[active] - linear.residual
        size = np.abs(error).max(axis=1)
        touches[active[size < TOUCHING]] = True
        # Not finite: an arm at its stretched singularity never reaches contact.
        moving = (size >= TOUCHING) & np.isfinite(size)
        active, error, J = active[moving], error[moving], (linear.J_pose @ J_q)[moving]
        if not len(active):
            break
        damped = J @ np.swapaxes(J, 1, 2)
        scale = np.trace(damped, axis1=1, axis2=2)[:, None, None]
        damped = damped + (1e-12 * scale + 1e-30) * np.eye(damped.shape[1])
        step = np.swapaxes(J, 1, 2) @ np.linalg.solve(damped, error[:, :, None])
        longest = np.abs(step[:, :, 0]).max(axis=1)
        shorter = np.minimum(1.0, FARTHEST / np.maximum(longest, FARTHEST))
        q[active] += step[:, :, 0] * shorter[:, None]
    within = ((q >= chain.lower) & (q <= chain.upper)).all(axis=1)
    full[:, term.columns] = q
    return full, touches & within


# Closed-form starts.


def registered(problem: Problem, theta: Floats) -> Problem:
    """A problem about closed-form frames and instrument references.

    A pose in the setup is kept, as known or as a first guess; so is the identity for a
    frame that is partly fixed, bounded or has a prior. Term by term, each takes over
    what those before it have located.

    Args:
        problem: The problem.
        theta: Parameter values, shape (P,); those of the robot count.
    """
    _require_loose(problem)
    blocks = [trusted(block).sample(SAMPLE) for block in problem.data.blocks]
    few, located = replace(problem, data=Observations(tuple(blocks))), Located()
    for term in problem.terms.values():
        located.state(problem.parameters, term)
    return replace(problem, terms=located.placed(few, few.blocks, theta))


@dataclass
class Located:
    """References located so far, by name among all.

    Attributes:
        bases: Base frames of stations.
        tools: Tool frames.
        references: Reference objects, by section and name.
    """

    bases: dict[str, pin.SE3] = field(default_factory=dict)
    tools: dict[str, pin.SE3] = field(default_factory=dict)
    references: dict[tuple[str, str], ReferenceObject] = field(default_factory=dict)

    def state(self, parameters: ParameterSet, term: Term) -> None:
        """Take over the frames of a term that a setup states."""
        frames, ends = term.frames, (term.index[:FRAME], term.of_error[-FRAME:])
        if (base := _given_pose(parameters, frames.base, ends[0])) is not None:
            self.bases.setdefault(frames.station, base)
        if (tool := _given_pose(parameters, frames.end, ends[1])) is not None:
            self.tools.setdefault(frames.tool, tool)

    def register(self, block: Block, theta: Floats) -> Term:
        """Register the part of a block, and remember what that has located."""
        (term,) = with_shared_references([block.term], self.references)
        data, frames, robot = block.data, term.frames, term.values(theta)[0]
        F = term.error.tip_poses(data.q, robot, data.conditions)
        if data.start.size:
            begun = data.conditions.at_start
            F = invert(term.error.tip_poses(data.start, robot, begun)) @ F
        base, tool = self.bases.get(frames.station), self.tools.get(frames.tool)
        at_end = None if tool is None else tool * frames.offset
        measurement, base, at_end = term.measurement.register(F, data, base, at_end)
        self.bases.setdefault(frames.station, base)
        # A term that sees no tool frame has nothing to say of it.
        if term.measurement.sees_tool:
            self.tools.setdefault(frames.tool, at_end * frames.offset.inverse())
        for reference in measurement.references:
            if reference.located:
                self.references.setdefault(frames.place(reference), reference)
        return replace(term, measurement=measurement)

    def keep(self, term: Term, theta: Floats) -> None:
        """Take over everything of a term at parameter values, shape (P,)."""
        rebased = term.rebased(theta)
        self.bases[term.frames.station] = rebased.error.base
        self.tools[term.frames.tool] = rebased.error.tool * term.frames.offset.inverse()
        for reference in term.measurement.references:
            self.references[term.frames.place(reference)] = reference

    def placed(
        self, problem: Problem, blocks: Sequence[Block], theta: Floats
    ) -> dict[BlockKey, Term]:
        """Terms about all that has been located, and what some blocks locate of it.

        Args:
            problem: The problem.
            blocks: Those of its blocks that are registered; each takes over what those
                before it have located.
            theta: Parameter values, shape (P,); those of the robot count.
        """
        terms, identity = dict(problem.terms), pin.SE3.Identity()
        for block in _registration_order(blocks, self):
            terms[block.term.key] = self.register(block, theta)
        for key, term in terms.items():
            base = self.bases.get(term.frames.station, identity)
            tool = self.tools.get(term.frames.tool, identity) * term.frames.offset
            terms[key] = replace(term, error=term.error.with_frames(base, tool))
        shared = with_shared_references([*terms.values()], self.references)
        return {term.key: term for term in shared}


def relocated(problem: Problem, theta: Floats, station: str) -> Problem:
    """A problem with the closed-form base frame of a station; tools and others stay.

    Args:
        problem: The problem of measurements from there, about its solution.
        theta: Parameter values, shape (P,).
        station: Owner and kind of the base frame, see `Frames`.
    """
    located = Located()
    for term in problem.terms.values():
        located.keep(term, theta)
    del located.bases[station]
    few = [b._replace(data=b.data.sample(SAMPLE)) for b in problem.blocks]
    return replace(problem, terms=located.placed(problem, few, theta))


def _registration_order(blocks: Sequence[Block], located: Located) -> Iterator[Block]:
    """Blocks in an order in which each can be located.

    A model with its own measurement frame comes first, since sites stand in it, and
    with a tool before points that others tell more of. What stands still is located
    from stations that the robot has told of, and tells of others.
    """
    queue = list(blocks)

    def turn(block: Block) -> tuple[bool, bool, bool, bool]:
        frames, measurement = block.term.frames, block.term.measurement
        still = block.term.key.chain == WORLD
        lost = still and frames.station not in located.bases
        # Targets that stand still may tell where the station is.
        places = map(frames.place, measurement.references)
        blind = lost and any(place not in located.references for place in places)
        external = measurement.declaration.external
        return blind, lost, still or not external, not measurement.sees_tool

    while queue:
        # Blocks hold arrays, which are not compared.
        yield queue.pop(min(range(len(queue)), key=lambda k: turn(queue[k])))


def _require_loose(problem: Problem) -> None:
    """Refuse fixed, bounds or prior on what has no reference to be about."""
    parameters = problem.parameters
    lower, upper = parameters.bounds
    tied = np.isfinite([lower, upper, parameters.priors]).any(axis=0)
    tied |= problem.given.free & ~parameters.free
    for (section, name), reference in problem.references.items():
        if reference.located:
            continue
        start = f"{name}.{reference.kind}."
        index = [k for k, n in enumerate(parameters.names) if n.startswith(start)]
        if tied[index].any():
            reason = "fixed, bounds or prior on a part of an unknown instrument: give "
            reason += f"its '{section}' in a setup file (--setup)"
            raise OptionError(reason, file=problem.setup.file or None)


def _given_pose(
    parameters: ParameterSet, frame: FrameSetup, part: NDArray[np.intp]
) -> pin.SE3 | None:
    """The pose that a frame starts from, None for a closed-form estimate.

    Fixed components, bounds and priors refer to the pose of the setup file,
    not to an estimate.
    """
    lower, upper = parameters.bounds
    tied = np.isfinite([lower[part], upper[part], parameters.priors[part]]).any()
    given = frame.xyz is not None or frame.rpy is not None
    if given or tied or not parameters.free[part].all():
        return frame_pose(frame)
    return None


def extended(
    problem: Problem, theta: Floats, rows: Observations
) -> tuple[Problem, Floats]:
    """The problem of other measurements, with what only these name.

    That is reference objects, and stations of the instruments.

    Args:
        problem: The problem.
        theta: Parameter values, shape (P,).
        rows: The other measurements.

    Returns:
        The problem about its instruments, and its parameter values: those of
        instruments are zero.

    Raises:
        InputError: If measurements are of a model, a chain or a tool of which none was
            fitted.
    """
    # Poses are passed on, not poses and what was found about them.
    problem, values = problem.rebased(theta)
    if new := [block for block in rows.blocks if block.key not in problem.terms]:
        problem, values = _with_stations(problem, values, new)
    terms, other = dict(problem.terms), replace(problem, data=rows)
    for term, data, _, _ in other.blocks:
        if term.measurement.references:
            measurement = term.measurement.extended(term.poses(values, data), data)
            terms[term.key] = replace(term, measurement=measurement)
    return _of_terms(other, terms, values)


def _with_stations(
    problem: Problem, theta: Floats, new: Sequence[Measurements]
) -> tuple[Problem, Floats]:
    """The problem with stations that none of its terms has, registered.

    Args:
        problem: The problem about its solution.
        theta: Parameter values, shape (P,).
        new: Measurements from these stations.
    """
    terms = {**problem.terms, **{b.key: _term_elsewhere(problem, b) for b in new}}
    other = replace(problem, data=Observations(tuple(new)))
    other, values = _of_terms(other, terms, theta)
    located = Located()
    for key in problem.terms:
        located.keep(other.terms[key], values)
    for term, _, _, _ in other.blocks:
        located.state(other.parameters, term)
    if len(problem.units):
        known = fitted_components(other.layout, problem.layout)
        other = replace(other, units=problem.units[known])
    return replace(other, terms=located.placed(other, other.blocks, values)), values


def _term_elsewhere(problem: Problem, block: Measurements) -> Term:
    """The term of measurements from another station than any that was fitted."""
    key, setup = block.key, problem.setup
    fitted = reversed([*problem.terms.items()])
    term = {k._replace(station=""): t for k, t in fitted}.get(key._replace(station=""))
    if term is None:
        named = {"model": key.model, "chain": key.chain, "tool": key.tool}
        kind = ", ".join(f"{what} '{name}'" for what, name in named.items() if name)
        raise block.error(0, f"nothing of this kind was fitted: {kind}")
    owner = key.station or "elsewhere"
    base = setup.stations.get(key.station, FrameSetup())
    external = term.measurement.declaration.external
    free = external if base.estimate is None else base.estimate
    screws = *frame_screws("base", 0, free=free), *term.error.screws[FRAME:]
    measurement = measurement_model(key.model, setup, block.target.distinct)
    station, outer = f"{owner}.station", f"{owner}/"
    frames = replace(term.frames, station=station, outer=outer, base=base)
    error = replace(term.error, screws=screws)
    return replace(term, key=key, frames=frames, error=error, measurement=measurement)


def _of_terms(
    problem: Problem, terms: Mapping[BlockKey, Term], theta: Floats
) -> tuple[Problem, Floats]:
    """The problem of other terms, and its parameter values: zero for what is new.

    Args:
        problem: The problem.
        terms: All of its terms, those of further blocks or with more references.
        theta: Values of the parameters that it had, shape (P,).
    """
    terms, given = assembled([*terms.values()])
    position = {name: k for k, name in enumerate(given.names)}
    index = [position[name] for name in problem.given.names]
    values = np.zeros(len(given))
    values[index] = theta
    held = {index[k]: value for k, value in problem.held_at.items()}
    return replace(problem, terms=terms, given=given, held_at=held), values
