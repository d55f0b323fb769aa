"""`join`: two logs as people have them, and what cannot be joined."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import calib_pin
from calib_pin.io.measurements import read_measurements
from calib_pin.kinematics.spatial import so3_exp, so3_log
from calib_pin.observations import Measurements
from tests.cli.files import table
from tests.observations.test_joining import NOISE, Recording, recording

CHAIN = calib_pin.load_chain("example:ur10_robot", tip="tool0")
SETUP = """columns:
  time: Zeit
  x: X (mm) [mm]
  y: Y (mm) [mm]
  z: Z (mm) [mm]
"""


def comma(value: float) -> str:
    return f"{value:.5f}".replace(".", ",")


def lines(file: str, header: str, rows: Iterable[Sequence[object]]) -> None:
    """Write a file of cells between commas."""
    text = [header, *(",".join(map(str, row)) for row in rows)]
    Path(file).write_text("\n".join(text))


def written(made: Recording) -> None:
    """The logs of a robot (degrees) and of a tracker (its own names and marks)."""
    header = ",".join(["timestamp", *(f"{joint} [deg]" for joint in CHAIN.joints)])
    rows = np.column_stack([made.joints.time, np.rad2deg(made.joints.values)])
    lines("joints.csv", header, np.char.mod("%.6f", rows))
    text = ["# tracker", "Punkt;Zeit;X (mm);Y (mm);Z (mm);Temp"]
    for t, p in zip(made.readings.time, 1e3 * made.readings.values, strict=True):
        text.append(";".join(["SMR1", comma(t), *map(comma, p), "21,5"]))
    Path("tracker.txt").write_bytes("\r\n".join(text).encode("utf-8-sig"))
    Path("setup.yaml").write_text(SETUP)


def changed(change: Callable[[str], str]) -> None:
    """Write the times of the joints' log otherwise."""
    header, *rows = Path("joints.csv").read_text().splitlines()
    cut = [line.partition(",") for line in rows]
    lines("joints.csv", header, [[change(time), rest] for time, _, rest in cut])


def joined(within: float = 3.0, **options: Any) -> Measurements:
    """What was joined, which are the points of the robot to some of their noise."""
    data = read_measurements("m.csv", CHAIN, **options).only
    assert np.abs(data.values[:, :3] - points_at(data)).max() < within * NOISE
    return data


def points_at(data: Measurements, balls: Any = (0.0, 0.0, 0.0)) -> np.ndarray:
    """Where points of the tip link are at some measurements, shape (N, 3)."""
    T = CHAIN.poses(data.q)
    seen = T[:, :3, :3] @ np.broadcast_to(balls, (len(T), 3))[:, :, None]
    return np.asarray(seen[:, :, 0] + T[:, :3, 3] + [0.3, -1.0, 2.0])


def of_means(data: Measurements, rows: int, noise: Any) -> None:
    """Each sigma is that of the mean of independent readings, counted in the head."""
    head = Path("m.csv").read_text().partition("\n")[0]
    count = int(head.split()[6]) / rows
    assert head.endswith("each sigma that of a mean")
    found = np.mean(1.0 / data.sigma**2, axis=0) ** -0.5
    assert np.allclose(found, np.array(noise) / np.sqrt(count), rtol=0.25)


def poses_of(logs: Recording, time: np.ndarray) -> np.ndarray:
    q = [np.interp(time, logs.joints.time, c) for c in logs.joints.values.T]
    T = CHAIN.poses(np.column_stack(q))
    T[:, :3, 3] += [0.3, -1.0, 2.0]
    return T


JOIN = "join joints.csv tracker.txt --setup setup.yaml -o m.csv"


pytestmark = pytest.mark.usefixtures("alone")


@pytest.fixture
def logs() -> Recording:
    made = recording(7)
    written(made)
    return made


