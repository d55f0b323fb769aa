"""The state of a robot: a normal distribution of its errors, and how it changes.

An older calibration is the state of a robot: the values of its parameters, with their
covariance, about the frames in which it stood. It moves to the frames of new
measurements (`about`), becomes wider by drift and sudden changes, and is then the prior
of the next calibration, or of a plan for it (`prior`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import InputError, OptionError, enumerated
from calib_pin.estimation.fitted import robot_rows
from calib_pin.estimation.statistics.population_prior import RobotEvidence
from calib_pin.estimation.terms import FRAME, Terms
from calib_pin.kinematics.robot_types import robot_type
from calib_pin.kinematics.spatial import Floats, so3_log
from calib_pin.parameterizations.base import LENGTH_SCALE, expected_size, owner
from calib_pin.parameters import ParameterSet
from calib_pin.setup import JointPrior
from calib_pin.setup.population import ExpectedParameter
from calib_pin.validation.result import CalibrationResult

FLOOR = 1e-4
"""Least standard deviation of an error, in its expected size: far below any drift."""

ROUNDING = 1e-9
"""Part of a joint's motion that its errors lack where they hold its offset."""

Frame = tuple[str, str]
"""`base` or `tool`, and the station or the tool; empty for the only one."""


@dataclass(frozen=True)
class RobotState:
    """The parameters of a robot as a calibration knows them.

    Attributes:
        system: The robot, about the references that values belong to.
        values: Values of its P parameters, shape (P,).
        covariance: Of these, shape (P, P).
        free: Which of them were estimated, shape (P,).
        file: Where that stands, for messages.
    """

    system: Terms
    values: Floats
    covariance: Floats
    free: NDArray[np.bool_]
    file: str = ""

    @staticmethod
    def of(result: CalibrationResult) -> RobotState:
        """The state that a calibration has found."""
        free = np.array([p.status != "fixed" for p in result.parameters])
        C, file = np.asarray(result.covariance), result.provenance.file
        return RobotState(result.model, result.model.theta, C, free, file)

    @property
    def robot(self) -> NDArray[np.bool_]:
        """The estimated parameters that are errors of the robot, shape (P,)."""
        return self.free & ~self.system.given.nuisance

    def about(
        self, system: Terms, robot: NDArray[np.bool_]
    ) -> tuple[RobotState, Mapping[Frame, list[int]]]:
        """The state about the references of new measurements.

        Frames that both have are where they were, seen from where they stand now. What
        else is new has no covariance.

        Args:
            system: The robot before the new instrument.
            robot: The errors of the robot among its parameters, shape (P,).

        Returns:
            The state, and the positions of the parameters of frames that both have.
        """
        names, old = system.given.names, self.system.given.names
        values, frames = np.zeros(len(names)), dict[Frame, list[int]]()
        values[robot] = self.values[self.places(system.given, robot)]
        before, known = _frames(self.system), robot.copy()
        for frame, (pose, own) in _frames(system).items():
            if frame in before:
                moved = pose.actInv(before[frame][0])
                frames[frame] = [names.index(name) for name in own]
                known[frames[frame]] = True
                # Positions alone do not tell how a tool is turned, and move it nowhere.
                twist = np.append(moved.translation, so3_log(moved.rotation))
                values[frames[frame]] = twist
        here = [k for k in np.flatnonzero(known).tolist() if names[k] in old]
        there = [old.index(names[k]) for k in here]
        covariance = np.zeros((len(names), len(names)))
        covariance[np.ix_(here, here)] = self.covariance[np.ix_(there, there)]
        return RobotState(system, values, covariance, known, self.file), frames

    def places(self, parameters: ParameterSet, robot: NDArray[np.bool_]) -> list[int]:
        """Positions of the errors of the robot among the parameters of a problem.

        Raises:
            OptionError: If one of them was not estimated.
        """
        known = {p.name: k for k, p in enumerate(self.system.given) if self.free[k]}
        names = [p.name for p, of in zip(parameters, robot, strict=True) if of]
        if lacking := [name for name in names if name not in known]:
            reason = f"the older calibration has not estimated {enumerated(lacking)}"
            allowed = "the same 'fixed' in both"
            raise OptionError(reason, file=self.file or None, allowed=allowed)
        return [known[name] for name in names]

    def prior(
        self, effects: Iterable[tuple[float, Floats]], noise: Mapping[str, float]
    ) -> JointPrior:
        """The state as a prior of the errors of the robot, wider by changes.

        Args:
            effects: Sizes and directions of these, of the scaled parameters, shapes
                (P, k).
            noise: The noise of every quantity.
        """
        robot, given = self.robot, self.system.given
        scales = np.outer(given.scales[robot], given.scales[robot])
        index = np.flatnonzero(robot).tolist()
        squares, V = np.linalg.eigh(self.covariance[np.ix_(index, index)] / scales)
        C = (V * np.maximum(squares, FLOOR**2)) @ V.T
        for size, directions in effects:
            C += size**2 * directions[robot] @ directions[robot].T
        values = [(given[k], float(self.values[k])) for k in index]
        means = tuple(ExpectedParameter(p.name, p.unit, value) for p, value in values)
        rows = tuple(map(tuple, (0.5 * scales * (C + C.T)).tolist()))
        of_type = robot_type(self.system.chains)
        return JointPrior(of_type, means, rows, noise, self.file)


