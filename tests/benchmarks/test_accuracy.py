"""The benchmark of accuracy: files in public layouts, with invented numbers."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import calib_pin
from benchmarks.accuracy import converters, running
from benchmarks.accuracy.data_sets import DATA_SETS, WAM
from benchmarks.accuracy.public_files import read_columns
from benchmarks.accuracy.published import PUBLISHED
from calib_pin.errors import InputError
from calib_pin.observations import Observations

DATA_SET = {data_set.key: data_set for data_set in DATA_SETS}


def put(file: Path, *lines: str) -> Path:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text("".join(f"{line}\n" for line in lines))
    return file


def fitted(key: str, data: Path) -> Observations:
    data_set = DATA_SET[key]
    return data_set.fitted.read(data, data_set.chain(), data_set.model)


def row_of_the_tracker(number: int) -> str:
    """A line of a series of the UR10: seconds, a goal, joints, temperature, pose."""
    angles = [f"{0.1 * number + k / 100.0:.3f}" for k in range(6)]
    cells = ["20200714163904", *["0,8"] * 6, *angles, "23,68"]
    cells += [f"{1500 + number},25", "-1000,5", "2,0", "-90,4", "-59,8", "1,5E-02"]
    return ";".join(cells).replace(".", ",")


HEADER_OF_THE_TRACKER = ";".join(
    (
        *("Timestamp", "Goal x", "Goal y", "Goal z"),
        *("Goal roll", "Goal pitch", "Goal yaw"),
        *converters.UR,
        "measurement_temperature",
        *(f"measurement_{axis}" for axis in ("x", "y", "z", "rx", "ry", "rz")),
    )
)


def test_a_series_of_the_ur10(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(converters, "FITTED", 4)
    lines = [row_of_the_tracker(number) for number in range(7)]
    # A pose that the tracker has lost.
    lines[2] = lines[2].replace("1502,25", "")
    for name in converters.SERIES.values():
        put(tmp_path / "clone" / name, HEADER_OF_THE_TRACKER, *lines)
    converters.ipa_robot_accuracy(tmp_path / "clone", tmp_path)
    for folder in converters.SERIES:
        part = DATA_SET["ur10-a"].away[0]
        chain = DATA_SET["ur10-a"].chain()
        files = [tmp_path / folder / name for name in part.files]
        few, others = (calib_pin.read_measurements(file, chain) for file in files)
        assert (len(few), len(others)) == (4, 2)
        positions = np.concatenate([few.only.values, others.only.values])
        kept = sorted((positions[:, 0] * 1e3).round(6).tolist())
        assert kept == [1500.25, 1501.25, 1503.25, 1504.25, 1505.25, 1506.25]
        q = np.concatenate([few.q, others.q])[np.argsort(positions[:, 0])]
        assert q[1] == pytest.approx([0.1, 0.11, 0.12, 0.13, 0.14, 0.15])


@pytest.mark.parametrize(
    ("key", "stem", "joints"),
    [("ur5", "3D_UR5_uncalibrated", 6), ("wam", "WAM/3D_WAM_uncalibrated", 7)],
)
def test_a_grid_with_differences(tmp_path, key, stem, joints):
    names = [f"joint_{k + 1}" for k in range(joints)]
    header = ",".join(["step_order,x_t,y_t,z_t,x_dif,y_dif,z_dif", *names])
    angles = ",".join(["90.0", "-45"] + ["0"] * (joints - 2))
    line = f"0,-495.5,-261.25,359.5,-2.5,-0.25,0.5,{angles}"
    for word in ("grid", "random"):
        put(tmp_path / "clone" / f"{stem}_{word}_cleaned.csv", header, line)
    converters.serial_robots_datasets(tmp_path / "clone", tmp_path)
    rows = fitted(key, tmp_path)
    assert rows.only.values == pytest.approx(np.array([[-0.498, -0.2615, 0.36]]))
    assert rows.q[0, :2] == pytest.approx([np.pi / 2, -np.pi / 4])


def test_sockets_at_places(tmp_path: Path) -> None:
    for place in ("front", "window"):
        for socket in "01":
            file = tmp_path / "clone/data/panda_1" / place / f"hole_{socket}.csv"
            put(file, *[",".join([f"{k}.5e-01"] * 7) for k in range(1, 4)])
            put(file.with_name(f"hole_{socket}_pose.csv"), "1,2,3")
    converters.kinematics_calibration(tmp_path / "clone", tmp_path)
    rows = fitted("panda-1", tmp_path)
    assert rows.only.target.distinct == ("front/0", "front/1")
    assert rows.q[:, 6] == pytest.approx([0.15, 0.25, 0.35] * 2)
    (pair,) = DATA_SET["panda-1"].setup(rows).distances
    assert (pair.between, pair.value) == (("front/0", "front/1"), 0.05)
    elsewhere = DATA_SET["panda-1"].away[0]
    others = elsewhere.read(tmp_path, DATA_SET["panda-1"].chain(), "fixed-point")
    assert others.only.target.distinct == ("window/0", "window/1")
    assert not (tmp_path / "mukca_panda" / "panda_2.csv").exists()


def test_markers(tmp_path: Path) -> None:
    clone = tmp_path / "clone"
    names = ",".join(converters.TALOS)
    put(
        clone / "examples/talos/data/talos_left_arm_02_10_contact.csv",
        f"t,x1,y1,z1,{names}",
        ",".join(["42.4", "0.125", "-0.25", "0.5", *["0.1"] * 9]),
    )
    mocap = clone / "examples/tiago/data/calibration/mocap"
    for day in ("2021-11-30", "2021-11-26"):
        put(
            mocap / f"qualisys_{day}_static_postures.csv",
            f"x1,y1,z1,x2,y2,z2,{','.join(converters.TIAGO)},t_start_robot",
            ",".join(
                ["0.5", "0.25", "0.75", "9", "9", "9", *["0.2"] * 8, "1638287278.5"]
            ),
        )
    converters.figaroh_examples(clone, tmp_path)
    assert fitted("talos", tmp_path).only.values.tolist() == [[0.125, -0.25, 0.5]]
    assert fitted("tiago", tmp_path).only.values.tolist() == [[0.5, 0.25, 0.75]]
    assert fitted("tiago", tmp_path).q.tolist() == [[0.2] * 8]


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (
            ["a,b", "1,2", "3,much"],
            r"file.csv:3: .*number \(column 'b', value 'much'\)",
        ),
        (["a,b", "1,inf"], r"file.csv:2: it is no finite number"),
        (["a,b", "1,1_0"], r"file.csv:2: it is no finite number"),
        (["a,b", "1"], r"file.csv:2: 1 cells, where there are 2 columns"),
        (["a,c", "1,2"], r"file.csv:1: a column is missing \(column 'b'\).*a, c"),
        (["a,b"], r"file.csv: there are no measurements"),
        ([], r"file.csv: there are no measurements"),
        (["a,b", '"1,2'], r"file.csv: it cannot be read"),
        (["\x80\x04pickled"], r"file.csv: it cannot be read"),
    ],
)
def test_what_is_wrong_with_a_file_is_told(tmp_path, lines, said):
    file = put(tmp_path / "file.csv", *lines)
    file.write_bytes(file.read_text().encode("latin-1"))
    with pytest.raises(InputError, match=said) as told:
        read_columns(file, ("a", "b"))
    assert "\n" not in str(told.value)


def test_the_arm_of_the_wam() -> None:
    """A target and the joint angles to it, as one who has the arm published them."""
    chain = calib_pin.load_chain(WAM, base="base", tip="tool_plate")
    q = np.radians([20.0, 40.0, -30.0, 100.0, 10.0, -50.0, 70.0])
    turn, place = np.eye(3), np.zeros(3)
    # Denavit and Hartenberg: a, alpha in quarter turns, d.
    rows = [(0, -1, 0), (0, 1, 0), (0.045, -1, 0.55), (-0.045, 1, 0)]
    rows += [(0, -1, 0.3), (0, 1, 0), (0, 0, 0.06)]
    for angle, (a, alpha, d) in zip(q, rows, strict=True):
        cos, sin = np.cos(angle), np.sin(angle)
        about_z = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
        about_x = np.array([[1, 0, 0], [0, 1 - abs(alpha), -alpha]])
        about_x = np.vstack([about_x, [0, alpha, 1 - abs(alpha)]])
        place = place + turn @ about_z @ [a, 0, d]
        turn = turn @ about_z @ about_x
    pose = chain.poses(q[None])[0]
    assert pose[:3, 3] == pytest.approx(place, abs=1e-9)
    assert pose[:3, :3] == pytest.approx(turn, abs=1e-9)


def test_what_others_reach_belongs_to_data_sets() -> None:
    for other in PUBLISHED:
        data_set = DATA_SET[other.data_set]
        assert other.where in ("near", "away") and other.source
        assert other.statistic == data_set.statistic and other.error > 0.0


def run(monkeypatch: pytest.MonkeyPatch, *words: str) -> None:
    monkeypatch.setattr("sys.argv", ["benchmarks", "accuracy", *words])
    running.main()


def test_a_folder_without_data(tmp_path, monkeypatch, capsys):
    run(monkeypatch, "--data", str(tmp_path), "--only", "panda,talos", "--workers", "1")
    lines = capsys.readouterr().out.splitlines()
    assert [line.partition(":")[0] for line in lines] == ["panda-1", "panda-2", "talos"]
    assert all("skipped" in line for line in lines)


def test_a_damaged_repository_is_one_line(tmp_path, monkeypatch, capsys):
    put(tmp_path / "kinematics_calibration/data/panda_1/front/hole_0.csv", "1,2,3")
    with pytest.raises(SystemExit, match="1"):
        run(monkeypatch, "--data", str(tmp_path), "--only", "panda-1", "--workers", "1")
    (line,) = capsys.readouterr().err.splitlines()
    assert "hole_0.csv:1: 3 cells, where there are 7 columns" in line


@pytest.mark.slow
def test_a_data_set_from_its_repository(data_folder, tmp_path, monkeypatch, capsys):
    """The published layout again from our file: the same numbers as from this."""
    text = (data_folder / "talos_left_arm" / "measurements.csv").read_text()
    text = text.replace("time_s,x,y,z,", "t,x1,y1,z1,")
    name = "figaroh-examples/examples/talos/data/talos_left_arm_02_10_contact.csv"
    put(tmp_path / name, *text.splitlines())
    out, picture = tmp_path / "out.json", tmp_path / "out.svg"
    words = ("--only", "talos", "--workers", "1", "-o", str(out))
    run(monkeypatch, "--data", str(tmp_path), *words, "--figure", str(picture))
    (talos,) = json.loads(out.read_text())["data_sets"]
    assert talos["fitted"] == 61 and talos["verdict"].startswith("good")
    (near,) = talos["errors"]
    assert near["count"] == 61
    assert near["chosen"]["rms"] <= near["placement"]["rms"] < near["nominal"]["rms"]
    assert "TALOS" in capsys.readouterr().out
    assert picture.read_text().count("<svg") == 1
