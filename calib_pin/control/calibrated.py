"""A calibrated robot as kinematics: of which frame, which point, and which load."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np

from calib_pin.control.joints import Kinematics
from calib_pin.errors import OptionError, require_known
from calib_pin.estimation.terms import FRAME
from calib_pin.kinematics.spatial import Floats, adjoint, interpolate, invert
from calib_pin.observations import UNSTATED, BlockKey, Conditions, Signs
from calib_pin.parameterizations import NOTHING
from calib_pin.parameterizations.error_model import ErrorModel, varying
from calib_pin.units import DISPLAY
from calib_pin.validation.calibrated_model import CalibratedChain, CalibratedModel
from calib_pin.validation.result import (
    REMEDY,
    CalibrationResult,
    ToolAccuracy,
    frames_of,
)
from calib_pin.validation.tool_accuracy import SAMPLES

NOTHING_LEFT = 1e-9
"""Standard deviation that is rounding [m]."""

MUCH = 2.0
"""Usual deviations from which those of a point are worth a word."""

Frame: TypeAlias = Literal["measuring", "base"]
Point: TypeAlias = Literal["tool", "tip"]


def kinematics(
    model: CalibratedChain,
    *,
    frame: Frame = "measuring",
    point: Point = "tool",
    nominal: bool = False,
    side: Signs | None = None,
) -> Kinematics:
    """Kinematics of a calibrated robot, with all its corrections.

    Args:
        model: The calibrated chain.
        frame: Frame of the poses: `measuring`, or `base`, the base link.
        point: The placed point: `tool`, or `tip`, the tip link.
        nominal: Whether the robot is taken without its errors; the frames stay.
        side: Sign of the last motion of each joint, shape (n,); None where it is not
            known, and joints stand in the middle of their lost motion.

    Returns:
        Kinematics for `reach` and `search`. Derivatives of the corrections of joint
        positions by these are neglected.
    """
    error, theta = model.error, model.theta
    if nominal:
        error, theta = replace(error, learned=None), np.zeros_like(theta)

    def evaluate(q: Floats) -> tuple[Floats, Floats]:
        held = UNSTATED
        if side is not None:
            held = Conditions(direction=np.tile(side, (len(q), 1)))
        T, J = error.kinematics(q, theta, held)
        base, tool = _ends(error, q)
        if frame == "base":
            T = invert(base) @ T
        if point == "tip":
            # Through the tool, which also carries the learned motion.
            T, J = T @ invert(tool), adjoint(tool) @ J
        return T, J

    return evaluate


def _ends(error: ErrorModel, q: Floats) -> tuple[Floats, Floats]:
    """Base and tool frame, each (4, 4), or (N, 4, 4) where the correction fades."""
    base, tool = error.base.homogeneous, error.tool.homogeneous
    if error.learned is None:
        return base, tool
    products = error.corrections(error.learned.shift)
    shifted = base @ products[0].homogeneous, tool @ products[-1].homogeneous
    weight = error.learned.weight(q)
    if (weight == 1.0).all():
        return shifted
    return interpolate(base, shifted[0], weight), interpolate(tool, shifted[1], weight)


def block_of(
    model: CalibratedModel,
    chain: str | None = None,
    station: str | None = None,
    tool: str | None = None,
) -> BlockKey:
    """The first block of a calibration of a chain, a station and a tool.

    Raises:
        OptionError: If a name is not among those that were measured, or there are
            several chains and none is named.
    """
    if chain is None and len(model.measured_chains) > 1:
        raise OptionError(
            "the calibration is of several chains; say which one with --chain",
            allowed=", ".join(model.measured_chains),
        )
    keys = [key for key in model.terms if key.chain in model.measured_chains]
    for kind, name in (("chain", chain), ("station", station), ("tool", tool)):
        if name is not None:
            require_known(kind, name, dict.fromkeys(getattr(k, kind) for k in keys))
            keys = [key for key in keys if getattr(key, kind) == name]
    return keys[0]


def model_errors(result: CalibrationResult) -> dict[str, dict[str, Any]]:
    """Errors of a calibration on its validation measurements [m, rad], by quantity.

    Of the robot that commands are for, see `CalibrationResult.applied`.
    """
    errors, as_it_is = {}, result.verdict == "no-gain"
    for error in result.errors:
        size = error.validation_before if as_it_is else error.validation_after
        if size is not None and error.unit in ("m", "rad"):
            about = {"unit": error.unit, "method": result.validation.method}
            errors[error.name] = {**about, "mean": size.mean, "max": size.max}
    return errors


def with_payload(
    model: CalibratedChain, payload: str | None, file: str | Path | None = None
) -> CalibratedChain:
    """The calibrated robot with a payload that its setup knows.

    Args:
        model: The calibrated chain.
        payload: Name of the payload, `none` for nothing; may be left out where the
            calibration needs none or knows only one.
        file: File of the calibration, for messages.

    Raises:
        OptionError: If there is no payload of that name, or it is missing.
    """
    if payload is not None:
        return model.carrying(payload)
    if not model.geometric and len(model.setup.payloads) > 1:
        raise OptionError(
            "the calibration knows several payloads; say with --payload which one is "
            "carried",
            file=file,
            allowed=", ".join([*model.setup.payloads, NOTHING]),
        )
    return model


def ends_known(
    result: CalibrationResult,
    key: BlockKey,
    frame: str = "measuring",
    point: str = "tool",
) -> str:
    """How exactly the frame and the point of targets are known, as a sentence.

    Args:
        result: The calibration.
        key: The block whose chain, station and tool are used.
        frame: Frame of the targets, see `kinematics`.
        point: The placed point.

    Returns:
        The sentence with standard deviations over the workspace; empty where nothing
        but the measured poses matters, or where base and tool were given.

    Raises:
        OptionError: If the measurements leave open where the frame or the point is.
    """
    term, of_base, of_tip = result.model.terms[key], frame == "base", point == "tip"
    if of_base != of_tip:  # The tool in the base link, or the tip where it is measured.
        end, _ = frames_of(term)[of_base]
        # The orientation of a point is as stated.
        unknown = [c for c in result.unknown_of(*end) if of_tip or c in "xyz"]
        if unknown:
            reason = f"{', '.join(unknown)} of {end.label} unknown; {REMEDY}"
            raise OptionError(reason, file=result.provenance.file or None)
    free = term.error.parameters.free
    given = not ((of_base and free[:FRAME].any()) or (of_tip and free[-FRAME:].any()))
    position, orientation = _deviations(result, key, of_base, of_tip)
    usual, _ = _deviations(result, key, False, False)
    if expected := result.accuracies.get(key.chain, ToolAccuracy()).workspace:
        # Without what moves all points alike, as all references that are estimated do.
        usual = min(usual, MUCH * expected.calibrated.position)
    if given and position <= MUCH * usual:
        return ""
    size = "up to a fixed displacement"
    # Errors that the frames have absorbed count only where their size is known.
    if position > NOTHING_LEFT:
        parts = ((position, DISPLAY["m"]), (orientation, DISPLAY["rad"]))
        shown = (f"{float(f'{by * x:.1e}'):g} {unit}" for x, (unit, by) in parts)
        size = f"to +- {' and '.join(shown)} (standard deviation)"
    if given:
        return (
            f"errors of the robot that the measurements do not show move the {point}, "
            f"which is known {size}; measure poses, or several points of the tool"
        )
    return (
        f"base or tool were estimated along with the robot, so the {point} is known in "
        f"the {'base link' if of_base else 'measurement frame'} {size}; state them in "
        "the setup file, or give targets of the tool in the measurement frame"
    )


def _deviations(
    result: CalibrationResult, key: BlockKey, of_base: bool, of_tip: bool
) -> tuple[float, float]:
    """Standard deviations of the point in the frame, root mean square [m, rad]."""
    term = result.reference.terms[key]
    q = term.error.chain.random_configurations(SAMPLES, np.random.default_rng(0))
    _, J, C = result.linearized(term, q, result.model.setup.heaviest)
    if of_base:
        J[:, :, :FRAME] = 0.0
    if of_tip:
        J[:, :, -FRAME:] = 0.0
        J = adjoint(term.error.tool.homogeneous) @ J
    variances = np.einsum("kip,pr,kir->i", J, C, J) / len(q)
    return float(np.sqrt(variances[:3].sum())), float(np.sqrt(variances[3:].sum()))


def has_sides(model: CalibratedChain) -> bool:
    """Whether it matters from which side joints come: there is lost motion."""
    n = len(model.chain.joints)
    side, none = np.ones((1, n), np.int8), np.zeros((1, n))
    basis = model.error.basis(none, Conditions(direction=side))
    moved = (basis - model.error.basis(none)) * model.theta[varying(model.error)]
    return bool(moved.any())
