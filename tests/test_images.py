"""From images of a board to the camera that took them, by the commands alone."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
import yaml

import calib_pin
from calib_pin.cli import main
from calib_pin.io.urdf_tree import placed
from calib_pin.kinematics.spatial import invert
from calib_pin.setup import BoardSetup

pytestmark = [pytest.mark.needs("vision"), pytest.mark.slow]

ROBOT = "example:ur5_robot"
BOARD = BoardSetup("charuco", 7, 5, 0.03, marker=0.022)
SPEC = "charuco:7x5:0.03:0.022"
FRAMES = {
    "base": {"xyz": [-0.5, -0.1, 0.05], "rpy": [3.14159, 0.0, 0.3]},
    "tool": {"xyz": [0.0, 0.05, 0.05], "rpy": [0.0, 0.0, 0.3]},
}


@pytest.fixture(scope="module")
def shots(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """24 images by a camera on the hand of a robot with errors, and its joints."""
    import cv2

    from tests.io.rendered import INTRINSICS, SIZE, rendered

    folder = tmp_path_factory.mktemp("shots")
    focal, center = INTRINSICS[:2].tolist(), INTRINSICS[2:4].tolist()
    camera = {"mount": "hand", "focal": focal, "center": center, "size": [*SIZE]}
    camera["distortion"] = INTRINSICS[4:].tolist()
    stated = {
        "tip": "tool0",
        "model": "camera",
        "frames": FRAMES,
        "board": {"type": "charuco", "columns": 7, "rows": 5, "square": 0.03},
        "camera": camera,
    }
    setup = folder / "truth.yaml"
    setup.write_text(yaml.safe_dump(stated))
    files = [str(folder / name) for name in ("seen.csv", "true.urdf")]
    words = f"simulate {ROBOT} --setup {setup} --count 24 --noise 0.1 --seed 5 -o"
    assert main([*words.split(), files[0], "--truth", files[1]]) == 0
    chain = calib_pin.load_chain(files[1], tip="tool0")
    rows = calib_pin.read_measurements(files[0], chain, model="camera")
    q = np.unique(rows.q, axis=0)
    base, tool = (placed(FRAMES[end]["xyz"] + FRAMES[end]["rpy"]) for end in FRAMES)
    poses = invert(base.homogeneous @ chain.poses(q) @ tool.homogeneous)
    rng = np.random.default_rng(0)
    table = [["image", *chain.joints]]
    for k, (T, row) in enumerate(zip(poses, q, strict=True)):
        name = f"shot{k:02}.png"
        cv2.imwrite(str(folder / name), rendered(BOARD, T, rng, noise=2.0, blur=0.7))
        table.append([name, *map(repr, row.tolist())])
    with (folder / "joints.csv").open("w", newline="") as file:
        csv.writer(file).writerows(table)
    return folder


def test_images_tell_the_camera(shots, tmp_path, monkeypatch):
    """From focal lengths that are a third off."""
    from tests.io.rendered import INTRINSICS

    monkeypatch.chdir(tmp_path)
    images = sorted(map(str, shots.glob("*.png")))
    words = f"--board {SPEC} --joints {shots}/joints.csv -o m.csv --setup-output s.yaml"
    assert main(["detect", *images, *words.split()]) == 0
    stated = yaml.safe_load(Path("s.yaml").read_text())
    stated["camera"]["focal"] = [0.7 * f for f in stated["camera"]["focal"]]
    Path("s.yaml").write_text(yaml.safe_dump(stated))
    words = f"calibrate {ROBOT} m.csv --setup s.yaml --tip tool0 -o out"
    assert main(words.split()) == 0
    words = "export out --format camera-info -o"
    assert main([*words.split(), "camera.yaml"]) == 0
    found = yaml.safe_load(Path("camera.yaml").read_text())
    K = np.reshape(found["camera_matrix"]["data"], (3, 3))
    lens = found["distortion_coefficients"]["data"]
    values = [K[0, 0], K[1, 1], K[0, 2], K[1, 2], *lens]
    known = json.loads(Path("out/calibration.json").read_text())["parameters"]
    sigma = {
        p["name"].split(".")[-1]: p["sigma"] for p in known if "intrins" in p["name"]
    }
    for value, true, (name, deviation) in zip(
        values, INTRINSICS, sigma.items(), strict=True
    ):
        assert abs(value - true) < 3.0 * deviation, name
