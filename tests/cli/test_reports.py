"""What people look at, asked for by options: pages, pictures, colors, progress."""

from __future__ import annotations

import json
import os
import re
import sys
from pathlib import Path
from subprocess import PIPE, Popen

import pytest

from calib_pin.report.figures import NAMES

CALIBRATE = "calibrate arm.urdf rows.csv --setup setup.yaml"
PLAN = "plan arm.urdf --model position --count 8 --candidates 60 --method greedy"
MAGIC = {"png": b"\x89PNG", "svg": b"<?xml"}


def names(folder: str) -> set[str]:
    return {path.name for path in Path(folder).iterdir()}


# --- the page ----------------------------------------------------------------------


@pytest.mark.usefixtures("drawn")
def test_a_page_with_figures_and_the_words_of_the_terminal(here, run):
    result = run(f"{CALIBRATE} -o out --figures out/figures")
    assert (result.status, result.err) == (0, "")
    page = Path("out/report.html").read_text()
    pictures = {path.stem for path in Path("out/figures").iterdir()}
    assert pictures <= set(NAMES["calibration"]) and len(pictures) >= 7
    assert {*re.findall(r'<figure id="figure-([\w-]+)">', page)} == pictures
    words = result.out.splitlines()
    assert f"wrote {len(pictures)} figures to out/figures" == words[-1]
    assert words[0] in page
    assert "--figures out/figures" in page
    # The terminal tells those of the held-out measurements.
    for line in result.out.split("Accuracy\n")[1].splitlines()[1:3]:
        for cell in line.split():
            assert f">{cell}<" in page
    stored = json.loads(Path("out/calibration.json").read_text())
    for file in [stored["robot"], *stored["measurements"]["files"]]:
        assert file["sha256"] in page


def test_the_same_page_again(here, run):
    pages = []
    for _ in range(2):
        assert run(f"{CALIBRATE} -o out --force").status == 0
        page = Path("out/report.html").read_text()
        page = re.sub(r"\d{4}-\d\d-\d\dT[\d:]+\+00:00", "", page)
        pages.append(re.sub(r"<dt>time</dt><dd>[\d.]+ s</dd>", "", page))
    assert pages[0] == pages[1]


MESH = """v 0 0 0\nv 0.2 0 0\nv 0 0.2 0\nv 0 0 0.6
f 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"""


@pytest.mark.usefixtures("drawn")
def test_a_robot_is_drawn_with_meshes_that_are_found_again(here, run):
    """A page from files is the same; where meshes are gone, simple shapes stand in."""
    Path("ros/arm_meshes").mkdir(parents=True)
    Path("ros/arm_meshes/a.obj").write_text(MESH)
    mesh = '<mesh filename="package://arm_meshes/a.obj"/>'
    visual = f"<visual><geometry>{mesh}</geometry></visual>"
    text = Path("arm.urdf").read_text()
    shown = text.replace('<link name="link2"/>', f'<link name="link2">{visual}</link>')
    assert shown != text
    Path("arm.urdf").write_text(shown)
    words = f"{CALIBRATE} --package-dir ros -o out"
    assert run(words).status == 0
    page = Path("out/report.html").read_bytes()
    assert b'id="figure-robot-errors"' in page
    assert run("report out --package-dir ros").status == 0
    assert Path("out/report.html").read_bytes() == page
    result = run("report out")
    assert (result.status, result.err) == (0, "")
    assert Path("out/report.html").read_bytes() != page


def test_nothing_is_drawn_for_nobody(here, run, monkeypatch):
    def draw(*about: object) -> list[object]:
        raise AssertionError

    monkeypatch.setattr("calib_pin.cli.requests.draw_calibration", draw)
    assert run(CALIBRATE).status == 0


