"""Suggested measurements: what else to measure, or know, to identify more."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import CalibPinError, OptionError
from calib_pin.estimation.formulation import nominal_problem, restricted
from calib_pin.estimation.terms import BASE
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.measurement_models import declared
from calib_pin.measurement_models.pinhole import Camera
from calib_pin.measurement_models.pose import Pose
from calib_pin.measurement_models.position import Position
from calib_pin.observations import BlockKey
from calib_pin.parameterizations import frame_pose, frame_setup
from calib_pin.setup import FrameSetup, Setup, ToolSetup
from calib_pin.validation.assessment import identify
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.result import CalibrationResult, Identification, Suggestion

LARGEST = 1000
"""Most parameters of which suggestions are sought; each takes the time of an analysis,
which grows with the third power."""

ASSUMED_TOOL = pin.SE3(np.eye(3), np.array([0.05, 0.03, 0.02]))
"""Where a target sits in the tip that nobody has stated: beside the last axis [m]; and
from a tool that may sit on that to one that does not."""

POSES = "measure full poses, positions and orientations"

EVERYTHING = "measure full poses with base and tool known"


def calibrated_setup(model: CalibratedModel) -> Setup:
    """The setup of a calibration, with everything where the fit has found it."""
    setup, sections = model.setup, dict[str, Any]()
    camera, base, tool = setup.camera, setup.base_frame, setup.tool_frame
    stations, tools = dict(setup.stations), dict(setup.tools)
    for term in model.terms.values():
        for reference in term.measurement.references:
            if isinstance(reference, Camera):
                camera = reference.stated()
            else:
                named = sections.setdefault(reference.section, {})
                named[reference.name] = reference.stated()
    for name, frame in model.frames().items():
        owner, _, kind = name.rpartition(".")
        if kind == "station":
            stations[owner] = frame
        elif kind == "tool":
            tools[owner] = ToolSetup(frame.xyz, frame.rpy, frame.estimate)
        elif name == BASE:
            base = frame
        else:
            tool = frame
    changes = {"base_frame": base, "tool_frame": tool, "camera": camera} | sections
    # The points of a board stand among the targets.
    changes |= {"stations": stations, "tools": tools, "board": None}
    try:
        return replace(setup, **changes)
    except OptionError:
        # A fit to what was read wrong may end farther off than anything is.
        return setup


@serial_blas
def suggestions(
    chains: Chain | Chains,
    measured: str | Sequence[BlockKey],
    setup: Setup,
    result: Identification,
    *,
    seed: int = 0,
) -> tuple[Suggestion, ...]:
    """Changes by which more errors of the robot could be known, from the structure.

    Args:
        chains: The nominal chain, or several.
        measured: Name of the measurement model, or the blocks that are measured.
        setup: Estimated and known quantities; of a fit see `calibrated_setup`.
        result: The identifiability now.
        seed: Seed of the random configurations.

    Returns:
        Those that gain anything; all that a measurement of the tool can tell is last.
        None for more than `LARGEST` parameters.
    """
    if result.identifiability.parameters > LARGEST:
        return ()
    keys = (BlockKey(measured),) if isinstance(measured, str) else tuple(measured)
    known = {p.name for p in result.parameters if p.status == "identifiable"}
    now = result.identifiability.robot_rank
    others = {}
    for words, blocks, variant in _changes(keys, setup, result):
        other = _identified(chains, blocks, variant, setup.fixed, seed)
        if other is not None and other.identifiability.robot_rank > now:
            others[words] = other
    most = max((o.identifiability.robot_rank for o in others.values()), default=now)
    remedies = []
    for words, other in others.items():
        count = other.identifiability.robot_rank
        gained = tuple(
            p.name
            for p in other.parameters
            if p.status == "identifiable" and p.name not in known
        )
        complete = EVERYTHING in others and count == most
        remedies.append(Suggestion(words, count, gained, complete))
    # Where one of the others tells as much, that is simpler.
    if any(r.complete and r.change != EVERYTHING for r in remedies):
        remedies = [r for r in remedies if r.change != EVERYTHING]
    return tuple(remedies)


def with_suggestions(result: CalibrationResult) -> CalibrationResult:
    """A calibration, with the changes by which more of its robot could be known."""
    model, seed = result.model, result.solver.seed
    about = model.chains, tuple(model.terms), calibrated_setup(model)
    return replace(result, suggestions=suggestions(*about, result, seed=seed))


def _changes(
    keys: Sequence[BlockKey], setup: Setup, result: Identification
) -> Iterator[tuple[str, Sequence[BlockKey], Setup]]:
    """Possible changes: words, what is measured, and setup."""
    free = [p.name.rsplit(".", 2) for p in result.parameters if p.status != "fixed"]
    kinds = {owner if kind == "frame" else kind for owner, kind, _ in free}
    points = "target" in kinds
    base, tool = not kinds & {"base", "station"}, not kinds & {"tool"}
    plain = Setup(
        parameters=setup.parameters,
        base_frame=setup.base_frame,
        tool_frame=setup.tool_frame,
        stations=setup.stations,
        tools=setup.tools,
        gravity=setup.gravity,
        payloads=setup.payloads,
        gear_ratios=setup.gear_ratios,
    )
    plain = _held(keys, plain, base=base, tool=tool and not points)
    followed = {declared(key.model).tracks for key in keys}
    position, pose = Position.declaration.name, Pose.declaration.name
    if followed == {""}:
        tracker = _held(keys, plain, base=False)
        words = "measure positions of the tool point"
        yield words, _variants(position, keys), tracker
        yield POSES, _variants(pose, keys), tracker
    else:
        if "pose" not in followed:
            if not setup.targets:
                words = "mount the target off the last axis"
                yield words, keys, _held(keys, setup, tool=tool, aside=ASSUMED_TOOL)
            yield POSES, _variants(pose, keys), plain
        if not base:
            words = "state the pose of the base link in the measurement frame"
            where = "stations" if "station" in kinds else "frames.base"
            yield f"{words} ({where})", keys, _held(keys, setup, base=True)
        if points:
            words = "state the positions of the points on the tool (targets)"
            targets = {
                name: replace(point, estimate=False)
                for name, point in setup.targets.items()
            }
            held = _held(keys, setup, tool=True)
            yield words, keys, replace(held, targets=targets)
        elif not tool:
            several = len({key.tool for key in keys}) > 1
            words = "state the pose of the tool on the robot"
            where = "tools" if several else "frames.tool"
            yield f"{words} ({where})", keys, _held(keys, setup, tool=True)
    yield EVERYTHING, _variants(pose, keys), _held(keys, plain, base=True, tool=True)


def _variants(model: str, keys: Sequence[BlockKey]) -> tuple[BlockKey, ...]:
    """The blocks, each measured in another way."""
    return tuple(dict.fromkeys(key._replace(model=model) for key in keys))


def _held(
    keys: Sequence[BlockKey],
    setup: Setup,
    *,
    base: bool | None = None,
    tool: bool | None = None,
    aside: pin.SE3 | None = None,
) -> Setup:
    """A setup whose stations and tools are known, or not.

    Args:
        keys: The blocks, which name them.
        setup: The setup.
        base: Whether stations are known; None to leave them as they are.
        tool: The same of tools.
        aside: Motion of the tools first.
    """
    if base is not None:
        stations = {key.station: FrameSetup() for key in keys if key.station}
        setup = replace(
            setup,
            base_frame=frame_setup(frame_pose(setup.base_frame), known=base),
            stations={
                name: frame_setup(frame_pose(frame), known=base)
                for name, frame in {**stations, **setup.stations}.items()
            },
        )
    if tool is not None:
        moved = aside or pin.SE3.Identity()
        tools = {key.tool: ToolSetup() for key in keys if key.tool} | dict(setup.tools)
        for name, entry in tools.items():
            if entry.on is None:
                held = frame_setup(frame_pose(entry) * moved, known=tool)
                tools[name] = ToolSetup(held.xyz, held.rpy, held.estimate)
        end = frame_setup(frame_pose(setup.tool_frame) * moved, known=tool)
        setup = replace(setup, tool_frame=end, tools=tools)
    return setup


def _identified(
    chains: Chain | Chains,
    keys: Sequence[BlockKey],
    setup: Setup,
    fixed: tuple[str, ...],
    seed: int,
) -> Identification | None:
    """The identifiability then; None where the setup does not suffice to say."""
    variant = replace(setup, learned=None, fixed=(), bounds={}, prior={})
    try:
        names = nominal_problem(chains, keys, variant).parameters.names
        variant = restricted(replace(variant, fixed=fixed), names)
        return identify(chains, keys, variant, seed=seed)
    except CalibPinError:
        return None
