"""Where base, tools, stations and cameras are: static transforms, and camera files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
import yaml

from calib_pin.errors import OptionError, OutputError
from calib_pin.io.calibrated_model import frame_key
from calib_pin.io.exchange.base import EXACT, Encoded, Exported, Format
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
    documents, commands, found = [], [], places(exported)
    for place in found:
        (x, y, z), (qx, qy, qz, qw) = _numbers(place.pose)
        documents.append(
            {
                "header": {"frame_id": place.parent},
                "child_frame_id": place.child,
                "transform": {
                    "translation": {"x": x, "y": y, "z": z},
                    "rotation": {"x": qx, "y": qy, "z": qz, "w": qw},
                },
            }
        )
        commands.append(
            "# ros2 run tf2_ros static_transform_publisher "
            f"--x {x!r} --y {y!r} --z {z!r} --qx {qx!r} --qy {qy!r} --qz {qz!r} "
            f"--qw {qw!r} --frame-id {place.parent} --child-frame-id {place.child}"
        )
    text = "\n".join(
        [*commands, yaml.safe_dump({"transforms": documents}, sort_keys=False)]
    )
    for place, read in zip(found, yaml.safe_load(text)["transforms"], strict=True):
        numbers = [*read["transform"]["rotation"].values()]
        pose = pin.SE3(
            pin.Quaternion(np.array(numbers)).matrix(),
            np.array([*read["transform"]["translation"].values()]),
        )
        if not np.abs(pose.homogeneous - place.pose.homogeneous).max() < EXACT:
            raise OutputError(f"the frame '{place.child}' does not read back")
    return Encoded(text.encode())


def _numbers(pose: pin.SE3) -> tuple[list[float], list[float]]:
    return pose.translation.tolist(), pin.Quaternion(pose.rotation).coeffs().tolist()


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
    distortion = [*camera.distortion, *[0.0] * (5 - len(camera.distortion))]
    K = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
    P = [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    document = {
        "image_width": width,
        "image_height": height,
        "camera_name": name,
        "camera_matrix": _matrix(3, 3, K),
        "distortion_model": "plumb_bob",
        "distortion_coefficients": _matrix(1, 5, distortion),
        "rectification_matrix": _matrix(3, 3, np.eye(3).reshape(-1).tolist()),
        "projection_matrix": _matrix(3, 4, P),
    }
    comments = []
    for place in places(exported):
        if place.child == "camera":
            (x, y, z), (qx, qy, qz, qw) = _numbers(place.pose)
            comments.append(
                f"# optical frame in {place.parent}: xyz {x:.9g} {y:.9g} {z:.9g}, "
                f"quaternion x y z w {qx:.9g} {qy:.9g} {qz:.9g} {qw:.9g}"
            )
    text = yaml.safe_dump(document, sort_keys=False, default_flow_style=None)
    if yaml.safe_load(text) != document:
        raise OutputError("the camera does not read back")
    return Encoded("\n".join([*comments, text]).encode(), tuple(remarks))


def _matrix(rows: int, columns: int, data: list[float]) -> dict[str, object]:
    return {"rows": rows, "cols": columns, "data": [float(number) for number in data]}


TF = Format(
    "tf",
    ".yaml",
    "static transforms of base, tools, stations, camera",
    encode_transforms,
)
CAMERA_INFO = Format(
    "camera-info", ".yaml", "the camera, as ROS loads it", encode_camera
)
