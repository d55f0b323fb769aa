"""`accept`, and `plan --accept`: what they print and write, and what is no test."""

from __future__ import annotations

import importlib.util
import io
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import calib_pin
from calib_pin.io.measurements import encode_table
from calib_pin.io.results import read_calibration
from tests.cli.files import document, table, write

LIMITS = "tip: tool\nlimit: {position: 5.0e-4, repeatability: 2.0e-4}\n"
FRAMES = """frames:
  base: {xyz: [0, 0, 0], rpy: [0, 0, 0], estimate: false}
  tool: {xyz: [0, 0, 0], rpy: [0, 0, 0], estimate: false}
"""
REPORT = "report: {serial_number: KR 7, customer: ACME, date: 2026-11-23, load: 5 kg}\n"
ACCEPT = "accept arm.urdf visits.csv --setup limits.yaml"
CALIBRATE = "calibrate arm.urdf rows.csv --setup setup.yaml -o c"


@pytest.fixture
def visits(here) -> None:
    """Thirty cycles of five poses of the robot that `rows.csv` is of."""
    chain = calib_pin.load_chain("arm.urdf", tip="tool")
    rng = np.random.default_rng(0)
    q = np.tile(0.5 * chain.random_configurations(5, rng), (30, 1))
    moved = q + np.array([0.0, 4e-3, -6e-3, 0.0])
    points = chain.poses(moved)[:, :3, 3] + rng.normal(0.0, 1e-5, (150, 3))
    table = dict(zip(chain.joints, q.T, strict=True))
    table |= dict(zip("xyz", points.T, strict=True))
    Path("visits.csv").write_bytes(encode_table(table, []))
    Path("limits.yaml").write_text(LIMITS + FRAMES)


@pytest.fixture
def without_typst(monkeypatch) -> None:
    """The extra is not installed: no PDF is written, which takes the longest."""
    find = importlib.util.find_spec
    monkeypatch.setattr(
        "calib_pin.errors.find_spec",
        lambda name, *more: None if name == "typst" else find(name, *more),
    )


def pages(file: str) -> list[str]:
    """The text of each page."""
    from pypdf import PdfReader

    reader = PdfReader(io.BytesIO(Path(file).read_bytes()))
    return [page.extract_text() for page in reader.pages]


def test_a_robot_is_tested(visits, run, without_typst):
    """What is accepted is told by the status."""
    Path("limits.yaml").write_text(LIMITS + FRAMES + REPORT)
    result = run(f"{ACCEPT} -o out")
    assert result.status == 2
    lines = result.out.splitlines()
    assert lines[0].startswith("FAIL: AP ") and "0.5000 mm" in lines[0]
    assert lines[1].startswith("PASS: RP ")
    found = document("out/acceptance.json")
    assert found["format"] == "calib-pin/acceptance"
    assert [one["status"] for one in found["limits"]] == ["fail", "pass"]
    poses = found["tests"]["robot"]["poses"]
    assert [pose["visits"] for pose in poses] == [30] * 5
    rows = Path("out/acceptance.csv").read_text().splitlines()
    assert float(rows[2].split(",")[3]) == poses[0]["accuracy"]["value"]
    page = Path("out/acceptance.html").read_text()
    assert "KR 7" in page and page.count("FAIL: AP") == 1
    Path("limits.yaml").write_text(LIMITS.replace("5.0e-4", "0.02") + FRAMES)
    assert run(ACCEPT).status == 0


def test_a_calibration_is_tested_beside_the_nominal_robot(visits, run, fails):
    """A setup may say what it says; all else is named."""
    accept = "accept done/calibration.json visits.csv --register --setup limits.yaml"
    fails(accept, "limits.yaml", "its own frames")
    Path("limits.yaml").write_text(LIMITS)
    result = run(accept)
    assert result.status == 2
    assert "Poses, nominal" in result.out and "Poses, calibrated" in result.out
    assert "0.5000 mm" in result.out and result.err == ""
    # Five poses hold the station, but never the tool.
    assert "the station was fitted to these visits, 6 unknowns of 15" in said(result)
    assert "the misfit of the station is " in said(result)
    changed(partial(shift, first=0, by=0.05))
    assert "--register fits it" in run(accept.replace("--register ", "")).out


