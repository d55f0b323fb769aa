"""The command `view`: what it opens, what it says, and what it refuses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest


def test_without_the_extra(here, monkeypatch, fails):
    monkeypatch.setattr("calib_pin.cli.view.find_spec", lambda _: None)
    fails("view no/robot.urdf", "calib-pin[view]")


def test_a_robot_alone(here, run, opened):
    result = run("view arm.urdf --once")
    assert result.status == 0 and "http://localhost:8081/?token=abc" in result.out
    assert result.err.count("\n") == 1 and "8080" in result.err
    (scene,) = opened
    assert scene.title == "arm"
    assert (scene.chains.names, scene.rows, scene.plan) == ((), None, None)
    (body,) = scene.bodies
    assert body.skeleton.joints == ("joint1", "joint2", "joint3", "joint4")
    # Several leaves are no hindrance where nothing is measured.
    assert run("view example:talos_reduced --once --port 5").status == 0


def test_a_robot_with_measurements_and_a_plan(here, run, opened):
    result = run("view arm.urdf rows.csv --setup setup.yaml --plan new.csv --port 5")
    assert (result.status, result.err) == (0, "")
    (scene,) = opened
    assert scene.rows is not None and scene.plan is not None
    assert list(scene.rows.stages) == ["before"]
    assert (len(scene.rows.data), len(scene.plan.q)) == (40, 25)


def test_a_calibration(here, run, opened):
    words = "view done/calibration.json new.csv rows.csv --port 5"
    assert run(words).status == 0
    assert run("view done/calibration.json --port 5").status == 0
    scene, bare = opened
    assert [body.name for body in scene.bodies] == ["nominal", "corrected"]
    assert scene.rows is not None and bare.rows is None
    assert [thing.kind for thing in scene.things] == ["station"]
    np.testing.assert_allclose(scene.things[0].origin, bare.things[0].origin, atol=0.01)
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
    assert "2 meshes" in result.err and "--package-dir" in result.err


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ("", "Missing argument"),
        ("no.urdf", "no.urdf"),
        ("arm.urdf no.csv", "no.csv"),
        ("arm.urdf --plan no.csv", "no.csv"),
        ("arm.urdf rows.csv rows.csv", "twice"),
        ("arm.urdf --port 70000", "0 to 65535"),
        ("arm.urdf --port x", "'x'"),
        ("arm.urdf --tip nowhere", "'nowhere'"),
        ("arm.urdf rows.csv --model sonar", "sonar"),
        ("rows.csv", "XML"),
        ("arm.urdf --package-dir nowhere", "nowhere"),
        ("arm.urdf --package-dir rows.csv", "rows.csv"),
        ("done", "done/calibration.json"),
        ("done/calibration.json --tip link3", "tip"),
        ("done/calibration.json --setup setup.yaml --tip link3", "setup.yaml"),
        ("done/calibration.json distances.csv", "distances.csv:2"),
        ("example:talos_reduced rows.csv", "--tip"),
    ],
)
def test_bad_input(here, fails, opened, words, named):
    fails(f"view {words}", named)
    assert opened == []
