"""Frames of stations and tools that an older calibration and new measurements have."""

from __future__ import annotations

from collections.abc import Mapping

import pinocchio as pin

from calib_pin.estimation.system import FRAME, System
from calib_pin.kinematics.spatial import so3_log

Frame = tuple[str, str]
"""`base` or `tool`, and the station or the tool; empty for the only one."""


def shared_frames(older: System, new: System) -> Mapping[Frame, Mapping[str, float]]:
    """The frames that two systems have, about their solutions.

    Of each the values [m, rad] of its parameters about the new frame, by their names,
    where the older one stood.
    """
    before, result = _frames(older), dict[Frame, Mapping[str, float]]()
    for frame, (pose, names) in _frames(new).items():
        if frame in before:
            moved = pose.actInv(before[frame][0])
            # Positions alone do not tell how a tool is turned, and move it nowhere.
            values = (*moved.translation.tolist(), *so3_log(moved.rotation).tolist())
            result[frame] = dict(zip(names, values, strict=True))
    return result


def _frames(system: System) -> Mapping[Frame, tuple[pin.SE3, tuple[str, ...]]]:
    """Pose and names of the parameters of every frame."""
    found: dict[Frame, tuple[pin.SE3, tuple[str, ...]]] = {}
    for part in system.parts.values():
        scope, count = part.scope, len(part.error.screws)
        names = tuple(p.name for p in part.parameters[:count])
        tool = part.error.tool * scope.offset.inverse()
        for kind, name, pose, own in (
            ("base", scope.station, part.error.base, names[:FRAME]),
            ("tool", scope.tool, tool, names[-FRAME:]),
        ):
            owner = "" if name == f"{kind}.frame" else name.rpartition(".")[0]
            found.setdefault((kind, owner), (pose, own))
    return found