def changed(change) -> None:
    """Give the visits a cycle and a pose, and change their lists of cells."""
    header, *rows = Path("visits.csv").read_text().splitlines()
    ends = [[str(k // 5 + 1), f"P{k % 5 + 1}"] for k in range(len(rows))]
    cells = [[*row.split(","), *end] for row, end in zip(rows, ends, strict=True)]
    change(cells)
    lines = [f"{header},cycle,pose", *map(",".join, cells)]
    Path("visits.csv").write_text("\n".join(lines))


def said(result) -> str:
    """What was printed, in one line."""
    return " ".join(result.out.split())


def test_what_is_fitted_to_visits_says_nothing_of_their_place(
    visits, run, without_typst
):
    """Neither five poses nor one of a robot that is off pass any limit."""
    accept = "accept arm.urdf visits.csv --setup limits.yaml"
    Path("limits.yaml").write_text(LIMITS.replace("5.0e-4", "1.0e-2"))
    changed(drop)
    result = run(f"{accept} -o out")
    assert result.status == 2 and "UNDECIDED: AP is not testable" in result.out
    page = " ".join(Path("out/acceptance.html").read_text().split())
    for words in ("base and tool were fitted to these visits", "P3 lacks 4"):
        assert words in said(result) and words in page
    found = document("out/acceptance.json")
    assert [one["status"] for one in found["limits"]] == ["undecided", "undecided"]
    assert 0.0 < found["tests"]["robot"]["bound"]["low"] < 1e-2
    header, *rows = Path("visits.csv").read_text().splitlines()
    one = [row for row in rows if row.endswith("P1")]
    Path("visits.csv").write_text("\n".join([header, *one]))
    result = run(accept)
    assert result.status == 2 and "from 4 poses on AP has a bound" in said(result)


def interval(run) -> tuple[float, float]:
    assert run(f"{ACCEPT} -o bounds --force --quiet").status in (0, 2)
    pose = document("bounds/acceptance.json")["tests"]["robot"]["poses"][0]
    return pose["accuracy"]["low"], pose["accuracy"]["high"]


def test_frames_to_an_uncertainty_and_of_other_poses(visits, run, without_typst):
    sharp = interval(run)
    loose = FRAMES.replace(", estimate: false", "")
    loose += "prior: {'*.frame.*': 1.0e-9, 'base.frame.?': 1.0e-4}"
    Path("limits.yaml").write_text(LIMITS + loose)
    wide = interval(run)
    for near, far, way in ((sharp[0], wide[0], -1), (sharp[1], wide[1], 1)):
        assert way * (far - near) == pytest.approx(1.96e-4, rel=0.1)
    # The same robot at other poses: nothing is stated of the frames.
    chain = calib_pin.load_chain("arm.urdf", tip="tool")
    q = chain.random_configurations(40, np.random.default_rng(1))
    points = chain.poses(q + np.array([0.0, 4e-3, -6e-3, 0.0]))[:, :3, 3]
    header, *rows = Path("visits.csv").read_text().splitlines()
    rows = [f"{row},validate" for row in rows]
    rows += [",".join([*map(str, row), "train"]) for row in np.hstack([q, points])]
    Path("visits.csv").write_text("\n".join([f"{header},set", *rows]))
    Path("limits.yaml").write_text(LIMITS)
    low, high = interval(run)
    assert low < high < 1e-2
    assert "registered on 40 other measurements" in said(run(ACCEPT))


def names(row: int, column: int, cell: str):
    return lambda rows: rows[row].__setitem__(column, cell)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (names(7, -1, "P2"), "visits.csv:9: the configuration of P2"),
        (names(7, -1, ""), "visits.csv:9: the visit names no pose, others do"),
        (names(7, -2, "1"), "visits.csv:9: cycle 1 has had P3 in line 4"),
        (lambda rows: [row.__setitem__(-1, "P1") for row in rows], "visits.csv:3: P1"),
    ],
)
def test_names_that_contradict_each_other(visits, fails, change, told):
    changed(change)
    fails(ACCEPT, told)


def renamed(rows) -> None:
    """Names of people: one number is behind another word."""
    for row in rows:
        row[-1] = row[-1].replace("P3", "home 3").replace("P", "Pose ")


def test_poses_with_any_names_are_numbered_in_their_order(visits, run):
    changed(renamed)
    result = run(ACCEPT)
    assert "pose 1 is 'Pose 1', 2 is 'Pose 2', 3 is 'home 3'" in result.err


def test_positions_test_a_calibration_of_poses(alone, run, without_typst):
    simulate = "simulate space6 --model pose --seed 1 --noise 1e-4"
    assert run(f"{simulate} --count 30 -o rows.csv").status == 0
    assert run("calibrate space6 rows.csv -o c").status == 0
    few = Path("rows.csv").read_text().splitlines(keepends=True)[:4]
    Path("rows.csv").write_text("".join(few))
    words = f"{simulate} --configurations rows.csv --repeats 5 -o"
    assert run(f"{words} poses.csv").status == 0
    # A comment, joints, positions and quaternions.
    lines = Path("poses.csv").read_text().splitlines()[1:]
    cut = (",".join(line.split(",")[:9]) for line in lines)
    Path("positions.csv").write_text("\n".join(cut))
    found = []
    for kind in ("poses", "positions"):
        assert run(f"accept c {kind}.csv -o {kind}").status == 0
        tests = document(f"{kind}/acceptance.json")["tests"]["calibrated"]
        found.append([pose["accuracy"] for pose in tests["poses"]])
    assert found[0] == found[1] and len(found[0]) == 2
    assert run("evaluate c positions.csv").out.count("position ") == 1


def exchange(rows) -> None:
    place = slice(-5, -2)
    rows[51][place], rows[52][place] = rows[52][place], rows[51][place]


def shift(rows, first: int = 77, by: float = 1e-4) -> None:
    for row in rows[first:]:
        row[-5] = str(float(row[-5]) + by)


def drop(rows) -> None:
    del rows[12:32:5]
    rows[-1][-5:-2] = ["", "", ""]


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (
            exchange,
            ["visits.csv:53 (P2) is left out", "visits.csv:54 (P3)", "where P2 is"],
        ),
        (shift, ["the instrument was moved before visits.csv:79 (P3)"]),
        (drop, ["P3 lacks 4 of 30 cycles: 3, 4, 5, 6", "P5 lacks", "30"]),
    ],
)
def test_faulty_and_missing_visits_pass_nothing(visits, run, change, told):
    Path("limits.yaml").write_text(LIMITS.replace("5.0e-4", "0.02") + FRAMES)
    changed(change)
    result = run(ACCEPT)
    assert result.status == 2 and "PASS:" not in result.out.replace("No PASS:", "")
    for words in told:
        assert words in said(result)


