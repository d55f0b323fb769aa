"""Calibrations that are exported, and the formats that other software loads.

A format declares which parts of a calibration it holds; from these come its refusals,
its remarks and its documentation. Its writer makes the bytes, about the user's own file
where it takes one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

import calib_pin.validation.joint_errors as joint_errors
from calib_pin.errors import InputError, OptionError, enumerated
from calib_pin.estimation.evidence import TRUSTED
from calib_pin.io.results import encode_urdf
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
from calib_pin.validation.result import CalibrationResult

ENOUGH = 1e-6
"""Distance of the tool point below which a file holds the whole calibration [m]."""

USELESS = 0.9
"""Part of a calibration that is missing in a file from which it is of no use alone."""

GEOMETRY, OFFSETS, GAINS = "geometry", "joint offsets", "gains"
FRAMES, CAMERA = "frames", "camera"
"""Parts of a calibration that a format may hold."""

SIGNS = "directions of columns"
"""Whether a column counts as its joint turns, or the other way."""

MIMIC, PRISMATIC, SEVERAL = "mimic joints", "prismatic joints", "several chains"
"""Properties of a robot that it may hold."""

PARTS = (GEOMETRY, OFFSETS, GAINS, FRAMES, CAMERA)
ROBOTS = (MIMIC, PRISMATIC, SEVERAL)
"""All of both."""

ALREADY = "goes with the nominal URDF: the corrected one has the joint offsets already"
"""A warning of what would correct twice: offsets in a controller below a URDF that has
them."""

RIGID = (GEOMETRY, OFFSETS)
"""Held by a description of joint frames."""

Read = Callable[[Chain, Floats], Floats]
"""Tip poses of a nominal chain in its base as a file has them, by the chain and its
joint positions, (N, n) -> (N, 4, 4); `Chain.poses` are those of the nominal robot."""

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
            raise self.error(f"must not be trusted: {self.result.reason}")

    def error(self, reason: str, value: object = None) -> OptionError:
        """A refusal of this calibration."""
        return OptionError(reason, file=self.file, value=value)

    @cached_property
    def geometry(self) -> CalibratedModel | None:
        """The corrected geometry; None where the nominal one holds.

        Raises:
            OptionError: If it is not good without what else was calibrated.
        """
        result = self.result
        if result.geometry is None and result.verdict == "good":
            reason = "" if result.urdf is None else result.urdf.reason
            raise self.error(f"has no corrected geometry to export: {reason}")
        return result.geometry

    @cached_property
    def robot(self) -> Robot:
        """The robot as its corrected URDF describes it."""
        if self.geometry is None:
            return self.result.model.chains.robot
        path = f"{self.file} (corrected)"
        return parse_robot(encode_urdf(self.geometry, path), path)

    @cached_property
    def fitted(self) -> tuple[CalibratedChain, ...]:
        """The chains with their whole calibration, carrying the heaviest payload."""
        model = self.result.applied
        heaviest, chains = model.setup.heaviest, map(model.of, self.names)
        return tuple(replace(k, error=k.error.carrying(heaviest)) for k in chains)

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
        """The first corrected chain."""
        return Chain(self.robot, self.nominal.base, self.nominal.tip)

    @cached_property
    def reverses(self) -> Mapping[str, str]:
        """A sentence by joint that turns back as its column goes on."""
        joints = self.result.model.setup.joints
        return joint_errors.reversals(JointColumns.of(self.chains, joints))

    def distance(self, read: Read | None) -> float:
        """How far a file is from the whole calibration.

        Args:
            read: The robot as the file has it; None for the corrected one.

        Returns:
            Distance of the tool points between calibrated base and tool, root mean
            square over the workspace [m].
        """
        far = []
        for fitted in self.fitted:
            q = joint_errors.configurations(fitted.chain)
            corrected = Chain(self.robot, fitted.chain.base, fitted.chain.tip)
            poses = corrected.poses(q) if read is None else read(fitted.chain, q)
            T = poses @ fitted.tool.homogeneous
            far.append((T - joint_errors.in_base(fitted, q))[:, :3, 3])
        return float(np.sqrt(np.mean(np.sum(np.concatenate(far) ** 2, axis=1))))

    def joint_errors(
        self, joints: Mapping[str, JointMap], *, gains: bool = False
    ) -> joint_errors.JointErrors:
        """The errors of the joints that come closest to the whole calibration.

        Args:
            joints: Joint map by column; empty for the driven joints of the URDF.
            gains: Whether gains are sought, of joints whose transmissions were fitted.
        """
        known = self.result.model.given.names if gains else ()
        gained = [j for j in self.chains.joints if f"{owner(j)}{GAIN}" in known]
        return joint_errors.joint_errors(self.chains, self.fitted, joints, gained)

    @cached_property
    def parts(self) -> tuple[str, ...]:
        """The parts of the calibration that are not zero."""
        parts = dict[str, None]()
        for fitted in self.fitted:
            for screw, value in zip(fitted.error.screws, fitted.theta, strict=True):
                name, kind = screw.parameter.name, screw.parameter.name.split(".")[-2]
                if screw.basis is None:
                    kind = OFFSETS if kind == "joint-offset" else GEOMETRY
                if value and not screw.parameter.nuisance:
                    parts[GAINS if name.endswith(GAIN) else kind] = None
            if fitted.error.learned is not None:
                parts["learned correction"] = None
        return tuple(parts)


@dataclass(frozen=True)
class Encoded:
    """A file to be written.

    Attributes:
        data: Its bytes.
        remarks: Sentences about things that cannot be seen in it.
        read: The robot as the file has it; None for the corrected one.
    """

    data: bytes
    remarks: tuple[str, ...] = ()
    read: Read | None = None


@dataclass(frozen=True)
class Format:
    """A format that other software loads.

    Attributes:
        name: Name on the command line.
        holds: Parts of a calibration, and properties of a robot, that it has a place
            for.
        template: Whether it needs the user's own file (`required`), can do with it
            (`optional`), or cannot (empty).
        write: Makes the file; takes the user's own one, where there is one. The first
            line of its docstring describes the format.
    """

    name: str
    holds: tuple[str, ...]
    template: str
    write: Callable[[Exported, Path | None], Encoded]

    @property
    def summary(self) -> str:
        """Its description, for the help."""
        return (self.write.__doc__ or "").partition(".\n")[0].removesuffix(".")

    def encode(self, exported: Exported, template: Path | None) -> Encoded:
        """The file, with sentences about what it does not hold.

        Raises:
            OptionError: If the robot is none that the format can hold.
            InputError: If the template is no such file.
        """
        others = () if SEVERAL in self.holds else exported.names[1:]
        single = replace(exported, name=exported.names[0]) if others else exported
        if OFFSETS in self.holds and PRISMATIC not in self.holds:
            for k in np.flatnonzero(~single.chains.revolute)[:1]:
                slides = f"'{single.chains.joints[k]}' slides"
                raise single.error(f"{self.name} is for joints that turn, {slides}")
        encoded = self.write(single, template)
        remarks = [*encoded.remarks]
        if single.result.verdict == "no-gain":
            remarks.append("without a gain this is of the nominal robot")
        elif {OFFSETS, GEOMETRY} & {*self.holds} == {OFFSETS}:
            remarks.append(f"{self.name} {ALREADY}")
        if OFFSETS in self.holds:
            remarks += self._lacking(single, encoded.read)
        if others:
            text = f"'{single.name}', not {enumerated(others)} (--chain)"
            remarks.append(f"{self.name} holds one chain: {text}")
        return replace(encoded, remarks=tuple(remarks))

    def _lacking(self, exported: Exported, read: Read | None) -> Iterator[str]:
        """Sentences about the distance to the calibration, frames and kinds of joints.

        Args:
            exported: The calibration.
            read: The robot as the file has it; None for the corrected one.
        """
        lacking = [part for part in exported.parts if part not in self.holds]
        if (far := exported.distance(read)) >= ENOUGH:
            (unit, factor), whole = DISPLAY["m"], exported.distance(Chain.poses)
            sentence = f"{factor * far:.3g} of {factor * whole:.3g} {unit} of what was "
            sentence += "found are missing (tool point, rms over the workspace)"
            if far > USELESS * whole:
                sentence += ": a robot that has this alone is hardly more accurate"
        else:
            lacking = [p for p in lacking if p not in (GEOMETRY, OFFSETS, GAINS)]
            sentence = "it depends on what measurements state" if lacking else ""
        holds = f"{self.name} holds no {', '.join(lacking)}: " if lacking else ""
        if sentence:
            yield holds + sentence
        fitted = exported.fitted
        placed = [s.parameter for chain in fitted for s in chain.error.screws]
        carries = any(chain.tool_carries_tip for chain in fitted)
        if carries or any(p.nuisance and p.free for p in placed):
            yield f"{self.name} holds no base and tool frames: see 'tf'"
        mimics = exported.nominal.mimics.items()
        followers = [f"{n} is {m.factor:g} {m.leader} {m.offset:+g}" for n, m in mimics]
        reversed_ = [f"{joint} is reversed" for joint in exported.reverses]
        for part, sentences in ((MIMIC, followers), (SIGNS, reversed_)):
            if sentences and part not in self.holds:
                yield f"{self.name} holds no {part}: {enumerated(sentences)}"


def require(
    usable: bool, reason: str, file: Path | None, value: object, allowed: str
) -> None:
    """Refuse a file of the user's.

    Raises:
        InputError: If it is not usable.
    """
    if not usable:
        raise InputError(reason, file=file, value=value, allowed=allowed)
