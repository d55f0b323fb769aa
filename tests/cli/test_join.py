"""`join`: two logs as people have them, and what cannot be joined."""

from __future__ import annotations

from collections.abc import Callable
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


def written(made: Recording) -> None:
    """The logs of a robot (degrees) and of a tracker (its own names and marks)."""
    names = [f"{joint} [deg]" for joint in CHAIN.joints]
    lines = [",".join(["timestamp", *names])]
    for t, q in zip(made.joints.time, np.rad2deg(made.joints.values), strict=True):
        lines.append(",".join([f"{t:.4f}", *(f"{angle:.6f}" for angle in q)]))
    Path("joints.csv").write_text("\n".join(lines))
    lines = ["# tracker", "Punkt;Zeit;X (mm);Y (mm);Z (mm);Temp"]
    for t, p in zip(made.readings.time, 1e3 * made.readings.values, strict=True):
        lines.append(";".join(["SMR1", comma(t), *map(comma, p), "21,5"]))
    Path("tracker.txt").write_bytes("\r\n".join(lines).encode("utf-8-sig"))
    Path("setup.yaml").write_text(SETUP)


def changed(change: Callable[[str], str]) -> None:
    """Write the times of the joints' log otherwise."""
    header, *lines = Path("joints.csv").read_text().splitlines()
    cut = [line.partition(",") for line in lines]
    rows = [f"{change(time)},{rest}" for time, _, rest in cut]
    Path("joints.csv").write_text("\n".join([header, *rows]))


def joined(within: float, **options: Any) -> Measurements:
    """What was joined, which are the points of the robot to some of their noise."""
    data = read_measurements("m.csv", CHAIN, **options).only
    expected = CHAIN.poses(data.q)[:, :3, 3] + [0.3, -1.0, 2.0]
    assert np.abs(data.values - expected).max() < within * NOISE
    return data


def of_means(data: Measurements, rows: int, noise: Any) -> None:
    """Each sigma is that of the mean of independent readings, counted in the head."""
    head = Path("m.csv").read_text().partition("\n")[0]
    count = int(head.split()[6]) / rows
    assert head.endswith("each sigma that of a mean")
    found = np.mean(1.0 / data.sigma**2, axis=0) ** -0.5
    assert np.allclose(found, np.array(noise) / np.sqrt(count), rtol=0.25)


def poses_of(logs: Recording, time: np.ndarray) -> np.ndarray:
    q = [np.interp(time, logs.joints.time, c) for c in logs.joints.values.T]
    return CHAIN.poses(np.column_stack(q))


JOIN = "join joints.csv tracker.txt --setup setup.yaml -o m.csv"


@pytest.fixture
def logs(tmp_path, monkeypatch) -> Recording:
    monkeypatch.chdir(tmp_path)
    made = recording(7)
    written(made)
    return made


@pytest.mark.parametrize("turn", [360, 4096])
def test_two_logs_become_measurements(logs, run, turn):
    if turn != 360:  # A servo counts them.
        header, *lines = Path("joints.csv").read_text().splitlines()
        rows = np.array([[*map(float, line.split(","))] for line in lines])
        rows[:, 1:] = 100.0 + rows[:, 1:] * turn / 360.0
        with Path("joints.csv").open("w") as file:
            print(header.replace("[deg]", f"[steps/{turn}@100]"), file=file)
            np.savetxt(file, rows, "%.6f", delimiter=",")
    result = run(JOIN)
    assert result.status == 0
    assert result.err == ""
    assert result.out.startswith("12 standstills")
    assert f"{logs.ahead:+.3f}" in result.out
    data = joined(3.0)
    assert data.target.distinct == ("SMR1",)
    assert len(data.q) == 12 and data.sigma is not None
    of_means(data, 12, NOISE)


def test_every_reading_can_be_kept(logs, run):
    """Dates are times as well."""
    first = np.datetime64("2026-03-01T23:59:30")
    changed(lambda t: f"{first + np.timedelta64(round(1e6 * float(t)), 'us')}")
    assert run(f"{JOIN} --keep").status == 0
    assert len(joined(6.0).q) > 100


