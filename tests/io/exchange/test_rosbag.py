"""Bags of both generations, written by their own library, join like the CSV files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rosbags import rosbag1
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import calib_pin
from calib_pin.cli import main
from calib_pin.io.exchange.rosbag import TYPES
from calib_pin.io.measurements import read_measurements
from calib_pin.observations.joining import Log
from tests.observations.test_joining import recording

CHAIN = calib_pin.load_chain("example:ur10_robot", tip="tool0")
STORE = get_typestore(Stores.ROS2_HUMBLE)
STORE_1 = get_typestore(Stores.ROS1_NOETIC)
for _store in (STORE, STORE_1):
    for _name, _text in TYPES.items():
        _store.register(get_types_from_msg(_text, _name))
STORE_1.register(
    get_types_from_msg(
        "geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"
    )
)
T = STORE.types
STORAGE = {"mcap": StoragePlugin.MCAP, "sqlite": StoragePlugin.SQLITE3}
ALL = [*STORAGE, "ros1"]


def header(time: float, frame: str = "") -> object:
    whole = int(np.floor(time))
    stamp = T["builtin_interfaces/msg/Time"](whole, round(1e9 * (time - whole)))
    return T["std_msgs/msg/Header"](stamp, frame)


def joint_state(time: float, q: np.ndarray) -> object:
    empty = np.zeros(0)
    names = [*CHAIN.joints]
    return T["sensor_msgs/msg/JointState"](header(time), names, q.copy(), empty, empty)


def point(time: float, p: np.ndarray) -> object:
    xyz = T["geometry_msgs/msg/Point"](*map(float, p))
    return T["geometry_msgs/msg/PointStamped"](header(time), xyz)


def transform(time: float, p: np.ndarray) -> object:
    moved = T["geometry_msgs/msg/Vector3"](*map(float, p))
    turned = T["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    pose = T["geometry_msgs/msg/Transform"](moved, turned)
    one = T["geometry_msgs/msg/TransformStamped"](header(time), "smr", pose)
    return T["tf2_msgs/msg/TFMessage"]([one])


def sample(time: float, q: np.ndarray, points: np.ndarray) -> object:
    numbers = {"width": 0, "height": 0}
    info = T["sensor_msgs/msg/CameraInfo"](
        header(time),
        0,
        0,
        "",
        np.zeros(0),
        np.zeros(9),
        np.zeros(9),
        np.zeros(12),
        0,
        0,
        T["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False),
    )
    nothing = np.zeros(0, np.uint8)
    cloud = T["sensor_msgs/msg/PointCloud2"](
        header(time), 0, 0, [], False, 0, 0, nothing, False
    )
    image = T["sensor_msgs/msg/Image"](
        header(time), *numbers.values(), "", 0, 0, nothing
    )
    extended = T["robot_calibration_msgs/msg/ExtendedCameraInfo"](info, [])
    seen = T["robot_calibration_msgs/msg/Observation"](
        "head", [point(time, p) for p in points], extended, cloud, image
    )
    return T["robot_calibration_msgs/msg/CalibrationData"](joint_state(time, q), [seen])


def write(
    path: str, storage: str, topics: dict[str, list[tuple[float, object]]]
) -> str:
    """Write a bag, and tell how it is called."""
    if storage == "ros1":
        return write_1(f"{path}.bag", topics)
    with Writer(Path(path), version=9, storage_plugin=STORAGE[storage]) as writer:
        for topic, messages in topics.items():
            kind = messages[0][1].__msgtype__
            connection = writer.add_connection(topic, kind, typestore=STORE)
            for time, message in messages:
                raw = STORE.serialize_cdr(message, kind)
                writer.write(connection, round(1e9 * time), raw)
    return path


def write_1(path: str, topics: dict[str, list[tuple[float, object]]]) -> str:
    with rosbag1.Writer(path) as writer:
        for topic, messages in topics.items():
            kind = messages[0][1].__msgtype__
            connection = writer.add_connection(topic, kind, typestore=STORE_1)
            for time, message in messages:
                raw = STORE_1.serialize_ros1(first_generation(message), kind)
                writer.write(connection, round(1e9 * time), raw)
    return path


def first_generation(message: object) -> object:
    """The same message of ROS 1, whose headers are numbered."""
    kind = getattr(message, "__msgtype__", "")
    if not kind:
        several = isinstance(message, list)
        return [first_generation(one) for one in message] if several else message
    made = STORE_1.types[kind]
    values = {
        # The matrices of a camera are capitals there.
        name: first_generation(
            getattr(message, name, getattr(message, name.lower(), 0))
        )
        for name in made.__dataclass_fields__
        if name != "__msgtype__"
    }
    return made(**values)


def csv(path: str, names: list[str], log: Log) -> None:
    lines = [",".join(["time", *names])]
    for t, row in zip(log.time, log.values, strict=True):
        lines.append(",".join(map(repr, [float(t), *map(float, row)])))
    Path(path).write_text("\n".join(lines))


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="module")
def made():
    made = recording(11, standstills=8)
    # ROS has no negative times.
    return (
        Log(made.joints.time + 100.0, made.joints.values),
        Log(made.readings.time + 100.0, made.readings.values),
    )


@pytest.mark.parametrize("storage", ALL)
@pytest.mark.parametrize("kind", [point, transform])
def test_a_bag_joins_like_the_files(made, storage, kind):
    joints, readings = made
    csv("joints.csv", [*CHAIN.joints], joints)
    csv("tracker.csv", ["x", "y", "z"], readings)
    assert main(["join", "joints.csv", "tracker.csv", "-o", "a.csv"]) == 0
    states = [
        (t, joint_state(t, q)) for t, q in zip(joints.time, joints.values, strict=True)
    ]
    points = [
        (t, kind(t, p)) for t, p in zip(readings.time, readings.values, strict=True)
    ]
    topic = "/tracker" if kind is point else "/tf"
    bag = write("bag", storage, {"/joint_states": states, topic: points})
    assert main(["join", bag, bag, "-o", "b.csv"]) == 0
    first, second = (read_measurements(f, CHAIN).only for f in ("a.csv", "b.csv"))
    assert len(first.q) == len(second.q) == 8
    assert np.allclose(first.q, second.q, rtol=0, atol=1e-9)
    assert np.allclose(first.values[:, :3], second.values[:, :3], rtol=0, atol=1e-9)
    if kind is point:
        assert np.allclose(first.sigma, second.sigma, rtol=1e-6)


@pytest.mark.parametrize("storage", ALL)
def test_calibration_data_need_no_joining(storage):
    rng = np.random.default_rng(0)
    q = CHAIN.random_configurations(6, rng)
    corners = rng.normal(size=(6, 4, 3))
    samples = [(k + 1.0, sample(k + 1.0, q[k], corners[k])) for k in range(6)]
    bag = write("bag", storage, {"/calibration_data": samples})
    assert main(["join", bag, bag, "-o", "m.csv"]) == 0
    data = read_measurements("m.csv", CHAIN).only
    assert np.array_equal(data.q, np.repeat(q, 4, axis=0))
    assert np.array_equal(data.values, corners.reshape(-1, 3))
    assert [*data.target][:4] == ["head-0", "head-1", "head-2", "head-3"]


def refused(words: str, said: str, capsys) -> None:
    before = sorted(map(str, Path().rglob("*")))
    capsys.readouterr()
    assert main(words.split()) == 1
    err = capsys.readouterr().err
    assert said in err and err.count("\n") == 1
    assert sorted(map(str, Path().rglob("*"))) == before


@pytest.mark.parametrize("storage", ALL)
def test_bags_that_cannot_be_used(made, storage, capsys):
    joints, readings = made
    states = [
        (t, joint_state(t, q)) for t, q in zip(joints.time, joints.values, strict=True)
    ]
    points = [
        (t, point(t, p)) for t, p in zip(readings.time, readings.values, strict=True)
    ]
    bag = write("bag", storage, {"/joint_states": states, "/a": points, "/b": points})
    join = f"join {bag} {bag} -o m.csv"
    refused(join, "has 2 topics of", capsys)
    refused(f"{join} --topic /c", "has no topic '/c'", capsys)
    refused(f"join {bag} none.mcap -o m.csv", "no such file", capsys)
    only = write("points", storage, {"/a": points})
    refused(f"join {only} {only} -o m.csv", "has 0 topics of JointState: none", capsys)
    file = Path(bag)
    if file.is_dir():
        (file,) = (f for f in file.iterdir() if f.suffix in (".mcap", ".db3"))
    file.write_bytes(file.read_bytes()[:4000])
    refused(f"{join} --topic /a", "cannot be read as a bag", capsys)


def test_without_the_extra(monkeypatch, capsys):
    Path("a.mcap").write_bytes(b"")
    monkeypatch.setattr("calib_pin.io.exchange.rosbag.find_spec", lambda _: None)
    refused("join a.mcap a.mcap -o m.csv", "pip install 'calib-pin[ros]'", capsys)
