"""Calibrations that are exported, and the files that other software loads."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import pinocchio as pin

from calib_pin.errors import OptionError, OutputError, enumerated
from calib_pin.estimation.evidence import TRUSTED
from calib_pin.io.calibrated_model import encode_urdf
from calib_pin.io.urdf_tree import parse_robot
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.joint_columns import JointColumns
from calib_pin.kinematics.robot import Robot
from calib_pin.kinematics.spatial import Floats
from calib_pin.parameterizations.base import owner
from calib_pin.setup import JointMap
from calib_pin.units import DISPLAY
from calib_pin.validation.calibrated_model import CalibratedChain, CalibratedModel
from calib_pin.validation.joint_errors import (
    JointErrors,
    configurations,
    in_base,
    joint_errors,
    told_reversed,
)
from calib_pin.validation.result import CalibrationResult

EXACT = 1e-9
"""Largest difference of forward kinematics that is rounding [m, rad]."""

ENOUGH = 1e-6
"""Distance of the tool point below which a file holds the whole calibration [m]."""

GEOMETRY, OFFSETS, GAINS = "geometry", "joint offsets", "gains"
FRAMES, CAMERA, CAMERA_LINK = "frames", "camera", "camera link"
"""Parts of a calibration that a format may hold."""

SIGNS = "directions of columns"
"""Whether a column counts as its joint turns, or the other way."""

MIMIC, PRISMATIC, SEVERAL = "mimic joints", "prismatic joints", "several chains"
"""Properties of a robot that it may hold."""

PARTS = (GEOMETRY, OFFSETS, GAINS, FRAMES, CAMERA, CAMERA_LINK)
ROBOTS = (MIMIC, PRISMATIC, SEVERAL)
"""All of both."""

RIGID = (GEOMETRY, OFFSETS)
"""Held by a description of joint frames."""

Read = Callable[[Chain, Floats], Floats]
"""Tip poses of a nominal chain in its base as a file has them, by the chain and its
joint positions, (N, n) -> (N, 4, 4); `Chain.poses` are those of the nominal robot."""

ORIGIN = ("x", "y", "z", "roll", "pitch", "yaw")
"""Numbers of an origin as URDFs have them [m, rad]."""

GAIN = ".transmission.gain"
"""End of the names of gains."""


@dataclass(frozen=True)
class Exported:
    """A calibration to be exported.

    Attributes:
        result: The calibration, good or without a gain.
        file: Where it was read from, for messages.
        name: Name of the only chain; None for all that move.
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
    def fitted(self) -> tuple[CalibratedChain, ...]:
        """The chains with their whole calibration, carrying the heaviest payload."""
        model = self.result.model
        return tuple(
            replace(one, error=one.error.carrying(model.setup.heaviest))
            for one in map(model.of, self.names)
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the chains."""
        measured = self.result.model.measured_chains
        return measured if self.name is None else (self.name,)

    @cached_property
    def chains(self) -> Chains:
        """The nominal chains."""
        return self.result.model.chains.named(self.names)

    @property
    def nominal(self) -> Chain:
        """The first nominal chain."""
        return self.fitted[0].chain

    @cached_property
    def chain(self) -> Chain:
        """Its corrected chain."""
        return self.corrected(self.nominal)

    def corrected(self, chain: Chain) -> Chain:
        """The corrected chain of a nominal one."""
        return Chain(self.robot, chain.base, chain.tip)

    def corrected_poses(self, chain: Chain, q: Floats) -> Floats:
        """Tip poses of the corrected chain of a nominal one, (N, n) -> (N, 4, 4)."""
        return self.corrected(chain).poses(q)

    @cached_property
    def reverses(self) -> Mapping[str, str]:
        """A sentence by joint that turns back as its column goes on."""
        joints = self.result.model.setup.joints
        return told_reversed(JointColumns.of(self.chains, joints))

    @cached_property
    def configurations(self) -> Floats:
        """Its random configurations, shape (N, n)."""
        return configurations(self.nominal)

    def require_same(self, read: Read, what: str, tolerance: float = EXACT) -> None:
        """Compare what was written with the corrected chains.

        Args:
            read: What was written, as it is read again.
            what: Its name, for messages.
            tolerance: Largest difference [m, rad].

        Raises:
            OutputError: If they differ.
        """
        for chain in (one.chain for one in self.fitted):
            q = configurations(chain)
            difference = np.abs(read(chain, q) - self.corrected_poses(chain, q)).max()
            if not difference < tolerance:
                raise OutputError(
                    f"{what} differs from the corrected robot by {difference:.2g}"
                )

    def distance(self, read: Read = Chain.poses) -> float:
        """How far a file is from the whole calibration.

        Args:
            read: What was written, as it is read again; default the nominal robot.

        Returns:
            Distance of the tool points between calibrated base and tool, root mean
            square over the workspace [m].
        """
        far = []
        for one in self.fitted:
            q = configurations(one.chain)
            found = read(one.chain, q) @ one.tool.homogeneous
            far.append((found - in_base(one, q))[:, :3, 3])
        return rms(np.concatenate(far))

    def joint_errors(
        self, joints: Mapping[str, JointMap], *, gains: bool = False
    ) -> JointErrors:
        """The errors of the joints that come closest to the whole calibration.

        Args:
            joints: Joint map by column; empty for the driven joints of the URDF.
            gains: Whether gains are sought, of joints whose transmissions were fitted.
        """
        known = self.result.model.given.names if gains else ()
        gained = [j for j in self.chains.joints if f"{owner(j)}{GAIN}" in known]
        return joint_errors(self.chains, self.fitted, joints, gained)

    @cached_property
    def parts(self) -> tuple[str, ...]:
        """The parts of the calibration that are not zero."""
        found = dict[str, None]()
        for one in self.fitted:
            for screw, value in zip(one.error.screws, one.theta, strict=True):
                name, kind = screw.parameter.name, screw.parameter.name.split(".")[-2]
                if screw.basis is None:
                    kind = OFFSETS if kind == "joint-offset" else GEOMETRY
                if value and not screw.parameter.nuisance:
                    found[GAINS if name.endswith(GAIN) else kind] = None
            if one.error.learned is not None:
                found["learned correction"] = None
        return tuple(found)

    @cached_property
    def framed(self) -> bool:
        """Whether there are frames that the calibration found."""
        return any(
            one.tool_carries_tip
            or any(s.parameter.nuisance and s.parameter.free for s in one.error.screws)
            for one in self.fitted
        )


@dataclass(frozen=True)
class Encoded:
    """A file to be written.

    Attributes:
        data: Its bytes.
        remarks: Sentences about things that cannot be seen in it.
        read: The robot as the file has it; the nominal one where it has none.
    """

    data: bytes
    remarks: tuple[str, ...] = ()
    read: Read = Chain.poses


@dataclass(frozen=True)
class Format:
    """A format that other software loads.

    Attributes:
        name: Name on the command line.
        suffix: Suffix of its files.
        summary: Its description, for the help.
        write: Makes the file; takes the user's own one, where there is one.
        template: Whether it needs the user's own file (`required`), can do with it
            (`optional`), or cannot (empty).
        holds: Parts of a calibration, and properties of a robot, that it has a place
            for. From these come the refusals, the remarks and the documentation.
    """

    name: str
    suffix: str
    summary: str
    write: Callable[[Exported, Path | None], Encoded]
    template: str = ""
    holds: tuple[str, ...] = ()

    def encode(self, exported: Exported, template: Path | None) -> Encoded:
        """The file, with sentences about what it does not hold.

        Raises:
            OptionError: If the robot is none that the format can hold.
            InputError: If the template is no such file.
            OutputError: If the file does not read back.
        """
        whole = exported
        if SEVERAL not in self.holds:
            exported = replace(exported, name=exported.names[0])
        joints, moves = exported.chains.joints, OFFSETS in self.holds
        slides = [joints[k] for k in np.flatnonzero(~exported.chains.revolute)]
        if slides and moves and PRISMATIC not in self.holds:
            reason = f"{self.name} is for joints that turn, '{slides[0]}' slides"
            raise OptionError(reason, file=exported.file)
        encoded = self.write(exported, template)
        remarks = [*encoded.remarks]
        if moves:
            remarks += self._distance(exported, encoded.read)
        if moves and exported.framed:
            seen = CAMERA_LINK in self.holds and exported.result.model.cameras
            lacking = "frames but the camera's" if seen else "base and tool frames"
            remarks.append(f"{self.name} holds no {lacking}: see 'tf'")
        if moves and MIMIC not in self.holds and (mimics := exported.nominal.mimics):
            said = enumerated(
                f"{name} is {of.factor:g} {of.leader} {of.offset:+g}"
                for name, of in mimics.items()
            )
            remarks.append(f"{self.name} holds no mimic joints: {said}")
        if moves and SIGNS not in self.holds and exported.reverses:
            said = enumerated(f"{joint} is reversed" for joint in exported.reverses)
            remarks.append(f"{self.name} holds no {SIGNS}: {said}")
        if others := whole.names[1:] if whole is not exported else ():
            said = f"'{exported.name}', not {enumerated(others)} (--chain)"
            remarks.append(f"{self.name} holds one chain: {said}")
        return replace(encoded, remarks=tuple(remarks))

    def _distance(self, exported: Exported, read: Read) -> Iterator[str]:
        """A sentence about how far a file is from the calibration, if it is."""
        remaining, (unit, factor) = exported.distance(read), DISPLAY["m"]
        lacking = [p for p in exported.parts if p not in self.holds]
        about = (
            f"{factor * remaining:.3g} of {factor * exported.distance():.3g} {unit} "
            "of what was found are missing (tool point, rms over the workspace)"
        )
        if remaining < ENOUGH:
            lacking = [p for p in lacking if p not in (GEOMETRY, OFFSETS, GAINS)]
            about = "it depends on what measurements state"
        if lacking:
            yield f"{self.name} holds no {', '.join(lacking)}: {about}"
        elif remaining >= ENOUGH:
            yield about


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
