"""Where base, tools, stations and cameras are: static transforms, and camera files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
import pinocchio as pin
import yaml

import calib_pin.io.exchange.base as base
from calib_pin.errors import enumerated
from calib_pin.io.exchange.base import Encoded, Exported, Format
from calib_pin.io.urdf_tree import joint_text, parse_document, placed, words
from calib_pin.measurement_models.pinhole import Camera
from calib_pin.validation.result import REMEDY, frames_of

NAMES = {
    "base": ("measurement", "measured_frame"),
    "tool": ("tool", "measured_point"),
}
"""Names of the frames that have none of their own, by how they are called here."""

OPTICAL = placed((0.0, 0.0, 0.0, -np.pi / 2, 0.0, -np.pi / 2))
"""The optical frame of a camera in its link."""

ENDS = ("link", "joint", "optical_frame", "optical_joint")
"""Ends of the names of a camera's links and joints."""

TURNS = ("rx", "ry", "rz")
"""Components of an orientation."""


@dataclass(frozen=True)
class Place:
    """A frame that stands still in a link.

    Attributes:
        parent: The link.
        child: Name of the frame, of which no link and no other frame has any.
        pose: Its pose in the link.
        camera: Whether it is the optical frame of a camera.
        unknown: Names of the components of its pose that nobody knows.
        written: Whether it is of use: all is known, or of a point its position.
    """

    parent: str
    child: str
    pose: pin.SE3
    camera: bool
    unknown: tuple[str, ...]
    written: bool

    @property
    def remark(self) -> str:
        """A sentence about what nobody knows of it."""
        where = f"of {self.parent} -> {self.child}"
        if self.written:
            return f"the orientation {where} was not measured, only its position"
        return f"{', '.join(self.unknown)} {where} unknown"

    @property
    def numbers(self) -> tuple[dict[str, float], dict[str, float]]:
        """Position [m] and quaternion, each number by its name."""
        turn = pin.Quaternion(self.pose.rotation).coeffs().tolist()
        position = dict(zip("xyz", self.pose.translation.tolist(), strict=True))
        return position, dict(zip("xyzw", turn, strict=True))


def places(
    exported: Exported, *, cameras: bool = False
) -> tuple[list[Place], tuple[str, ...]]:
    """The measurement frames in the base link, and the tools in the tip link.

    They belong to the corrected URDF; a frame that several blocks share is listed once.

    Args:
        exported: The calibration.
        cameras: Only the frames of cameras.

    Returns:
        The frames, and sentences about what is not known of them.
    """
    result, every = exported.result, dict[tuple[str, ...], Place]()
    taken = set(result.model.chains.robot.links)
    for term in result.model.terms.values():
        chain, (station, tool) = term.error.chain, (f for f, _ in frames_of(term))
        start, tip = term.error.base.inverse(), result.model.of(term.key).tool
        seen = {
            "tool" if reference.mount == "hand" else "station": reference
            for reference in term.measurement.references
            if isinstance(reference, Camera)
        }
        for frame, link, pose in ((station, chain.base, start), (tool, chain.tip, tip)):
            if (key := (*frame, link)) in every:
                continue
            names = NAMES.get(frame.name, (f"{frame.name}_{frame.kind}",))
            if camera := seen.get(frame.kind):
                name = term.frames.reference(camera)
                names = (name, f"{name}_optical_frame")
            child, unknown = _free_name(names, taken), result.unknown_of(*frame)
            point = frame is tool and camera is None and unknown == TURNS
            about = camera is not None, unknown, point or not unknown
            every[key] = Place(link, child, pose, *about)
    found = [place for place in every.values() if place.camera or not cameras]
    remarks = [place.remark for place in found if place.unknown]
    if not all(place.written for place in found):
        known = [f"only {sums.expression} is known" for sums in result.coupled_frames]
        remarks.append("; ".join([REMEDY, *known]))
    return found, tuple(remarks)


def _free_name(names: Sequence[str], taken: set[str]) -> str:
    """The first name that no frame has, or the last with a number; taken from now."""
    plain = [name.replace(".", "_").replace("/", "_") for name in names]
    plain += [f"{plain[-1]}_{k}" for k in range(2, len(taken) + 3)]
    name = next(name for name in plain if name not in taken)
    taken.add(name)
    return name


