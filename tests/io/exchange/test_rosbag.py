"""Bags of both generations, written by their own library, join like the CSV files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest

import calib_pin
from calib_pin.cli import main
from calib_pin.io.exchange.rosbag import TYPES
from calib_pin.io.measurements import read_measurements
from calib_pin.observations.joining import Log

ABSENT = "needs rosbags (ros), scripts/test --all has it"
rosbag1 = pytest.importorskip("rosbags.rosbag1", reason=ABSENT)
rosbag2 = pytest.importorskip("rosbags.rosbag2", reason=ABSENT)
typesys = pytest.importorskip("rosbags.typesys", reason=ABSENT)

CHAIN = calib_pin.load_chain("example:ur10_robot", tip="tool0")
STORE = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
STORE_1 = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
for _store in (STORE, STORE_1):
    for _name, _text in TYPES.items():
        _store.register(typesys.get_types_from_msg(_text, _name))
STORE_1.register(
    typesys.get_types_from_msg(
        "geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"
    )
)
T = STORE.types
STORAGE = {"mcap": rosbag2.StoragePlugin.MCAP, "sqlite": rosbag2.StoragePlugin.SQLITE3}


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


def sample(time: float, q: np.ndarray, points: Mapping[str, np.ndarray]) -> object:
    zeros = np.zeros(0), np.zeros(9), np.zeros(9), np.zeros(12)
    region = T["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    info = T["sensor_msgs/msg/CameraInfo"](header(time), 0, 0, "", *zeros, 0, 0, region)
    nothing = np.zeros(0, np.uint8)
    cloud = T["sensor_msgs/msg/PointCloud2"](
        header(time), 0, 0, [], False, 0, 0, nothing, False
    )
    image = T["sensor_msgs/msg/Image"](header(time), 0, 0, "", 0, 0, nothing)
    extended = T["robot_calibration_msgs/msg/ExtendedCameraInfo"](info, [])
    seen = [
        T["robot_calibration_msgs/msg/Observation"](
            sensor, [point(time, p) for p in features], extended, cloud, image
        )
        for sensor, features in points.items()
    ]
    return T["robot_calibration_msgs/msg/CalibrationData"](joint_state(time, q), seen)


def write(
    path: str, storage: str, topics: dict[str, list[tuple[float, object]]]
) -> str:
    """Write a bag, and tell how it is called."""
    if storage == "ros1":
        path, store, kept = f"{path}.bag", STORE_1, first_generation
        encode, opened = store.serialize_ros1, rosbag1.Writer(path)
    else:
        store, kept = STORE, lambda message: message
        opened = rosbag2.Writer(Path(path), version=9, storage_plugin=STORAGE[storage])
        encode = store.serialize_cdr
    with opened as writer:
        for topic, sent in topics.items():
            kind = sent[0][1].__msgtype__
            connection = writer.add_connection(topic, kind, typestore=store)
            for time, message in sent:
                raw = encode(kept(message), kind)
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


def messages(kind: Callable[..., object], log: Log) -> list[tuple[float, object]]:
    return [(t, kind(t, row)) for t, row in zip(log.time, log.values, strict=True)]


def csv(path: str, names: list[str], log: Log) -> None:
    lines = [",".join(["time", *names])]
    for t, row in zip(log.time, log.values, strict=True):
        lines.append(",".join(map(repr, [float(t), *map(float, row)])))
    Path(path).write_text("\n".join(lines))


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="module")
def made() -> tuple[Log, Log]:
    """Positions of the joints and of the tool, which stands still six times."""
    rng = np.random.default_rng(11)
    corners = np.repeat(0.5 * CHAIN.random_configurations(6, rng), 2, axis=0)
    ends = np.cumsum([0.0, *rng.uniform(1.5, 3.0, 11)])

    def at(times: np.ndarray) -> np.ndarray:
        return np.column_stack([np.interp(times, ends, q) for q in corners.T])

    often, seldom = np.arange(0.0, ends[-1], 0.01), np.arange(0.0, ends[-1], 0.05)
    points = CHAIN.poses(at(seldom))[:, :3, 3]
    points += 1e-5 * rng.normal(size=points.shape)
    return Log(often + 100.0, at(often)), Log(seldom + 100.0, points)


@pytest.mark.parametrize(("kind", "storage"), [(point, "sqlite"), (transform, "ros1")])
def test_a_bag_joins_like_the_files(made, storage, kind):
    joints, readings = made
    csv("joints.csv", [*CHAIN.joints], joints)
    csv("tracker.csv", ["x", "y", "z"], readings)
    assert main(["join", "joints.csv", "tracker.csv", "-o", "a.csv"]) == 0
    topic = "/tracker" if kind is point else "/tf"
    topics = {
        "/joint_states": messages(joint_state, joints),
        topic: messages(kind, readings),
    }
    bag = write("bag", storage, topics)
    assert main(["join", bag, bag, "-o", "b.csv"]) == 0
    first, second = (read_measurements(f, CHAIN).only for f in ("a.csv", "b.csv"))
    assert len(first.q) == len(second.q) == 6
    # A bag counts whole nanoseconds.
    assert np.allclose(first.q, second.q, rtol=0, atol=1e-8)
    assert np.allclose(first.values[:, :3], second.values[:, :3], rtol=0, atol=1e-8)
    if kind is point:
        assert np.allclose(first.sigma, second.sigma, rtol=1e-4)


def test_joints_of_several_publishers(made):
    """A gripper speaks first, and each half of the arm for itself."""
    joints, readings = made

    def states(names: slice, late: float) -> list[tuple[float, object]]:
        return [
            (
                t + late,
                T["sensor_msgs/msg/JointState"](
                    header(t + late),
                    CHAIN.joints[names],
                    q[names],
                    np.zeros(0),
                    np.zeros(0),
                ),
            )
            for t, q in zip(joints.time, joints.values, strict=True)
        ]

    gripper = T["sensor_msgs/msg/JointState"](
        header(99.0), ["finger"], np.array([0.02]), np.zeros(0), np.zeros(0)
    )
    both = sorted([*states(slice(0, 3), 0.0), *states(slice(3, 6), 2e-3)], key=first)
    topics = {
        "/joint_states": [(99.0, gripper), *both],
        "/tracker": messages(point, readings),
    }
    bag = write("bag", "sqlite", topics)
    assert main(["join", bag, bag, "-o", "b.csv"]) == 0
    data = read_measurements("b.csv", CHAIN).only
    expected = CHAIN.poses(data.q)[:, :3, 3]
    assert len(data.q) == 6 and np.allclose(data.values, expected, rtol=0, atol=5e-5)
    assert Path("b.csv").read_text().splitlines()[1].startswith("finger,")


def first(pair: tuple[float, object]) -> float:
    return pair[0]


def test_points_that_never_move_are_no_measurement(capsys):
    rng = np.random.default_rng(1)
    q, seen = CHAIN.random_configurations(5, rng), rng.normal(size=(5, 2, 3))
    known = np.array([[0.0, 0.0, 0.05], [0.03, 0.0, 0.05]])
    samples = [
        (k + 1.0, sample(k + 1.0, q[k], {"arm": known, "camera": seen[k]}))
        for k in range(5)
    ]
    bag = write("bag", "mcap", {"/calibration_data": samples})
    assert main(["join", bag, bag, "-o", "m.csv"]) == 0
    data = read_measurements("m.csv", CHAIN).only
    assert np.array_equal(data.values, seen.reshape(-1, 3))
    assert {*data.target} == {"camera-0", "camera-1"}
    assert "arm-1" in capsys.readouterr().err


@pytest.mark.parametrize("storage", ["mcap", "ros1"])
def test_calibration_data_need_no_joining(storage):
    rng = np.random.default_rng(0)
    q = CHAIN.random_configurations(6, rng)
    corners = rng.normal(size=(6, 4, 3))
    samples = [(k + 1.0, sample(k + 1.0, q[k], {"head": corners[k]})) for k in range(6)]
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


def test_bags_that_cannot_be_used(made, monkeypatch, capsys):
    states, points = messages(joint_state, made[0]), messages(point, made[1])
    topics = {"/joint_states": states[:9], "/a": points[:9], "/b": points[:9]}
    bag = write("bag", "sqlite", topics)
    join = f"join {bag} {bag} -o m.csv"
    refused(join, "2 topics", capsys)
    refused(f"{join} --topic /c", "'/c'", capsys)
    refused(f"join {bag} none.mcap -o m.csv", "none.mcap", capsys)
    only = write("points", "ros1", {"/a": points[:9]})
    refused(f"join {only} {only} -o m.csv", "JointState", capsys)
    (file,) = Path(bag).glob("*.db3")
    file.write_bytes(file.read_bytes()[:4000])
    refused(f"{join} --topic /a", "bag", capsys)
    monkeypatch.setattr("calib_pin.io.exchange.rosbag.find_spec", lambda _: None)
    refused(join, "calib-pin[ros]", capsys)
