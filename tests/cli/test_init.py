"""`calib-pin init`: its draft calibrates without an edit."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

import calib_pin
from calib_pin.cli import init as module
from calib_pin.cli import main
from calib_pin.io.setup import read_setup


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def run(words: str | Sequence[str]) -> int:
    return main(words.split() if isinstance(words, str) else list(words))


def calibrated(robot: str, file: Path | str, *words: str) -> dict:
    """The document of a calibration with the draft of `init`, as it is."""
    assert run(["init", robot, str(file), *words, "-o", "setup.yaml"]) == 0
    assert read_setup("setup.yaml").parameters == ("placement",)
    again = ["calibrate", robot, str(file), "--setup", "setup.yaml", "-o", "out"]
    assert run(again) == 0, Path("setup.yaml").read_text()
    return json.loads(Path("out/calibration.json").read_text())


def held_out(document: dict) -> tuple[float, float]:
    """Root mean square errors of the first quantity, nominal and calibrated."""
    errors = next(iter(document["errors"].values()))["validation"]
    return errors["before"]["rms"], errors["after"]["rms"]


Edit = Callable[[list[str], list[list[str]]], tuple[list[str], list[list[str]]]]


def rewritten(file: str, edit: Edit, separator: str = ",", comma: bool = False) -> str:
    """A measurement file with other headers and cells; the new file."""
    lines = [line for line in Path(file).read_text().splitlines() if line[0] != "#"]
    header, *rows = csv.reader(lines)
    header, rows = edit(header, rows)
    text = io.StringIO()
    writer = csv.writer(text, delimiter=separator, lineterminator="\n")
    cells = [[c.replace(".", ",") if comma else c for c in row] for row in rows]
    writer.writerows([header, *cells])
    Path("foreign.csv").write_text(text.getvalue())
    return "foreign.csv"


REAL = {
    # The folder and file, the robot, further words, the largest held-out error [m].
    "ur10": ("ur10_tmac/train.csv", "ur10_robot", (), 0.55e-3),
    "ur5": ("ur5_tracker/train.csv", "ur5_robot", (), 0.15e-3),
    "panda": ("mukca_panda/panda_1.csv", "panda", ("--distance", "50 mm"), 1.1e-3),
    "talos": ("talos_left_arm/measurements.csv", "talos_reduced", (), 0.9e-3),
    "tiago": ("tiago/train.csv", "tiago_no_hand", (), 3.35e-3),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", REAL)
def test_real_measurements(name: str, data_folder: Path):
    file, robot, words, most = REAL[name]
    before, after = held_out(calibrated(f"example:{robot}", data_folder / file, *words))
    assert after < most and after < before


def test_semicolons_decimal_commas_and_names_of_another_language():
    words = "simulate space6 --model position --count 40 --noise 1e-4 --seed 1 -o a.csv"
    assert run(words) == 0

    def german(header: list[str], rows: list[list[str]]):
        names = ["Punkt", *(f"Achse {k} [Grad]" for k in range(1, 7))]
        names += [f"Istposition {axis} (mm)" for axis in "XYZ"]
        kept = [header.index(name) for name in (*header[:6], "x", "y", "z")]
        scales = np.array([180.0 / np.pi] * 6 + [1e3] * 3)
        numbers = np.array([[float(row[k]) for k in kept] for row in rows]) * scales
        cells = [
            [f"P{number}", *(f"{value:.6f}" for value in row)]
            for number, row in enumerate(numbers)
        ]
        return names, cells

    file = rewritten("a.csv", german, ";", comma=True)
    before, after = held_out(calibrated("space6", file))
    assert after < 0.3e-3 < 1e-3 < before
    columns = read_setup("setup.yaml").columns
    assert columns["joint_1"] == "Achse 1 [deg]"
    assert columns["x"] == "Istposition X (mm) [mm]"
    # A number of its own for every measurement names nothing that they share.
    assert "target" not in columns


def test_degrees_without_a_unit():
    words = "simulate space6 --model position --count 40 --noise 1e-4 --seed 1 -o a.csv"
    assert run(words) == 0

    def degrees(header: list[str], rows: list[list[str]]):
        turned = [
            [*(f"{np.rad2deg(float(cell)):.6f}" for cell in row[:6]), *row[6:]]
            for row in rows
        ]
        return header, turned

    before, after = held_out(calibrated("space6", rewritten("a.csv", degrees)))
    assert after < 0.3e-3 < 1e-3 < before
    assert "(unit by its numbers)" in Path("setup.yaml").read_text()


def test_small_motions_in_degrees():
    """Numbers that might be radians as well are told apart by the robot."""
    words = "simulate space6 --model position --count 40 --noise 1e-4 --seed 1 -o a.csv"
    assert run(words) == 0

    def degrees(header: list[str], rows: list[list[str]]):
        kept = [row for row in rows if max(abs(float(c)) for c in row[:6]) < 3.0]
        return header, [
            [*(f"{np.rad2deg(float(c) / 40):.9f}" for c in row[:6]), *row[6:]]
            for row in kept
        ]

    file = rewritten("a.csv", degrees)
    lines = Path(file).read_text().splitlines()
    numbers = np.array([[float(c) for c in line.split(",")[:6]] for line in lines[1:]])
    assert np.abs(numbers).max() < 2.0 * np.pi
    chain = calib_pin.load_chain("space6")
    points = chain.poses(np.deg2rad(numbers))[:, :3, 3]
    rows = [
        ",".join([*line.split(",")[:6], *(f"{1e3 * v:.6f}" for v in point)])
        for line, point in zip(lines[1:], points, strict=True)
    ]
    header = ",".join([*lines[0].split(",")[:6], "tcp_x", "tcp_y", "tcp_z"])
    Path("small.csv").write_text("\n".join([header, *rows]) + "\n")
    assert run("init space6 small.csv -o setup.yaml") == 0
    columns = read_setup("setup.yaml").columns
    assert columns["joint_1"] == "joint_1 [deg]" and columns["x"] == "tcp_x [mm]"


def test_three_chains():
    Path("arms.yaml").write_text(
        "chains:\n"
        "  left: {tip: arm_left_7_link}\n"
        "  right: {tip: arm_right_7_link}\n"
        "  head: {tip: head_2_link}\n"
    )
    words = "simulate example:talos_reduced --setup arms.yaml --model pose --count 40"
    assert run(f"{words} --noise 2e-4 --seed 2 -o a.csv") == 0
    before, after = held_out(calibrated("example:talos_reduced", "a.csv"))
    assert after < 0.8e-3 < before
    chains = read_setup("setup.yaml").chains
    for name, link in (
        ("left", "arm_left_7_link"),
        ("right", "arm_right_7_link"),
        ("head", "head_2_link"),
    ):
        # Of links that the same joints move any may be the tip.
        tip, known = (
            calib_pin.load_chain("example:talos_reduced", tip=end)
            for end in (chains[name].tip, link)
        )
        assert tip.joints == known.joints


def test_a_camera_and_its_board():
    Path("camera.yaml").write_text(
        "tip: tool\nmodel: camera\n"
        "frames: {base: {xyz: [1.2, 0.1, 0.2], rpy: [3.1, 0, 0]}}\n"
        "board: {type: charuco, columns: 7, rows: 5, square: 0.03}\n"
        "camera: {mount: hand, focal: [900, 905], center: [641, 478],"
        " size: [1280, 960]}\n"
    )
    words = "simulate pa10 --setup camera.yaml --count 24 --all-targets --seed 3"
    assert run(f"{words} --noise 0.3 -o a.csv") == 0
    board = "charuco:7x5:0.03:0.022"
    before, after = held_out(calibrated("pa10", "a.csv", "--board", board))
    assert after < 1.0 < before


def test_sockets():
    Path("sockets.yaml").write_text(
        "tip: tool\nmodel: fixed-point\n"
        "targets: {ball: {xyz: [0.02, 0.03, 0.1], estimate: true}}\n"
        "sockets: {front/0: {xyz: [0.9, 0.2, 0.4]}, front/1: {xyz: [0.9, 0.28, 0.4]},"
        " side/0: {xyz: [0.1, 0.95, 0.5]}, side/1: {xyz: [0.1, 0.95, 0.58]}}\n"
    )
    words = "simulate space6 --setup sockets.yaml --count 80 --noise 1e-4 --seed 3"
    assert run(f"{words} -o a.csv") == 0
    document = calibrated("space6", "a.csv", "--distance", "80 mm")
    assert document["setup"]["distances"][0]["value"] == 0.08
    before, after = held_out(document)
    assert after < 1e-3 < before


LIMB = """<link name="{side}_{k}"/>
<joint name="{side}_joint_{k}" type="revolute"><origin xyz="{xyz}"/>
<parent link="{parent}"/><child link="{side}_{k}"/><axis xyz="{axis}"/>
<limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
"""


def twins(mirror: float) -> Path:
    """A robot with two arms that make the same motions, and a file of one of them.

    Args:
        mirror: -1 for a right arm that is the mirror image of the left one, 1 for the
            same arm once more.
    """
    parts = []
    for side, sign in (("left", 1.0), ("right", mirror)):
        shift = 0.4 if side == "left" else -0.4
        places = [f"0.1 {shift} 0.3", f"0 {0.1 * sign} 0.2"]
        places += [f"0.4 {0.05 * sign} 0", f"0.3 {0.1 * sign} 0.05"]
        parent = "base"
        for k, xyz in enumerate(places):
            axis = ("0 0 1", "1 0 0", "0 1 0", "0 0 1")[k]
            parts.append(LIMB.format(side=side, k=k, xyz=xyz, parent=parent, axis=axis))
            parent = f"{side}_{k}"
    text = f'<robot name="twins"><link name="base"/>{"".join(parts)}</robot>'
    Path("twins.urdf").write_text(text)
    chain = calib_pin.load_chain("twins.urdf", tip="left_3")
    q = np.random.default_rng(0).uniform(-1.5, 1.5, (40, 4))
    points = chain.poses(q)[:, :3, 3]
    header = ",".join(
        f"{side}_joint_{k}" for side in ("left", "right") for k in range(4)
    )
    np.savetxt(
        "both.csv",
        np.hstack([q, q, points]),
        "%.9f",
        ",",
        header=f"{header},x,y,z",
        comments="",
    )
    return Path("both.csv")


def test_the_arm_that_fits_is_the_one_that_was_measured():
    twins(mirror=-1.0)
    assert run("init twins.urdf both.csv -o setup.yaml") == 0
    assert read_setup("setup.yaml").tip == "left_3"


def test_a_terminal_is_asked(monkeypatch: pytest.MonkeyPatch, capsys):
    """Which of two arms was measured that are the same and move alike?"""
    twins(mirror=1.0)
    assert run("init twins.urdf both.csv") == 1
    assert "which link was measured? state --tip" in capsys.readouterr().err
    monkeypatch.setattr(module.sys.stdin, "isatty", lambda: True, raising=False)
    monkeypatch.setattr(module.typer, "prompt", lambda *_, **__: "right_3")
    assert run("init twins.urdf both.csv") == 0
    assert "\ntip: right_3\n" in capsys.readouterr().out


HEADERS = {
    "numbers": ([f"J{k} (deg)" for k in range(1, 7)], "measurement_x", "mm"),
    "kuka": ([f"A{k}" for k in range(1, 7)], "X", "mm"),
    "spaces": ([f"Joint {k}" for k in range(1, 7)], "TCP_x", "m"),
    "from zero": ([f"q{k}" for k in range(6)], "px", "m"),
    "motoman": ([*"SLURBT"], "X_meas", "mm"),
    "words": (
        ["base", "shoulder", "elbow", "wrist1", "wrist2", "wrist3"],
        "x Ist",
        "mm",
    ),
}
"""Headers of joints, that of x, and the unit of lengths; angles are in degrees."""


@pytest.mark.parametrize("name", HEADERS)
def test_headers_of_other_software(name: str):
    joints, x, unit = HEADERS[name]
    words = "simulate space6 --model position --count 40 --noise 1e-4 --seed 1 -o a.csv"
    assert run(words) == 0
    last = x.lower().rindex("x")

    def renamed(header: list[str], rows: list[list[str]]):
        axes = [
            x[:last] + (a if x[last] == "x" else a.upper()) + x[last + 1 :]
            for a in "xyz"
        ]
        # What was commanded is not what was measured, a speed is no position.
        names = [
            *(f"qd{k}" for k in range(1, 7)),
            *joints,
            *axes,
            "X_cmd",
            "Y_cmd",
            "Z_cmd",
        ]
        kept = [header.index(name) for name in (*header[:6], "x", "y", "z")]
        cells = []
        for row in rows:
            numbers = np.array([float(row[k]) for k in kept])
            numbers *= [180.0 / np.pi] * 6 + [1e3 if unit == "mm" else 1.0] * 3
            speeds, goals = 0.1 * numbers[::-1][:6], numbers[6:] + 20.0 * numbers[:3]
            cells.append([f"{v:.9f}" for v in (*speeds, *numbers, *goals)])
        return names, cells

    before, after = held_out(calibrated("space6", rewritten("a.csv", renamed)))
    assert after < 0.3e-3 < 1e-3 < before


def test_measured_joints_and_not_commanded_ones():
    words = "simulate space6 --model position --count 40 --noise 1e-4 --seed 1 -o a.csv"
    assert run(words) == 0

    def both(header: list[str], rows: list[list[str]]):
        names = [f"q{k}_{what}" for what in ("cmd", "actual") for k in range(1, 7)]
        return [*names, *header[6:]], [[*row[:6], *row] for row in rows]

    assert run(["init", "space6", rewritten("a.csv", both), "-o", "setup.yaml"]) == 0
    assert read_setup("setup.yaml").columns["joint_3"] == "q3_actual"


def test_what_fits_no_robot_is_said(capsys):
    words = "simulate space6 --model position --count 40 --noise 1e-4 --seed 1 -o a.csv"
    assert run(words) == 0
    rng = np.random.default_rng(0)

    def noise(header: list[str], rows: list[list[str]]):
        drawn = rng.normal(size=(len(rows), 3)).tolist()
        names = [f"{name} [rad]" for name in header[:6]]
        return [*names, "x [m]", "y [m]", "z [m]"], [
            [*row[:6], *map(repr, xyz)] for row, xyz in zip(rows, drawn, strict=True)
        ]

    assert run(["init", "space6", rewritten("a.csv", noise)]) == 0
    found = capsys.readouterr()
    assert "That is NO fit" in " ".join(found.out.split())
    assert found.err == (
        "calib-pin: note: no reading of the columns fits the robot; see the draft\n"
    )


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--board charuco:7x5:0.03:0.022", "--board is that of a camera"),
        ("--distance 5mm", "--distance is that of sockets"),
        ("--tip nolink", "no link 'nolink'"),
        ("--base nolink", "no link 'nolink'"),
        ("--model camera", "u, v"),
        ("-o a.csv", "is an input of this run"),
    ],
)
def test_options_that_do_not_fit(words: str, said: str, capsys):
    made = "simulate space6 --model position --count 12 --noise 1e-4 --seed 1 -o a.csv"
    assert run(made) == 0
    capsys.readouterr()
    assert run(f"init space6 a.csv {words}") == 1
    found = capsys.readouterr()
    assert said in found.err and found.err.count("\n") == 1 and found.out == ""


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "foreign.csv"),
        ("a,b\n1,2\n", "no columns are found for the joints of the robot"),
        ("\x00\x01\x02", "foreign.csv"),
        (",".join(f"joint_{k}" for k in range(1, 7)) + "\n", "foreign.csv"),
        (
            ",".join(f"joint_{k}" for k in range(1, 7)) + ",x,y,z\n" + "0," * 8 + "0\n",
            "1 measurement (3 numbers) are too few",
        ),
    ],
)
def test_files_that_are_none(text: str, said: str, capsys):
    Path("foreign.csv").write_text(text)
    assert run("init space6 foreign.csv -o setup.yaml") == 1
    found = capsys.readouterr()
    assert said in found.err and found.err.count("\n") == 1 and found.out == ""
    assert not Path("setup.yaml").exists()


def test_units_that_nothing_tells_are_asked_for(capsys):
    """Positions that have nothing to do with the joints fit in any unit."""
    rng = np.random.default_rng(0)
    header = ",".join([*(f"joint_{k}" for k in range(1, 7)), "x", "y", "z"])
    rows = rng.uniform(-1.0, 1.0, (30, 9))
    np.savetxt("any.csv", rows, delimiter=",", header=header, comments="")
    assert run("init space6 any.csv -o setup.yaml") == 1
    assert "state the units in the header" in capsys.readouterr().err
    assert not Path("setup.yaml").exists()


def test_an_existing_file_is_kept(capsys):
    words = "simulate space6 --model position --count 40 --noise 1e-4 --seed 1 -o a.csv"
    assert run(words) == 0
    Path("setup.yaml").write_text("mine: 1\n")
    assert run("init space6 a.csv -o setup.yaml") == 1
    assert "exists already" in capsys.readouterr().err
    assert Path("setup.yaml").read_text() == "mine: 1\n"
    assert run("init space6 a.csv -o setup.yaml --force") == 0
    assert read_setup("setup.yaml").tip == "tool"


@pytest.mark.parametrize("length", ["fifty", "-5 mm", "5 furlongs", "mm"])
def test_lengths_that_are_none(length: str, capsys):
    with pytest.raises(module.OptionError, match="is no length"):
        module._length(length)


@pytest.mark.parametrize(
    ("text", "value"), [("50 mm", 0.05), ("0.05", 0.05), ("2[in]", 0.0508)]
)
def test_lengths(text: str, value: float):
    assert module._length(text) == pytest.approx(value, rel=1e-12)
