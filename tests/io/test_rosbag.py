"""Bags of both generations, written by their own library, join like the CSV files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import calib_pin
from calib_pin.cli import main
from calib_pin.io.measurements import read_measurements
from calib_pin.io.rosbag import TYPES
from calib_pin.observations.joining import Log

ABSENT = "needs rosbags (ros), scripts/test --all has it"
rosbag1 = pytest.importorskip("rosbags.rosbag1", reason=ABSENT)
rosbag2 = pytest.importorskip("rosbags.rosbag2", reason=ABSENT)
typesys = pytest.importorskip("rosbags.typesys", reason=ABSENT)

CHAIN = calib_pin.load_chain("example:ur10_robot", tip="tool0")
STORES = {
    "ros1": typesys.get_typestore(typesys.Stores.ROS1_NOETIC),
    "ros2": typesys.get_typestore(typesys.Stores.ROS2_HUMBLE),
}
TF = {"tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms"}
for _generation, _store in STORES.items():
    for _name, _text in (TYPES | (TF if _generation == "ros1" else {})).items():
        _store.register(typesys.get_types_from_msg(_text, _name))
STORAGE = {"mcap": rosbag2.StoragePlugin.MCAP, "sqlite": rosbag2.StoragePlugin.SQLITE3}

Make = Callable[..., Any]
"""Makes a message by its kind and the values of its fields; the others are zero."""

Message = tuple[str, Callable[[Make], Any]]
"""Kind of a message, and what makes it with the types of a generation."""


def make(store: Any, kind: str, **values: Any) -> Any:
    def zero(node: int, about: Any) -> Any:
        if node == 2:
            return make(store, about)
        if node == 1:
            return "" if about[0] == "string" else 0
        (below, kinds), count = about
        plain = below == 1 and kinds[0] != "string"
        return np.zeros(count, kinds[0]) if plain else []

    fields = {name: zero(*rest) for name, rest in store.fielddefs[kind][1]}
    return store.types[kind](**fields | values)


def header(new: Make, time: float) -> Any:
    sec = int(np.floor(time))
    stamp = new(
        "builtin_interfaces/msg/Time", sec=sec, nanosec=round(1e9 * (time - sec))
    )
    return new("std_msgs/msg/Header", stamp=stamp)


def xyz(new: Make, kind: str, p: np.ndarray) -> Any:
    return new(
        f"geometry_msgs/msg/{kind}", **dict(zip("xyz", map(float, p), strict=True))
    )


def joint_state(time: float, q: np.ndarray, names: Any = CHAIN.joints) -> Message:
    kind = "sensor_msgs/msg/JointState"
    state = {"name": [*names], "position": np.array(q, float)}
    return kind, lambda new: new(kind, header=header(new, time), **state)


def point(time: float, p: np.ndarray) -> Message:
    kind = "geometry_msgs/msg/PointStamped"
    return kind, lambda new: new(
        kind, header=header(new, time), point=xyz(new, "Point", p)
    )


def transform(time: float, p: np.ndarray) -> Message:
    def made(new: Make) -> Any:
        turned = new("geometry_msgs/msg/Quaternion", w=1.0)
        pose = {"translation": xyz(new, "Vector3", p), "rotation": turned}
        one = new(
            "geometry_msgs/msg/TransformStamped",
            header=header(new, time),
            child_frame_id="smr",
            transform=new("geometry_msgs/msg/Transform", **pose),
        )
        return new("tf2_msgs/msg/TFMessage", transforms=[one])

    return "tf2_msgs/msg/TFMessage", made


def sample(time: float, q: np.ndarray, points: Mapping[str, np.ndarray]) -> Message:
    kind = "robot_calibration_msgs/msg/CalibrationData"

    def made(new: Make) -> Any:
        seen = [
            new(
                "robot_calibration_msgs/msg/Observation",
                sensor_name=sensor,
                features=[point(time, p)[1](new) for p in features],
            )
            for sensor, features in points.items()
        ]
        return new(kind, joint_states=joint_state(time, q)[1](new), observations=seen)

    return kind, made


def write(
    path: str, storage: str, topics: dict[str, list[tuple[float, Message]]]
) -> str:
    """Write a bag, and tell how it is called."""
    if storage == "ros1":
        path, store = f"{path}.bag", STORES["ros1"]
        encode, opened = store.serialize_ros1, rosbag1.Writer(path)
    else:
        store, plugin = STORES["ros2"], STORAGE[storage]
        encode = store.serialize_cdr
        opened = rosbag2.Writer(Path(path), version=9, storage_plugin=plugin)
    with opened as writer:
        for topic, sent in topics.items():
            kind = sent[0][1][0]
            connection = writer.add_connection(topic, kind, typestore=store)
            for time, (_, made) in sent:
                raw = encode(made(partial(make, store)), kind)
                writer.write(connection, round(1e9 * time), raw)
    return path


def messages(kind: Callable[..., Message], log: Log) -> list[tuple[float, Message]]:
    return [(t, kind(t, row)) for t, row in zip(log.time, log.values, strict=True)]


def csv(path: str, names: list[str], log: Log) -> None:
    rows = np.column_stack([log.time, log.values])
    np.savetxt(path, rows, "%.17g", ",", header=",".join(["time", *names]), comments="")


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


def test_joints_of_several_publishers(made, capsys):
    """A gripper speaks first, each half of the arm for itself; a point is none.

    No name of a joint is taken for that of a counter.
    """
    joints, lost = made[0], np.array(made[1].values)
    lost[7] = np.nan
    readings = Log(made[1].time, lost)
    states = [(99.0, joint_state(99.0, np.array([0.02]), ["index_1"]))]
    for half, late in ((slice(0, 3), 0.0), (slice(3, 6), 2e-3)):
        for t, q in zip(joints.time + late, joints.values, strict=True):
            states.append((t, joint_state(t, q[half], CHAIN.joints[half])))
    states.sort(key=lambda pair: pair[0])
    topics = {"/joint_states": states, "/tracker": messages(point, readings)}
    bag = write("bag", "sqlite", topics)
    assert main(["join", bag, bag, "-o", "b.csv"]) == 0
    data = read_measurements("b.csv", CHAIN).only
    expected = CHAIN.poses(data.q)[:, :3, 3]
    assert len(data.q) == 6 and np.allclose(data.values, expected, rtol=0, atol=5e-5)
    assert Path("b.csv").read_text().splitlines()[1].startswith("index_1,")
    told = capsys.readouterr().err
    assert f"1 of {len(lost)} rows have no reading (the first in line 8)" in told


@pytest.mark.parametrize("storage", ["mcap", "ros1"])
def test_calibration_data_need_no_joining(storage, capsys):
    """And points that never move are no measurement; a sample may lack a joint."""
    rng = np.random.default_rng(1)
    q, seen = CHAIN.random_configurations(5, rng), rng.normal(size=(5, 2, 3))
    known = {"arm": np.array([[0.0, 0.0, 0.05], [0.03, 0.0, 0.05]])}
    samples = [
        (k + 1.0, sample(k + 1.0, q[k], known | {"camera": seen[k]})) for k in range(5)
    ]
    kind, whole = sample(9.0, q[0], known | {"camera": seen[0]})
    part = joint_state(9.0, q[0, :5], CHAIN.joints[:5])[1]

    def lacking(new: Make) -> Any:
        return replace(whole(new), joint_states=part(new))

    samples.append((9.0, (kind, lacking)))
    bag = write("bag", storage, {"/calibration_data": samples})
    assert main(["join", bag, bag, "-o", "m.csv"]) == 0
    data = read_measurements("m.csv", CHAIN).only
    assert np.array_equal(data.q, np.repeat(q, 2, axis=0))
    assert np.array_equal(data.values, seen.reshape(-1, 3))
    assert [*data.target][:2] == ["camera-0", "camera-1"]
    told = capsys.readouterr().err
    assert "arm-1" in told and "1 of 6 rows have no reading" in told


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
    refused(f"join {bag} none.mcap -o m.csv", "none.mcap: no such file", capsys)
    only = write("points", "ros1", {"/a": points[:2]})
    refused(f"join {only} {only} -o m.csv", "JointState", capsys)
    refused(f"join {bag} {only} -o m.csv", "too short", capsys)
    (file,) = Path(bag).glob("*.db3")
    file.write_bytes(file.read_bytes()[:4000])
    refused(f"{join} --topic /a", "bag", capsys)
    monkeypatch.setattr("calib_pin.errors.find_spec", lambda _: None)
    refused(join, "calib-pin[ros]", capsys)