@pytest.mark.needs("pdf")
def test_it_is_written_for_a_customer(visits, run):
    Path("limits.yaml").write_text(LIMITS + FRAMES + REPORT)
    run(f"{ACCEPT} -o out")
    first, *annex = pages("out/acceptance.pdf")
    named = ("FAIL", "KR 7", "ACME", "2026-11-23", "AP 0.5000 mm, RP 0.2000 mm")
    for words in (*named, "5 kg", "speed not stated"):
        assert words in first
    for title in ("Poses", "Distances between poses"):
        assert any(title in text for text in annex)
    run("accept arm.urdf visits.csv --tip tool -o bare")
    first = pages("bare/acceptance.pdf")[0]
    assert "NO LIMIT STATED" in first and "PASS" not in first and "FAIL" not in first


@pytest.mark.needs("pdf")
@pytest.mark.slow
def test_a_calibration_has_limits_and_entries_of_its_own(visits, run):
    """But the day and the temperature are those of the test."""
    entries = REPORT.replace("2026-11-23", "1999-01-02, temperature: 31.5")
    with Path("setup.yaml").open("a") as file:
        file.write(LIMITS.replace("tip: tool\n", "") + entries)
    assert run(CALIBRATE).status == 0
    result = run("accept c/calibration.json visits.csv -o out")
    assert "0.5000 mm" in result.out
    first = pages("out/acceptance.pdf")[0]
    assert "KR 7" in first and "1999" not in first and "31.5" not in first
    Path("own.yaml").write_text("limit: {position: 7.0e-3}\nreport: {operator: me}\n")
    result = run("accept c/calibration.json visits.csv --setup own.yaml -o own")
    first = pages("own/acceptance.pdf")[0]
    assert "7.000 mm" in result.out
    assert "0.5000 mm" not in first and "me" in first and "KR 7" not in first


def test_without_the_extra_the_rest_is_written(visits, run, fails, without_typst):
    result = run(f"{ACCEPT} -o out")
    assert result.status == 2 and "calib-pin[pdf]" in result.err
    names = sorted(path.name for path in Path("out").iterdir())
    assert names == ["acceptance.csv", "acceptance.html", "acceptance.json"]
    Path("out/acceptance.pdf").write_bytes(b"an older one")
    assert "acceptance.pdf" in run(f"{ACCEPT} -o out --force").err
    fails("report done --pdf c.pdf", "calib-pin[pdf]")


@pytest.mark.needs("pdf")
def test_a_calibration_is_printed(here, run, fails):
    assert run("report done --pdf c.pdf").status == 0
    before = Path("c.pdf").read_bytes()
    assert before.startswith(b"%PDF")
    fails("report done --pdf c.pdf", "c.pdf")
    fails("report done --pdf done/calibration.json --force", "done/calibration.json")
    assert run("report done --pdf c.pdf --force --quiet").status == 0
    assert Path("c.pdf").read_bytes() == before