@pytest.mark.parametrize("turn", [360, 4096])
def test_two_logs_become_measurements(logs, run, turn):
    if turn != 360:  # A servo counts them.
        header, *text = Path("joints.csv").read_text().splitlines()
        rows = np.array([[*map(float, line.split(","))] for line in text])
        rows[:, 1:] = 100.0 + rows[:, 1:] * turn / 360.0
        header = header.replace("[deg]", f"[steps/{turn}@100]")
        lines("joints.csv", header, np.char.mod("%.6f", rows))
    result = run(JOIN)
    assert result.status == 0 and result.err == ""
    assert result.out.startswith("12 standstills")
    assert f"{logs.ahead:+.3f}" in result.out
    data = joined()
    assert data.target.distinct == ("SMR1",) and len(data.q) == 12
    of_means(data, 12, NOISE)
    # By an older join, with the sigma of a reading: of 50 in each standstill.
    _, *text = Path("m.csv").read_text().splitlines()
    head = "# joined by time: 12 standstills, 600 readings"
    Path("m.csv").write_text("\n".join([head, *text]))
    assert np.allclose(joined().sigma * np.sqrt(50), data.sigma, rtol=1e-12)


FIRST = datetime(2026, 3, 12, 23, 59, 30)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: f"{1e3 * t:.1f}", "the times of the joints are read as ms"),
        (lambda t: f"{FIRST + timedelta(seconds=t)}", ""),
    ],
)
def test_times_as_people_write_them(logs, run, change, words):
    changed(lambda time: change(float(time)))
    result = run(f"{JOIN} --keep")
    assert result.status == 0 and result.out.startswith("12 standstills")
    assert words in result.err and bool(words) == bool(result.err)
    assert len(joined(6.0).q) > 100


def test_poses_keep_their_scatter(logs, run):
    """What does not scatter has no sigma; half turns have a mean, whatever sign."""
    time = np.linspace(0.0, logs.joints.time[-1], 900)
    T, rng = poses_of(logs, time), np.random.default_rng(0)
    R = T[:, :3, :3] @ so3_exp(rng.normal(0.0, 1e-4, (len(T), 3)))
    p = T[:, :3, 3] + rng.normal(0.0, NOISE, (len(T), 3))
    rows = np.column_stack([1e3 * time, p, so3_log(R)])
    lines("poses.csv", "time [ms],x,y,z,rx,ry,rz", rows)
    assert run("join joints.csv poses.csv -o m.csv").status == 0
    data = joined()
    assert data.model == "pose"
    of_means(data, 12, 3 * [NOISE] + 3 * [1e-4])
    for size, scatters in ((0.0, False), (1e-6, True)):
        signs = size * (-1.0) ** np.arange(len(p))
        rows = np.column_stack([time, p, *np.full((3, len(p)), 3**-0.5), signs])
        lines("poses.csv", "time,x,y,z,qx,qy,qz,qw", rows)
        assert run("join joints.csv poses.csv -o m.csv --force").status == 0
        found = joined()
        assert (found.sigma is not None) == scatters
        assert np.allclose(np.abs(found.values[:, 3:6]), 3**-0.5, rtol=0, atol=1e-5)


BALLS = {"A": np.zeros(3), "B": np.array([0.1, 0.0, 0.02])}
"""Points on the tool, in the tip link."""


def test_points_that_are_read_by_turns_stay_apart(logs, run):
    """Also where a point is lost in some rows, and others share a time."""
    time = np.arange(0.0, logs.joints.time[-1], 0.05)
    T, rng, rows = poses_of(logs, time), np.random.default_rng(1), list[Any]()
    for k, (t, pose) in enumerate(zip(time, T, strict=True)):
        for name in BALLS if k % 3 else "A":
            p = pose[:3, :3] @ BALLS[name] + pose[:3, 3] + rng.normal(0.0, NOISE, 3)
            lost = name == "B" and k % 5 == 0
            rows.append([t, name, *(["MISSING"] * 3 if lost else p)])
    lines("tracker.csv", "stamp,Marker,tracker_x,tracker_y,tracker_z", rows)
    result = run("join joints.csv tracker.csv -o m.csv")
    assert result.status == 0 and "have no reading" in result.err
    data = read_measurements("m.csv", CHAIN).only
    assert {*data.target} == {*BALLS} and len(data.q) == 24
    expected = points_at(data, [BALLS[name] for name in data.target])
    assert np.abs(data.values - expected).max() < 3.0 * NOISE
    of_means(data, 24, NOISE)