def test_poses_keep_their_scatter(logs, run):
    time = np.linspace(0.0, logs.joints.time[-1], 900)
    T, rng = poses_of(logs, time), np.random.default_rng(0)
    lines = ["time [ms],x,y,z,rx,ry,rz"]
    R = T[:, :3, :3] @ so3_exp(rng.normal(0.0, 1e-4, (len(T), 3)))
    p = T[:, :3, 3] + rng.normal(0.0, NOISE, (len(T), 3))
    for t, a, b in zip(time, p, so3_log(R), strict=True):
        lines.append(",".join(map(str, [1e3 * t, *a, *b])))
    Path("poses.csv").write_text("\n".join(lines))
    assert run("join joints.csv poses.csv -o m.csv").status == 0
    data = read_measurements("m.csv", CHAIN).only
    assert data.model == "pose" and data.sigma is not None
    of_means(data, 12, 3 * [NOISE] + 3 * [1e-4])


BALLS = {"A": np.zeros(3), "B": np.array([0.1, 0.0, 0.02])}
"""Points on the tool, in the tip link."""


def test_points_that_are_read_by_turns_stay_apart(logs, run):
    """Also where a point is lost in some rows, and others share a time."""
    time = np.arange(0.0, logs.joints.time[-1], 0.05)
    T, rng = poses_of(logs, time), np.random.default_rng(1)
    lines = ["stamp,Marker,tracker_x,tracker_y,tracker_z"]
    for k, (t, pose) in enumerate(zip(time, T, strict=True)):
        for name, ball in BALLS.items() if k % 3 else [("A", BALLS["A"])]:
            p = pose[:3, :3] @ ball + pose[:3, 3] + rng.normal(0.0, NOISE, 3)
            cells = ["MISSING"] * 3 if name == "B" and k % 5 == 0 else map(str, p)
            lines.append(",".join([f"{t:.3f}", name, *cells]))
    Path("tracker.csv").write_text("\n".join(lines))
    result = run("join joints.csv tracker.csv -o m.csv")
    assert result.status == 0 and "have no reading" in result.err
    data = read_measurements("m.csv", CHAIN).only
    assert {*data.target} == {*BALLS} and len(data.q) == 24
    T = CHAIN.poses(data.q)
    balls = np.array([BALLS[name] for name in data.target])
    expected = (T[:, :3, :3] @ balls[:, :, None])[:, :, 0] + T[:, :3, 3]
    assert np.abs(data.values - expected).max() < 3.0 * NOISE
    of_means(data, 24, NOISE)


def test_points_with_names_need_no_time(tmp_path, monkeypatch, run):
    """Two targets of each point; what only one file has is left out and told."""
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(3)
    q = CHAIN.random_configurations(8, rng)
    joints = [",".join(["name", *CHAIN.joints])]
    joints += [",".join([f"P{k}", *map(repr, row.tolist())]) for k, row in enumerate(q)]
    points = ["Punkt-Nr;Kugel;X [mm];Y [mm];Z [mm];RMS"]
    T = CHAIN.poses(q)
    for k in rng.permutation(7):
        for name, ball in BALLS.items():
            p = 1e3 * (T[k, :3, :3] @ ball + T[k, :3, 3])
            points.append(";".join([f"p{k}", name, *map(comma, p), "0,01"]))
    points.append("P99;A;1;2;3;0,01")
    Path("joints.csv").write_text("\n".join(joints))
    Path("points.txt").write_text("\n".join(points))
    result = run("join joints.csv points.txt -o m.csv")
    assert result.status == 0
    assert "in one of both files only, and left out: p7, p99" in result.err
    data = read_measurements("m.csv", CHAIN).only
    assert len(data.q) == 14
    at = [np.flatnonzero((q == row).all(axis=1))[0] for row in data.q]
    balls = np.array([BALLS[name] for name in data.target])
    expected = (T[at, :3, :3] @ balls[:, :, None])[:, :, 0] + T[at, :3, 3]
    assert np.allclose(data.values, expected, atol=1e-7)
    Path("points.txt").write_text("\n".join(points).replace("p", "q"))
    wrong = run("join joints.csv points.txt -o n.csv")
    assert wrong.status == 1 and "no column of names" in wrong.err
    assert not Path("n.csv").exists()


