"""Suggested measurements: what else to measure, or know, to identify more."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import CalibPinError
from calib_pin.estimation.formulation import nominal_problem, restricted
from calib_pin.kinematics.chain import Chain
from calib_pin.measurement_models import tracked
from calib_pin.measurement_models.mount import Frame
from calib_pin.measurement_models.pinhole import Camera
from calib_pin.measurement_models.pose import Pose
from calib_pin.measurement_models.position import Position
from calib_pin.parameterizations import frame_pose, frame_setup
from calib_pin.setup import Setup
from calib_pin.validation.assessment import identify
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.result import Identification

BESIDE = pin.SE3(np.eye(3), np.array([0.05, 0.03, 0.02]))
"""From a tool that may sit on the last axis to one that does not [m]."""

POSES = "measure full poses, positions and orientations"

EVERYTHING = "measure full poses with base and tool known"


@dataclass(frozen=True)
class Suggestion:
    """A change of what is measured or known, and what it would identify.

    Attributes:
        change: Suggested change, in the imperative.
        count: Number of independent errors of the robot that can be known then.
        parameters: Names of those of its parameters that become identifiable.
        complete: Whether no measurement of the tool tells more: what is in sums then
            moves it only together.
    """

    change: str
    count: int
    parameters: tuple[str, ...]
    complete: bool


def calibrated_setup(model: CalibratedModel) -> Setup:
    """The setup of a calibration, with everything where the fit has found it."""
    sections: dict[str, Any] = {}
    camera = model.setup.camera
    for reference in model.measurement.references:
        if isinstance(reference, Camera):
            camera = reference.stated()
        elif not isinstance(reference, Frame):
            sections.setdefault(reference.section, {})[reference.name] = (
                reference.stated()
            )
    free = model.error.parameters.free
    return replace(
        model.setup,
        base_frame=frame_setup(model.error.base, known=not free[:6].any()),
        tool_frame=frame_setup(model.tool, known=not free[-6:].any()),
        camera=camera,
        board=None,  # Its points stand among the targets.
        **sections,
    )


@serial_blas
def suggestions(
    chain: Chain, model: str, setup: Setup, found: Identification, *, seed: int = 0
) -> tuple[Suggestion, ...]:
    """Changes by which more errors of the robot could be known, from the structure.

    Args:
        chain: The nominal chain.
        model: Name of the measurement model.
        setup: Estimated and known quantities; of a fit see `calibrated_setup`.
        found: The identifiability now.
        seed: Seed of the random configurations.

    Returns:
        Those that gain anything; all that a measurement of the tool can tell is last.
    """
    known = {p.name for p in found.parameters if p.status == "identifiable"}
    now = found.identifiability.robot_rank
    others = {}
    for words, measured, stated in _changes(model, setup, found):
        other = _identified(chain, measured, stated, setup.fixed, seed)
        if other is not None and other.identifiability.robot_rank > now:
            others[words] = other
    most = max((o.identifiability.robot_rank for o in others.values()), default=now)
    result = []
    for words, other in others.items():
        count = other.identifiability.robot_rank
        gained = tuple(
            p.name
            for p in other.parameters
            if p.status == "identifiable" and p.name not in known
        )
        complete = EVERYTHING in others and count == most
        result.append(Suggestion(words, count, gained, complete))
    # Where one of the others tells as much, that is simpler.
    if any(r.complete and r.change != EVERYTHING for r in result):
        result = [r for r in result if r.change != EVERYTHING]
    return tuple(result)


def _changes(
    model: str, setup: Setup, found: Identification
) -> Iterator[tuple[str, str, Setup]]:
    """Possible changes: words, measurement model, and setup."""
    free = [p.name.rsplit(".", 2) for p in found.parameters if p.status != "fixed"]
    owners = {f"{owner}.{kind}" for owner, kind, _ in free}
    points = any(kind == "target" for _, kind, _ in free)
    base, tool = "base.frame" not in owners, "tool.frame" not in owners
    stand, place = frame_pose(setup.base_frame), frame_pose(setup.tool_frame)
    plain = Setup(
        parameters=setup.parameters,
        base_frame=frame_setup(stand, known=base),
        tool_frame=frame_setup(place, known=tool and not points),
        gravity=setup.gravity,
        payloads=setup.payloads,
        gear_ratios=setup.gear_ratios,
    )
    followed = tracked(model)
    position, pose = Position.declaration.name, Pose.declaration.name
    if followed == {""}:
        tracker = replace(plain, base_frame=frame_setup(stand, known=False))
        yield "measure positions of the tool point", position, tracker
        yield POSES, pose, tracker
    else:
        if "pose" not in followed:
            if not setup.targets:
                beside = frame_setup(place * BESIDE, known=tool)
                words = "mount the target off the last axis"
                yield words, model, replace(setup, tool_frame=beside)
            yield POSES, pose, plain
        if not base:
            words = "state the pose of the base link in the measurement frame"
            held = frame_setup(stand, known=True)
            yield f"{words} (frames.base)", model, replace(setup, base_frame=held)
        if points:
            words = "state the positions of the points on the tool (targets)"
            held = frame_setup(place, known=True)
            targets = {
                name: replace(point, estimate=False)
                for name, point in setup.targets.items()
            }
            yield words, model, replace(setup, targets=targets, tool_frame=held)
        elif not tool:
            words = "state the pose of the tool on the robot (frames.tool)"
            held = frame_setup(place, known=True)
            yield words, model, replace(setup, tool_frame=held)
    at_ends = (frame_setup(stand, known=True), frame_setup(place, known=True))
    yield EVERYTHING, pose, replace(plain, base_frame=at_ends[0], tool_frame=at_ends[1])


def _identified(
    chain: Chain, model: str, setup: Setup, fixed: tuple[str, ...], seed: int
) -> Identification | None:
    """The identifiability then; None where the setup does not suffice to say."""
    stated = replace(setup, learned=None, fixed=(), bounds={}, prior={})
    try:
        names = nominal_problem(chain, model, stated).parameters.names
        stated = restricted(replace(stated, fixed=fixed), names)
        return identify(chain, model, stated, seed=seed)
    except CalibPinError:
        return None
