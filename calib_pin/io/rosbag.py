"""Bags of ROS as logs: joint states, poses and points, and calibration data.

Bags of both generations are read: folders with `metadata.yaml`, `.mcap`, `.db3`,
`.bag`. `robot_calibration_msgs/CalibrationData`, of the ROS package robot_calibration,
holds the joints and what sensors saw of each sample: nothing is left to be joined.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from operator import attrgetter, itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from calib_pin.errors import InputError, enumerated, require_package, words_of
from calib_pin.io.columns import Column
from calib_pin.io.logs import POSE
from calib_pin.io.measured_columns import POSITION
from calib_pin.io.table import Growing, Notice, Table
from calib_pin.measurement_models.declaration import QUATERNION

SUFFIXES = (".mcap", ".db3", ".bag")

JOINTS = ("sensor_msgs/msg/JointState",)
DATA = "robot_calibration_msgs/msg/CalibrationData"
TRANSFORM = "geometry_msgs/msg/TransformStamped"
READINGS = {
    "geometry_msgs/msg/PointStamped": ("point",),
    "geometry_msgs/msg/PoseStamped": ("pose.position", "pose.orientation"),
    TRANSFORM: ("transform.translation", "transform.rotation"),
    "tf2_msgs/msg/TFMessage": (),
}
"""Messages of an instrument, and where their numbers are."""

TYPES = {
    DATA: "sensor_msgs/JointState joint_states\n"
    "robot_calibration_msgs/Observation[] observations",
    "robot_calibration_msgs/msg/Observation": "string sensor_name\n"
    "geometry_msgs/PointStamped[] features\n"
    "robot_calibration_msgs/ExtendedCameraInfo ext_camera_info\n"
    "sensor_msgs/PointCloud2 cloud\nsensor_msgs/Image image",
    "robot_calibration_msgs/msg/ExtendedCameraInfo": "sensor_msgs/CameraInfo "
    "camera_info\ndiagnostic_msgs/KeyValue[] parameters",
}
"""Messages of robot_calibration, which bags need not describe."""


def is_bag(path: str | Path) -> bool:
    """Whether a path is that of a bag: by its suffix, or a folder with metadata."""
    path = Path(path)
    return path.suffix in SUFFIXES or (path / "metadata.yaml").is_file()


def read_bag(path: str | Path, kinds: Collection[str], topic: str | None) -> Table:
    """A topic of a bag by time: columns `time` and joints, or those of a measurement.

    Args:
        path: The bag.
        kinds: Kinds of the messages, `JOINTS` or `READINGS`.
        topic: The topic, of transforms the child frame; None for the only one.

    Raises:
        InputError: If it cannot be read, or has not one such topic.
        OptionError: If the extra is missing.
    """
    heard, rows = dict[str, float](), dict[float, dict[str, float]]()
    for time, message in sorted(_messages(path, kinds, topic), key=itemgetter(0)):
        # Each publisher states its own joints; others are where they were last.
        heard = rows[time] = {**heard, "time [s]": time, **_cells(message)}
    return _table(path, [*rows.values()])


def read_calibration_data(
    path: str | Path, topic: str | None, notice: Notice
) -> tuple[Table, Table] | None:
    """The joints and the features of a bag of calibration data, by number of sample.

    A feature is the point `<sensor>-<number>`, and of a single one nothing is said. A
    sensor whose features never move is none: it states known points of the tool, as the
    chain of an arm does. Of several others each is a station.

    Args:
        path: The bag.
        topic: Topic of the samples; None for the only one.
        notice: Called with a sentence about known points.

    Returns:
        Both; None if it holds no calibration data.

    Raises:
        InputError: If it cannot be read, or holds no features that were measured.
        OptionError: If the extra is missing.
    """
    if not (messages := _messages(path, [DATA], topic)):
        return None
    samples, points = list[dict[str, object]](), defaultdict[str, list[Any]](list)
    for k, (_, message) in enumerate(messages):
        samples.append({POSE: k, **_cells(message.joint_states)})
        for sensor in message.observations:
            for n, feature in enumerate(sensor.features):
                row = {POSE: k, "station": sensor.sensor_name, **_cells(feature)}
                points[f"{sensor.sensor_name}-{n}"].append(row)
    rows, known = list[dict[str, object]](), list[str]()
    for name, seen in points.items():
        places = {tuple(row[axis] for axis in POSITION) for row in seen}
        if len(places) == 1 and len(seen) > 2:
            known.append(f"{name}: {[*places.pop()]}")
        else:
            rows += [{**row, "target": name} for row in seen]
    if not rows:
        raise InputError("its calibration data hold no features", file=path)
    if known:
        reason = "features that never move are known points of the tool"
        notice(f"{path}: {reason}: {', '.join(known)}")
    return _table(path, samples), _table(path, rows)


def _messages(
    path: str | Path, kinds: Collection[str], topic: str | None
) -> list[tuple[float, Any]]:
    """Time [s] and content of the messages of a topic or child frame.

    Whatever is wrong with the bag is told in a line.
    """
    require_package("rosbags", "bags need rosbags", "ros", path)
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    if not Path(path).exists():
        raise InputError("no such file", file=path)
    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in TYPES.items():
        store.register(get_types_from_msg(text, name))
    topics = defaultdict[str, list[tuple[float, Any]]](list)
    try:
        with AnyReader([Path(path)], default_typestore=store) as reader:
            chosen = [c for c in reader.connections if c.msgtype in kinds]
            for connection, recorded, raw in reader.messages(chosen) if chosen else ():
                message = reader.deserialize(raw, connection.msgtype)
                for item in getattr(message, "transforms", [message]):
                    name = connection.topic if item is message else item.child_frame_id
                    stamp = getattr(item, "joint_states", item).header.stamp
                    made = stamp.sec + 1e-9 * stamp.nanosec
                    # Where it does not say when it was made, when it was recorded.
                    topics[name].append((made or 1e-9 * recorded, item))
    except Exception as error:  # Of the library, sqlite, lz4, struct, and what not.
        reason = f"cannot be read as a bag: {words_of(error)}"
        raise InputError(reason, file=path) from error
    if topic in topics or (topic is None and len(topics) == 1):
        return topics[topic or next(iter(topics))]
    if not topics and kinds == [DATA]:
        return []
    words = " or ".join(sorted({kind.split("/")[-1] for kind in kinds}))
    reason = f"has {len(topics)} topics of {words}: {enumerated(topics) or 'none'}"
    allowed = "one, named by --topic or --joint-topic"
    raise InputError(reason, file=path, value=topic, allowed=allowed)


def _cells(message: Any) -> dict[str, float]:
    """The columns of a message: its joints, or a position and maybe a quaternion."""
    if message.__msgtype__ in JOINTS:
        return dict(zip(message.name, message.position.tolist(), strict=False))
    parts = (attrgetter(path)(message) for path in READINGS[message.__msgtype__])
    numbers = (getattr(p, key) for p in parts for key in "xyzw" if hasattr(p, key))
    return dict(zip((*POSITION, *QUATERNION), numbers, strict=False))


def _table(path: str | Path, rows: Sequence[Mapping[str, object]]) -> Table:
    """Messages by columns, numbered from 1; one leaves blank what it does not state."""
    columns = dict[str, Column]()
    for name in dict.fromkeys(name for row in rows for name in row):
        cells = np.array([row.get(name, np.nan) for row in rows])
        growing = Growing(named=(texts := cells.dtype.kind == "U"))
        growing.add(cells.tolist() if texts else cells.astype(float))
        # A name that all rows have says nothing.
        if len((column := growing.column(name)).words) != 1:
            columns[column.theirs] = column
    return Table(str(path), None, columns, np.arange(1, len(rows) + 1))