def test_times_of_one_log_may_be_milliseconds(logs, run):
    changed(lambda time: f"{1e3 * float(time):.1f}")
    result = run(JOIN)
    assert "the times of the joints are read as ms" in result.err
    assert result.out.startswith("12 standstills")
    text = Path("joints.csv").read_text()
    Path("joints.csv").write_text(text.replace("p", "p [s]", 1))
    assert run(f"{JOIN} --force").status == 1


@pytest.mark.parametrize("way", ["%d.%m.%Y %H:%M:%S.%f", "%H:%M:%S.%f"])
def test_dates_as_people_write_them(logs, run, way):
    """A clock without a date begins anew at midnight."""
    first = datetime(2026, 3, 12, 23, 59, 30)
    changed(lambda time: (first + timedelta(seconds=float(time))).strftime(way))
    result = run(JOIN)
    assert result.status == 0 and result.out.startswith("12 standstills")
    lines = Path("m.csv").read_text().replace("SMR1", "").splitlines()
    assert len(lines) == 14


def test_columns_of_one_point_stay_together(logs, run):
    """Of two points the one is taken that no controller computes, whole."""
    time = np.arange(0.0, logs.joints.time[-1], 0.05)
    p = poses_of(logs, time)[:, :3, 3]
    cells = np.column_stack([time, p[:, :2] + 1.0, p - 9.0, p[:, 2] + 1.0])
    lines = [",".join(f"{number:.6f}" for number in row) for row in cells]
    header = "time,pos_x,pos_y,tcp_x,tcp_y,tcp_z,pos_z"
    Path("two.csv").write_text("\n".join([header, *lines]))
    assert run("join joints.csv two.csv -o m.csv").status == 0
    data = read_measurements("m.csv", CHAIN).only
    expected = CHAIN.poses(data.q)[:, :3, 3] + 1.0
    assert np.abs(data.values - expected).max() < 1e-5


def test_words_of_a_logger_and_signs_of_lost_readings(logs, run):
    """-9999 in some rows is told and left out; a voltage is no joint."""
    header, *lines = Path("joints.csv").read_text().splitlines()
    names = [f"rec.{name}" for name in header.split(",")]
    rows = [[*line.split(","), "24.1"] for line in lines]
    for k in (30, 200, 201):
        rows[k][3] = "-9999"
    text = "\n".join(",".join(row) for row in [[*names, "Battery [V]"], *rows])
    Path("joints.csv").write_text(text)
    result = run(JOIN)
    assert result.status == 0 and "-9999 in 3 rows" in result.err
    assert result.out.startswith("12 standstills")
    columns = {joint: f"rec.{joint} [deg]" for joint in CHAIN.joints}
    joined(3.0, columns=columns)


def test_a_log_of_the_robot_as_it_is(logs, run):
    """Counters, stamps of nanoseconds, speeds and gaps are no joints and hide none."""
    names = CHAIN.joints
    speeds = [f"{name}.velocity" for name in names]
    lines = [",".join(["", "seq", "timestamp", *names, *speeds])]
    q, epoch = logs.joints.values, 1_700_000_000
    for k, (t, row) in enumerate(zip(logs.joints.time, q, strict=True)):
        cells = [repr(float(angle)) for angle in row]
        cells[k % 6] = "" if k % 50 == 0 else cells[k % 6]
        stamp = epoch * 10**9 + round(1e9 * float(t))
        lines.append(",".join([str(k), str(7 + k), str(stamp), *cells, *("0.0",) * 6]))
    Path("joints.csv").write_text("\n".join(lines))
    result = run(JOIN)
    assert result.status == 0 and "joints.csv" in result.err
    data = joined(3.0)
    assert table("m.csv")[0][:7] == [*names, "x"]
    assert len(data.q) == 12
    # Columns that the setup names are the joints, whatever else there is.
    some = "".join(f"  {name}: {name}\n" for name in names[:3])
    Path("setup.yaml").write_text(SETUP.replace("  time: Zeit\n", "") + some)
    assert run("join joints.csv tracker.txt --setup setup.yaml -o n.csv").status == 0
    assert table("n.csv")[0][:4] == [*names[:3], "x"]


