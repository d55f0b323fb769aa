"""What else to measure, or to know, so that more of the robot can be told."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from calib_pin.calibration import identify
from calib_pin.chain import Chain
from calib_pin.formulation import nominal_problem, restricted
from calib_pin.parameterizations import frame_pose, frame_setup
from calib_pin.result import Identification
from calib_pin.setup import Setup

__all__ = ["Remedy", "remedies"]

TRACKED = ("position", "pose")
"""Models that look at the tool from a frame of their own."""

ALL = "all of these"

BESIDE = pin.SE3(np.eye(3), np.array([0.05, 0.03, 0.02]))
"""From a tool that may sit on the last axis to one that does not [m]."""


@dataclass(frozen=True)
class Remedy:
    """A change of what is measured or known, and what it would tell.

    Attributes:
        change: What is to be done.
        count: Number of independent errors of the robot that can be known then.
        parameters: Names of those of its parameters that become identifiable.
    """

    change: str
    count: int
    parameters: tuple[str, ...]


@dataclass(frozen=True)
class _Change:
    """A way to measure, and whether its frames would be known."""

    words: str
    model: str
    base: bool
    tool: bool
    beside: bool = False


def remedies(
    chain: Chain,
    model: str,
    setup: Setup,
    found: Identification,
    *,
    tool: pin.SE3 | None = None,
    seed: int = 0,
) -> tuple[Remedy, ...]:
    """Changes by which more errors of the robot could be known, from the structure.

    Args:
        chain: The nominal chain.
        model: Name of the measurement model.
        setup: What is estimated and what is known.
        found: What can be known now.
        tool: Where the tool sits in the tip, by a fit; default where the setup says.
        seed: Seed of the random configurations.

    Returns:
        Those that gain anything, all together last. What is still in sums then moves
        the tool only together: no measurement of the tool can take it apart.
    """
    tool = frame_pose(setup.tool_frame) if tool is None else tool
    known = {p.name for p in found.parameters if p.status == "identifiable"}
    result = []
    for change in _changes(model, found):
        stated = Setup(
            parameters=setup.parameters,
            base_frame=frame_setup(pin.SE3.Identity(), known=change.base),
            tool_frame=frame_setup(
                tool * BESIDE if change.beside else tool, known=change.tool
            ),
            gravity=setup.gravity,
            payloads=setup.payloads,
            gear_ratios=setup.gear_ratios,
        )
        names = nominal_problem(chain, change.model, stated).parameters.names
        stated = restricted(replace(stated, fixed=setup.fixed), names)
        other = identify(chain, change.model, stated, seed=seed)
        count = other.identifiability.robot_rank
        if count > found.identifiability.robot_rank:
            gained = tuple(
                p.name
                for p in other.parameters
                if p.status == "identifiable" and p.name not in known
            )
            result.append(Remedy(change.words, count, gained))
    alone = len(result) == 2 and result[1].change == ALL
    return tuple(result[:1] if alone else result)


def _changes(model: str, found: Identification) -> Iterator[_Change]:
    """What could be done otherwise."""
    free = {p.name.rpartition(".")[0] for p in found.parameters if p.status != "fixed"}
    base, tool = "base.frame" not in free, "tool.frame" not in free
    poses = "measure full poses, positions and orientations"
    if model not in TRACKED:
        yield _Change("measure positions of the tool", "position", False, False)
        yield _Change(poses, "pose", False, False)
        return
    changes = []
    if model == "position":
        words = "put the target beside the last axis"
        changes.append(_Change(words, model, base, tool, beside=True))
        changes.append(_Change(poses, "pose", base, tool))
    if not base:
        words = "know where the base link stands in the measuring frame (frames.base)"
        changes.append(_Change(words, model, True, tool))
    if not tool:
        words = "know where the tool sits on the robot (frames.tool)"
        changes.append(_Change(words, model, base, True))
    yield from changes
    if changes:
        yield _Change(ALL, "pose", True, True)
