"""`accept`: what it prints and writes, and visits that are no test."""

from __future__ import annotations

import importlib.util
import io
import json
from pathlib import Path

import numpy as np
import pypdf
import pytest

import calib_pin
from calib_pin.io.measurements import encode_table

LIMITS = "tip: tool\nlimit: {position: 5.0e-4, repeatability: 2.0e-4}\n"


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
    Path("limits.yaml").write_text(LIMITS)


ACCEPT = "accept arm.urdf visits.csv --setup limits.yaml"


def test_a_robot_is_tested(visits, run):
    result = run(f"{ACCEPT} -o out")
    assert result.status == 2 and result.err == ""
    lines = result.out.splitlines()
    assert lines[0].startswith("FAIL: AP ") and "the limit is 0.5000 mm." in lines[0]
    assert lines[1].startswith("PASS: RP ")
    assert "150 visits of 5 poses; base and tool registered" in result.out
    document = json.loads(Path("out/acceptance.json").read_text())
    assert document["format"] == "calib-pin/acceptance"
    assert [one["status"] for one in document["limits"]] == ["fail", "pass"]
    poses = document["tests"]["robot"]["poses"]
    assert [pose["visits"] for pose in poses] == [30] * 5
    rows = Path("out/acceptance.csv").read_text().splitlines()
    assert float(rows[2].split(",")[3]) == poses[0]["accuracy"]["value"]


def test_a_calibration_is_tested_beside_the_nominal_robot(visits, run):
    assert run("calibrate arm.urdf rows.csv --setup setup.yaml -o out").status == 0
    result = run("accept out/calibration.json visits.csv --register")
    assert "Poses, nominal" in result.out and "Poses, calibrated" in result.out


def test_a_calibration_has_its_own_setup_but_the_limits(visits, run):
    """Of a setup that it has already nothing is passed over in silence."""
    assert run("calibrate arm.urdf rows.csv --setup setup.yaml -o out").status == 0
    accept = "accept out/calibration.json visits.csv --setup limits.yaml"
    assert "a calibration has its own setup" in run(accept).err
    Path("limits.yaml").write_text(LIMITS.partition("\n")[2])
    result = run(accept)
    assert "the limit is 0.5000 mm" in result.out and result.err == ""


def test_what_is_within_its_limits_is_accepted(visits, run):
    Path("limits.yaml").write_text(LIMITS.replace("5.0e-4", "0.1"))
    assert run(ACCEPT).status == 0


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ("accept arm.urdf rows.csv --tip tool", "no pose was visited 3 times"),
        ("accept arm.urdf visits.csv --tip tool --model camera", "camera"),
        ("accept arm.urdf none.csv --tip tool", "no such file"),
        (f"{ACCEPT} -o visits.csv", "folder"),
        ("accept arm.urdf visits.csv visits.csv --tip tool", "given twice"),
    ],
)
def test_what_is_no_test_is_told(visits, run, listing, words, text):
    before = listing(Path.cwd())
    result = run(words)
    assert (result.status, result.out) == (1, "")
    assert text in result.err and result.err.count("\n") == 1
    assert listing(Path.cwd()) == before


def test_a_path_is_its_worst_point(visits, run):
    result = run(f"{ACCEPT} --path -o out")
    assert result.out.startswith("FAIL: AT ") and "\nPASS: RT " in result.out
    assert "AT 0.5000 mm, RT 0.2000 mm" in pages("out/acceptance.pdf")[0]
    document = json.loads(Path("out/acceptance.json").read_text())
    poses = document["tests"]["robot"]["poses"]
    row = next(line for line in result.out.splitlines() if line.startswith("robot "))
    assert row.split()[1] == "5"
    for at, key in ((2, "accuracy"), (6, "repeatability")):
        worst = max(pose[key]["value"] for pose in poses)
        assert float(row.split()[at]) == pytest.approx(1e3 * worst, rel=1e-3)


REPORT = "report: {serial_number: KR 7, customer: ACME, date: 2026-11-23}\n"


def pages(file: str) -> list[str]:
    """The text of each page."""
    reader = pypdf.PdfReader(io.BytesIO(Path(file).read_bytes()))
    return [page.extract_text() for page in reader.pages]


def test_it_is_written_for_a_customer(visits, run):
    with Path("limits.yaml").open("a") as file:
        file.write(REPORT)
    result = run(f"{ACCEPT} -o out")
    assert result.err == "" and "wrote out/acceptance.pdf" in result.out
    first, *annex = pages("out/acceptance.pdf")
    page = Path("out/acceptance.html").read_text()
    for words in ("FAIL", "KR 7", "ACME", "2026-11-23", "AP 0.5000 mm, RP 0.2000 mm"):
        assert words in first and words in page
    assert page.count("FAIL: AP") == 1
    words = " ".join(first.split())
    assert "needs the standard itself" in words and "signature" in words
    for title in ("Poses", "Distances between poses"):
        assert any(title in text for text in annex) and f"<caption>{title}" in page


