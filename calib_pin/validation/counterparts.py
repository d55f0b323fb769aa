"""Two calibrations of one robot side by side: chains and nominal robots."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from calib_pin.errors import InputError
from calib_pin.kinematics.chain import Chain
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.result import CalibrationResult

SAME = 1e-9
"""Largest difference between places of one nominal robot, or of a frame [m, rad]."""


def partners(first: CalibratedModel, second: CalibratedModel) -> dict[str, str]:
    """Names of the chains of one robot, and of the same chains in another."""
    others = {_ends(term.error.chain): name for name, term in second.by_chain.items()}
    return {
        name: others[ends]
        for name, term in first.by_chain.items()
        if (ends := _ends(term.error.chain)) in others
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


def _same(a: pin.SE3, b: pin.SE3) -> bool:
    return np.allclose(a.homogeneous, b.homogeneous, rtol=0.0, atol=SAME)