def test_an_untrusted_calibration_is_said_to_be(visits, run, without_typst):
    """The limits alone would pass."""
    words = "calibrate arm.urdf foreign.csv --setup setup.yaml --validation rows.csv"
    assert run(f"{words} -o c").status == 2
    Path("own.yaml").write_text("limit: {position: 0.02}\n")
    accept = "accept c/calibration.json visits.csv --register --setup own.yaml -o out"
    result = run(accept)
    assert result.status == 2
    assert "UNDECIDED" in Path("out/acceptance.html").read_text()


@pytest.mark.slow
@pytest.mark.needs("browser")
@pytest.mark.parametrize("width", [1280, 400])
def test_nothing_sticks_out_of_the_page(visits, run, browser, width):
    long = "left_arm_shoulder_lift_joint_with_a_name_of_sixty_characters"
    robot = Path("arm.urdf").read_text().replace('name="arm"', f'name="{long}"')
    Path("arm.urdf").write_text(robot)
    with Path("limits.yaml").open("a") as file:
        file.write(f"report: {{serial_number: {long}}}\n")
    run(f"{ACCEPT} -o out --quiet")
    page = browser.new_page(viewport={"width": width, "height": 900})
    page.goto(Path("out/acceptance.html").resolve().as_uri())
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert page.locator("#figure-poses-tested svg").bounding_box()["width"] > 300


# --- from the plan through the measured visits to the test ------------------------


PLAN = "plan arm.urdf --tip tool --accept --ignore-collisions -o visits.csv"


def filled(model, error: np.ndarray, noise: float) -> dict[str, float]:
    """Fill in what a robot with other joint offsets does; its error by pose."""
    header, rows, _ = table("visits.csv")
    # The calibration knows this arm alone.
    kept = [k for k, name in enumerate(header) if name != "chain"]
    header, *rows = ([row[k] for k in kept] for row in (header, *rows))
    q = np.radians(np.array([row[:4] for row in rows], float))
    rng = np.random.default_rng(0)
    wrong, right = (model.poses(at)[:, :3, 3] for at in (q + error, q))
    points = 1e3 * (wrong + noise * rng.standard_normal(wrong.shape))
    place = header.index("x [mm]")
    for row, point in zip(rows, points.tolist(), strict=True):
        row[place : place + 3] = [str(value) for value in point]
    write("visits.csv", ",".join(header), rows)
    names = [row[header.index("pose")] for row in rows]
    away = np.linalg.norm(wrong - right, axis=1)
    return dict(zip(names, away.tolist(), strict=True))


@pytest.mark.slow
def test_from_the_plan_to_the_test(here, run):
    Path("two.yaml").write_text(TWO)
    words = PLAN.replace("--tip tool", "--setup two.yaml --chain b")
    result = run(f"{words} --degrees --cycles 4")
    assert (result.status, result.err) == (0, "")
    assert "calib-pin accept arm.urdf visits.csv" in result.out
    assert max(map(len, result.out.splitlines())) <= 80 and result.out.isascii()
    # The schedule is in the file as well.
    comments = Path("visits.csv").read_text().replace("# ", "").replace("#", "")
    assert result.out.rsplit("\nwrote", 1)[0] in comments
    header, rows, _ = table("visits.csv")
    assert header[0] == "joint1 [deg]" and len(rows) == 20
    assert [row[4:7] for row in rows[4:6]] == [["b", "1", "P1"], ["b", "2", "P5"]]
    model = read_calibration("done/calibration.json").of()
    errors = filled(model, np.array([0.0, 1e-3, -1e-3, 0.0]), 1e-6)
    tested = run("accept done/calibration.json visits.csv -o out")
    assert tested.status in (0, 2)
    poses = document("out/acceptance.json")["tests"]["calibrated"]["poses"]
    assert [pose["visits"] for pose in poses] == [4] * 5
    found = [pose["accuracy"]["value"] for pose in poses]
    assert list(errors) == ["P5", "P4", "P3", "P2", "P1"]
    # Four visits of 1 um each.
    np.testing.assert_allclose(found, list(errors.values()), atol=4e-6)
    assert min(found) > 1e-4


TWO = "chains: {a: {tip: link3}, b: {tip: tool}}\n"


@pytest.mark.slow
def test_a_robot_of_six_joints_keeps_its_orientation(here, run):
    words = "plan space6 --accept -o visits.csv --ignore-collisions --cycles 3"
    result = run(words)
    assert result.status == 0
    assert "roll " in result.out
    assert "- 0.0" not in result.out and " -0.0 " not in result.out
