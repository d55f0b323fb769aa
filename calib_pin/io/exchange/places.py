"""Where base, tools, stations and cameras are: static transforms, and camera files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
import yaml

from calib_pin.errors import OptionError
from calib_pin.io.calibrated_model import frame_key
from calib_pin.io.exchange.base import (
    CAMERA,
    FRAMES,
    ROBOTS,
    Encoded,
    Exported,
    Format,
    require_read,
)
from calib_pin.setup import CameraSetup


@dataclass(frozen=True)
class Place:
    """A frame that stands still in a link.

    Attributes:
        parent: The link.
        child: Name of the frame.
        pose: Its pose in the link.
    """

    parent: str
    child: str
    pose: pin.SE3


def places(exported: Exported) -> list[Place]:
    """The measurement frames in the base link, and the tools in the tip link.

    They belong to the corrected URDF; a frame that several blocks share is listed once.
    """
    model, found = exported.result.model, dict[str, Place]()
    for part in model.parts.values():
        chain, scope = part.error.chain, part.scope
        station, tool = frame_key(scope.station), frame_key(scope.tool)
        if station == "base":
            station = "measurement"
        for reference in part.measurement.references:
            camera = reference.stated()
            if isinstance(camera, CameraSetup) and camera.mount == "hand":
                tool = "camera"
            elif isinstance(camera, CameraSetup):
                station = "camera"
        ends = (
            (chain.base, station, part.error.base.inverse()),
            (chain.tip, tool, model.of(part.key).tool),
        )
        for parent, child, pose in ends:
            name = child.replace(".", "_").replace("/", "_")
            found.setdefault(name, Place(parent, name, pose))
    return list(found.values())


def encode_transforms(exported: Exported, _: Path | None) -> Encoded:
    """Static transforms as ROS prints them, and the commands that publish them."""
    documents, commands = [], []
    for place in places(exported):
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
    document = {"transforms": documents}
    text = yaml.safe_dump(document, sort_keys=False)
    require_read(yaml.safe_load(text), document, "the frames")
    return Encoded("\n".join([*commands, text]).encode())


def _numbers(pose: pin.SE3) -> tuple[dict[str, float], dict[str, float]]:
    """Position and quaternion, each number by its name."""
    quaternion = pin.Quaternion(pose.rotation).coeffs()
    turn = zip(("qx", "qy", "qz", "qw"), quaternion.tolist(), strict=True)
    return dict(zip("xyz", pose.translation.tolist(), strict=True)), dict(turn)


def encode_camera(exported: Exported, _: Path | None) -> Encoded:
    """A camera as ROS' camera_info_manager loads it, and where it is.

    Raises:
        OptionError: If there is not one camera.
    """
    found = exported.result.model.cameras
    if len(found) != 1:
        told = ", ".join(found) or "none"
        raise OptionError("one camera can be exported", file=exported.file, value=told)
    ((name, camera),) = found.items()
    (fx, fy), (cx, cy) = camera.focal, camera.center
    remarks = []
    if camera.size is None:
        width, height = round(2.0 * cx), round(2.0 * cy)
        remarks.append(
            f"the setup states no image size: {width} x {height} is twice the "
            "principal point; state 'camera: {size: [width, height]}'"
        )
    else:
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
    for place in places(exported):
        if place.child == "camera":
            x, turn = (
                " ".join(f"{number:.9g}" for number in part.values())
                for part in _numbers(place.pose)
            )
            about = f"xyz {x}, quaternion x y z w {turn}"
            comments.append(f"# optical frame in {place.parent}: {about}")
    text = yaml.safe_dump(document, sort_keys=False, default_flow_style=None)
    require_read(yaml.safe_load(text), document, "the numbers of the camera")
    return Encoded("\n".join([*comments, text]).encode(), tuple(remarks))


def _matrix(rows: Sequence[Sequence[float]]) -> dict[str, object]:
    data = [float(number) for row in rows for number in row]
    return {"rows": len(rows), "cols": len(rows[0]), "data": data}


CAMERA_INFO = Format(
    "camera-info", ".yaml", "the camera, as ROS loads it", encode_camera
)


TF = Format(
    "tf",
    ".yaml",
    "static transforms of base, tools, stations, camera",
    encode_transforms,
    holds=(FRAMES, *ROBOTS),
)
CAMERA_INFO = Format(
    "camera-info",
    ".yaml",
    "the camera, as ROS loads it",
    encode_camera,
    holds=(CAMERA, *ROBOTS),
)
