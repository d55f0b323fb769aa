"""`calib-pin init`: its draft calibrates without an edit."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import chdir
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import calib_pin
from calib_pin.cli import main
from calib_pin.io.measurements import read_measurements
from calib_pin.io.setup import read_setup
from calib_pin.kinematics.spatial import Floats
from tests.cli.files import document, numbers, table, write
from tests.shared import joint, urdf_of

JOINTS = [f"joint_{k}" for k in range(1, 7)]
INIT = "init space6 foreign.csv -o setup.yaml"


pytestmark = pytest.mark.usefixtures("alone")


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Floats:
    """Joint positions and points of space6: forty rows of nine numbers."""
    words = "simulate space6 --model position --count 40 --noise 1e-4 --seed 1 -o a.csv"
    with chdir(tmp_path_factory.mktemp("measured")):
        assert main(words.split()) == 0
        return numbers("a.csv")[:, :9]


def calibrated(robot: str, file: Path | str, *words: str) -> dict[str, Any]:
    """The document of a calibration with the draft of `init`, as it is."""
    assert main(["init", robot, str(file), *words, "-o", "setup.yaml"]) == 0
    assert read_setup("setup.yaml").parameters == ("placement",)
    again = ["calibrate", robot, str(file), "--setup", "setup.yaml", "-o", "out"]
    assert main([*again, "--quiet"]) == 0
    return document("out")


def held_out(found: dict[str, Any]) -> tuple[float, float]:
    """Root mean square errors of the first quantity, nominal and calibrated."""
    errors = next(iter(found["errors"].values()))["validation"]
    return errors["before"]["rms"], errors["after"]["rms"]


def foreign(names: Sequence[str], rows: Floats) -> str:
    """Write a file of other software."""
    cells = [[f"{value:.9f}" for value in row] for row in rows.tolist()]
    write("foreign.csv", ",".join(names), cells)
    return "foreign.csv"


REAL = {
    # The folder and file, the robot, further words, the largest held-out error [m].
    "ur10": ("ur10_tmac/train.csv", "ur10_robot", (), 0.55e-3),
    "ur5": ("ur5_tracker/train.csv", "ur5_robot", (), 0.15e-3),
    "panda": ("mukca_panda/panda_1.csv", "panda", ("--distance", "50 mm"), 1.1e-3),
    "talos": ("talos_left_arm/measurements.csv", "talos_reduced", (), 0.9e-3),
    "tiago": ("tiago/train.csv", "tiago_no_hand", (), 3.35e-3),
}


@pytest.mark.parametrize(
    ("factor", "zero", "unit", "why"),
    [
        (4096 / 360, 2048, "steps/4096", "steps of servos"),
        (1.0, 0, "deg", "whole degrees"),
    ],
)
def test_an_arm_of_servos(measured, run, factor, zero, unit, why):
    """Its zeros are looked for, and expected to be off by degrees."""
    chain, q = calib_pin.load_chain("space6"), measured[:, :6] / 2.0
    points = 1e3 * chain.poses(q)[:, :3, 3]
    rows = np.round(np.hstack([zero + factor * np.degrees(q), points]))
    foreign([*JOINTS, *"xyz"], rows)
    draft = run(INIT)
    assert why in draft.out and "off by about 5 degrees" in draft.out
    setup = read_setup("setup.yaml")
    assert setup.columns["joint_1"] == f"joint_1 [{unit}]"
    assert setup.columns["x"] == "x [mm]"
    assert setup.parameters == ("joint-offset",)
    assert setup.prior == {"*.joint-offset.q": 0.087}


@pytest.mark.slow
@pytest.mark.parametrize("name", REAL)
def test_real_measurements(name, data_folder):
    file, robot, words, most = REAL[name]
    before, after = held_out(calibrated(f"example:{robot}", data_folder / file, *words))
    assert after < most and after < before


GAUGE = (
    "{tip: tool, model: sphere-contact, gauge: 5.0e-4, noise: {contact: 2.0e-5},\n"
    "frames: {tool: {xyz: [0.05, 0.08, 0.12]}},\n"
    "spheres: {a: {xyz: [0.6, 0.3, 0.4], radius: 0.15}}}\n"
)


@pytest.mark.parametrize(
    ("header", "factor", "line"),
    [
        ("Gauge Reading", -1e3, "dial: Gauge Reading [mm]  # (unit by its numbers)"),
        ("Abweichung [um]", 1e6, "deviation: Abweichung"),
    ],
)
def test_readings_of_a_gauge(run, fails, header, factor, line):
    """The draft says which sign they have; without it they are not ignored."""
    Path("gauge.yaml").write_text(GAUGE)
    assert run("simulate space6 --setup gauge.yaml --count 40 -o a.csv").status == 0
    rows = np.array([row[:7] for row in table("a.csv")[1]], float)
    foreign([*JOINTS, header], rows * [*[1.0] * 6, factor])
    draft = run("init space6 foreign.csv --model sphere-contact -o setup.yaml")
    words = " ".join(draft.out.replace("\n#", "").split())
    assert line in draft.out and "pushed in is positive" in words
    assert run("evaluate space6 foreign.csv --setup setup.yaml").err == ""
    words = "calibrate space6 foreign.csv --tip tool --model sphere-contact"
    fails(words, line.split(":")[0])


@pytest.mark.slow
def test_three_chains():
    tips = {side: f"arm_{side}_7_link" for side in ("left", "right")}
    tips["head"] = "head_2_link"
    text = "".join(f"  {name}: {{tip: {tip}}}\n" for name, tip in tips.items())
    Path("arms.yaml").write_text(f"chains:\n{text}")
    words = "simulate example:talos_reduced --setup arms.yaml --model pose --count 15"
    assert main(f"{words} --noise 2e-4 --seed 2 -o a.csv".split()) == 0
    assert main(["init", "example:talos_reduced", "a.csv", "-o", "setup.yaml"]) == 0
    chains = read_setup("setup.yaml").chains
    for name, link in tips.items():
        # Of links that the same joints move any may be the tip.
        tip, known = (
            calib_pin.load_chain("example:talos_reduced", tip=end)
            for end in (chains[name].tip, link)
        )
        assert tip.joints == known.joints


CAMERA = """tip: tool
model: camera
frames: {base: {xyz: [1.2, 0.1, 0.2], rpy: [3.1, 0, 0]}}
board: {type: charuco, columns: 7, rows: 5, square: 0.03}
camera: {mount: hand, focal: [900, 905], center: [641, 478], size: [1280, 960]}
"""
BOARD = "simulate pa10 --setup camera.yaml --seed 3 --noise 0.3"


@pytest.mark.slow
@pytest.mark.parametrize("count", [8, 24])
def test_a_camera_and_its_board(count):
    Path("camera.yaml").write_text(CAMERA)
    assert main(f"{BOARD} --count {count} -o a.csv".split()) == 0
    board = ("--board", "charuco:7x5:0.03:0.022")
    if count > 20:
        before, after = held_out(calibrated("pa10", "a.csv", *board))
        assert after < 1.0 < before
        return
    assert main(["init", "pa10", "a.csv", *board, "-o", "setup.yaml"]) == 0
    found = read_setup("setup.yaml")
    assert found.camera is not None and found.board is not None
    assert (found.camera.mount, found.camera.size) == ("hand", None)
    assert (found.board.columns, found.board.rows) == (7, 5)
    # As detect writes it.
    words = "init pa10 a.csv --setup camera.yaml -o both.yaml"
    assert main(words.split()) == 0
    both, given = read_setup("both.yaml"), read_setup("camera.yaml")
    assert (both.board, both.camera) == (given.board, given.camera)


def test_sockets(run, fails):
    Path("sockets.yaml").write_text(
        "tip: tool\nmodel: fixed-point\n"
        "targets: {ball: {xyz: [0.02, 0.03, 0.1], estimate: true}}\n"
        "sockets: {front/0: {xyz: [0.9, 0.2, 0.4]}, front/1: {xyz: [0.9, 0.28, 0.4]},"
        " side/0: {xyz: [0.1, 0.95, 0.5]}, side/1: {xyz: [0.1, 0.95, 0.58]}}\n"
    )
    words = "simulate space6 --setup sockets.yaml --count 80 --noise 1e-4 --seed 3"
    assert main(f"{words} -o a.csv".split()) == 0
    result = run("init space6 a.csv")
    assert result.status == 0 and "front/0 and front/1" in result.err
    found = calibrated("space6", "a.csv", "--distance", "80 mm")
    assert found["setup"]["distances"][0]["value"] == 0.08
    before, after = held_out(found)
    assert after < 1e-3 < before
    for length in ("0 mm", "-5 mm", "fifty", "5 furlongs"):
        fails(["init", "space6", "a.csv", f"--distance={length}"], "--distance")


def points_of(chain: calib_pin.Chain, q: Floats, tool: Any = (0, 0, 0)) -> Floats:
    """Measured points of a tool, shape (N, 3) [m]."""
    T, rng = chain.poses(q), np.random.default_rng(1)
    found = T[:, :3, :3] @ np.array(tool, float) + T[:, :3, 3]
    return np.asarray(found + rng.normal(0.0, 1e-5, found.shape))


def twins(mirror: float) -> None:
    """A robot with two arms that make the same motions, and a file of the left one.

    Args:
        mirror: -1 for a right arm that is the mirror image of the left one, 1 for the
            same arm once more.
    """
    joints = []
    for side, sign, shift in (("left", 1.0, 0.4), ("right", mirror, -0.4)):
        places = [f"0.1 {shift} 0.3", f"0 {0.1 * sign} 0.2"]
        places += [f"0.4 {0.05 * sign} 0", f"0.3 {0.1 * sign} 0.05"]
        links = ["base", *(f"{side}_{k}" for k in range(4))]
        axes = ("0 0 1", "1 0 0", "0 1 0", "0 0 1")
        for (parent, link), place, axis in zip(
            pairwise(links), places, axes, strict=True
        ):
            name, ends = f"{link}_joint", f"{parent} {link}"
            joints.append(joint(name, ends, place, axis, limits="-2 2"))
    Path("twins.urdf").write_text(urdf_of(*joints))
    chain = calib_pin.load_chain("twins.urdf", tip="left_3")
    q = np.random.default_rng(0).uniform(-1.5, 1.5, (40, 4))
    names = [f"{side}_{k}_joint" for side in ("left", "right") for k in range(4)]
    foreign([*names, *"xyz"], np.hstack([q, q, points_of(chain, q)]))


def test_the_arm_that_fits_is_the_one_that_was_measured(run, fails):
    """Of two that are the same and move alike an option says which."""
    twins(mirror=-1.0)
    assert run("init twins.urdf foreign.csv -o setup.yaml").status == 0
    assert read_setup("setup.yaml").tip == "left_3"
    twins(mirror=1.0)
    fails("init twins.urdf foreign.csv", "--tip")
    result = run("init twins.urdf foreign.csv --tip right_3")
    assert result.status == 0 and "\ntip: right_3\n" in result.out


def test_a_gripper_in_percent(run):
    """It stands still, and names of its columns have words around those of joints."""
    chain = calib_pin.load_chain("example:so101", tip="gripper_frame_link")
    q = chain.random_configurations(40, np.random.default_rng(0))
    percent = np.full((40, 1), 37.5)
    rows = np.hstack([q + 0.001, q, percent, points_of(chain, q)])
    names = [f"goal/{joint}/angle" for joint in chain.joints]
    names += [f"state/{joint}/angle" for joint in [*chain.joints, "gripper"]]
    foreign([*names, *"xyz"], rows)
    assert run("init example:so101 foreign.csv -o setup.yaml").status == 0
    setup = read_setup("setup.yaml")
    assert setup.tip == "gripper_frame_link" and len(setup.columns) == 5
    assert setup.columns["elbow_flex"] == "state/elbow_flex/angle"


def test_axes_that_meet_tell_no_unit_of_lengths(fails):
    """A positioner of meters fits as well in millimeters, which nothing refuses."""
    tilt = joint("tilt_joint", "base tilt", axis="1 0 0", limits="-2 2")
    turn = joint("top_joint", "tilt top", limits="-2 2")
    Path("table.urdf").write_text(urdf_of(tilt, turn))
    chain = calib_pin.load_chain("table.urdf")
    q = chain.random_configurations(40, np.random.default_rng(0))
    points = points_of(chain, q, (0.4, 0.1, 0.2))
    foreign([*chain.joints, *"xyz"], np.hstack([q, points]))
    fails("init table.urdf foreign.csv -o setup.yaml", "units")


def test_what_fits_no_robot_is_said(run):
    """Plain headers are then in m and rad, as documented, where numbers may be."""
    drawn = np.random.default_rng(0).uniform(-1.0, 1.0, (30, 9))
    for marks in ([""] * 9, [" [rad]"] * 6 + [" [m]"] * 3):
        foreign([*map("".join, zip([*JOINTS, *"xyz"], marks, strict=True))], drawn)
        result = run("init space6 foreign.csv")
        assert result.status == 0 and "NO fit" in " ".join(result.out.split())
        assert result.err.startswith("calib-pin: note: ")


def poses_of(names: str, convention: str, spread: float = 1.0) -> Rotation:
    """Write poses with an orientation in a convention of scipy, in degrees."""
    chain, rng = calib_pin.load_chain("space6"), np.random.default_rng(0)
    q = spread * chain.random_configurations(40, rng)
    poses = chain.poses(q)
    points = 1e3 * poses[:, :3, 3] + np.sin(np.arange(120.0)).reshape(40, 3)
    off = Rotation.from_rotvec(rng.normal(scale=1e-3, size=(40, 3)))
    turns = Rotation.from_matrix(poses[:, :3, :3]) * off
    ways = {"vector": np.degrees(turns.as_rotvec()), "xyzw": turns.as_quat()}
    ways["wxyz"] = ways["xyzw"][:, [3, 0, 1, 2]]
    if convention not in ways:
        ways[convention] = turns.as_euler(convention, degrees=True)
    header = [*JOINTS, "X", "Y", "Z", *names.split()]
    foreign(header, np.hstack([np.degrees(q), points, ways[convention]]))
    return turns


@pytest.mark.parametrize(
    ("names", "convention", "first", "hold"),
    [
        ("A B C", "ZYX", "yaw: A", None),  # KUKA
        ("A B C", "xyz", "yaw: A", "intrinsic-zyx"),  # Mitsubishi
        ("q1 q2 q3 q4", "wxyz", "qw: q1", None),  # ABB
        ("quat_0 quat_1 quat_2 quat_3", "wxyz", "qx: quat_0", "wxyz"),
        ("Rx Ry Rz", "vector", "rx: Rx", None),
        ("Rx Ry Rz", "XYZ", "rx: Rx", "intrinsic-xyz"),  # Staubli
        ("A E R", "ZYZ", "roll: A", "intrinsic-zyz"),  # Comau
    ],
)
def test_orientations_as_controllers_write_them(run, names, convention, first, hold):
    """The robot tells the convention where names do not; it is said and written."""
    turns = poses_of(names, convention)
    result = run(INIT)
    setup = read_setup("setup.yaml")
    ours, theirs = first.split(": ")
    assert setup.model == "pose" and setup.columns[ours].split(" [")[0] == theirs
    assert "poses computed from them" in Path("setup.yaml").read_text()
    held = setup.reading.orientation
    assert hold == (held and held.hold) and "not used" not in result.err
    said = hold is not None or ours not in theirs.lower()
    assert ("taken for" in result.err) == said
    file, chain = Path("foreign.csv"), calib_pin.load_chain("space6")
    how = {"columns": setup.columns, "reading": setup.reading, "model": "pose"}
    read = read_measurements([file], chain, **how).blocks[0].values[:, 3:]
    assert (Rotation.from_quat(read) * turns.inv()).magnitude().max() < 1e-6


def test_conventions_that_fit_alike_are_told(run):
    """Of small turns the names count, and the others are told."""
    poses_of("Rx[deg] Ry[deg] Rz[deg]", "vector", 0.01)
    result = run(INIT)
    assert read_setup("setup.yaml").reading.orientation is None
    assert "others fit about as well: 'columns: rotation-vector, hold: " in result.err


def test_columns_beside_a_position_that_are_no_orientation(run):
    """They are not used, and said to be none; four numbers behind it may be joints."""
    poses_of("A B C", "xyz")
    header, rows, _ = table("foreign.csv")
    q, points = np.array(rows, float)[:, :6], np.array(rows, float)[:, 6:9]
    foreign([*header[:9], *"ABC"], np.hstack([q, points, 30.0 * np.sin(q[:, :3])]))
    result = run(INIT)
    assert read_setup("setup.yaml").model == "position"
    assert "columns ignored: A, B, C" in result.err
    names = ["X", "Y", "Z", *(f"q{k}" for k in range(1, 7))]
    foreign(names, np.hstack([points, q]))
    assert run(f"{INIT} --force").status == 0
    assert read_setup("setup.yaml").columns["joint_1"].startswith("q1")


def test_names_that_tell_stations_or_tools_apart_are_told(measured, run):
    """Where the robot fits with them, or with nothing; not where it fits anyway."""
    names, rows = [*JOINTS, *"xyz", "Aufstellung"], measured.tolist()
    moved = {"vorn": 0.0, "links": 0.7, "hinten": -1.1}
    for scale, told in ((1.0, "named station in 'columns'"), (0.0, "")):
        cells = [
            [*row[:7], row[7] + scale * step, row[8] - scale * step, name]
            for row, (name, step) in zip(rows, [*moved.items()] * 14, strict=False)
        ]
        write("foreign.csv", ",".join(names), cells)
        result = run(f"{INIT} --force")
        assert ("'Aufstellung' has 3 names" in result.err) == bool(told)
        assert told in result.err
    mixed = [[*row[:6], *rows[k - 7][6:], "ab"[k % 2]] for k, row in enumerate(rows)]
    write("foreign.csv", ",".join(names), mixed)
    assert "does it tell station, tool, target apart" in run(f"{INIT} --force").err


@pytest.mark.parametrize("apart", [3e-3, 0.0])
def test_tools_that_are_less_apart_than_the_robot_errs_are_told(measured, run, apart):
    """Reflectors in turn, 3 mm apart: a fit leaves 1.7 mm, and looks good."""
    shift = calib_pin.load_chain("space6").poses(measured[:, :6])[:, :3, 0]
    shift *= apart * (np.arange(len(measured)) % 2)[:, None]
    rows = np.hstack([measured[:, :6], measured[:, 6:] + shift]).tolist()
    cells = [[*row, "AB"[k % 2]] for k, row in enumerate(rows)]
    write("foreign.csv", ",".join([*JOINTS, *"xyz", "Reflector"]), cells)
    told = run(INIT).err
    assert ("'Reflector' has 2 names that repeat: named tool or target" in told) == (
        apart > 0.0
    )
    assert ("% of the errors of a fit" in told) == (apart > 0.0)


def test_thousands_that_were_read_as_the_whole_are_told(measured, run):
    """1.541 for 1541 mm; numbers with three decimals throughout are none."""
    points = [[round(1e3 * number) for number in row[6:]] for row in measured.tolist()]
    angles = np.degrees(measured[:, :6]).round(3).tolist()
    for form, told in (("{:,}", True), ("{:.3f}", False)):
        marked = [[form.format(n).replace(",", ".") for n in row] for row in points]
        cells = [q + p for q, p in zip(angles, marked, strict=True)]
        write("foreign.csv", ",".join([*JOINTS, *"xyz"]), cells)
        assert ("no mark between thousands" in run(f"{INIT} --force").err) == told


def test_poses_of_a_board_in_the_camera_of_the_hand(run):
    """As OpenCV states them."""
    assert run("simulate space6 --model pose --count 30 --seed 1 -o a.csv").status == 0
    rows, T = numbers("a.csv"), np.tile(np.eye(4), (30, 1, 1))
    T[:, :3, :3] = Rotation.from_quat(rows[:, 9:13]).as_matrix()
    T[:, :3, 3] = rows[:, 6:9]
    seen = np.linalg.inv(T)
    position = [f"t_target2cam_{k}" for k in range(3)]
    names = [*JOINTS, *position, *(f"R_target2cam_{k}" for k in range(9))]
    cells = seen[:, :3, :3].reshape(30, 9)
    foreign(names, np.hstack([rows[:, :6], seen[:, :3, 3], cells]))
    assert run(INIT).status == 0
    setup = read_setup("setup.yaml")
    assert setup.reading.inverted and setup.parameters == ("placement",)
    assert setup.columns["x"] == position[0]


def test_of_two_positions_the_other_is_told(measured, run):
    rng = np.random.default_rng(0)
    q, points = measured[:, :6], measured[:, 6:]
    other = points + rng.normal(scale=1e-3, size=points.shape)
    axes = [f"{name}_{axis}" for name in ("one", "two") for axis in "xyz"]
    rows = np.hstack([q, points, other])
    result = run(INIT.replace("foreign.csv", foreign([*JOINTS, *axes], rows)))
    assert result.status == 0 and "'two_x' fits to" in result.err
    assert read_setup("setup.yaml").columns["x"] == "one_x"


def test_cells_that_are_no_numbers_are_shown(measured, fails):
    """And u, v, w beside a position are no pixels."""
    cells = [[f"{value:.3f}" for value in row] for row in measured.tolist()]
    marked = [[f"{cell} deg" for cell in row[:6]] + row[6:] for row in cells]
    write("foreign.csv", "J1,J2,J3,J4,J5,J6,x,y,z", marked)
    fails(INIT, f"'J1' has no numbers, but '{marked[0][0]}'")
    foreign([*JOINTS, *"xyzUVW"], measured[:, [*range(9), 0, 1, 2]])
    assert main(INIT.split()) == 0
    assert read_setup("setup.yaml").model == "position"


@pytest.mark.slow
def test_faults_of_a_file_are_told_and_not_those_of_a_unit(measured, fails, run):
    """Where no reading can be used; other words of a set are none of ours."""
    rows = measured * [*[180.0 / np.pi] * 6, *[1e3] * 3]
    foreign(["J1", "J2", "J3", "J4", "J5", "J6", *"XYZ"], rows[:4])
    fails(INIT, "too few")
    cells = [[f"{k:.6f}" for k in row] for row in rows.tolist()]
    write("foreign.csv", "J1,J2,J3,J4,J5,J6,Hz,V,D", cells)
    fails(INIT, "no position or distance is found")
    cells = [[*row, ("new", "old")[k % 2]] for k, row in enumerate(cells)]
    write("foreign.csv", "J1,J2,J3,J4,J5,J6,X,Y,Z,Set", cells)
    assert "columns ignored: Set" in run(INIT).err


@pytest.mark.slow
def test_joints_are_exchanged_only_where_that_fits(measured, run):
    """Of a frame that is left-handed nothing fits, and columns keep their order."""
    names = [f"J{k}" for k in range(1, 7)]
    foreign([*names, *"xyz"], measured[:15] * [*[1.0] * 8, -1.0])
    assert "NO fit" in " ".join(run(INIT).out.split())
    columns = read_setup("setup.yaml").columns
    assert [columns[joint] for joint in JOINTS] == names


@pytest.mark.slow
def test_the_draft_of_a_reversed_joint_leads_to_its_name(measured, run, sought):
    foreign([*JOINTS, *"xyz"], measured * [1, 1, -1, 1, 1, 1, 1, 1, 1])
    assert run(INIT).status == 0
    found = run("calibrate space6 foreign.csv --setup setup.yaml")
    assert found.status == 2 and "'joint_3' is reversed" in found.out
