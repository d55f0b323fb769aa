"""Bags of ROS as logs: joint states, poses and points, and calibration data.

Bags of both generations are read: folders with `metadata.yaml`, `.mcap`, `.db3`,
`.bag`. `robot_calibration_msgs/CalibrationData`, of the ROS package robot_calibration,
holds the joints and what sensors saw of each sample: nothing is left to be joined.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from calib_pin.errors import InputError, OptionError, enumerated
from calib_pin.io.logs import Series
from calib_pin.measurement_models.declaration import QUATERNION
from calib_pin.observations.joining import Joined, Log, Standstill, continuous

SUFFIXES = (".mcap", ".db3", ".bag")

JOINTS = ("sensor_msgs/msg/JointState",)
DATA = ("robot_calibration_msgs/msg/CalibrationData",)
TRANSFORMS = "tf2_msgs/msg/TFMessage"
_GEOMETRY = "geometry_msgs/msg"
READINGS = {
    f"{_GEOMETRY}/PointStamped": ("point",),
    f"{_GEOMETRY}/PoseStamped": ("pose.position", "pose.orientation"),
    f"{_GEOMETRY}/TransformStamped": ("transform.translation", "transform.rotation"),
}
"""Messages of an instrument, and where their numbers are."""

POSITION = ("x", "y", "z")

TYPES = {
    DATA[0]: "sensor_msgs/JointState joint_states\n"
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


def read_joint_bag(path: str | Path, topic: str | None = None) -> Series:
    """The joint states of a bag.

    Args:
        path: The bag.
        topic: The topic; None for the only one.

    Raises:
        InputError: If it cannot be read, or has not one such topic.
        OptionError: If the extra is missing.
    """
    heard, samples = dict[str, float](), list[tuple[float, tuple[float, ...]]]()
    for time, message in _messages(path, topic, JOINTS):
        # Each publisher states its own joints; others are where they were last.
        heard |= zip(message.name, message.position, strict=False)
        samples.append((time, (*heard.values(),)))
    whole = [sample for sample in samples if len(sample[1]) == len(heard)]
    return Series(_ordered(path, whole), dict.fromkeys(heard))


def read_reading_bag(path: str | Path, topic: str | None = None) -> Series:
    """The points or poses of a bag.

    Args:
        path: The bag.
        topic: The topic, of transforms the child frame; None for the only one.

    Raises:
        InputError: If it cannot be read, or has not one such topic.
        OptionError: If the extra is missing.
    """
    found = _messages(path, topic, (*READINGS, TRANSFORMS))
    log = _ordered(path, [(time, _numbers(message)) for time, message in found])
    if log.values.shape[1] == len(POSITION):
        return Series(log, dict.fromkeys(POSITION))
    return Series(continuous(log), dict.fromkeys(POSITION + QUATERNION))


def holds_calibration_data(path: str | Path) -> bool:
    """Whether a bag holds calibration data."""
    with _opened(path) as reader:
        return any(c.msgtype in DATA for c in reader.connections)


def read_calibration_data(
    path: str | Path, topic: str | None, notice: Callable[[str], None]
) -> tuple[Series, Series, Joined]:
    """The samples of a bag of calibration data, joined as they are.

    A feature is the point `<sensor>-<number>`, and of a single one nothing is said. A
    sensor whose features never move is none: it states known points of the tool, as the
    chain of an arm does. Of several others each is a station.

    Args:
        path: The bag.
        topic: Topic of the samples; None for the only one.
        notice: Called with a sentence about known points.

    Raises:
        InputError: If it cannot be read, or holds no features that were measured.
        OptionError: If the extra is missing.
    """
    samples, names = list[tuple[float, list[float]]](), list[str]()
    rows = list[tuple[int, str, tuple[float, ...]]]()
    for time, message in _messages(path, topic, DATA):
        state = message.joint_states
        stated = dict(zip(state.name, state.position, strict=False))
        names = names or [*stated]
        if not {*names} <= {*stated}:
            raise InputError("its samples are of different joints", file=path)
        for sensor in message.observations:
            for k, feature in enumerate(sensor.features):
                point = f"{sensor.sensor_name}-{k}"
                rows.append((len(samples), point, _numbers(feature)))
        samples.append((time, [stated[name] for name in names]))
    seen = dict[str, list[tuple[float, ...]]]()
    for _, point, xyz in rows:
        seen.setdefault(point, []).append(xyz)
    still = {p: s[0] for p, s in seen.items() if len(s) > 2 and len({*s}) == 1}
    rows = sorted(row for row in rows if row[1] not in still)
    if not (names and rows):
        raise InputError("its calibration data hold no features", file=path)
    if still:
        known = ", ".join(f"{name}: {[*xyz]}" for name, xyz in still.items())
        said = "features that never move are known points of the tool"
        notice(f"{path}: {said}: {known}")
    of, points, values = zip(*rows, strict=True)
    which = np.array(of)
    stamps, q = (np.array(found, float) for found in zip(*samples, strict=True))
    stands = [
        Standstill(stamps[k], stamps[k], q[k], np.flatnonzero(which == k))
        for k in np.unique(which)
    ]
    columns = {"target": points, "station": [p.rpartition("-")[0] for p in points]}
    texts = {key: cells for key, cells in columns.items() if len({*cells}) > 1}
    readings = Log(stamps[which], np.array(values))
    joints = Series(Log(stamps, q), dict.fromkeys(names))
    seen_by = Series(readings, dict.fromkeys(POSITION), texts)
    return joints, seen_by, Joined(None, tuple(stands), 0, 0, 0)


@contextmanager
def _opened(path: str | Path) -> Iterator[Any]:
    """A reader of a bag; whatever is wrong with the bag is told in a line."""
    if find_spec("rosbags") is None:
        reason = "bags need rosbags, which is missing: pip install 'calib-pin[ros]'"
        raise OptionError(reason, file=path)
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    if not Path(path).exists():
        raise InputError("no such file", file=path)
    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in TYPES.items():
        store.register(get_types_from_msg(text, name))
    try:
        with AnyReader([Path(path)], default_typestore=store) as reader:
            yield reader
    except InputError:
        raise
    except Exception as error:  # Of the library, sqlite, lz4, struct, and what not.
        line = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"cannot be read as a bag: {line}", file=path) from error


def _messages(
    path: str | Path, topic: str | None, kinds: Sequence[str]
) -> list[tuple[float, Any]]:
    """Time [s] and content of the messages of a topic, or of a child frame."""
    found = dict[str, list[tuple[float, Any]]]()
    with _opened(path) as reader:
        chosen = [c for c in reader.connections if c.msgtype in kinds]
        for connection, stamp, raw in reader.messages(chosen) if chosen else ():
            message = reader.deserialize(raw, connection.msgtype)
            named = {connection.topic: message}
            if connection.msgtype == TRANSFORMS:
                named = {one.child_frame_id: one for one in message.transforms}
            for name, one in named.items():
                header = (getattr(one, "header", None) or one.joint_states.header).stamp
                made = float(header.sec) + 1e-9 * float(header.nanosec)
                # Where it does not say when it was made, when it was recorded.
                time = made if made > 0.0 else 1e-9 * stamp
                rows = found.setdefault(name, [])
                if topic in (None, name):
                    rows.append((time, one))
    if topic in found:
        return found[topic]
    if topic is None and len(found) == 1:
        return found.popitem()[1]
    words = " or ".join(sorted({kind.split("/")[-1] for kind in kinds}))
    reason = f"has {len(found)} topics of {words}: {enumerated(found) or 'none'}"
    reason += f", and no '{topic}'" if topic else ""
    allowed = "one, named by --topic or --joint-topic"
    raise InputError(reason, file=path, allowed=allowed)


def _numbers(message: Any) -> tuple[float, ...]:
    """Position and, of a pose, quaternion."""
    paths = READINGS[message.__msgtype__]
    parts = (attrgetter(path)(message) for path in paths)
    return tuple(getattr(p, key) for p in parts for key in "xyzw" if hasattr(p, key))


def _ordered(path: str | Path, rows: Sequence[tuple[float, tuple[float, ...]]]) -> Log:
    """A log by time; what was recorded twice counts once.

    Raises:
        InputError: If the rows are few, are not all of one kind, or hold no numbers.
    """
    alike = len({len(values) for _, values in rows}) == 1
    time, first = np.unique([time for time, _ in rows], return_index=True)
    values = np.array([values for _, values in rows] if alike else [], float)
    if len(time) < 3 or not (values.size and np.isfinite(values).all()):
        reason = "holds too little, several kinds of messages, or numbers that are none"
        raise InputError(reason, file=path)
    return Log(time, values[first])