def test_points_with_names_need_no_time(run):
    """Two targets of each point; what only one file has is left out and told."""
    rng = np.random.default_rng(3)
    q = CHAIN.random_configurations(8, rng)
    rows = [[f"P{k}", *row] for k, row in enumerate(q)]
    lines("joints.csv", ",".join(["pose", *CHAIN.joints]), rows)
    points = ["pose;Kugel;X [mm];Y [mm];Z [mm];RMS"]
    T = CHAIN.poses(q)
    for k in rng.permutation(7):
        for name, ball in BALLS.items():
            p = 1e3 * (T[k, :3, :3] @ ball + T[k, :3, 3] + [0.3, -1.0, 2.0])
            points.append(";".join([f"p{k}", name, *map(comma, p), "0,01"]))
    text = "\n".join([*points, "P99;A;1;2;3;0,01"])
    Path("points.txt").write_text(text)
    result = run("join joints.csv points.txt -o m.csv")
    assert result.status == 0
    assert "in one of both files only, and left out: p7, p99" in result.err
    data = read_measurements("m.csv", CHAIN).only
    assert len(data.q) == 14
    expected = points_at(data, [BALLS[name] for name in data.target])
    assert np.allclose(data.values, expected, atol=1e-7)
    # The names that an instrument gives its points are those of the poses.
    Path("points.txt").write_text(text.replace("pose", "Punkt"))
    assert run("join joints.csv points.txt -o n.csv").status == 0
    named = [Path(file).read_text() for file in ("m.csv", "n.csv")]
    assert named[0] == named[1]
    Path("points.txt").write_text(text.replace("pose", "Lage").replace("\np", "\nr"))
    wrong = run("join joints.csv points.txt -o o.csv")
    assert wrong.status == 1
    assert "none of names, 'pose', that both have" in wrong.err
    assert not Path("o.csv").exists()


def test_readings_of_one_name_from_two_stations_are_not_averaged(run):
    """As an instrument exports them that was moved, and called its points alike."""
    q = CHAIN.random_configurations(2, np.random.default_rng(3))
    rows = [[name, *row] for name, row in zip(("P1", "P2"), q, strict=True)]
    lines("joints.csv", ",".join(["pose", *CHAIN.joints]), rows)
    points = [["A", "P1", 1, 2, 300], ["A", "P2", 2, 3, 400], ["B", "P1", 1, 2, 310]]
    for header, status in (("group", 1), ("station", 0)):
        lines("points.csv", f"{header},pose,x [m],y [m],z [cm]", points)
        result = run("join joints.csv points.csv -o m.csv")
        assert result.status == status
        assert ("points.csv:4: readings of one name are 100 mm" in result.err) == status


def test_joints_of_one_name_leave_open_whose_a_reading_is(run):
    """The readings of both would be averaged, and each get the mean."""
    q = CHAIN.random_configurations(3, np.random.default_rng(3))
    rows = [[name, *row] for name, row in zip(("P1", "P2", "p1"), q, strict=True)]
    lines("joints.csv", ",".join(["pose", *CHAIN.joints]), rows)
    lines("points.csv", "pose,x,y,z", [["P1", 1, 2, 3], ["P2", 2, 3, 4]])
    wrong = run("join joints.csv points.csv -o m.csv")
    assert wrong.status == 1 and "joints.csv:4" in wrong.err
    assert "has this name" in wrong.err and "'p1'" in wrong.err


