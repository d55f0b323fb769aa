"""What people look at: pages, pictures, colors, progress, and `view`."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path
from subprocess import PIPE, Popen

import pytest

from calib_pin.report.figures import NAMES
from tests.cli.files import DRAW, document, figures

CALIBRATE = "calibrate arm.urdf rows.csv --setup setup.yaml"


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
    assert pictures <= set(NAMES["calibration"]) and len(pictures) >= 6
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


def test_nothing_is_drawn_for_nobody(here, run, monkeypatch):
    def draw(*about: object) -> list[object]:
        raise AssertionError

    monkeypatch.setattr("calib_pin.cli.calibrate.draw_calibration", draw)
    assert run(CALIBRATE).status == 0


# --- pictures ----------------------------------------------------------------------


def test_pictures_of_an_earlier_run(here, run, refuses, monkeypatch):
    """They are not replaced unasked, and a note tells of those that stay."""
    # Of all others there is nothing to show.
    monkeypatch.setattr(DRAW[0], lambda *about: figures(*about)[:1])
    Path("figures").mkdir()
    old, stale = (Path(f"figures/{name}.png") for name in NAMES["calibration"][:2])
    for file in (old, stale):
        file.write_text("of an earlier run")
    words = f"{CALIBRATE} --figures figures"
    refuses(words, file=str(old), reason="--force")
    result = run(f"{words} --force")
    assert old.read_bytes().startswith(b"robot-errors")
    assert f"note: {stale}" in result.err
    assert stale.read_text() == "of an earlier run"


# --- terminals ---------------------------------------------------------------------


def on_terminal(words: str) -> bytes:
    """What a process writes to its error stream, which is a terminal."""
    main, side = os.openpty()
    process = Popen(
        [sys.executable, "-m", "calib_pin", *words.split()],
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


# --- the viewer -------------------------------------------------------------------


def test_without_the_extra(here, monkeypatch, fails):
    monkeypatch.setattr("calib_pin.errors.find_spec", lambda _: None)
    fails("view no/robot.urdf", "calib-pin[view]")


def test_a_robot_alone(here, run, opened):
    result = run("view arm.urdf")
    assert result.status == 0 and "http://localhost:8081/?token=abc" in result.out
    assert result.err.count("\n") == 1 and "8080" in result.err
    (scene,) = opened
    assert scene.title == "arm"
    assert (scene.chains.names, scene.rows, scene.plan) == ((), None, None)
    (body,) = scene.bodies
    assert body.skeleton.joints == ("joint1", "joint2", "joint3", "joint4")
    # Several leaves are no hindrance where nothing is measured.
    assert run("view example:talos_reduced --port 5").status == 0


def test_a_calibration(here, run, opened):
    words = "view done/calibration.json new.csv rows.csv --port 5"
    assert run(words).status == 0
    assert run("view done/calibration.json --port 5").status == 0
    scene, bare = opened
    assert [body.name for body in scene.bodies] == ["nominal", "corrected"]
    assert scene.rows is not None and bare.rows is None
    before, after = scene.rows.stages.values()
    sizes = [e.sizes["position"].mean() for e in (before, after)]
    assert sizes[0] > 5.0 * sizes[1]


def test_missing_meshes_are_noted_once(here, run, opened):
    text = Path("arm.urdf").read_text()
    mesh = '<visual><geometry><mesh filename="{}.stl"/></geometry></visual>'
    for k in (1, 2):
        text = text.replace(
            f'<link name="link{k}"/>', f'<link name="link{k}">{mesh.format(k)}</link>'
        )
    Path("meshes.urdf").write_text(text)
    result = run("view meshes.urdf --port 5")
    assert result.status == 0
    assert result.err.count("\n") == 1
    assert "1.stl, 2.stl" in result.err and "--package-dir" in result.err