def test_images_get_the_joints_of_their_standstill(tmp_path, monkeypatch, run):
    """Corners with their deviations, and a list of images alone, in any order."""
    monkeypatch.chdir(tmp_path)
    made = recording(0, still_only=True)
    written(made)
    times = made.readings.time
    names = [f"img_{k}.png" for k in range(len(times))]
    rows = [f"{names[k]},{times[k]:.4f}" for k in np.argsort(names)]
    text = "\n".join(["Filename,time", *rows, "late.png,0.01"])
    Path("images.csv").write_text(text)
    corners = [f"{row},{c},{c + 0.25},7,0.0{c + 2}" for row in rows for c in range(2)]
    text = "\n".join(["image,time,target,u,v,sigma_u", *corners])
    Path("pixels.csv").write_text(text)
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


def test_means_that_were_joined_with_the_sigma_of_a_reading(logs, run):
    """By an older join: of 50 readings in each of 12 standstills."""
    assert run(JOIN).status == 0
    data, (_, *lines) = joined(3.0), Path("m.csv").read_text().splitlines()
    head = "# joined by time: 12 standstills, 600 readings"
    Path("m.csv").write_text("\n".join([head, *lines]))
    older = joined(3.0)
    assert np.allclose(older.sigma * np.sqrt(50), data.sigma, rtol=1e-12)


def test_readings_that_do_not_scatter_have_no_sigma(logs, run):
    lines = ["time,x,y,z,qx,qy,qz,qw"]
    for t, p in zip(logs.readings.time, logs.readings.values, strict=True):
        lines.append(",".join(map(str, [t, *p, 0.5, 0.5, 0.5, 0.5])))
    Path("poses.csv").write_text("\n".join(lines))
    assert run("join joints.csv poses.csv -o m.csv").status == 0
    assert read_measurements("m.csv", CHAIN).only.sigma is None


def test_half_turns_have_a_mean(logs, run):
    """Which of both signs a quaternion has is chance there."""
    lines = ["time,x,y,z,qx,qy,qz,qw"]
    pairs = zip(logs.readings.time, logs.readings.values, strict=True)
    for k, (t, p) in enumerate(pairs):
        lines.append(",".join(map(str, [t, *p, 0.6, 0.8, 0.0, 1e-6 * (-1) ** k])))
    Path("poses.csv").write_text("\n".join(lines))
    assert run("join joints.csv poses.csv -o m.csv").status == 0
    turned = read_measurements("m.csv", CHAIN).only.values[:, 3:]
    expected = np.tile([0.6, 0.8], (len(turned), 1))
    np.testing.assert_allclose(np.abs(turned[:, :2]), expected, rtol=0, atol=1e-5)


@pytest.mark.parametrize(
    ("file", "change", "named"),
    [
        ("tracker.txt", lambda t: t.replace("Zeit", "Uhr"), "'time'"),
        ("tracker.txt", lambda t: t.replace(" (mm)", ""), "tracker.txt"),
        ("joints.csv", lambda t: "\n".join(t.splitlines()[:2]), "joints.csv"),
        ("joints.csv", lambda t: "timestamp\n1\n2\n3\n4", "joints.csv"),
        ("joints.csv", lambda t: t + "\n0.5" + ",1" * 6, "time"),
        ("tracker.txt", lambda t: t.replace("SMR1;", "SMR1;a", 1), "tracker.txt:3"),
    ],
)
def test_logs_that_cannot_be_joined(logs, fails, file, change, named):
    path = Path(file)
    path.write_text(change(path.read_text("utf-8-sig")))
    fails(JOIN, named)


def test_logs_of_no_common_time(logs, fails):
    text = Path("tracker.txt").read_text("utf-8-sig").splitlines()
    Path("tracker.txt").write_text("\n".join([*text[:2], *text[2::40]]))
    header, *lines = Path("joints.csv").read_text().splitlines()
    later = [f"9{line}" for line in lines[1200:]]
    Path("joints.csv").write_text("\n".join([header, *later]))
    fails(JOIN, "common time")
