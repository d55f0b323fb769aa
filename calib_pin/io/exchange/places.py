"""Where base, tools, stations and cameras are: static transforms, and camera files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain as joined
from itertools import count
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
import pinocchio as pin
import yaml

from calib_pin.errors import OptionError, enumerated
from calib_pin.io.exchange.base import (
    CAMERA,
    CAMERA_LINK,
    FRAMES,
    ROBOTS,
    Encoded,
    Exported,
    Format,
    origin_of,
    placed,
    require_read,
)
from calib_pin.io.urdf_tree import parse_document
from calib_pin.measurement_models.pinhole import Camera
from calib_pin.validation.result import REMEDY, frames_of

NAMES = {
    "base": ("measurement", "measured_frame"),
    "tool": ("tool", "measured_point"),
}
"""Names of the frames that have none of their own, by how they are called here."""

OPTICAL = (0.0, 0.0, 0.0, -np.pi / 2, 0.0, -np.pi / 2)
"""Origin of the optical frame of a camera in its link, see `ORIGIN`."""

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


def places(exported: Exported) -> list[Place]:
    """The measurement frames in the base link, and the tools in the tip link.

    They belong to the corrected URDF; a frame that several blocks share is listed once.
    """
    result, found = exported.result, dict[tuple[str, ...], Place]()
    taken = set(result.model.chains.robot.links)
    for term in result.model.terms.values():
        chain, (station, tool) = term.error.chain, (f for f, _ in frames_of(term))
        base, tip = term.error.base.inverse(), result.model.of(term.key).tool
        cameras = {
            "tool" if reference.mount == "hand" else "station": reference
            for reference in term.measurement.references
            if isinstance(reference, Camera)
        }
        for frame, link, pose in ((station, chain.base, base), (tool, chain.tip, tip)):
            if (key := (*frame, link)) in found:
                continue
            names = NAMES.get(frame.name, (f"{frame.name}_{frame.kind}",))
            if camera := cameras.get(frame.kind):
                name = term.frames.reference(camera)
                names = (name, f"{name}_optical_frame")
            child, unknown = _free_name(names, taken), result.unknown_of(*frame)
            point = frame is tool and camera is None and unknown == TURNS
            found[key] = Place(
                link, child, pose, camera is not None, unknown, point or not unknown
            )
    return list(found.values())


def _free_name(names: Sequence[str], taken: set[str]) -> str:
    """The first name that no frame has, or the last with a number; taken from now."""
    plain = [name.replace(".", "_").replace("/", "_") for name in names]
    more = (f"{plain[-1]}_{k}" for k in count(2))
    name = next(name for name in joined(plain, more) if name not in taken)
    taken.add(name)
    return name


def camera_links(exported: Exported) -> tuple[str, tuple[str, ...]]:
    """Links of the cameras whose place is known, as elements of a URDF, and remarks.

    As ROS has it (REP 103): in `NAME_link` x is forward and z up, in
    `NAME_optical_frame` z is forward and x to the right of the image.
    """
    found = [place for place in places(exported) if place.camera]
    document, text = parse_document(exported.robot.source, exported.robot.file), ""
    taken = {*document.named("link"), *document.named("joint")}
    for place in (place for place in found if place.written):
        stem = place.child.removesuffix("_optical_frame")
        names = (_free_name([f"{stem}_{end}"], taken) for end in ENDS)
        link, joint, frame, optical = names
        forward = origin_of(place.pose * placed(OPTICAL).inverse())
        text += _fixed(joint, place.parent, link, forward)
        text += _fixed(optical, link, frame, OPTICAL)
    return text, _remarks(exported, found)


def _fixed(joint: str, parent: str, child: str, origin: Sequence[float]) -> str:
    """A link and the joint that holds it."""
    xyz, rpy = (" ".join(map(repr, part)) for part in (origin[:3], origin[3:]))
    return f"""  <link name={quoteattr(child)}/>
  <joint name={quoteattr(joint)} type="fixed">
    <parent link={quoteattr(parent)}/>
    <child link={quoteattr(child)}/>
    <origin xyz="{xyz}" rpy="{rpy}"/>
  </joint>
