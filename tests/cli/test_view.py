"""The command `view`: what it opens, what it says, and what it refuses."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calib_pin.viewer.scene import Scene


def test_help(run: Callable[..., Any]) -> None:
    result = run("view --help")
    assert result.status == 0
    usage = "calib-pin view [OPTIONS] ROBOT|calibration.json [MEASUREMENTS...]"
    assert result.out.splitlines()[0] == f"Usage: {usage}"
    options = "--plan --port --once --package-dir --setup --model --base --tip"
    for option in options.split():
        assert f"  {option}" in result.out
    assert max(map(len, result.out.splitlines())) <= 80
    assert "\n  view " in run("--help").out


def test_without_the_extra(
    monkeypatch: pytest.MonkeyPatch, run: Callable[..., Any]
) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    result = run("view no/robot.urdf")
    assert (result.status, result.out) == (1, "")
    assert result.err == (
        "calib-pin: the viewer needs viser, which is missing: "
        "pip install 'calib-pin[view]'\n"
    )


def test_a_robot_alone(
    here: Path, run: Callable[..., Any], opened: list[Scene]
) -> None:
    result = run("view arm.urdf --once")
    assert (result.status, result.out) == (
        0,
        "viewing at http://localhost:8081/?token=abc (Ctrl-C ends it)\n",
    )
    assert result.err == "calib-pin: note: port 8080 cannot be used; 8081 is free\n"
    (scene,) = opened
    assert scene.title == "arm"
    assert (scene.chains, scene.rows, scene.plan) == (None, None, None)
    (body,) = scene.bodies
    assert body.skeleton.joints == ("joint1", "joint2", "joint3", "joint4")
    # Several leaves are no hindrance where nothing is measured.
    assert run("view example:talos_reduced --once --port 5").status == 0


def test_a_robot_with_measurements_and_a_plan(
    here: Path, run: Callable[..., Any], opened: list[Scene]
) -> None:
    result = run("view arm.urdf rows.csv --setup setup.yaml --plan new.csv --port 5")
    assert (result.status, result.err) == (0, "")
    assert result.out.splitlines() == [
        "viewing at http://localhost:5/?token=abc (Ctrl-C ends it)",
        "",
    ]
    (scene,) = opened
    assert scene.rows is not None and scene.plan is not None
    assert list(scene.rows.stages) == ["before"]
    assert (len(scene.rows.data), len(scene.plan.q)) == (40, 25)


def test_a_calibration(
    here: Path, run: Callable[..., Any], opened: list[Scene]
) -> None:
    words = "view done/calibration.json new.csv rows.csv --port 5"
    assert run(words).status == 0
    assert run("view done/calibration.json --port 5").status == 0
    scene, bare = opened
    assert [body.name for body in scene.bodies] == ["nominal", "corrected"]
    assert scene.rows is not None and bare.rows is None
    assert [thing.kind for thing in scene.things] == ["station"]
    np.testing.assert_allclose(scene.things[0].origin, bare.things[0].origin, atol=0.01)
    before, after = scene.rows.stages.values()
    sizes = [e.quantities["position"].sizes.mean() for e in (before, after)]
    assert sizes[0] > 5.0 * sizes[1]


def test_missing_meshes_are_noted_once(
    here: Path, run: Callable[..., Any], opened: list[Scene]
) -> None:
    text = Path("arm.urdf").read_text()
    mesh = '<visual><geometry><mesh filename="{}.stl"/></geometry></visual>'
    for k in (1, 2):
        text = text.replace(
            f'<link name="link{k}"/>', f'<link name="link{k}">{mesh.format(k)}</link>'
        )
    Path("meshes.urdf").write_text(text)
    result = run("view meshes.urdf --port 5")
    assert result.status == 0
    assert result.err == (
        "calib-pin: note: 2 meshes are missing or unreadable and replaced by "
        "simple shapes: 1.stl, ...; name the folder of its package with "
        "--package-dir\n"
    )


def test_few_rows_are_noted(
    here: Path, run: Callable[..., Any], opened: list[Scene]
) -> None:
    lines = Path("rows.csv").read_text().splitlines()
    Path("few.csv").write_text("\n".join(lines[:5]))
    result = run("view arm.urdf few.csv --setup setup.yaml --port 5")
    assert result.status == 0
    assert result.err.startswith(
        "calib-pin: note: the errors before cannot be trusted: "
    )


@pytest.mark.parametrize(
    ("words", "fields"),
    [
        ("", dict(text="Missing argument")),
        ("no.urdf", dict(file="no.urdf", reason="no such file")),
        ("arm.urdf no.csv", dict(file="no.csv", reason="no such file")),
        ("arm.urdf --plan no.csv", dict(file="no.csv", reason="no such file")),
        ("arm.urdf rows.csv rows.csv", dict(file="rows.csv", reason="given twice")),
        (
            "arm.urdf --port 70000",
            dict(reason="--port cannot be '70000'", allowed="0 to 65535"),
        ),
        ("arm.urdf --port x", dict(reason="--port cannot be 'x'")),
        (
            "arm.urdf --tip nowhere",
            dict(file="arm.urdf", reason="no link 'nowhere' for the tip"),
        ),
        ("arm.urdf rows.csv --model sonar", dict(reason="sonar")),
        ("rows.csv", dict(file="rows.csv", reason="XML")),
        (
            "arm.urdf --package-dir nowhere",
            dict(file="nowhere", reason="no such folder"),
        ),
        (
            "arm.urdf --package-dir rows.csv",
            dict(file="rows.csv", reason="is a file, not a folder"),
        ),
        (
            "done",
            dict(
                file="done",
                reason="is a folder",
                allowed="done/calibration.json, or a robot",
            ),
        ),
        (
            "done/calibration.json --tip link3",
            dict(reason="its own base, tip and model"),
        ),
        (
            "done/calibration.json --setup setup.yaml",
            dict(file="setup.yaml", reason="its own setup"),
        ),
        (
            "done/calibration.json distances.csv",
            dict(file="distances.csv", line=2, column="x"),
        ),
        (
            "example:talos_reduced rows.csv",
            dict(file="example:talos_reduced", reason="name one with --tip"),
        ),
    ],
)
def test_bad_input(
    here: Path,
    refuses: Callable[..., None],
    opened: list[Scene],
    words: str,
    fields: dict[str, Any],
) -> None:
    refuses(f"view {words}", **fields)
    assert opened == []