def camera_links(exported: Exported) -> tuple[str, tuple[str, ...]]:
    """Links of the cameras whose place is known, as elements of a URDF, and remarks.

    As ROS has it (REP 103): in `NAME_link` x is forward and z up, in
    `NAME_optical_frame` z is forward and x to the right of the image.
    """
    (found, remarks), text = places(exported, cameras=True), ""
    document = parse_document(exported.robot.source, exported.robot.file)
    taken = {*document.named("link"), *document.named("joint")}
    for place in (place for place in found if place.written):
        stem = place.child.removesuffix("_optical_frame")
        names = (_free_name([f"{stem}_{end}"], taken) for end in ENDS)
        link, joint, frame, optical = names
        forward = place.pose * OPTICAL.inverse()
        for name, parent, child, pose in (
            (joint, place.parent, link, forward),
            (optical, link, frame, OPTICAL),
        ):
            text += f"  <link name={quoteattr(child)}/>\n"
            text += joint_text(name, "fixed", parent, child, pose)
    return text, remarks


@partial(Format, "tf", ".yaml", (base.FRAMES, base.CAMERA_LINK, *base.ROBOTS), "")
def tf(exported: Exported, _: Path | None) -> Encoded:
    """Static transforms of base, tools, stations, camera.

    As ROS prints them, and the commands that publish them.

    Raises:
        OptionError: If nothing is known of any.
    """
    (found, remarks), documents, commands = places(exported), [], []
    for place in (place for place in found if place.written):
        position, turn = place.numbers
        documents.append(
            {
                "header": {"frame_id": place.parent},
                "child_frame_id": place.child,
                "transform": {"translation": position, "rotation": turn},
            }
        )
        options = position | {f"q{key}": number for key, number in turn.items()}
        stated = " ".join(f"--{key} {number!r}" for key, number in options.items())
        commands.append(
            f"# ros2 run tf2_ros static_transform_publisher {stated} "
            f"--frame-id {place.parent} --child-frame-id {place.child}"
        )
    if not documents:
        raise exported.error("; ".join(remarks))
    text = yaml.safe_dump({"transforms": documents}, sort_keys=False)
    lines = [*(f"# {remark}" for remark in remarks), *commands, text]
    return Encoded("\n".join(lines).encode(), remarks)


@partial(Format, "camera-info", ".yaml", (base.CAMERA, *base.ROBOTS), "")
def camera_info(exported: Exported, _: Path | None) -> Encoded:
    """The camera, as ROS loads it.

    With its place, as a comment.

    Raises:
        OptionError: If there is not one camera, or its intrinsics are not known.
    """
    found = exported.result.model.cameras
    if len(found) != 1:
        told = ", ".join(found) or "none"
        raise exported.error("one camera can be exported", told)
    ((name, camera),) = found.items()
    if unknown := [p for p in exported.result.unknown if p.startswith(f"{name}.")]:
        raise exported.error(f"{enumerated(unknown)} unknown; {REMEDY}")
    if camera.size is None:
        raise exported.error(
            "the size of the images is unknown, and ROS refuses a wrong one; state "
            "'size: [width, height]' [px] under 'camera' in the setup file, and "
            "calibrate again"
        )
    (fx, fy), (cx, cy) = camera.focal, camera.center
    K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    matrices = {
        "camera_matrix": K,
        "distortion_coefficients": np.array([camera.distortion]),
        "rectification_matrix": np.eye(3),
        "projection_matrix": np.pad(K, ((0, 0), (0, 1))),
    }
    sizes = zip(("image_width", "image_height"), map(int, camera.size), strict=True)
    document = dict[str, object](sizes)
    document |= {"camera_name": name, "distortion_model": "plumb_bob"}
    for key, matrix in matrices.items():
        rows, cols = matrix.shape
        document[key] = {"rows": rows, "cols": cols, "data": matrix.ravel().tolist()}
    cameras, remarks = places(exported, cameras=True)
    lines = []
    for place in cameras:
        x, turn = (words(part.values()) for part in place.numbers)
        about = f" in {place.parent}: xyz {x}, quaternion x y z w {turn}"
        about = about if place.written else f": {place.remark}"
        lines.append(f"# optical frame{about}")
    lines.append(yaml.safe_dump(document, sort_keys=False, default_flow_style=None))
    return Encoded("\n".join(lines).encode(), remarks)
