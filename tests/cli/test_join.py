"""`join`: two logs as people have them, and what cannot be joined."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import calib_pin
from calib_pin.io.measurements import read_measurements
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


JOIN = "join joints.csv tracker.txt --setup setup.yaml -o m.csv"


@pytest.fixture
def logs(tmp_path, monkeypatch) -> Recording:
    monkeypatch.chdir(tmp_path)
    made = recording(7)
    written(made)
    return made


def test_two_logs_become_measurements(logs, run):
    result = run(JOIN)
    assert result.status == 0
    assert "tracker.txt" in result.err and "Punkt, Temp" in result.err
    assert result.out.startswith("12 standstills")
    assert f"{logs.ahead:+.3f}" in result.out
    data = read_measurements("m.csv", CHAIN).only
    assert len(data.q) == 12 and data.sigma is not None
    assert np.allclose(data.sigma, NOISE, rtol=0.2)
    expected = CHAIN.poses(data.q)[:, :3, 3] + [0.3, -1.0, 2.0]
    assert np.abs(data.values - expected).max() < 3.0 * NOISE


def test_every_reading_can_be_kept(logs, run):
    """Dates are times as well."""
    header, *lines = Path("joints.csv").read_text().splitlines()
    first, rows = np.datetime64("2026-03-01T23:59:30"), [header]
    for line in lines:
        stamp, rest = line.split(",", 1)
        when = first + np.timedelta64(round(1e6 * float(stamp)), "us")
        rows.append(f"{when},{rest}")
    Path("joints.csv").write_text("\n".join(rows))
    assert run(f"{JOIN} --keep").status == 0
    data = read_measurements("m.csv", CHAIN).only
    expected = CHAIN.poses(data.q)[:, :3, 3] + [0.3, -1.0, 2.0]
    assert len(data.q) > 100
    assert np.abs(data.values - expected).max() < 6.0 * NOISE


def test_poses_keep_their_scatter(logs, run):
    time = np.linspace(0.0, logs.joints.time[-1], 900)
    q = [np.interp(time, logs.joints.time, c) for c in logs.joints.values.T]
    T = CHAIN.poses(np.column_stack(q))
    rng = np.random.default_rng(0)
    lines = ["time [ms],x,y,z,rx,ry,rz"]
    from calib_pin.kinematics.spatial import so3_exp, so3_log

    R = T[:, :3, :3] @ so3_exp(rng.normal(0.0, 1e-4, (len(T), 3)))
    p = T[:, :3, 3] + rng.normal(0.0, NOISE, (len(T), 3))
    for t, a, b in zip(time, p, so3_log(R), strict=True):
        lines.append(",".join(map(str, [1e3 * t, *a, *b])))
    Path("poses.csv").write_text("\n".join(lines))
    assert run("join joints.csv poses.csv -o m.csv").status == 0
    data = read_measurements("m.csv", CHAIN).only
    assert data.model == "pose" and data.sigma is not None
    assert np.allclose(data.sigma, 3 * [NOISE] + 3 * [1e-4], rtol=0.25)


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
