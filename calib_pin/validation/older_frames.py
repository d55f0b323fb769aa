"""Frames of stations and tools that an older calibration and new measurements have."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import pinocchio as pin

from calib_pin.estimation.system import FRAME, Part, System
from calib_pin.kinematics.spatial import so3_log


@dataclass(frozen=True)
class SharedFrame:
    """A frame that both have.

    Attributes:
        kind: `base` or `tool`.
        owner: The station or the tool; empty for the only one.
        values: Its parameters about the new frame where the older one stood, each with
            its name [m, rad].
    """

    kind: str
    owner: str
    values: tuple[tuple[str, float], ...]


def shared_frames(older: System, new: System) -> tuple[SharedFrame, ...]:
    """The frames by the same names in two systems, about their solutions."""
    before, result = _frames(older), []
    for name, (kind, pose, names) in _frames(new).items():
        if name in before:
            moved = pose.actInv(before[name][1])
            # Positions alone do not tell how a tool is turned, and move it nowhere.
            values = (*moved.translation, *so3_log(moved.rotation))
            owner, _, of = name.rpartition(".")
            alone = f"{owner}.{of}" in ("base.frame", "tool.frame")
            pairs = tuple(zip(names, map(float, values), strict=True))
            result.append(SharedFrame(kind, "" if alone else owner, pairs))
    return tuple(result)


def _frames(system: System) -> Mapping[str, tuple[str, pin.SE3, tuple[str, ...]]]:
    """Kind, pose and names of the parameters of every frame by its name."""
    found: dict[str, tuple[str, pin.SE3, tuple[str, ...]]] = {}
    for part in system.parts.values():
        for name, *frame in _ends(part):
            found.setdefault(name, tuple(frame))
    return found


def _ends(part: Part) -> Iterator[tuple[str, str, pin.SE3, tuple[str, ...]]]:
    count, scope = len(part.error.screws), part.scope
    names = tuple(p.name for p in part.parameters[:count])
    yield scope.station, "base", part.error.base, names[:FRAME]
    tool = part.error.tool * scope.offset.inverse()
    yield scope.tool, "tool", tool, names[-FRAME:]
