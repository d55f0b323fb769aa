"""The page of one tab, and the job behind it."""

from __future__ import annotations

import csv
import io
import signal
import subprocess
import sys
import zipfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml

from calib_pin.cli.page_job import ALL, SETUP, Job
from calib_pin.io.urdf import bundled_robots
from calib_pin.viewer.app import Page, Section, Widget, words

ROBOT = bundled_robots()["pa10"]


class Tab:
    """A job whose work is done at once, and what its page shows."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "0"
        self.folder.mkdir()
        self.job = Job(self.folder, folder, "/tab/{}", lambda work, *of: work(*of))

    def shown(self, title: str) -> list[Widget]:
        """The widgets of a section."""
        (found,) = (s for s in self.job.sections() if s.title == title)
        return [*found.widgets]

    def said(self, title: str) -> str:
        return "\n".join(w.value for w in self.shown(title) if w.kind == "words")

    def widget(self, title: str, label: str) -> Widget:
        (found,) = (w for w in self.shown(title) if w.label == label)
        return found

    def links(self, title: str) -> dict[str, str]:
        found = (w.value for w in self.shown(title) if w.kind == "links")
        return {label: to for links in found for label, to in links.items()}


@pytest.fixture
def tab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Tab:
    # Pages of results are not looked at here.
    draw = "calib_pin.cli.calibrate.draw_calibration"
    monkeypatch.setattr(draw, lambda *about: [])
    return Tab(tmp_path)


def table(
    change: Callable[[dict[str, str]], None] = lambda row: None, count: int = 60
) -> bytes:
    """The first example measurements of the robot, each changed."""
    text = ROBOT.with_name("measurements.csv").read_text()
    rows = [*csv.DictReader(line for line in text.splitlines() if line[0] != "#")][
        :count
    ]
    stream = io.StringIO()
    for row in rows:
        change(row)
    writer = csv.DictWriter(stream, rows[0])
    writer.writeheader()
    writer.writerows(rows)
    return stream.getvalue().encode()


def foreign(row: dict[str, str]) -> None:
    """Degrees and millimeters under other names."""
    numbers = {name: float(value) for name, value in row.items()}
    row.clear()
    for k in range(1, 8):
        row[f"A{k}"] = str(57.29577951308232 * numbers[f"joint_{k}"])
    for axis in "xyz":
        row[f"{axis.upper()}_ist"] = str(1e3 * numbers[axis])


def reversed_joint(row: dict[str, str]) -> None:
    row["joint_3"] = str(-float(row["joint_3"]))


def test_from_two_files_to_a_corrected_robot(tab):
    """Whatever they are called, with what was found on the way."""
    before = ROBOT.read_bytes()
    assert "robot" in tab.said("Now") and tab.job.scene is None
    tab.job.give("C:\\arms\\arm.urdf", before)
    assert tab.job.scene.rows is None and "measurements" in tab.said("Now")
    tab.job.give("rows.csv", table(foreign))
    assert len(tab.job.scene.rows.data) == 60
    found = {w.label: w.value for w in tab.shown("Found in the files")}
    assert found["tip"] == "tool" and found["measured"] == "position"
    assert "60 measurements of pa10" in tab.said("Found in the files")
    columns = {w.label: w for w in tab.shown("Columns and units")}
    assert columns["joint_2"].value == "A2 [deg]" and columns["x"].value == "X_ist [mm]"
    assert {"X_ist [m]", "A1 [rad]"} <= {*columns["x"].choices}
    assert tab.shown("Result") == []
    tab.widget("Now", "Calibrate").do()
    verdict, *_ = tab.shown("Result")
    assert verdict.value.startswith("GOOD:") and verdict.tone == "good"
    assert tab.job.scene.bodies[-1].name == "corrected"
    links = tab.links("Result")
    assert links["corrected robot: pa10.urdf"] == "/tab/pa10.urdf"
    assert {"report", "calibration.json", "setup.yaml", "all files"} <= links.keys()
    assert tab.job.files["pa10.urdf"] != before
    with zipfile.ZipFile(io.BytesIO(tab.job.files[ALL])) as archive:
        names = {Path(name).name for name in archive.namelist()}
    assert names == tab.job.files.keys() - {ALL}
    # Files are named as they were dropped.
    assert b"rows.csv" in tab.job.files["calibration.json"]
    assert str(tab.folder).encode() not in tab.job.files["calibration.json"]
    assert (tab.folder / "arm.urdf").read_bytes() == before


def test_untrusted_there_is_a_reason_and_no_robot_until_its_lines_are_applied(tab):
    tab.job.add("pa10")
    tab.job.give("rows.csv", table(reversed_joint, 18))
    assert "no reading of the columns fits" in tab.said("Now")
    tab.job.calibrate()
    first = tab.shown("Result")[0]
    assert first.value.startswith("UNTRUSTED: joint 'joint_3' is reversed")
    assert "no corrected robot" in tab.said("Result")
    assert not any(label.startswith("corrected") for label in tab.links("Result"))
    assert "pa10.urdf" not in tab.job.files
    tab.widget("Result", "apply these lines").do()
    assert tab.shown("Result") == []
    assert "sign: -1" in tab.said("Found in the files")
    assert b"sign: -1" in tab.job.files[SETUP.name]
    assert tab.job.read.inputs.setup.joints["joint_3"].sign == -1
    assert tab.widget("Now", "Calibrate")


def test_what_was_found_can_be_changed(tab):
    tab.job.add("pa10")
    tab.job.give("rows.csv", table(foreign, 20))
    tab.widget("Found in the files", "tip").do("link_7")
    assert tab.job.read.inputs.setup.tip == "link_7"
    tab.widget("Columns and units", "x").do("X_ist [m]")
    assert "X_ist" in tab.job.problem + tab.said("Now")
    tab.widget("Columns and units", "x").do("X_ist [mm]")
    assert tab.job.problem == ""
    assert yaml.safe_load(tab.job.read.text)["tip"] == "link_7"
    # A wrong tip is one line, and the way back is there.
    tab.widget("Found in the files", "tip").do("base_link")
    assert tab.job.problem.count("\n") == 0 and tab.job.problem
    assert tab.job.read.inputs is None
    assert {"joint_7", "x"} <= {w.label for w in tab.shown("Columns and units")}
    tab.widget("Found in the files", "tip").do("tool")
    assert tab.job.problem == "" and tab.job.read.inputs is not None
    # Of a person's own text nothing is drafted.
    (lines,) = (w for w in tab.shown("Setup file") if w.kind == "lines")
    lines.do("tip: tool\nno_such_key: 1\n")
    assert tab.job.problem.startswith("setup.yaml:2: ")
    lines.do("")
    assert tab.job.problem == "" and tab.job.read.text.startswith("# Setup file")


def test_units_of_headers_are_shown_and_a_wrong_one_has_no_dead_end(tab):
    joints = ",".join(f"joint_{k} [deg]" for k in range(1, 8))
    rows = [f"{9 * k},{k},20,{-7 * k},5,{k * k},40,{700 + k}\n" for k in range(9)]
    tab.job.add("pa10")
    tab.job.give("rows.csv", f"{joints},distance [m]\n{''.join(rows)}".encode())
    assert "write the header as 'distance [mm]'" in tab.job.problem
    assert "is taken" not in tab.said("Now") and "choose below" in tab.said("Now")
    columns = {w.label: w for w in tab.shown("Columns and units")}
    assert columns["joint_2"].value == "joint_2 [deg]"
    assert columns["distance"].value == "distance [m]"
    # Another unit would contradict the header.
    assert "distance [mm]" not in columns["distance"].choices
    columns["distance"].do("distance [m]")
    (section,) = (s for s in tab.job.sections() if s.title == "Columns and units")
    assert section.expanded  # Nobody has to open it again.
    tab.job.give("rows.csv", f"{joints},Abstand [m]\n{''.join(rows)}".encode())
    tab.job.choose(changes={"columns": {"distance": "Abstand [m]"}})
    assert "write the header as 'Abstand [mm]'" in tab.job.problem


BROKEN = {
    "bad.urdf": (b"<robot", "bad.urdf:1: "),
    "bad.csv": (table() + b"1,2,x\n", "bad.csv:62: "),
    "bad.yaml": (b"tip: [", "setup.yaml"),
    "empty.csv": (b"", "empty.csv"),
    "noise.xacro": (bytes(range(256)), "noise.xacro"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_file_is_one_line(name, tab):
    content, line = BROKEN[name]
    tab.job.add("pa10")
    tab.job.give("rows.csv", table())
    tab.job.give(name, content)
    assert line in tab.job.problem and "\n" not in tab.job.problem
    assert "internal" not in tab.job.problem
    assert [w.label for w in tab.shown("Now") if w.kind == "button"] == []


@pytest.mark.parametrize(
    "name", ["../../arm.urdf", "/etc/arm.urdf", "a\\..\\arm.urdf", "..", "", "a\nb"]
)
def test_nothing_is_written_outside_of_the_folder(name, tab):
    tab.job.give(name, ROBOT.read_bytes())
    everything = [p for p in tab.folder.parent.rglob("*") if p.is_file()]
    assert everything == ([tab.folder / "arm.urdf"] if "arm" in name else [])


def test_paths_examples_and_files_of_the_same_name(tab, tmp_path):
    tab.widget("Robot and measurements", "or bundled robot").do("pa10")
    tab.widget("Chosen", "take its example measurements").do()
    (example,) = tab.job.chosen.measurements
    assert example.name == "measurements.csv" and tab.job.read.inputs is not None
    tab.widget("Chosen", f"remove {example.name}").do()
    assert tab.job.chosen.measurements == [] and tab.job.read.inputs is None
    (tmp_path / "own.csv").write_bytes(table()[:-300])
    tab.widget("Robot and measurements", "take this path").do(" own.csv ")
    assert tab.job.chosen.measurements == [tmp_path / "own.csv"]
    tab.job.choose(measurements=[])
    for count in (1, 2):  # A file that is corrected takes the place of the first.
        tab.job.give("rows.csv", b"\n".join(table().splitlines()[: 20 * count + 1]))
        assert len(tab.job.scene.rows.data) == 20 * count
    (tmp_path / "packages").mkdir()
    tab.job.add("packages")
    assert tab.job.read.inputs.request.package_dir == [tmp_path / "packages"]
    for nothing in ("", " ", "(choose)"):
        tab.job.add(nothing)
    tab.job.add("missing.csv")
    assert "missing.csv: no such file" in tab.job.problem
    assert tab.job.chosen.robot == "pa10"
    tab.job.add("nobody")
    assert "nobody" in tab.job.problem


def test_of_several_readings_the_first_is_taken_and_told(tab, monkeypatch):
    def looked(asked: Any, choose: Any) -> None:
        raise OSError(5, choose("which link", ["a", "b"], "--tip"))

    monkeypatch.setattr("calib_pin.cli.page_job.looked_at", looked)
    tab.job.add("pa10")
    tab.job.give("rows.csv", table())
    assert "which link? a is taken" in tab.said("Now")


def test_work_is_stopped(tab, monkeypatch):
    tab.job.add("pa10")
    tab.job.give("rows.csv", table())
    shown = list[list[Widget]]()

    def slow(*_: Any, bar: Any, **__: Any) -> None:
        bar("fit", 0.5)
        shown.append(tab.shown("Now"))
        shown[0][1].do()
        bar("fit", 0.6)

    monkeypatch.setattr("calib_pin.cli.page_job.calibrated", slow)
    tab.job.calibrate()
    bar, stop = shown[0]
    assert (bar.kind, bar.label, bar.value) == ("progress", "fit", 0.5)
    assert stop.label == "stop"
    assert tab.job.problem == "stopped" and tab.job.result is None
    assert tab.widget("Now", "Calibrate").tone == "good"


def test_files_are_followed_while_they_are_written(tab, tmp_path):
    *first, one = table().splitlines(keepends=True)[:23]
    file = tmp_path / "live.csv"
    file.write_bytes(b"".join(first))
    tab.job.add("pa10")
    tab.job.add("live.csv")
    (follow,) = tab.shown("While it is measured")
    follow.do()
    [*tab.job.sections()]
    told = tab.said("While it is measured")
    assert told
    with file.open("ab") as stream:
        stream.write(one)
    [*tab.job.sections()]
    assert tab.said("While it is measured") != told
    assert len(tab.job.scene.rows.data) == 22


def test_lines_go_into_a_setup_file(tab):
    tab.job.add("pa10")
    tab.job.give("rows.csv", table())
    tab.job.change({"reading": {"scale": 2.0}})
    tab.job.change({"reading": {"shift": 1}, "base": "base_link"})
    whole = yaml.safe_load(tab.job.read.text)
    assert whole["reading"] == {"scale": 2.0, "shift": 1}
    assert whole["base"] == "base_link" and whole["tip"] == "tool"
    assert "60 measurements of pa10" in tab.said("Found in the files")
    for text in ("tip: [", "columns: 5\n", "- a\n"):
        tab.job.give("setup.yaml", text.encode())
        tab.job.change({"tip": "tool"})
        assert tab.job.problem.startswith("setup.yaml")


# --- as viser draws it ---------------------------------------------------------------


def recorded(known: list[str], add: Callable[..., Any], word: str, **how: Any) -> Any:
    known.append(word)
    return add(word, **how)


@pytest.mark.needs("view")
def test_only_sections_that_changed_are_drawn_again(scene, viser_server, monkeypatch):
    every = [
        words("<b>1 < 2</b>", "good"),
        Widget("links", value={"robot": "/a.urdf", "page": "/report.html?token=a"}),
        Widget("progress", "fit", None),
        Widget("choice", "tip", "a", ("a", "b")),
        Widget("entry", "take it", choices=("path",)),
        Widget("lines", "use it", "tip: a"),
        Widget("button", "go"),
        Widget("upload", "choose", "drop"),
    ]
    told = SimpleNamespace(view=[], shown=[])

    def sections() -> list[Section]:
        shown = {"One": told.shown, "Two": every, "View": told.view}
        return [Section(title, widgets) for title, widgets in shown.items()]

    page = Page(viser_server, viser_server.initial_camera, sections)
    made = dict[str, list[str]](add_folder=[], add_html=[])
    for name, known in made.items():
        add = getattr(viser_server.gui, name)
        monkeypatch.setattr(viser_server.gui, name, partial(recorded, known, add))
    folders, html = made.values()
    for _ in range(2):
        page.tick()
        assert folders == ["Two"]  # One without widgets is not shown.
    told.shown = every[:2]
    page.tick()
    assert folders == ["Two", "One"]
    told.view = [Widget("scene", value=scene)]
    page.tick()
    assert folders[2] == "View" and "Residual map" in folders
    assert any("&lt;b&gt;1 &lt; 2" in content for content in html)
    robot, report = next(c for c in html if "a.urdf" in c).split("</a>")[:2]
    assert " download" in robot and " download" not in report


# --- in a browser --------------------------------------------------------------------


@pytest.fixture
def address(tmp_path: Path) -> Iterator[str]:
    """The address of a page of a process of its own."""
    words = [sys.executable, "-u", "-m", "calib_pin", "app", "--port", "0"]
    process = subprocess.Popen(words, cwd=tmp_path, text=True, stdout=subprocess.PIPE)
    assert process.stdout is not None
    yield process.stdout.readline().split()[2]
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=60)
    assert process.returncode == 0


@pytest.mark.slow
@pytest.mark.needs("view", "browser")
def test_the_whole_way_in_a_browser_and_another_tab(browser, address, tmp_path):
    """By the button and by dropping; a tab that is loaded again has its job."""
    (tmp_path / "arm.urdf").write_bytes(ROBOT.read_bytes())
    (tmp_path / "rows.csv").write_bytes(table(foreign))
    small = {"width": 800, "height": 600}
    page, other = (browser.new_page(viewport=small) for _ in range(2))
    complaints: list[str] = []
    for one in (page, other):
        one.set_default_timeout(120_000)
        one.on("pageerror", lambda error: complaints.append(str(error)))
        one.goto(address, wait_until="commit")
        one.get_by_text("Begin with the robot").wait_for()
    upload = page.locator("input[type=file]")
    upload.set_input_files(tmp_path / "arm.urdf")
    page.get_by_text("Now the measurements").wait_for()
    upload.set_input_files(tmp_path / "rows.csv")
    page.get_by_role("button", name="Calibrate").click()
    page.get_by_text("GOOD: ").wait_for()
    with page.expect_download() as started:
        page.get_by_role("link", name="corrected robot").click()
    assert b"<robot" in Path(started.value.path()).read_bytes()
    with page.context.expect_page() as opened:
        page.get_by_role("link", name="report").click()
    opened.value.get_by_text("Calibration of pa10").first.wait_for()
    page.reload(wait_until="commit")
    page.get_by_text("GOOD: ").wait_for()
    assert other.get_by_text("GOOD: ").count() == 0
    other.evaluate(
        "const data = new DataTransfer();"
        "data.items.add(new File(['x,y,z\\n'], 'empty.csv'));"
        "data.items.add(new File(['<robot'], 'bad.urdf'));"
        "document.querySelector('[ondrop]').dispatchEvent(new DragEvent('drop',"
        "{dataTransfer: data, bubbles: true, cancelable: true}))"
    )
    other.get_by_text("bad.urdf:1: ").first.wait_for()
    other.get_by_text("Measurements: empty.csv").wait_for()
    assert complaints == []
