"""Closed-form starts: a problem about registered frames and instrument references."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib_pin.errors import OptionError
from calib_pin.estimation.problem import SAMPLE, Problem, alike
from calib_pin.estimation.terms import (
    FRAME,
    Block,
    Term,
    assembled,
    with_shared_references,
)
from calib_pin.kinematics.spatial import Floats, invert
from calib_pin.measurement_models import measurement_model
from calib_pin.measurement_models.references import ReferenceObject
from calib_pin.observations import BlockKey, Measurements, Observations, trusted
from calib_pin.parameterizations import frame_pose, frame_screws
from calib_pin.parameters import ParameterSet
from calib_pin.setup import WORLD, FrameSetup


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
    few, found = replace(problem, data=Observations(tuple(blocks))), Located()
    for term in problem.terms.values():
        found.state(problem.parameters, term)
    return problem.with_terms(found.placed(few, few.blocks, theta))


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
        if (base := _given(parameters, frames.base, ends[0])) is not None:
            self.bases.setdefault(frames.station, base)
        if (tool := _given(parameters, frames.end, ends[1])) is not None:
            self.tools.setdefault(frames.tool, tool)

    def register(self, block: Block, theta: Floats) -> Term:
        """Register the part of a block, and remember what that has located."""
        (term,) = with_shared_references([block.term], self.references)
        data, frames, of_robot = block.data, term.frames, term.values(theta)[0]
        F = term.error.tip_poses(data.q, of_robot, data.conditions)
        if data.start.size:
            begun = data.conditions.at_start
            F = invert(term.error.tip_poses(data.start, of_robot, begun)) @ F
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
        moved = term.rebased(theta)
        self.bases[term.frames.station] = moved.error.base
        self.tools[term.frames.tool] = moved.error.tool * term.frames.offset.inverse()
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
        for block in _in_turn(blocks, self):
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
    found = Located()
    for term in problem.terms.values():
        found.keep(term, theta)
    del found.bases[station]
    few = [b._replace(data=b.data.sample(SAMPLE)) for b in problem.blocks]
    return problem.with_terms(found.placed(problem, few, theta))


def _in_turn(blocks: Sequence[Block], found: Located) -> Iterator[Block]:
    """Blocks in an order in which each can be located.

    A model with its own measurement frame comes first, since sites stand in it, and
    with a tool before points that others tell more of. What stands still is located
    from stations that the robot has told of, and tells of others.
    """
    left = list(blocks)

    def turn(block: Block) -> tuple[bool, bool, bool, bool]:
        frames, measurement = block.term.frames, block.term.measurement
        still = block.term.key.chain == WORLD
        lost = still and frames.station not in found.bases
        # Targets that stand still may tell where the station is.
        places = map(frames.place, measurement.references)
        blind = lost and any(place not in found.references for place in places)
        external = measurement.declaration.external
        return blind, lost, still or not external, not measurement.sees_tool

    while left:
        # Blocks hold arrays, which are not compared.
        yield left.pop(min(range(len(left)), key=lambda k: turn(left[k])))


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
        own = [k for k, n in enumerate(parameters.names) if n.startswith(start)]
        if tied[own].any():
            raise OptionError(
                "fixed, bounds or prior on a part of an unknown instrument: give "
                f"its '{section}' in a setup file (--setup)",
                file=problem.setup.file or None,
            )


def _given(
    parameters: ParameterSet, frame: FrameSetup, part: NDArray[np.intp]
) -> pin.SE3 | None:
    """The pose that a frame starts from, None for a closed-form estimate.

    Fixed components, bounds and priors refer to the pose of the setup file,
    not to an estimate.
    """
    lower, upper = parameters.bounds
    tied = np.isfinite([lower[part], upper[part], parameters.priors[part]]).any()
    stated = frame.xyz is not None or frame.rpy is not None
    if stated or tied or not parameters.free[part].all():
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
    terms, there = dict(problem.terms), replace(problem, data=rows)
    for term, data, _, _ in there.blocks:
        if term.measurement.references:
            measurement = term.measurement.extended(term.poses(values, data), data)
            terms[term.key] = replace(term, measurement=measurement)
    return _of_terms(there, terms, values)


def _with_stations(
    problem: Problem, theta: Floats, new: Sequence[Measurements]
) -> tuple[Problem, Floats]:
    """The problem with stations that none of its terms has, registered.

    Args:
        problem: The problem about its solution.
        theta: Parameter values, shape (P,).
        new: Measurements from these stations.
    """
    every = dict(problem.terms)
    for block in new:
        every[block.key] = _elsewhere(problem, block)
    there = replace(problem, data=Observations(tuple(new)))
    there, values = _of_terms(there, every, theta)
    found = Located()
    for key in problem.terms:
        found.keep(there.terms[key], values)
    for term, _, _, _ in there.blocks:
        found.state(there.parameters, term)
    if len(problem.units):
        known = alike(there.layout, problem.layout)
        there = replace(there, units=problem.units[known])
    return there.with_terms(found.placed(there, there.blocks, values)), values


def _elsewhere(problem: Problem, block: Measurements) -> Term:
    """The term of measurements from another station than any that was fitted."""
    key, setup = block.key, problem.setup
    fitted = reversed([*problem.terms.items()])
    term = {k._replace(station=""): t for k, t in fitted}.get(key._replace(station=""))
    if term is None:
        named = {"model": key.model, "chain": key.chain, "tool": key.tool}
        told = ", ".join(f"{what} '{name}'" for what, name in named.items() if name)
        raise block.error(0, f"nothing of this kind was fitted: {told}")
    owner = key.station or "elsewhere"
    base = setup.stations.get(key.station, FrameSetup())
    external = term.measurement.declaration.external
    free = external if base.estimate is None else base.estimate
    screws = *frame_screws("base", 0, free=free), *term.error.screws[FRAME:]
    stands = replace(term.frames, station=f"{owner}.station", outer=f"{owner}/")
    return replace(
        term,
        key=key,
        frames=replace(stands, base=base),
        error=replace(term.error, screws=screws),
        measurement=measurement_model(key.model, setup, block.target.distinct),
    )


def _of_terms(
    problem: Problem, terms: Mapping[BlockKey, Term], theta: Floats
) -> tuple[Problem, Floats]:
    """The problem of other terms, and its parameter values: zero for what is new.

    Args:
        problem: The problem.
        terms: All of its terms, those of further blocks or with more references.
        theta: Values of the parameters that it had, shape (P,).
    """
    found, given = assembled([*terms.values()])
    position = {name: k for k, name in enumerate(given.names)}
    moved = [position[name] for name in problem.given.names]
    values = np.zeros(len(given))
    values[moved] = theta
    held = {moved[k]: value for k, value in problem.held_at.items()}
    return replace(problem, terms=found, given=given, held_at=held), values
