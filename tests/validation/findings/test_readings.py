"""Other robots, links, frames, targets, columns and conventions are told from data."""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import calib_pin
from benchmarks.verdict.jobs import draw, stream
from calib_pin.cli.files import open_chains, open_rows
from calib_pin.cli.options import OfRobot
from calib_pin.errors import InputError
from calib_pin.estimation.evidence import Finding
from calib_pin.estimation.fit import fit_model
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.io.measurements import encode_table
from calib_pin.io.setup import read_setup
from calib_pin.io.urdf import other_robots
from calib_pin.kinematics.chains import Chains
from calib_pin.observations import Observations
from calib_pin.setup import (
    STATED,
    BoardSetup,
    CameraSetup,
    DistanceSetup,
    FrameSetup,
    JointMap,
    PointSetup,
    Setup,
    SphereSetup,
)
from calib_pin.validation.findings.alternatives import (
    Alternative,
    Explanation,
    Family,
    explain,
    findings_of,
    read_with,
)
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.readings import (
    instruments,
    joint_columns,
    line_order,
    orientations,
    robots,
    standing,
    target_frames,
    target_names,
    targets,
)
from calib_pin.validation.findings.sentences import written
from tests.shared import simulated

TOOL = FrameSetup((0.05, 0.08, 0.12), (0.2, -0.3, 0.1))
UR5, UR10 = "example:ur5_robot", "example:ur10_robot"
WHOLE = calib_pin.load_chain(UR10, base="base_link", tip="tool0")


def of_robot(chains, rows, setup=None, known=tuple):
    case = Case.of_robot(Chains.of(chains), rows, setup or Setup(), known)
    assert case.doubtful
    found = explain(case, (robots,))
    return [] if found is None else list(findings_of(case, found))


@pytest.fixture(scope="module")
def file(tmp_path_factory, ur10):
    path = tmp_path_factory.mktemp("robot") / "rows.csv"
    calib_pin.write_measurements(path, ur10(count=50))
    return path


def read(file):
    return lambda chains: calib_pin.read_measurements(file, chains)


def test_wrong_robot(file) -> None:
    chains = calib_pin.load_chains(UR5, base="base_link", tip="tool0")
    setup, rows = Setup(base="base_link", tip="tool0"), read(file)(chains)
    (found,) = of_robot(chains, rows, setup, partial(other_robots, chains, setup))
    assert (found.code, found.severity, found.setup) == ("robot", "error", {})
    assert UR10 in found.message and UR10 in found.remedy and UR5 in found.remedy
    assert of_robot(chains, rows, setup) == []


@pytest.mark.parametrize(
    ("code", "ends"),
    [
        ("tip-link", {"base": "base_link", "tip": "wrist_2_link"}),
        ("base-link", {"base": "shoulder_link", "tip": "tool0"}),
    ],
)
def test_wrong_link_of_which_the_file_has_the_joints(file, code, ends) -> None:
    chains = calib_pin.load_chains(UR10, **ends)
    (found,) = of_robot(chains, read(file)(chains))
    assert found.code == code
    lines = {"tip-link": {"tip": "wrist_3_link"}, "base-link": {"base": "base_link"}}
    assert found.setup == lines[code]


def told_by(robot, rows, setup=None):
    """The findings that lead to no trust."""
    chain = calib_pin.load_chain(robot, tip="tool")
    found = calib_pin.calibrate(chain, rows, setup, validate=False).findings
    return [one for one in found if one.severity == "error"]