def _frames(system: Terms) -> Mapping[Frame, tuple[pin.SE3, tuple[str, ...]]]:
    """Pose and names of the parameters of every frame."""
    found: dict[Frame, tuple[pin.SE3, tuple[str, ...]]] = {}
    for term in system.terms.values():
        names = tuple(p.name for p in term.parameters[: len(term.error.screws)])
        tool = term.error.tool * term.frames.offset.inverse()
        for kind, scope, pose, own in (
            ("base", term.frames.station, term.error.base, names[:FRAME]),
            ("tool", term.frames.tool, tool, names[-FRAME:]),
        ):
            name = "" if scope == f"{kind}.frame" else scope.rpartition(".")[0]
            found.setdefault((kind, name), (pose, own))
    return found


@dataclass(frozen=True)
class Change:
    """A sudden change that parameters may show.

    Attributes:
        name: The joint, station or tool; empty for the whole robot, or the only one.
        kind: `offset` of the joint, `placement` for all of its errors, `robot`, or the
            frame that moves, `base` or `tool`.
        directions: Its independent effects on all parameters divided by their scales,
            shape (P, k), each of the expected size of an error.
        unit: Unit of an offset, rad or m.
        size: Expected size of an offset in that unit.
    """

    name: str
    kind: str
    directions: Floats
    unit: str = "m"
    size: float = LENGTH_SCALE


def drifts(
    system: Terms, robot: NDArray[np.bool_], sudden: Iterable[Change]
) -> Mapping[str, Floats]:
    """How errors drift by independent effects, shapes (P, k) in their scales, by name.

    Of a drift of size one [m, rad] errors without such a unit have the same part of
    their expected sizes as a length.

    Args:
        system: The robot.
        robot: The errors of the robot among its parameters, shape (P,).
        sudden: What may change at once: offsets drift as well.
    """
    scales = [p.scale if p.unit in ("m", "rad") else LENGTH_SCALE for p in system.given]
    offsets = [c.directions / c.size for c in sudden if c.kind == "offset"]
    alone = np.hstack([np.zeros((len(robot), 0)), *offsets])
    geometry = np.diag(1.0 / np.array(scales))[:, robot]
    return {"geometry": geometry, "joint offsets": alone}


def changes(system: Terms, robot: NDArray[np.bool_]) -> dict[str, Change]:
    """The sudden changes that the errors of a robot may show, by name.

    Args:
        system: The robot.
        robot: The errors of the robot among its parameters, shape (P,).
    """
    found = {f"offset {one.name}": one for one in _offsets(system, robot)}
    every = np.eye(len(robot))
    for joint in system.chains.joints:
        own = robot & _of(system, joint)
        if own.sum() > 1:
            found[f"placement {joint}"] = Change(joint, "placement", every[:, own])
    found["robot"] = Change("", "robot", every[:, robot])
    return found


def _of(system: Terms, joint: str) -> NDArray[np.bool_]:
    """The parameters that have the name of a joint, shape (P,)."""
    owners = [parameter.name.rsplit(".", 2)[0] for parameter in system.given]
    return np.asarray(np.array(owners) == owner(joint))


def _offsets(system: Terms, robot: NDArray[np.bool_]) -> Iterator[Change]:
    """Offsets of the joints whose motion the errors of the robot hold."""
    found = set[str]()
    for term in system.terms.values():
        chain = term.error.chain
        behind = [*chain.placements, chain.tip_placement]
        for frame, joint in enumerate(chain.joints, 1):
            # Errors in the next frame, as those of a DH matrix, move with the joint.
            to_frame = {frame: np.eye(6), frame + 1: behind[frame].toActionMatrix()}
            own, T = robot & _of(system, joint), np.zeros((6, len(robot)))
            for screw, k in zip(term.error.screws, term.of_error, strict=True):
                if own[k] and screw.frame in to_frame and screw.basis is None:
                    twist = to_frame[screw.frame] @ screw.twist
                    T[:, k] += twist * screw.parameter.scale
            motion = chain.motions[frame - 1]
            along = np.linalg.lstsq(T, motion, rcond=1e-9)[0]
            if joint in found or np.abs(T @ along - motion).max() > ROUNDING:
                continue
            found.add(joint)
            unit = "rad" if chain.revolute[frame - 1] else "m"
            size = expected_size(unit)
            yield Change(joint, "offset", size * along[:, None], unit, size)


@serial_blas
def robot_evidence(result: CalibrationResult) -> RobotEvidence:
    """The equations for the errors of its robot that a calibration amounts to.

    Args:
        result: The calibration, of this program or read from its folder.

    Raises:
        InputError: If it does not say what was measured, how large the noise is, or
            learned more than errors of parameters.
    """
    model, noise = result.model, result.statistics.noise
    for refused, reason in (
        (model.setup.learned, "with a learned correction tells a fleet nothing"),
        (not np.isfinite(result.fitted.after).any(), "does not say what was measured"),
        (not noise, "does not know its noise: its measurements are too few"),
    ):
        if refused:
            file = result.provenance.file or None
            raise InputError(f"the calibration {reason}", file=file)
    factors = np.array([component.factor for component in noise])
    problem = replace(model.problem(result.fitted.rows), units=factors)
    told = robot_rows(problem, model.theta, noise)
    own = [p for p, of in zip(problem.parameters, told.robot, strict=True) if of]
    names, units = tuple(p.name for p in own), tuple(p.unit for p in own)
    scales, robot = np.array([p.scale for p in own]), robot_type(model.chains)
    sizes = {c.quantity: c.estimate for c in noise if c.estimate > 0.0}
    return RobotEvidence(robot, names, units, scales, told.rows, told.values, sizes)