"""


def encode_transforms(exported: Exported, _: Path | None) -> Encoded:
    """Static transforms as ROS prints them, and the commands that publish them.

    Raises:
        OptionError: If nothing is known of any.
    """
    found = places(exported)
    documents, commands = [], []
    for place in found:
        if not place.written:
            continue
        position, turn = _numbers(place.pose)
        documents.append(
            {
                "header": {"frame_id": place.parent},
                "child_frame_id": place.child,
                "transform": {
                    "translation": position,
                    "rotation": {key[1:]: number for key, number in turn.items()},
                },
            }
        )
        options = (f"--{key} {x!r}" for key, x in (position | turn).items())
        commands.append(
            f"# ros2 run tf2_ros static_transform_publisher {' '.join(options)} "
            f"--frame-id {place.parent} --child-frame-id {place.child}"
        )
    remarks = _remarks(exported, found)
    if not documents:
        raise OptionError("; ".join(remarks), file=exported.file)
    document = {"transforms": documents}
    text = yaml.safe_dump(document, sort_keys=False)
    require_read(yaml.safe_load(text), document, "the frames")
    lines = [*(f"# {remark}" for remark in remarks), *commands, text]
    return Encoded("\n".join(lines).encode(), remarks)


def _remarks(exported: Exported, found: Sequence[Place]) -> tuple[str, ...]:
    """Sentences about what is not known of frames, and what to do about it."""
    remarks = [place.remark for place in found if place.unknown]
    if not all(place.written for place in found):
        coupled = exported.result.coupled_frames
        known = [f"only {sums.expression} is known" for sums in coupled]
        remarks.append("; ".join([REMEDY, *known]))
    return tuple(remarks)


def _numbers(pose: pin.SE3) -> tuple[dict[str, float], dict[str, float]]:
    """Position and quaternion, each number by its name."""
    quaternion = pin.Quaternion(pose.rotation).coeffs()
    turn = zip(("qx", "qy", "qz", "qw"), quaternion.tolist(), strict=True)
    return dict(zip("xyz", pose.translation.tolist(), strict=True)), dict(turn)


def encode_camera(exported: Exported, _: Path | None) -> Encoded:
    """A camera as ROS' camera_info_manager loads it, and where it is.

    Raises:
        OptionError: If there is not one camera, or its intrinsics are not known.
    """
    found = exported.result.model.cameras
    if len(found) != 1:
        told = ", ".join(found) or "none"
        raise OptionError("one camera can be exported", file=exported.file, value=told)
    ((name, camera),) = found.items()
    if unknown := [p for p in exported.result.unknown if p.startswith(f"{name}.")]:
        reason = f"{enumerated(unknown)} unknown; {REMEDY}"
        raise OptionError(reason, file=exported.file)
    (fx, fy), (cx, cy) = camera.focal, camera.center
    if camera.size is None:
        raise OptionError(
            "the size of the images is unknown, and ROS refuses a wrong one; state "
            "'size: [width, height]' [px] under 'camera' in the setup file, and "
            "calibrate again",
            file=exported.file,
        )
    width, height = (int(edge) for edge in camera.size)
    K = [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]
    document = {
        "image_width": width,
        "image_height": height,
        "camera_name": name,
        "camera_matrix": _matrix(K),
        "distortion_model": "plumb_bob",
        "distortion_coefficients": _matrix([camera.distortion]),
        "rectification_matrix": _matrix(np.eye(3).tolist()),
        "projection_matrix": _matrix([[*row, 0.0] for row in K]),
    }
    comments = []
    cameras = [place for place in places(exported) if place.camera]
    for place in cameras:
        x, turn = (
            " ".join(f"{number:.9g}" for number in part.values())
            for part in _numbers(place.pose)
        )
        about = f" in {place.parent}: xyz {x}, quaternion x y z w {turn}"
        told = about if place.written else f": {place.remark}"
        comments.append(f"# optical frame{told}")
    remarks = _remarks(exported, cameras)
    text = yaml.safe_dump(document, sort_keys=False, default_flow_style=None)
    require_read(yaml.safe_load(text), document, "the numbers of the camera")
    return Encoded("\n".join([*comments, text]).encode(), remarks)


def _matrix(rows: Sequence[Sequence[float]]) -> dict[str, object]:
    data = [float(number) for row in rows for number in row]
    return {"rows": len(rows), "cols": len(rows[0]), "data": data}


TF = Format(
    "tf",
    ".yaml",
    "static transforms of base, tools, stations, camera",
    encode_transforms,
    holds=(FRAMES, CAMERA_LINK, *ROBOTS),
)
CAMERA_INFO = Format(
    "camera-info",
    ".yaml",
    "the camera, as ROS loads it",
    encode_camera,
    holds=(CAMERA, *ROBOTS),
)