@pytest.mark.parametrize(
    "frame",
    [pytest.param(False, marks=pytest.mark.slow), True],
    ids=["controller", "frame"],
)
def test_signs_of_a_controller_look_like_a_left_handed_frame(erring, frame) -> None:
    """KUKA counts A1, A4 and A6 the other way; both are named."""
    rows = erring("heavy6", Setup(tool_frame=TOOL), 3, count=50).only
    change = {"values": rows.values * [1.0, 1.0, -1.0]}
    if not frame:
        change = {"q": rows.q * [-1.0, 1.0, 1.0, -1.0, 1.0, -1.0]}
    (found,) = told_by("heavy6", replace(rows, **change))
    assert found.code == "joint-reversed" and "left-handed" in found.message
    lines = found.setup["joints"].items()
    turned = {name: {"joint": name, "sign": -1} for name in ("joint_1", "joint_4")}
    assert dict(lines) == turned | {"joint_6": {"joint": "joint_6", "sign": -1}}
    assert "axes: [x, y, -z]" in found.remedy
    # A point that is known beside the plane of the arm tells them apart.
    known = Setup(tool_frame=replace(TOOL, estimate=False))
    codes = {f.code for f in told_by("heavy6", replace(rows, **change), known)}
    assert codes == {"left-handed-frame" if frame else "joint-reversed"}


def test_a_reading_that_leaves_half_a_meter_is_no_cause(erring) -> None:
    """Zeros of A2 and A3 are a quarter of a turn elsewhere as well: three faults."""
    rows = erring("heavy6", Setup(tool_frame=TOOL), 3, count=50).only
    q = rows.q * [-1, 1, 1, -1, 1, -1] + np.radians([0, -90, 90, 0, 0, 0])
    chain = calib_pin.load_chain("heavy6", tip="tool")
    fitted = fit_model(chain, replace(rows, q=q), Setup(), 0)

    def zeros(case: Case) -> list[Alternative]:
        return [one for one in joint_columns(case) if one.code == "joint-offset"]

    assert explain(Case.of(fitted), (zeros,)) is None


def test_a_tool_that_touches_sockets_beyond_the_stated_tip(tmp_path) -> None:
    """A longer chain touches one point the worse, unless it is the one that does."""
    sockets = {name: PointSetup((x, 0.3, 0.4)) for name, x in [("a", 0.5), ("b", -0.5)]}
    setup = Setup(tool_frame=TOOL, sockets=sockets)
    problem, _ = simulated("fixed-point", setup, 40, 1.0, 2, robot=WHOLE, noise=1e-4)
    calib_pin.write_measurements(tmp_path / "rows.csv", problem.data)
    short = calib_pin.load_chains(UR10, base="base_link", tip="wrist_2_link")
    for chains, expected in ((short, ["tip-link"]), (Chains.of(WHOLE), [])):
        rows = calib_pin.read_measurements(
            tmp_path / "rows.csv", chains, model="fixed-point"
        )
        found = explain(Case.of_robot(chains, rows, Setup()), (robots,))
        assert [fault.code for fault in (found.faults if found else ())] == expected


def test_tip_behind_the_measured_link() -> None:
    """The joints of the measured link are among those that were read."""
    short = calib_pin.load_chain(UR10, base="base_link", tip="wrist_1_link")
    rng = np.random.default_rng(0)
    q = WHOLE.random_configurations(50, rng)
    setup, how = Setup(tool_frame=TOOL), {"q": q[:, :4], "noise": 1e-4}
    job, _ = simulated("position", setup, size=1.0, robot=short, **how)
    values, joints = job.data.only.values, WHOLE.joints
    rows = calib_pin.Measurements(joints=joints, q=q, model="position", values=values)
    (found,) = of_robot(WHOLE, Observations.of(rows))
    assert found.setup == {"tip": "wrist_1_link"}


KNOWN = {
    "base_frame": FrameSetup((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), estimate=False),
    "tool_frame": replace(TOOL, estimate=False),
}
NEAR = FrameSetup((0.08, 0.08, 0.12), TOOL.rpy, estimate=False)


