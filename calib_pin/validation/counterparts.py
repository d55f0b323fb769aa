"""Two calibrations of one robot side by side: chains, nominal robots, frames."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from calib_pin.errors import InputError
from calib_pin.kinematics.chain import Chain
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.result import CalibrationResult

SAME = 1e-9
"""Largest difference between places of one nominal robot, or of a frame [m, rad]."""


@dataclass(frozen=True)
class Displacement:
    """How far a frame stands from where it stood.

    Attributes:
        frame: `base`, seen from the measurement frame, or `tool`, seen from the tip; of
            several the name of the station or the tool.
        shift: Distance between both origins [m].
        turn: Angle between both orientations [rad]; None where rows do not tell.
        of_tool: Whether it is that of a tool.
    """

    frame: str
    shift: float
    turn: float | None
    of_tool: bool = False


def partners(first: CalibratedModel, second: CalibratedModel) -> dict[str, str]:
    """Names of the chains of one robot, and of the same chains in another."""
    others = {_ends(part.error.chain): name for name, part in second.by_chain.items()}
    return {
        name: others[ends]
        for name, part in first.by_chain.items()
        if (ends := _ends(part.error.chain)) in others
    }


def _ends(chain: Chain) -> tuple[object, ...]:
    """The identity of a chain: its ends and its joints."""
    return chain.base, chain.tip, chain.joints, tuple(chain.revolute)


def require_comparable(first: CalibrationResult, second: CalibrationResult) -> None:
    """Complain about robots whose tips have nothing in common."""
    if partners(first.model, second.model):
        return
    A, B = first.model.of().chain, second.model.of().chain
    mine, other = (
        ", ".join(
            f"{joint} ({'turns' if revolute else 'slides'})"
            for joint, revolute in zip(chain.joints, chain.revolute, strict=True)
        )
        for chain in (A, B)
    )
    known = first.provenance.file or "the first"
    for what, a, b in (
        ("chain starts at", A.base, B.base),
        ("chain ends at", A.tip, B.tip),
        ("joints are", mine, other),
    ):
        if a != b:
            raise InputError(
                f"cannot be compared with {known}: its {what} {b}, there {a}",
                file=second.provenance.file or None,
            )


def same_nominal(first: CalibratedModel, second: CalibratedModel) -> bool:
    """Whether the nominal robots are the same, whatever else their URDFs hold."""
    if first.chains.robot.source == second.chains.robot.source:
        return True
    # Joint corrections depend on the masses as well.
    if not (first.geometric and second.geometric):
        return False
    return all(
        _same_chain(first.of(name).chain, second.of(other).chain)
        for name, other in partners(first, second).items()
    )


def _same_chain(A: Chain, B: Chain) -> bool:
    pairs = zip(
        (*A.placements, A.tip_placement, *A.ends),
        (*B.placements, B.tip_placement, *B.ends),
        strict=True,
    )
    return np.allclose(A.axes, B.axes, rtol=0.0, atol=SAME) and all(
        _same(a, b) for a, b in pairs
    )


def displacements(
    first: CalibratedModel, second: CalibratedModel, told: bool
) -> Iterator[Displacement]:
    """How far the frames that both have stand from where they stood.

    Args:
        first: One calibrated robot.
        second: The other.
        told: Whether the measurements of both tell how the tool is turned.
    """
    A, B = _frames(first), _frames(second)
    for place in (found for found in A if found in B):
        a, b = A[place], B[place]
        if not _same(a, b):
            shift = float(np.linalg.norm(b.translation - a.translation))
            turn = float(np.linalg.norm(pin.log3(a.rotation.T @ b.rotation)))
            of_tool = place[0] == "tool"
            known = turn if told or not of_tool else None
            yield Displacement(place[1], shift, known, of_tool)


def _frames(model: CalibratedModel) -> dict[tuple[str, str], pin.SE3]:
    """Base and tool, or the frames of all stations and tools by their names."""
    found: dict[tuple[str, str], pin.SE3] = {}
    for key, part in model.parts.items():
        at, scope = model.of(key), part.scope
        found.setdefault(("base", scope.station.rpartition(".")[0]), at.error.base)
        tool = at.tool * scope.offset.inverse()
        found.setdefault(("tool", scope.tool.rpartition(".")[0]), tool)
    return found


def _same(a: pin.SE3, b: pin.SE3) -> bool:
    return np.allclose(a.homogeneous, b.homogeneous, rtol=0.0, atol=SAME)
