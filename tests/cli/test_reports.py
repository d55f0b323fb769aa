"""What people look at, asked for by options: pages, pictures, colors, progress."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path
from subprocess import PIPE, Popen

import pytest

from calib_pin.report.figures import NAMES
from tests.cli.conftest import DRAW
from tests.cli.files import document, figures

CALIBRATE = "calibrate arm.urdf rows.csv --setup setup.yaml"
PLAN = "plan arm.urdf --model position --count 8 --candidates 60 --method greedy"


def names(folder: str) -> set[str]:
    return {path.name for path in Path(folder).iterdir()}


# --- the page ----------------------------------------------------------------------


MESH = "v 0 0 0\nv 0.2 0 0\nv 0 0.2 0\nv 0 0 0.6\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"


@pytest.mark.parametrize("real", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_page_with_figures_and_the_words_of_the_terminal(
    real, here, drawn, run, monkeypatch
):
    """And one that is made from the files again is the same."""
    for place in () if real else DRAW:
        monkeypatch.setattr(place, figures)
    Path("ros/arm_meshes").mkdir(parents=True)
    Path("ros/arm_meshes/a.obj").write_text(MESH)
    mesh = '<mesh filename="package://arm_meshes/a.obj"/>'
    visual = f"<visual><geometry>{mesh}</geometry></visual>"
    text = Path("arm.urdf").read_text()
    shown = text.replace('<link name="link2"/>', f'<link name="link2">{visual}</link>')
    Path("arm.urdf").write_text(shown)
    words = f"{CALIBRATE} --package-dir ros -o out --figures out/figures"
    words += " --figure-format svg"
    result = run(words)
    assert (result.status, result.err) == (0, "")
    page = Path("out/report.html").read_text()
    pictures = {path.stem for path in Path("out/figures").iterdir()}
    assert pictures <= set(NAMES["calibration"]) and len(pictures) >= 7
    assert {*re.findall(r'<figure id="figure-([\w-]+)">', page)} == pictures
    assert "robot-errors" in pictures
    assert result.out.splitlines()[0] in page
    # The terminal tells those of the held-out measurements.
    for line in result.out.split("Accuracy\n")[1].splitlines()[1:3]:
        for cell in line.split():
            assert f">{cell}<" in page
    stored = document("out")
    for file in [stored["robot"], *stored["measurements"]["files"]]:
        assert file["sha256"] in page
    assert run("report out --package-dir ros").status == 0
    assert Path("out/report.html").read_text() == page


def test_the_same_page_again(here, run):
    assert run(f"{CALIBRATE} -o out").status == 0
    pages = []
    for folder in ("done", "out"):
        page = Path(folder, "report.html").read_text()
        page = re.sub(r"\d{4}-\d\d-\d\dT[\d:]+\+00:00", "", page)
        page = re.sub(r"<dt>time</dt><dd>[\d.]+ s</dd>", "", page)
        pages.append(re.sub(r" -o \w+( --quiet)?", "", page))
    assert pages[0] == pages[1]


def test_nothing_is_drawn_for_nobody(here, run, monkeypatch):
    def draw(*about: object) -> list[object]:
        raise AssertionError

    monkeypatch.setattr("calib_pin.cli.requests.draw_calibration", draw)
    assert run(CALIBRATE).status == 0


# --- pictures ----------------------------------------------------------------------


def test_pictures_of_a_plan(here, run):
    result = run(f"{PLAN} -o plan.csv --figures figures --figure-format svg")
    assert (result.status, result.err.count("\n")) == (0, 1)
    assert names("figures") == {f"{name}.svg" for name in NAMES["plan"]}
    assert all(p.read_bytes()[:5] == b"<?xml" for p in Path("figures").iterdir())


def test_pictures_of_an_earlier_run(here, run, refuses):
    """They are not replaced unasked, and a note tells of those that stay."""
    Path("figures").mkdir()
    old, stale = Path("figures/tip-drift.png"), Path("figures/residuals-by-joint.png")
    for file in (old, stale):
        file.write_text("of an earlier run")
    words = "compare done/calibration.json later/calibration.json --figures figures"
    refuses(words, file=str(old), reason="--force")
    assert run(f"{words} --force").status == 0
    assert old.read_bytes().startswith(b"\x89PNG")
    # Of so few measurements no course can be seen.
    few = Path("rows.csv").read_text().splitlines(keepends=True)[:8]
    Path("few.csv").write_text("".join(few))
    few_of = CALIBRATE.replace("rows.csv", "few.csv")
    result = run(f"{few_of} --figures figures --force")
    assert f"note: {stale}" in result.err
    assert stale.read_text() == "of an earlier run"


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (f"{CALIBRATE} --figures figures --figure-format gif", "'gif'"),
        (f"{PLAN} -o plan.csv --figures rows.csv", "rows.csv"),
        (f"{PLAN} -o plan.csv --figures rows.csv/x", "rows.csv"),
        (f"{CALIBRATE} -o out --figures rows.csv/x/y", "rows.csv"),
        (f"{CALIBRATE} -o out --figures out/calibration.json", "calibration.json"),
    ],
)
def test_wrong_options(words, named, here, fails):
    fails(words, named)


# --- terminals ---------------------------------------------------------------------


def on_terminal(words: str) -> bytes:
    """What a process writes to its error stream, which is a terminal."""
    main, side = os.openpty()
    process = Popen(
        [sys.executable, "-m", "calib_pin.cli", *words.split()],
        stdin=PIPE,
        stdout=PIPE,
        stderr=side,
        env={**os.environ, "TERM": "xterm-256color", "COLUMNS": "80"},
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
def test_progress_on_the_error_stream(here):
    shown = on_terminal("evaluate done/calibration.json new.csv")
    assert b"read" in shown and b"evaluate" in shown