def test_a_log_of_the_robot_as_it_is(logs, run):
    """Counters, stamps of nanoseconds, speeds and gaps are no joints and hide none."""
    names, rows = CHAIN.joints, list[Any]()
    speeds = [f"{name}.velocity" for name in names]
    for k, (t, q) in enumerate(zip(logs.joints.time, logs.joints.values, strict=True)):
        cells = [*q]
        cells[k % 6] = "" if k % 50 == 0 else cells[k % 6]
        stamp = 1_700_000_000 * 10**9 + round(1e9 * float(t))
        rows.append([k, 7 + k, stamp, *cells, *[0.0] * 6])
    lines("joints.csv", ",".join(["", "seq", "timestamp", *names, *speeds]), rows)
    result = run(JOIN)
    assert result.status == 0 and "joints.csv" in result.err
    assert len(joined().q) == 12 and table("m.csv")[0][:7] == [*names, "x"]
    # Columns that the setup names are the joints, whatever else there is.
    some = "".join(f"  {name}: {name}\n" for name in names[:3])
    Path("setup.yaml").write_text(SETUP.replace("  time: Zeit\n", "") + some)
    assert run("join joints.csv tracker.txt --setup setup.yaml -o n.csv").status == 0
    assert table("n.csv")[0][:4] == [*names[:3], "x"]


def test_images_get_the_joints_of_their_standstill(run):
    """Corners with their deviations, and a list of images alone, in any order."""
    made = recording(0, still_only=True)
    written(made)
    times = made.readings.time
    names = [f"img_{k}.png" for k in range(len(times))]
    rows = [[names[k], f"{times[k]:.4f}"] for k in np.argsort(names)]
    lines("images.csv", "Filename,time", [*rows, ["late.png", 0.01]])
    corners = [[*row, c, c + 0.25, 7, f"0.0{c + 2}"] for row in rows for c in range(2)]
    lines("pixels.csv", "image,time,target,u,v,sigma_u", corners)
    result = run("join joints.csv images.csv -o n.csv")
    assert result.status == 0 and "late.png" in result.err
    kept = {name for name in names if name not in result.err}
    assert len(kept) > 0.6 * len(names)
    assert run("join joints.csv pixels.csv -o m.csv").status == 0
    (head, images, _), (named, pixels, _) = table("n.csv"), table("m.csv")
    assert head[6:] == ["image", "time"] and {row[6] for row in images} == kept
    assert named[6:] == ["u", "v", "target", "image", "sigma_u", "time"]
    assert len(pixels) == 2 * len(kept)
    for row in images:
        time, q = times[names.index(row[6])], np.deg2rad(np.array(row[:6], float))
        columns = made.joints.values.T
        true = [np.interp(time, made.joints.time, column) for column in columns]
        assert np.abs(q - true).max() < 1e-4
        both = [cells for cells in pixels if cells[9] == row[6]]
        assert [cells[:6] for cells in both] == 2 * [row[:6]]
        assert [cells[8] + cells[10] for cells in both] == ["00.02", "10.03"]


@pytest.mark.parametrize(
    ("file", "change", "named"),
    [
        ("tracker.txt", lambda t: t.replace("Zeit", "Uhr"), "'time'"),
        ("tracker.txt", lambda t: t.replace("SMR1;", "SMR1;12.03.2026 "), "not a time"),
        ("tracker.txt", lambda t: t.replace(" (mm)", ""), "tracker.txt"),
        ("tracker.txt", lambda t: t.replace("SMR1;", "SMR1;a", 1), "tracker.txt:3"),
        ("joints.csv", lambda t: "\n".join(t.splitlines()[:2]), "joints.csv"),
        ("joints.csv", lambda t: "timestamp\n1\n2\n3\n4", "joints.csv"),
        ("joints.csv", lambda t: t + "\n0.5" + ",1" * 6, "time"),
    ],
)
def test_logs_that_cannot_be_joined(logs, fails, file, change, named):
    path = Path(file)
    path.write_text(change(path.read_text("utf-8-sig")))
    fails(JOIN, named)


def test_a_topic_of_no_bag_is_refused(logs, fails):
    fails(f"{JOIN} --topic /points", "--topic", "tracker.txt")
    fails(f"{JOIN} --joint-topic /joints", "--joint-topic", "joints.csv")


def test_logs_of_no_common_time(logs, fails):
    text = Path("tracker.txt").read_text("utf-8-sig").splitlines()
    Path("tracker.txt").write_text("\n".join([*text[:2], *text[2::40]]))
    header, *rows = Path("joints.csv").read_text().splitlines()
    lines("joints.csv", header, [[f"9{line}"] for line in rows[1200:]])
    fails(JOIN, "common time")
