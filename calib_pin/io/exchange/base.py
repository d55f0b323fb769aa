"""Calibrations that are exported, and the files that other software loads."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pinocchio as pin

from calib_pin.errors import OptionError, OutputError
from calib_pin.estimation.evidence import TRUSTED
from calib_pin.io.calibrated_model import encode_urdf
from calib_pin.io.urdf_tree import parse_robot
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.robot import Robot
from calib_pin.kinematics.spatial import Floats
from calib_pin.validation.calibrated_model import CalibratedChain, CalibratedModel
from calib_pin.validation.result import CalibrationResult

EXACT = 1e-9
"""Largest difference of forward kinematics that is rounding [m, rad]."""

CONFIGURATIONS = 40
"""Random configurations at which robots are compared."""

Poses = Callable[[Floats], Floats]
"""Forward kinematics, joint positions (N, n) -> poses (N, 4, 4)."""

ORIGIN = ("x", "y", "z", "roll", "pitch", "yaw")
"""Numbers of an origin as URDFs have them [m, rad]."""

STEPS = 20
"""Most Gauss-Newton steps."""


@dataclass(frozen=True)
class JointErrors:
    """Errors of the joints alone, which some formats hold: `(1 + gain) q + offset`.

    Attributes:
        offsets: Offset of each joint, shape (n,) [rad, m].
        gains: Gain of its transmission, shape (n,).
        before: Distance of the tip from where the calibration has it, rms [m].
        after: The same with these.
    """

    offsets: Floats
    gains: Floats
    before: float
    after: float


@dataclass(frozen=True)
class Exported:
    """A calibration to be exported.

    Attributes:
        result: The calibration, good or without a gain.
        file: Where it was read from, for messages.
        name: Name of the chain; None for the first that moves.
    """

    result: CalibrationResult
    file: Path
    name: str | None = None

    def __post_init__(self) -> None:
        """Check that there is something to trust.

        Raises:
            OptionError: If there is not.
        """
        if self.result.verdict not in TRUSTED:
            reason = f"must not be trusted: {self.result.reason}"
            raise OptionError(reason, file=self.file)

    @cached_property
    def geometry(self) -> CalibratedModel | None:
        """The corrected geometry; None where the nominal one holds.

        Raises:
            OptionError: If it is not good without what else was calibrated.
        """
        result = self.result
        if result.geometry is None and result.verdict == "good":
            reason = "" if result.urdf is None else result.urdf.reason
            raise OptionError(
                f"has no corrected geometry to export: {reason}", file=self.file
            )
        return result.geometry

    @cached_property
    def robot(self) -> Robot:
        """The robot as its corrected URDF describes it."""
        nominal = self.result.model.chains.robot
        if self.geometry is None:
            return nominal
        path = f"{self.file} (corrected)"
        return parse_robot(encode_urdf(self.geometry, path), path)

    @cached_property
    def calibrated(self) -> CalibratedChain:
        """The chain with its whole calibration."""
        return self.result.model.of(self.name)

    @property
    def nominal(self) -> Chain:
        """The nominal chain."""
        return self.calibrated.chain

    @cached_property
    def chain(self) -> Chain:
        """The corrected chain."""
        return Chain(self.robot, self.nominal.base, self.nominal.tip)

    @cached_property
    def configurations(self) -> Floats:
        """Random configurations of the chain, shape (N, n)."""
        return self.nominal.random_configurations(
            CONFIGURATIONS, np.random.default_rng(0)
        )

    def require_same(self, poses: Poses, what: str, tolerance: float = EXACT) -> None:
        """Compare what was written with the corrected chain.

        Args:
            poses: Forward kinematics of what was written and read again.
            what: Its name, for messages.
            tolerance: Largest difference [m, rad].

        Raises:
            OutputError: If they differ.
        """
        q = self.configurations
        difference = float(np.abs(poses(q) - self.chain.poses(q)).max())
        if not difference < tolerance:
            raise OutputError(
                f"{what} differs from the corrected robot by {difference:.2g}"
            )

    @cached_property
    def offsets(self) -> JointErrors:
        """The joint offsets that come closest to the whole calibration."""
        return self.joint_errors(gains=False)

    def joint_errors(self, gains: bool) -> JointErrors:
        """The errors of the joints that come closest to the whole calibration.

        Least squares at random configurations; exact if nothing else was fitted.

        Args:
            gains: Whether gains are sought, of joints whose transmissions were fitted.
        """
        q, nominal, fitted = self.configurations, self.nominal, self.calibrated
        base, tool = fitted.error.base.inverse(), fitted.tool.inverse()
        target = base.homogeneous @ fitted.poses(q) @ tool.homogeneous
        # A turn counts as the move that it is at the usual distance from the base.
        reach = np.linalg.norm(nominal.poses(q)[:, :3, 3], axis=1).mean()
        weights = np.repeat([1.0, max(float(reach), 0.1)], 3)
        known, count = self.result.model.given.names, len(nominal.joints)
        gained = [gains and f"{j}.transmission.gain" in known for j in nominal.joints]
        x, free, sizes = np.zeros(2 * count), np.append([True] * count, gained), []
        for _ in range(STEPS):
            T, J = nominal.jacobian((1.0 + x[count:]) * q + x[:count])
            sizes.append(rms(T[:, :3, 3] - target[:, :3, 3]))
            pairs = zip(T, target, strict=True)
            twists = [pin.log6(pin.SE3(a).actInv(pin.SE3(b))).vector for a, b in pairs]
            rhs = (weights * np.array(twists)).reshape(-1)
            A = weights[:, None] * np.concatenate([J, J * q[:, None]], axis=2)
            step = np.linalg.lstsq(A.reshape(len(rhs), -1)[:, free], rhs, rcond=None)[0]
            x[free] += step
            if np.abs(step).max(initial=0.0) < EXACT:
                break
        return JointErrors(x[:count], x[count:], sizes[0], sizes[-1])


@dataclass(frozen=True)
class Encoded:
    """A file to be written.

    Attributes:
        data: Its bytes.
        remarks: Sentences about things that cannot be seen in it.
    """

    data: bytes
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True)
class Format:
    """A format that other software loads.

    Attributes:
        name: Name on the command line.
        suffix: Suffix of its files.
        summary: Its description, for the help.
        encode: Makes the file; takes the user's own one, where there is one.
        template: Whether it needs the user's own file (`required`), can do with it
            (`optional`), or cannot (empty).
    """

    name: str
    suffix: str
    summary: str
    encode: Callable[[Exported, Path | None], Encoded]
    template: str = ""


def rms(vectors: Floats) -> float:
    """Length of vectors, shape (N, 3), root mean square."""
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))


def require_read(found: object, wanted: object, what: str) -> None:
    """Compare what a file holds as it is read again.

    Raises:
        OutputError: If it is not what was to be written.
    """
    if found != wanted:
        raise OutputError(f"{what} do not read back")


def origin_of(pose: pin.SE3) -> list[float]:
    """The numbers of a pose, see `ORIGIN`."""
    return [*pose.translation.tolist(), *pin.rpy.matrixToRpy(pose.rotation).tolist()]


def placed(origin: Sequence[float]) -> pin.SE3:
    """The pose of the numbers of an origin, see `ORIGIN`."""
    numbers = np.array(origin, float)
    return pin.SE3(pin.rpy.rpyToMatrix(numbers[3:]), numbers[:3])
