"""Closed-form starts: a problem about registered frames and instrument references."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib_pin.errors import OptionError
from calib_pin.estimation.layout import alike
from calib_pin.estimation.measured import Block
from calib_pin.estimation.problem import SAMPLE, Problem
from calib_pin.estimation.system import (
    FRAME,
    Part,
    assembled,
    with_shared_references,
)
from calib_pin.kinematics.spatial import Floats, invert
from calib_pin.measurement_models import measurement_model
from calib_pin.measurement_models.references import ReferenceObject
from calib_pin.observations import (
    BlockKey,
    Measurements,
    Observations,
    trusted,
)
from calib_pin.parameterizations import frame_pose, frame_screws
from calib_pin.parameters import ParameterSet
from calib_pin.setup import WORLD, FrameSetup, Setup


def registered(problem: Problem, theta: Floats) -> Problem:
    """A problem about closed-form frames and instrument references.

    A pose in the setup is kept, as known or as a first guess; so is the identity for a
    frame that is partly fixed, bounded or has a prior. Part by part, each takes over
    what those before it have located.

    Args:
        problem: The problem.
        theta: Parameter values, shape (P,); those of the robot count.
    """
    _require_loose(problem)
    blocks = [trusted(block).sample(SAMPLE) for block in problem.data.blocks]
    few = replace(problem, data=Observations(tuple(blocks)))
    found = Located()
    for part in few.parts.values():
        found.state(problem.parameters, part)
    parts = dict(problem.parts)
    for block in _in_turn(few.blocks, found):
        parts[block.part.key] = found.register(block, theta)
    return problem.with_parts(found.placed(list(parts.values())))


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

    def state(self, parameters: ParameterSet, part: Part) -> None:
        """Take over the frames of a part that a setup states."""
        scope, ends = part.scope, (part.index[:FRAME], part.of_error[-FRAME:])
        base, tool = (
            _given(parameters, frame, own)
            for frame, own in zip((scope.base, scope.end), ends, strict=True)
        )
        if base is not None:
            self.bases[scope.station] = base
        if tool is not None:
            self.tools[scope.tool] = tool

    def register(self, block: Block, theta: Floats) -> Part:
        """Register the part of a block, and remember what that has located."""
        (part,) = with_shared_references([block.part], self.references)
        data, scope, of_robot = block.data, part.scope, part.values(theta)[0]
        F = part.error.tip_poses(data.q, of_robot, data.conditions)
        if data.start.size:
            begun = data.conditions.at_start
            F = invert(part.error.tip_poses(data.start, of_robot, begun)) @ F
        base, tool = self.bases.get(scope.station), self.tools.get(scope.tool)
        at_end = None if tool is None else tool * scope.offset
        measurement, base, at_end = part.measurement.register(F, data, base, at_end)
        self.bases.setdefault(scope.station, base)
        # A part that sees no tool frame has nothing to say of it.
        if part.measurement.sees_tool:
            self.tools.setdefault(scope.tool, at_end * scope.offset.inverse())
        for reference in measurement.references:
            if reference.located:
                self.references.setdefault(scope.place(reference), reference)
        return replace(part, measurement=measurement)

    def keep(self, part: Part, theta: Floats) -> None:
        """Take over everything of a part at parameter values, shape (P,)."""
        moved, _ = part.rebased(theta[part.index])
        self.bases[part.scope.station] = moved.error.base
        self.tools[part.scope.tool] = moved.error.tool * part.scope.offset.inverse()
        for reference in part.measurement.references:
            self.references[part.scope.place(reference)] = reference

    def placed(self, parts: list[Part]) -> dict[BlockKey, Part]:
        """Parts about all that has been located."""
        identity = pin.SE3.Identity()
        moved = [
            replace(
                part,
                error=part.error.with_frames(
                    self.bases.get(part.scope.station, identity),
                    self.tools.get(part.scope.tool, identity) * part.scope.offset,
                ),
            )
            for part in parts
        ]
        return {
            part.key: part for part in with_shared_references(moved, self.references)
        }

    def knows(self, block: Block) -> bool:
        """Whether targets that stand still tell where a station is."""
        return all(
            block.part.scope.place(reference) in self.references
            for reference in block.part.measurement.references
        )


def relocated(problem: Problem, theta: Floats, station: str) -> Problem:
    """A problem with the closed-form base frame of a station; tools and others stay.

    Args:
        problem: The problem of measurements from there, about its solution.
        theta: Parameter values, shape (P,).
        station: Owner and kind of the base frame, see `Scope`.
    """
    found, moved = Located(), []
    for part, _, _, _ in problem.blocks:
        found.keep(part, theta)
    del found.bases[station]
    for block in _in_turn(problem.blocks, found):
        few = block._replace(data=block.data.sample(SAMPLE))
        moved.append(found.register(few, theta))
    return problem.with_parts({**problem.parts, **found.placed(moved)})


def _in_turn(blocks: Sequence[Block], found: Located) -> Iterator[Block]:
    """Blocks in an order in which each can be located.

    A model with its own measurement frame comes first, since sites stand in it, and
    with a tool before points that others tell more of. What stands still is located
    from stations that the robot has told of, and tells of others.
    """
    left = list(blocks)

    def turn(block: Block) -> tuple[bool, bool, bool, bool]:
        station = block.part.scope.station in found.bases
        still = block.part.key.chain == WORLD
        external = block.part.measurement.declaration.external
        return (
            still and not station and not found.knows(block),
            still and not station,
            still or not external,
            not block.part.measurement.sees_tool,
        )

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
    if new := [block for block in rows.blocks if block.key not in problem.parts]:
        # Poses are passed on, not poses and what was found about them.
        problem, theta = problem.rebased(theta)
    values = theta.copy()
    parts = {}
    for key, part in problem.parts.items():
        own = part.of_instrument
        measurement = part.measurement.rebased(theta[own])
        parts[key], values[own] = replace(part, measurement=measurement), 0.0
    known = problem
    if new:
        known, values = _with_stations(problem, parts, values, new)
        parts = dict(known.parts)
    there = replace(known, parts=parts, data=rows)
    for part, data, _, _ in there.blocks:
        if not part.measurement.references:
            continue
        T = part.poses(values[part.index], data)
        measurement = part.measurement.extended(T, data)
        parts[part.key] = replace(part, measurement=measurement)
    return _of_parts(there, parts, values)


def _with_stations(
    problem: Problem,
    parts: Mapping[BlockKey, Part],
    theta: Floats,
    new: Sequence[Measurements],
) -> tuple[Problem, Floats]:
    """The problem with stations that none of its parts has, registered.

    Args:
        problem: The problem.
        parts: Its parts about their instruments.
        theta: Parameter values, shape (P,).
        new: Measurements from these stations.
    """
    every = {**parts}
    for block in new:
        every[block.key] = _elsewhere(parts, block, problem.setup)
    there, values = _of_parts(
        replace(problem, data=Observations(tuple(new))), every, theta
    )
    found = Located()
    for key in parts:
        found.keep(there.parts[key], values)
    for part, _, _, _ in there.blocks:
        base = _given(there.parameters, part.scope.base, part.index[:FRAME])
        if base is not None:
            found.bases.setdefault(part.scope.station, base)
    own = [found.register(block, values) for block in _in_turn(there.blocks, found)]
    placed = found.placed(own)
    if len(problem.units):
        known = alike(there.layout, problem.layout)
        there = replace(there, units=problem.units[known])
    return replace(there, parts={**there.parts, **placed}), values


def _elsewhere(
    parts: Mapping[BlockKey, Part], block: Measurements, setup: Setup
) -> Part:
    """The part of measurements from another station than any that was fitted."""
    key = block.key
    fitted = [
        part
        for other, part in parts.items()
        if other._replace(station="") == key._replace(station="")
    ]
    if not fitted:
        named = zip(
            ("model", "chain", "tool"), (key.model, key.chain, key.tool), strict=True
        )
        told = ", ".join(f"{what} '{name}'" for what, name in named if name)
        raise block.error(0, f"nothing of this kind was fitted: {told}")
    part, owner = fitted[0], key.station or "elsewhere"
    base = setup.stations.get(key.station, FrameSetup())
    free = part.measurement.declaration.external
    if base.estimate is not None:
        free = base.estimate
    screws = *frame_screws("base", 0, free=free), *part.error.screws[FRAME:]
    scope = replace(
        part.scope, station=f"{owner}.station", base=base, outer=f"{owner}/"
    )
    return replace(
        part,
        key=key,
        scope=scope,
        error=replace(part.error, screws=screws),
        measurement=measurement_model(key.model, setup, block.target.distinct),
    )


def _of_parts(
    problem: Problem, parts: Mapping[BlockKey, Part], theta: Floats
) -> tuple[Problem, Floats]:
    """The problem of other parts, and its parameter values: zero for what is new.

    Args:
        problem: The problem.
        parts: All of its parts, those of further blocks or with more references.
        theta: Values of the parameters that it had, shape (P,).
    """
    found, given = assembled(list(parts.values()))
    position = {name: k for k, name in enumerate(given.names)}
    moved = [position[name] for name in problem.given.names]
    values = np.zeros(len(given))
    values[moved] = theta
    held = {moved[k]: value for k, value in problem.held_at.items()}
    return replace(problem, parts=found, given=given, held_at=held), values