# --- pictures ----------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["png", pytest.param("svg", marks=pytest.mark.slow)])
def test_pictures_of_a_plan(kind, here, run):
    result = run(f"{PLAN} -o plan.csv --figures figures --figure-format {kind}")
    assert (result.status, result.err.count("\n")) == (0, 1)
    assert names("figures") == {f"{name}.{kind}" for name in NAMES["plan"]}
    assert all(
        p.read_bytes()[:5].startswith(MAGIC[kind]) for p in Path("figures").iterdir()
    )
    assert result.out.endswith("wrote 3 figures to figures\n")


def test_pictures_of_an_earlier_run(here, run, refuses):
    """They are not replaced unasked, and a note tells of those that stay."""
    Path("figures").mkdir()
    old = Path("figures/tip-drift.png")
    old.write_text("of an earlier run")
    later = Path("later")
    assert run(f"calibrate arm.urdf new.csv --setup setup.yaml -o {later}").status == 0
    words = "compare done/calibration.json later/calibration.json --figures figures"
    refuses(words, file=str(old), reason="--force")
    result = run(f"{words} --force")
    assert result.status == 0
    assert old.read_bytes().startswith(MAGIC["png"])
    stale = Path("figures/convergence.png")
    stale.write_text("of an earlier run")
    result = run(f"{CALIBRATE} --figures figures --force")
    assert f"calib-pin: note: {stale} is not from this run" in result.err
    assert stale.read_text() == "of an earlier run"


@pytest.mark.parametrize(
    ("words", "fields"),
    [
        (
            f"{CALIBRATE} --figures rows.csv",
            dict(file="rows.csv", reason="is a file, not a folder"),
        ),
        (
            f"{CALIBRATE} --figures figures --figure-format gif",
            dict(reason="unknown figure format 'gif'", allowed="png, pdf, svg"),
        ),
        (
            f"{PLAN} -o plan.csv --figures rows.csv",
            dict(file="rows.csv", reason="is a file, not a folder"),
        ),
        (
            f"{PLAN} -o plan.csv --figures rows.csv/x",
            dict(reason="is a file"),
        ),
        (
            f"{CALIBRATE} -o out --figures rows.csv/x/y",
            dict(reason="is a file"),
        ),
        (
            f"{CALIBRATE} -o out --figures out/calibration.json",
            dict(file="out/calibration.json", reason="cannot be a folder"),
        ),
    ],
)
def test_wrong_options(words, fields, here, refuses):
    refuses(words, **fields)


# --- terminals ---------------------------------------------------------------------


def on_terminal(words: str, stream: str, **environment: str) -> bytes:
    """What a process writes to a terminal, which is its output or its error stream."""
    main, side = os.openpty()
    streams = {"stdout": PIPE, "stderr": PIPE, stream: side}
    process = Popen(
        [sys.executable, "-m", "calib_pin.cli", *words.split()],
        stdin=PIPE,
        env={**os.environ, "TERM": "xterm-256color", "COLUMNS": "80", **environment},
        **streams,  # type: ignore[arg-type]
    )
    os.close(side)
    shown = b""
    try:
        while part := os.read(main, 4096):
            shown += part
    except OSError:  # How the end of a terminal shows on Linux.
        pass
    finally:
        process.communicate(timeout=60.0)
        os.close(main)
    assert process.returncode == 0
    return shown


@pytest.mark.slow
def test_colors_unless_unwanted(here):
    words = "evaluate done/calibration.json new.csv"
    assert b"\x1b[1mAccuracy" in on_terminal(words, "stdout", NO_COLOR="")
    plain = on_terminal(words, "stdout", NO_COLOR="1")
    assert b"\x1b[?25l" not in plain, "there is no bar where the numbers are"
    assert b"Accuracy" in plain
    # Bold is no color; colors of text are 30 to 37 and 90 to 97.
    assert not re.search(rb"\x1b\[(\d+;)*(3|9)[0-7](;\d+)*m", plain)


def test_progress_on_the_error_stream(here):
    shown = on_terminal("evaluate done/calibration.json new.csv", "stderr")
    assert b"read" in shown and b"evaluate" in shown
