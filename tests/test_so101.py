"""A hobbyist's SO-101, from a printed sheet or a webcam to motor offsets."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
import yaml

import calib_pin
from calib_pin.cli import main
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import skew

ROBOT = "example:so101"
CLOSE = 0.3
"""What an offset may be off [deg]."""

STEP = 360.0 / 4096
"""A step of a motor [deg]."""

SHEET = {
    "tip": "gripper_frame_link",
    "model": "position",
    "parameters": ["joint-offset"],
    # The sheet shows the outline of the base, which says where the arm stands on it.
    "frames": {"base": {"xyz": [0, 0, 0], "rpy": [0, 0, 0], "estimate": False}}
    | {"tool": {"xyz": [0, 0, 0], "estimate": False}},
    # The gripper holds a ruler by its middle.
    "targets": {
        "left": {"xyz": [0.0, 0.08, 0.0], "estimate": False},
        "right": {"xyz": [0.0, -0.08, 0.0], "estimate": False},
    },
    "noise": {"position": 5e-4},
}

WEBCAM = {
    "tip": "gripper_link",
    "model": "camera",
    "parameters": ["joint-offset"],
    "frames": {
        # The board lies face up, and its z points away from who looks at it.
        "base": {"xyz": [-0.15, 0.05, 0], "rpy": [3.14159, 0, 0], "estimate": False},
        "tool": {"xyz": [0, 0.05, 0.02], "rpy": [3.14159, 0, 0]},
    },
    "board": {"type": "charuco", "columns": 7, "rows": 5, "square": 0.02},
    "camera": {
        "mount": "hand",
        "focal": [900, 900],
        "center": [639.5, 359.5],
        "size": [1280, 720],
    },
}


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)


def touching(
    chain: Chain, end: np.ndarray, point: np.ndarray, start: np.ndarray
) -> np.ndarray:
    """Where an end of the ruler touches a point, not far from a start."""
    q = start
    for _ in range(20):
        T, J = (found[0] for found in chain.jacobian(q[None]))
        away = T[:3, :3].T @ (point - T[:3, 3]) - end
        q = q + np.linalg.pinv(J[:3] - skew(end) @ J[3:]) @ away
    assert np.linalg.norm(away) < 1e-9 and (chain.lower < q).all()
    assert (q < chain.upper).all()
    return q


def touched(offsets: np.ndarray, rng: np.random.Generator) -> None:
    """35 points of a printed grid, each touched by both ends of the ruler."""
    chain = calib_pin.load_chain(ROBOT, tip="gripper_frame_link")
    grid = np.meshgrid(0.15 + 0.03 * np.arange(7), 0.06 * np.arange(-2, 3))
    x, y = (part.ravel() for part in grid)
    header = [f"{joint} [deg]" for joint in chain.joints]
    rows = [[*header, "x [mm]", "y [mm]", "z [mm]", "target"]]
    for end, given in SHEET["targets"].items():
        for point in np.column_stack([x, y, 0.0 * x]):
            turn, tilt = (-1.0 if end == "right" else 1.0), rng.uniform(0.2, 1.2)
            start = [0.0, -0.3, 0.3, tilt, turn * rng.uniform(0.6, 1.5)]

            q = touching(chain, np.array(given["xyz"]), point, np.array(start))
            shown = STEP * np.round((np.rad2deg(q) - offsets) / STEP)
            seen = 1e3 * (point + rng.normal(0.0, 5e-4, 3))
            rows.append([*(f"{v:.4f}" for v in (*shown, *seen)), end])
    with Path("measured.csv").open("w", newline="") as file:
        csv.writer(file).writerows(rows)


def seen(offsets: np.ndarray, seed: int) -> None:
    """A printed board beside the outline of the base, seen by a webcam on the hand."""
    joints = calib_pin.load_chain(ROBOT, tip="gripper_link").joints
    errors = zip(joints, map(float, np.deg2rad(offsets)), strict=True)
    text = "".join(f"{name}.joint-offset.q: {value}\n" for name, value in errors)
    Path("errors.yaml").write_text(text)
    words = f"simulate {ROBOT} --setup setup.yaml --count 20 --errors errors.yaml"
    words += f" --noise 0.3 --seed {seed} -o measured.csv"
    assert main(words.split()) == 0


def table() -> dict[str, tuple[float, str, str]]:
    """Offset [deg], standard deviation and status by joint."""
    words = f"calibrate {ROBOT} measured.csv --setup setup.yaml -o out"
    assert main(words.split()) == 0
    words = "export out --format joint-offsets -o"
    assert main([*words.split(), "offsets.csv"]) == 0
    lines = Path("offsets.csv").read_text().splitlines()
    rows = csv.DictReader(line for line in lines if not line.startswith("#"))
    return {
        row["joint"]: (float(row["offset"]), row["sigma"], row["status"])
        for row in rows
    }


SLOW = (pytest.param(k, marks=pytest.mark.slow) for k in (1, 2, 3, 4, 5, 6, 8, 9))
# With seed 7 an offset is five degrees, as if the motor had been homed elsewhere.
SEEDS = [0, 7, *SLOW]


@pytest.mark.parametrize("seed", SEEDS)
def test_a_printed_sheet_and_a_ruler_tell_all_offsets(seed):
    rng = np.random.default_rng(seed)
    offsets = rng.uniform(-5.0, 5.0, 5)
    Path("setup.yaml").write_text(yaml.safe_dump(SHEET))
    touched(offsets, rng)
    for (offset, sigma, status), true in zip(table().values(), offsets, strict=True):
        assert status == "identifiable" and abs(offset - true) < CLOSE
        assert abs(offset - true) < 4.0 * float(sigma)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_webcam_tells_all_but_the_roll_which_its_mount_hides(seed):
    offsets = np.random.default_rng(seed).uniform(-5.0, 5.0, 5)
    Path("setup.yaml").write_text(yaml.safe_dump(WEBCAM))
    seen(offsets, seed)
    found = table()
    *known, roll = found.items()
    for (_, (offset, sigma, status)), true in zip(known, offsets, strict=False):
        assert status == "identifiable" and abs(offset - true) < CLOSE
        assert abs(offset - true) < 4.0 * float(sigma)
    assert roll == ("wrist_roll", (0.0, "", "coupled"))
    said = Path("offsets.csv").read_text()
    assert "not known by themselves" in said and "wrist_roll (coupled)" in said