@pytest.mark.parametrize(
    ("code", "frame", "known"),
    [
        ("tool-frame", NEAR, {"parameters": ("joint-offset",)}),
        ("base-frame", NEAR, {"parameters": ("joint-offset",)}),
        ("base-frame", FrameSetup(rpy=(0.0, 0.0, np.pi)), KNOWN),
        ("base-frame", FrameSetup(rpy=(np.pi, 0.0, 0.0)), KNOWN),
        ("base-frame", FrameSetup((0.3, 0.0, 0.0)), KNOWN),
        ("tool-frame", FrameSetup((0.05, 0.08, 0.27), TOOL.rpy), KNOWN),
    ],
)
def test_a_frame_that_is_stated_wrongly(code, frame, known, ur10) -> None:
    """Half a turn, too, where nothing is fitted from what was stated."""
    end = code.removesuffix("-frame")
    wrong = {f"{end}_frame": replace(frame, estimate=False)}
    (found,) = of_robot(WHOLE, ur10(count=50), Setup(**{**known, **wrong}))
    assert found.code == code
    assert found.setup == {"frames": {end: {"estimate": True}}}


def imaged(
    mount: str, away: float, board: Mapping[str, PointSetup] | None = None
) -> tuple[Chains, Observations, Setup]:
    """Thirty images of points, of four by default, and the setup of the camera."""
    board = board or {
        name: PointSetup((0.1 + 0.05 * (k % 2), 0.05 * (k // 2), 0.15))
        for k, name in enumerate("abcd")
    }
    camera = CameraSetup(mount, (900.0, 910.0), (4500.0, 4500.0))
    setup = Setup(camera=camera, targets=board)
    far = FrameSetup((0.1, -0.2, away))
    problem = nominal_problem(WHOLE, "camera", replace(setup, base_frame=far))
    rng = np.random.default_rng(0)
    theta = calib_pin.draw_errors(problem.parameters, rng)
    q = WHOLE.random_configurations(2000, rng)
    if mount == "hand":
        # The board is below, in front of the lens.
        T = WHOLE.poses(q)
        q = q[(T[:, 2, 2] < -0.9) & (T[:, 2, 3] > -0.5)]
    q = np.repeat(q[:30], len(board), axis=0)
    names = tuple([*board] * (len(q) // len(board)))
    rows = calib_pin.simulate(problem, theta, rng, q=q, target=names, noise=0.2)
    return Chains.of(WHOLE), rows, setup


def test_corners_that_are_counted_from_one() -> None:
    """Of ids of 1 to 24 a shift of lines looked like the cause, and 24 is no corner."""
    chains, rows, setup = imaged("world", 4.0)
    board = BoardSetup("chessboard", 3, 3, 0.05)
    named = tuple(str("abcd".index(name) + 1) for name in rows.only.target)
    rows = Observations.of(replace(rows.only, target=named))
    setup = replace(setup, targets={}, board=board)
    with pytest.raises(InputError, match=r"begin with 1, .* subtract 1 from each"):
        calib_pin.calibrate(chains, rows, setup)


@pytest.mark.slow
def test_corners_of_tags_that_are_counted_counterclockwise() -> None:
    """As detectors of AprilTags give them, from the lower left one."""
    board = BoardSetup("apriltag", 2, 2, 0.05, gap=0.02)
    chains, rows, setup = imaged("hand", 1.8, board.points)
    named = tuple(f"{name[:2]}{3 - int(name[2])}" for name in rows.only.target)
    rows = Observations.of(replace(rows.only, target=named))
    setup = replace(setup, targets={}, board=board)
    found = explain(Case.of_none(chains, rows, setup), (target_names,))
    assert found is not None and found.after < 0.2 * found.before
    assert "not counted clockwise" in found.faults[0].words


@pytest.mark.parametrize(
    ("mount", "away", "square"), [("world", 4.0, 0.2), ("hand", 1.8, 0.05)]
)
def test_images_of_a_board_that_looks_the_same_turned(mount, away, square) -> None:
    """As it is found where the camera rolls; up to a third would be outliers."""
    board = BoardSetup("chessboard", 5, 3, square)
    chains, rows, setup = imaged(mount, away, board.points)
    turned = np.arange(len(rows)) // 8 * 7 % 10 < 4
    pairs = zip(rows.target, turned.tolist(), strict=True)
    named = tuple(str(7 - int(name)) if other else name for name, other in pairs)
    wrong = Observations.of(replace(rows.only, target=named))
    case = Case.of_none(chains, wrong, replace(setup, targets={}, board=board))
    found = explain(case, (target_names,))
    assert found is not None
    (fault,) = found.faults
    assert read_with(wrong, [fault]).target == rows.target
    assert "as 12 of 30 images" in fault.words and "the other end" in fault.advice


def of_camera(
    chains: Chains, rows: Observations, camera: CameraSetup, setup: Setup
) -> Finding:
    """What explains images that are said to be of a camera."""
    case = Case.of_none(chains, rows, replace(setup, camera=camera))
    found = explain(case, (instruments, robots))
    assert found is not None
    (one,) = findings_of(case, found)
    return one


@pytest.mark.parametrize(
    ("mount", "said", "away"), [("world", "hand", 4.0), ("hand", "world", 1.8)]
)
def test_a_camera_that_is_somewhere_else(mount, said, away) -> None:
    """What stands still is said to move with the tool, or the other way round."""
    chains, rows, setup = imaged(mount, away)
    one = of_camera(chains, rows, replace(setup.camera, mount=said), setup)
    assert (one.code, one.setup) == ("camera-mount", {"camera": {"mount": mount}})


@pytest.mark.parametrize("factor", [0.5, pytest.param(1.2, marks=pytest.mark.slow)])
def test_a_camera_with_another_lens(factor: float) -> None:
    """Of images of half the size, say, where those of the whole one are stated."""
    chains, rows, setup = imaged("hand", 1.8)
    focal, center = setup.camera.focal, setup.camera.center
    wrong = replace(
        setup.camera,
        focal=(factor * focal[0], factor * focal[1]),
        center=(factor * center[0], factor * center[1]),
    )
    one = of_camera(chains, rows, wrong, setup)
    stated = {"camera": {"estimate": True}}
    assert (one.code, one.setup) == ("camera-intrinsics", stated)


@pytest.mark.slow
@pytest.mark.parametrize(("factor", "codes"), [(1.02, ["camera-intrinsics"]), (1, [])])
def test_a_lens_that_is_a_little_off(factor: float, codes: list[str]) -> None:
    """A fit hides a part of it, and promises what it does not keep."""
    chains, rows, setup = imaged("hand", 1.8)
    focal = tuple(factor * number for number in setup.camera.focal)
    stated = replace(setup, camera=replace(setup.camera, focal=focal))
    result = calib_pin.calibrate(chains, rows, stated, validate=False)
    assert [f.code for f in result.findings if f.severity != "info"] == codes


def test_rows_and_columns_of_an_image() -> None:
    chains, rows, setup = imaged("hand", 1.8)
    turned = replace(rows.only, values=rows.only.values[:, ::-1])
    one = of_camera(chains, Observations((turned,)), setup.camera, setup)
    assert one.code == "image-axes" and "names of these columns" in one.remedy


def test_rows_of_an_image_that_are_counted_from_below() -> None:
    """Which leaves a mirror image, as exchanged axes do."""
    chains, rows, setup = imaged("hand", 1.8)
    camera = replace(setup.camera, size=(9000.0, 9000.0), center=(4300.0, 4600.0))
    u, v = (rows.only.values + np.array([-200.0, 100.0])).T
    below = replace(rows.only, values=np.column_stack([u, 8999.0 - v]))
    one = of_camera(chains, Observations((below,)), camera, setup)
    assert one.code == "image-axes" and "take 8999 - v" in one.remedy


@pytest.mark.slow
def test_a_wire_that_reads_too_much() -> None:
    """One hundred and twenty distances, 50 mm too long, each a value of its own."""
    job = draw(3, robot="space6", model="point-distance", least=120, noise=1e-4)
    rows = job.measured(stream(3, 1))
    long, setup = (
        replace(rows, values=rows.values + 0.04),
        replace(job.setup, anchors={}),
    )
    result = calib_pin.calibrate(job.chain, long, setup, validate=False)
    (one,) = (f for f in result.findings if f.severity == "error")
    assert one.code == "held-number"
    names = set(rows.target)
    assert one.setup == {"anchors": {n: {"estimate_bias": True} for n in names}}


@pytest.mark.parametrize(("off", "codes"), [(5e-4, ["held-number"]), (0.0, [])])
def test_a_radius_that_is_held_wrong(erring, off: float, codes: list[str]) -> None:
    """Of spheres on a plate, or of the ball of a probe: gears would explain a part."""
    places = {"a": (0.9, 0.3, 0.4), "b": (0.9, -0.1, 0.4), "c": (0.6, 0.1, 0.5)}
    spheres = {n: SphereSetup(place, 0.0127) for n, place in places.items()}
    stylus = {"stylus": PointSetup((0.05, 0.0, 0.12), estimate=True)}
    setup = Setup(targets=stylus, spheres=spheres)
    how = {"count": 120, "target": tuple("abc") * 40}
    rows = erring(ARM, setup, 2, "sphere-contact", noise=2e-5, **how)
    apart = [np.linalg.norm(np.subtract(places["a"], places[n])) for n in "bc"]
    plate = [
        DistanceSetup(("a", n), float(size), 5e-6)
        for n, size in zip("bc", apart, strict=True)
    ]
    held = {n: replace(one, radius=0.0127 + off) for n, one in spheres.items()}
    stated = replace(setup, spheres=held, distances=tuple(plate))
    result = calib_pin.calibrate(ARM, rows, stated, validate=False)
    assert [f.code for f in result.findings if f.severity != "info"] == codes
    for one in result.findings[: len(codes)]:
        lines = {name: {"estimate_radius": True} for name in spheres}
        assert one.setup == {"spheres": lines}


ARM = calib_pin.load_chain("space6")
NAMES = ("a", "b", "c")


def compared(data: Observations) -> Case:
    return Case.of_robot(Chains.of(ARM), data, Setup())


def test_a_target_is_left_out(erring) -> None:
    """Three points of the tool, the last of which is off in a new way each time."""
    points = {n: PointSetup((0.1 * k, 0.05, 0.2)) for k, n in enumerate(NAMES)}
    rows = erring(ARM, Setup(targets=points), 4, count=90, target=NAMES * 30).only
    values = rows.values.copy()
    values[2::3] += 0.05 * np.random.default_rng(4).normal(size=(30, 3))
    files, lines = ("m.csv",) * 90, np.arange(2, 92)
    rows = replace(rows, values=values, lines=lines, files=files)
    found = explain(compared(Observations.of(rows)), (targets,))
    assert found is not None
    (fault,) = found.faults
    assert fault.code == "target"
    assert fault.reading.without == tuple(str(line) for line in range(4, 92, 3))
    assert found.after < 0.5 * found.before


def test_groups_with_a_tool_of_their_own() -> None:
    """Three points of one tool, and three of another that the file does not tell."""
    names = [f"{tool}/{name}" for tool in ("old", "new") for name in NAMES]
    points = {
        n: PointSetup((0.1 * (k % 3), 0.05, 0.2), False) for k, n in enumerate(names)
    }
    tools = [
        FrameSetup((0.0, 0.0, 0.1)),
        FrameSetup((0.05, -0.2, 0.0), (0.3, 0.0, 1.0)),
    ]
    parts = []
    for k, frame in enumerate(tools):
        own = names[3 * k : 3 * k + 3]
        setup = Setup(targets={n: points[n] for n in own}, tool_frame=frame)
        how = {"noise": 1e-4, "target": tuple(own) * 15}
        parts.append(simulated("position", setup, 45, seed=k, **how)[0].data.only)
    data = Observations.of(*(replace(part, sigma=None) for part in parts))
    case = Case.of_robot(Chains.of(ARM), data, Setup(targets=points))
    found = explain(case, (targets, target_frames))
    assert found is not None
    (fault,) = found.faults
    assert fault.code == "target-frames"
    assert fault.advice == "give each a tool of its own (a column 'tool')"


PLACES = ((0.1, 0.0), (0.15, 0.0), (0.1, 0.05), (0.19, 0.05))
BOARD = {n: PointSetup((*at, 0.15)) for n, at in zip("abcd", PLACES, strict=True)}
CAMERA = CameraSetup("world", (900.0, 910.0), (640.0, 500.0))
SEEN = Setup(camera=CAMERA, targets=BOARD)


def images(count: int) -> calib_pin.Measurements:
    """Corners of a board in so many images."""
    away = FrameSetup((0.1, -0.2, 6.0), (0.3, -0.2, 0.4))
    q = np.repeat(ARM.random_configurations(count, np.random.default_rng(2)), 4, axis=0)
    how = {"robot": ARM, "q": q, "target": tuple("abcd" * count), "noise": 0.2}
    job, _ = simulated("camera", replace(SEEN, base_frame=away), 0, 1.0, 2, **how)
    rows = job.data.only
    lines = np.arange(2, len(rows) + 2)
    return replace(rows, lines=lines, files=("m.csv",) * len(rows))


def explained(rows: calib_pin.Measurements, *families: Family) -> Explanation:
    case = Case.of_none(Chains.of(ARM), Observations.of(rows), SEEN)
    found = explain(case, families)
    assert found is not None
    return found


@pytest.mark.slow
def test_a_board_whose_lines_are_shifted_has_no_wrong_corner() -> None:
    """Three of four corners keep their joints if the lines are shifted by one."""
    rows = images(60)
    below = replace(rows.rows(np.arange(1, 240)), q=rows.q[:-1])
    found = explained(below, line_order, targets)
    assert [fault.reading.shift for fault in found.faults] == [1]
    assert found.after < 0.4


def test_corners_that_have_the_name_of_each_other() -> None:
    """Of twelve images the closed form is farther off than by two corners."""
    rows = images(12)
    target = tuple({"a": "c", "c": "a"}.get(name, name) for name in rows.target)
    found = explained(replace(rows, target=target), targets, target_names)
    (fault,) = found.faults
    assert fault.code == "targets-exchanged"
    assert "'a' and 'c'" in fault.words or "'c' and 'a'" in fault.words
    assert found.after < 1.0 < found.before


def test_images_during_which_an_encoder_stood_still() -> None:
    """The last nine of twenty; of fewer the others tell where the robot is."""
    rows = images(20)
    q = rows.q.copy()
    q[44:, 2] = q[44, 2]
    found = explained(replace(rows, q=q), standing, targets)
    (fault,) = found.faults
    assert fault.code == "stuck-encoder" and "joint_3" in fault.words
    assert fault.reading.without == tuple(map(str, range(46, 82)))
    assert found.after < 1.0 < found.before


Job = Callable[..., Any]
Stated = Callable[[Rotation], Any]


@pytest.fixture(scope="module")
def found(quick_case: Job) -> Job:
    """The findings of a job's measurements."""

    def find(job: Any, data: Observations) -> list[Finding]:
        case = quick_case(job.chain, data)
        explanation = explain(case, (orientations,))
        return [] if explanation is None else list(findings_of(case, explanation))

    return find


@pytest.mark.parametrize(
    ("columns", "stated", "line"),
    [
        (
            "quaternion",
            lambda R: R.inv().as_quat()[:, [3, 0, 1, 2]],
            "columns: quaternion, hold: wxyz, inverse: true",
        ),
        (
            "rotation-vector",
            lambda R: R.as_euler("ZYX"),
            "columns: rotation-vector, hold: intrinsic-zyx",
        ),
        (
            "roll-pitch-yaw",
            lambda R: R.as_euler("zxy")[:, [1, 2, 0]],
            "columns: roll-pitch-yaw, hold: rpy-zxy",
        ),
        (
            "roll-pitch-yaw",
            lambda R: R.as_euler("xyz") * np.pi / 180.0,
            "columns: roll-pitch-yaw, factor: 57.2957795",
        ),
    ],
)
def test_the_convention_and_its_lines(
    found: Job, moved_job: Job, tmp_path: Path, columns: str, stated: Stated, line: str
) -> None:
    """With the lines in the setup file the reader finds the true orientations."""
    job = moved_job((), (), 30, model="pose")
    true = job.plain.only
    table = dict(zip(true.joints, true.q.T, strict=True))
    table |= dict(zip("xyz", true.values[:, :3].T, strict=True))
    numbers = stated(Rotation.from_quat(true.values[:, 3:]))
    table |= dict(zip(STATED[columns], numbers.T, strict=True))
    file, setup = tmp_path / "poses.csv", tmp_path / "setup.yaml"
    file.write_bytes(encode_table(table, ()))
    (one,) = found(job, calib_pin.read_measurements(file, job.chain))
    assert (one.code, one.severity) == ("orientation-convention", "error")
    lines = written(one.setup)
    assert lines == f"reading: {{orientation: {{{line}}}}}" and lines in one.remedy
    setup.write_text(lines)
    again = calib_pin.read_measurements(
        file, job.chain, reading=read_setup(setup).reading
    )
    cosine = np.abs(np.sum(again.only.values[:, 3:] * true.values[:, 3:], axis=1))
    np.testing.assert_allclose(cosine, 1.0, atol=1e-12)


TO_TOOL = Setup(base="base_link", tip="tool0")


@pytest.fixture(scope="module")
def rows_of_ur10(ur10):
    return ur10(count=60).only


@pytest.fixture
def of_file(rows_of_ur10, tmp_path):
    """The findings of a file with one column of each joint, and others beside."""

    def of(q, columns, setup=TO_TOOL):
        path = tmp_path / "rows.csv"
        calib_pin.write_measurements(path, replace(rows_of_ur10, q=q), force=True)
        with path.open() as file:
            lines = list(csv.reader(file))
        for name, values in columns.items():
            cells = [name, *map(str, values)]
            lines = [[*line, c] for line, c in zip(lines, cells, strict=True)]
        with path.open("w") as file:
            csv.writer(file).writerows(lines)
        asked = OfRobot(robot="example:ur10_robot")
        chains = open_chains(asked, setup)
        chains, rows = open_rows(asked, [path], chains, setup, quiet=True)
        result = calib_pin.calibrate(chains, rows, setup, validate=False)
        return {f.code: f for f in result.findings}

    return of


def commanded(rows_of_ur10, size):
    rng = np.random.default_rng(1)
    return rows_of_ur10.q + rng.normal(0.0, size, rows_of_ur10.q.shape)


def in_degrees(q):
    return {f"actual_{k} [deg]": np.degrees(column) for k, column in enumerate(q.T)}


def test_measured_positions_fit_better(of_file, rows_of_ur10) -> None:
    found = of_file(commanded(rows_of_ur10, 2e-3), in_degrees(rows_of_ur10.q))
    finding = found["joint-columns"]
    assert finding.severity == "error"
    assert finding.setup == {
        "joints": {
            f"actual_{k}": {"joint": j} for k, j in enumerate(rows_of_ur10.joints)
        }
    }
    assert finding.evidence["rms_after"] == pytest.approx(1.5e-4, rel=0.2)
    assert "lag" not in found


def test_worse_ones_are_not_worth_a_word(of_file, rows_of_ur10) -> None:
    """And columns that overflow are no joints."""
    columns = in_degrees(commanded(rows_of_ur10, 1e-3))
    columns["count"] = np.full(len(rows_of_ur10.q), 1e300)
    assert of_file(rows_of_ur10.q, columns) == {}


def test_maps_of_joints_are_kept(of_file, rows_of_ur10) -> None:
    """The other column of a joint counts as the first one does."""
    first, second = rows_of_ur10.joints[:2]
    joints = {
        "shoulder": JointMap(first, sign=-1, gear=2.0, offset=0.1),
        second: JointMap(second),
    }
    there = commanded(rows_of_ur10, 1e-3)
    columns = {}
    for name, positions in (("shoulder", there), ("shoulder_measured", rows_of_ur10.q)):
        columns[name] = (0.1 - positions[:, 0]) / 2.0
    setup = replace(TO_TOOL, joints=joints)
    finding = of_file(rows_of_ur10.q, columns, setup)["joint-columns"]
    assert finding.setup["joints"] == {
        "shoulder_measured": {"joint": first, "sign": -1, "gear": 2.0, "offset": 0.1},
    }