def test_two_runs_write_the_same(visits, run):
    with Path("limits.yaml").open("a") as file:
        file.write(REPORT)
    for folder in ("one", "two"):
        run(f"{ACCEPT} -o {folder} --quiet")
    for kind in ("pdf", "html", "json", "csv"):
        one, two = (Path(f, f"acceptance.{kind}") for f in ("one", "two"))
        assert one.read_bytes() == two.read_bytes()


def test_without_a_limit_nothing_is_passed(visits, run):
    run("accept arm.urdf visits.csv --tip tool -o out")
    first = pages("out/acceptance.pdf")[0]
    assert "NO LIMIT STATED" in first and "no limit was stated" in first
    assert "PASS" not in first and "FAIL" not in first


def test_a_calibration_has_limits_and_entries_of_its_own(visits, run):
    """But the day and the temperature are those of the test."""
    entries = REPORT.replace("2026-11-23", "1999-01-02, temperature: 31.5")
    with Path("setup.yaml").open("a") as file:
        file.write(LIMITS.replace("tip: tool\n", "") + entries)
    assert run("calibrate arm.urdf rows.csv --setup setup.yaml -o c").status == 0
    result = run("accept c/calibration.json visits.csv -o out")
    assert "the limit is 0.5000 mm" in result.out
    first = pages("out/acceptance.pdf")[0]
    assert "KR 7" in first and "before" in first and "after" in first
    assert "1999" not in first and "31.5" not in first
    Path("own.yaml").write_text("limit: {position: 7.0e-3}\nreport: {operator: me}\n")
    result = run("accept c/calibration.json visits.csv --setup own.yaml -o own")
    first = pages("own/acceptance.pdf")[0]
    assert "the limit is 7.000 mm" in result.out
    assert "0.5000 mm" not in first and "me" in first and "KR 7" not in first


@pytest.fixture
def without_fpdf(monkeypatch) -> None:
    """The extra is not installed."""
    find = importlib.util.find_spec
    monkeypatch.setattr(
        "calib_pin.report.sheets.find_spec",
        lambda name, *more: None if name == "fpdf" else find(name, *more),
    )


def test_without_the_extra_the_rest_is_written(visits, run, without_fpdf):
    result = run(f"{ACCEPT} -o out")
    assert result.status == 2 and result.err.count("\n") == 1
    assert "pip install 'calib-pin[pdf]'" in result.err
    names = sorted(path.name for path in Path("out").iterdir())
    assert names == ["acceptance.csv", "acceptance.html", "acceptance.json"]
    Path("out/acceptance.pdf").write_bytes(b"an older one")
    assert "is not from this test" in run(f"{ACCEPT} -o out --force").err


def test_a_calibration_is_printed(visits, run, drawn):
    with Path("setup.yaml").open("a") as file:
        file.write(REPORT)
    assert run("calibrate arm.urdf rows.csv --setup setup.yaml -o c").status == 0
    told = run("report c --pdf c.pdf")
    assert told.status == 0 and told.err == "" and "wrote c.pdf" in told.out
    first, *annex = pages("c.pdf")
    for words in ("Calibration report", "GOOD", "KR 7", "before", "after"):
        assert words in first
    assert "no limit was stated" in first
    assert any("Identifiable errors of the robot" in text for text in annex)
    assert "exists already" in run("report c --pdf c.pdf").err
    assert "input of this run" in run("report c --pdf c/calibration.json --force").err
    before = Path("c.pdf").read_bytes()
    assert run("report c --pdf c.pdf --force --quiet").status == 0
    assert Path("c.pdf").read_bytes() == before


def test_a_pdf_needs_the_extra(here, run, without_fpdf):
    result = run("report done --pdf c.pdf")
    assert (result.status, result.out) == (1, "") and result.err.count("\n") == 1
    assert "pip install 'calib-pin[pdf]'" in result.err
    assert not Path("c.pdf").exists()


def test_an_untrusted_calibration_is_said_to_be(visits, run):
    """The limits alone would pass."""
    words = "calibrate arm.urdf foreign.csv --setup setup.yaml --validation rows.csv"
    assert run(f"{words} -o c").status == 2
    Path("own.yaml").write_text("limit: {position: 1.0}\n")
    accept = "accept c/calibration.json visits.csv --register --setup own.yaml -o out"
    assert run(accept).status == 2
    first = pages("out/acceptance.pdf")[0]
    assert "UNDECIDED" in first and "must not be trusted" in first
    assert run("report c --pdf c.pdf").status == 2
    assert "This calibration must not be trusted." in pages("c.pdf")[0]


@pytest.mark.slow
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
    page.close()
