"""Errors of the joints alone that come closest to a whole calibration."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.joint_columns import JointColumns
from calib_pin.kinematics.spatial import Floats, invert
from calib_pin.parameterizations.base import owner
from calib_pin.parameters import by_joint
from calib_pin.setup import JointMap, Setup
from calib_pin.units import DISPLAY
from calib_pin.validation.calibrated_model import CalibratedChain
from calib_pin.validation.result import CalibrationResult

CONFIGURATIONS = 40
"""Random configurations at which robots are compared."""


@dataclass(frozen=True)
class JointErrors:
    """Corrections of the columns c of a controller: `(1 + gain) c + offset`.

    Attributes:
        columns: The K columns of all chains.
        joints: Joint map by column, from which they come.
        offsets: Offset of each column, shape (K,) [rad, m].
        gains: Gain of each column, shape (K,).
    """

    columns: JointColumns
    joints: Mapping[str, JointMap]
    offsets: Floats
    gains: Floats

    @property
    def drives(self) -> list[tuple[int, str, str]]:
        """Place, column and joint of each drive."""
        both = zip(self.columns.names, self.columns.joints, strict=True)
        return [(k, name, joint) for k, (name, joint) in enumerate(both) if joint]

    def poses(self, chain: Chain, q: Floats) -> Floats:
        """Tip poses of a nominal chain that takes them, (N, n) -> (N, 4, 4)."""
        return chain.poses(self._corrected(chain, q)[0])

    def _corrected(self, chain: Chain, q: Floats) -> tuple[Floats, Floats, Floats]:
        """Corrected joint positions of a chain, and its part in all columns.

        Returns:
            Positions, shape (N, n), their derivative by the columns, (n, K), and the
            values of these before, (N, K), zero for those of other chains.
        """
        local = JointColumns.of(chain, self.joints)
        at = [self.columns.names.index(name) for name in local.names]
        factors = np.zeros((len(chain.joints), len(self.offsets)))
        values = np.zeros((len(q), len(self.offsets)))
        factors[:, at], values[:, at] = local.factors, local.values(q)
        corrected = (1.0 + self.gains) * values + self.offsets
        return corrected @ factors.T + local.offsets, factors, values

    def equations(self, fitted: CalibratedChain) -> tuple[Floats, Floats]:
        """Linear equations of further corrections at random configurations.

        Returns:
            Derivative by offsets and gains, shape (6 N, 2 K), and right side, (6 N,).
        """
        chain, q = fitted.chain, configurations(fitted.chain)
        moved, factors, values = self._corrected(chain, q)
        T, J = chain.jacobian(moved)
        J = J @ factors
        apart = invert(T) @ in_base(fitted, q) @ fitted.tool.inverse().homogeneous
        twists = np.array([pin.log6(pin.SE3(M)).vector for M in apart])
        # A turn counts as the move that it is at the usual distance from the base.
        reach = np.linalg.norm(chain.poses(q)[:, :3, 3], axis=1).mean()
        weights = np.repeat([1.0, max(float(reach), 0.1)], 3)
        A = weights[:, None] * np.concatenate([J, J * values[:, None]], axis=2)
        return A.reshape(-1, A.shape[2]), (weights * twists).reshape(-1)


def joint_errors(
    chains: Chains,
    fitted: Sequence[CalibratedChain],
    joints: Mapping[str, JointMap],
    gained: Collection[str] = (),
) -> JointErrors:
    """The errors of the joints that come closest to a calibration of all chains.

    Least squares at random configurations; exact if nothing else was fitted.

    Args:
        chains: The nominal chains.
        fitted: The same with their calibration.
        joints: Joint map by column; empty for the URDF's driven joints themselves.
        gained: Joints that have a gain as well.
    """
    columns = JointColumns.of(chains, joints)
    # A column that only moves the joint of another has no offset of its own.
    moves = [joint != "" for joint in columns.joints]
    free = np.array([*moves, *(joint in gained for joint in columns.joints)])
    x, step = np.zeros(len(free)), np.zeros(len(free))
    for _ in range(20):  # A few are enough.
        errors = JointErrors(columns, joints, *np.split(x, 2))
        parts = zip(*map(errors.equations, fitted), strict=True)
        A, rhs = (np.concatenate(part) for part in parts)
        step[free] = np.linalg.lstsq(A[:, free], rhs, rcond=None)[0]
        x += step
        if np.abs(step).max() < 1e-9:
            break
    return JointErrors(columns, joints, *np.split(x, 2))


def configurations(chain: Chain) -> Floats:
    """Random configurations of a chain within its limits, shape (N, n) [rad, m]."""
    return chain.random_configurations(CONFIGURATIONS, np.random.default_rng(0))


def in_base(fitted: CalibratedChain, q: Floats) -> Floats:
    """Poses of the tool in the base link by a calibration, shape (N, 4, 4)."""
    return np.asarray(fitted.error.base.inverse().homogeneous @ fitted.poses(q))


@dataclass(frozen=True)
class OffsetEstimate:
    """How far a joint stands from what its column says.

    Attributes:
        joint: URDF joint.
        column: Its file column.
        unit: Unit of the offset, rad or m.
        value: Where the joint stands minus what the column says.
        sigma: Standard deviation; None where the offset is not known.
        steps: Steps of its encoder per unit; None where they are not stated.
        status: That of the parameter, or of one less known that it is coupled to.
        within: Frames or instruments that the offset cannot be told from.
        reverses: A sentence where the joint turns back as its column goes on.
    """

    joint: str
    column: str
    unit: str
    value: float
    sigma: float | None
    steps: float | None
    status: str
    within: tuple[str, ...]
    reverses: str = ""


def encoder_steps(setup: Setup, joints: Sequence[str]) -> Mapping[str, float]:
    """Steps per turn by joint, of those that have any.

    Raises:
        OptionError: If a name or glob of the setup is no joint.
    """
    steps = setup.encoder_steps.items()
    return by_joint(steps, joints, "encoder_steps", setup.file or None)


def reversals(columns: JointColumns) -> dict[str, str]:
    """A sentence by joint that turns back as its column goes on."""
    sentences = {}
    for joint, (column, given) in columns.maps.items():
        if (factor := given.sign * given.gear) < 0.0:
            unit, display = DISPLAY["rad" if columns.angular[column] else "m"]
            times = "" if factor == -1.0 else f"{-factor:g} "
            zero = f" {display * given.offset:+.6g} {unit}" if given.offset else ""
            terms = "".join(f" {by:+g} {name}" for name, by in given.coupled.items())
            inside = f"(reading + offset{terms})"
            sentences[joint] = f"{joint} is reversed: q = -{times}{inside}{zero}"
    return sentences


def joint_offsets(result: CalibrationResult) -> tuple[OffsetEstimate, ...]:
    """The offsets of the columns of all joints that have one as a parameter."""
    model = result.model
    columns = JointColumns.of(model.chains, model.setup.joints)
    joints, reverses = model.chains.joints, reversals(columns)
    per_turn, revolute = encoder_steps(model.setup, joints), model.chains.revolute
    turning = (j for j, turns in zip(joints, revolute, strict=True) if turns)
    steps = {j: per_turn[j] / (2.0 * np.pi) for j in turning if j in per_turn}
    # Where columns are coupled, the offset of one is made up of those of several.
    weights = columns.values(np.eye(len(joints)) + columns.offsets).T
    estimates = {p.name: p for p in result.parameters if p.status != "fixed"}
    names = {joint: f"{owner(joint)}.joint-offset.q" for joint in joints}
    known = {j: estimates[name] for j, name in names.items() if name in estimates}
    absorbed = {e.of[0]: e.within for e in result.robot_errors if e.within}
    covariance, offsets = result.covariance, list[OffsetEstimate]()
    for row, joint, column in zip(weights, columns.joints, columns.names, strict=True):
        if joint not in known:
            continue
        parts = [k for k, j in enumerate(joints) if row[k] and j in known]
        involved, w = [known[joints[k]] for k in parts], row[parts]
        status = [one.status for one in involved if one.status != "identifiable"]
        index = [covariance.rows.index(one.name) for one in involved]
        C = np.asarray(covariance)[np.ix_(index, index)]
        offset = OffsetEstimate(
            joint,
            column,
            known[joint].unit,
            value=float(w @ [one.value for one in involved]),
            sigma=None if status else float(np.sqrt(w @ C @ w)),
            steps=steps.get(joint),
            status=[*status, "identifiable"][0],
            within=absorbed.get(joint, ()),
            reverses=reverses.get(joint, ""),
        )
        offsets.append(offset)
    return tuple(offsets)
