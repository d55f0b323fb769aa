"""A hobbyist's SO-101, from a webcam to motor offsets."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
import yaml

import calib_pin
from calib_pin.cli import main

ROBOT = "example:so101"
CLOSE = 0.3
"""What an offset may be off [deg]."""

STEP = 360.0 / 4096
"""A step of a motor [deg]."""


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
    "encoder_steps": {"*": 4096},
}


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    # Figures take most of the time and are tested elsewhere.
    monkeypatch.setattr("calib_pin.cli.calibrate.draw_calibration", lambda *about: [])


def seen(offsets: np.ndarray, seed: int) -> None:
    """A printed board beside the outline of the base, seen by a webcam on the hand."""
    joints = calib_pin.load_chain(ROBOT, tip="gripper_link").joints
    errors = zip(joints, map(float, np.deg2rad(offsets)), strict=True)
    text = "".join(f"{name}.joint-offset.q: {value}\n" for name, value in errors)
    Path("errors.yaml").write_text(text)
    words = f"simulate {ROBOT} --setup setup.yaml --count 20 --errors errors.yaml"
    words += f" --noise 0.3 --seed {seed} -o measured.csv"
    assert main(words.split()) == 0


def calibrated(capsys: pytest.CaptureFixture[str]) -> str:
    """The output of the calibration, which is short."""
    capsys.readouterr()
    words = f"calibrate {ROBOT} measured.csv --setup setup.yaml -o out"
    assert main(words.split()) == 0
    printed = capsys.readouterr()
    assert (printed.out + printed.err).count("\n") <= 40
    assert "joint-offset.q" not in printed.out
    return printed.out


def told(output: str) -> dict[str, tuple[float, float, int, str]]:
    """Offset and standard deviation [deg], motor steps and the way, by joint."""
    lines = output.split("\nJoint offsets\n")[1].splitlines()
    assert " ".join(lines[0].split()) == "offset std. dev. unit steps the joint stands"
    end = next(k for k, line in enumerate(lines) if line.startswith("A joint stands"))
    found = {}
    for line in lines[1:end]:
        joint, offset, sigma, unit, steps, *way = line.split()
        assert unit == "deg"
        found[joint] = float(offset), float(sigma), int(steps), " ".join(way)
    return found


def acceptable(found: tuple[float, float, int, str], true: float, joint: str) -> None:
    """What is told of a joint, by the truth: where it stands minus what it shows."""
    offset, sigma, steps, way = found
    assert abs(offset - true) < min(CLOSE, 4.0 * sigma), joint
    assert abs(steps * STEP - true) < CLOSE + STEP, joint
    if abs(offset) >= 2.0 * sigma:
        assert way == ("further" if true > 0.0 else "less far") + " than it says"


def table() -> dict[str, tuple[str, str, str, str]]:
    """Offset [deg], standard deviation, steps and status by joint."""
    words = "export out --format joint-offsets -o"
    assert main([*words.split(), "offsets.csv"]) == 0
    lines = Path("offsets.csv").read_text().splitlines()
    rows = csv.DictReader(line for line in lines if not line.startswith("#"))
    return {
        row["joint"]: tuple(row[k] for k in ("offset", "sigma", "steps", "status"))
        for row in rows
    }


# With seed 7 an offset is five degrees, as if the motor had been homed elsewhere.
@pytest.mark.parametrize("seed", [7, pytest.param(0, marks=pytest.mark.slow)])
def test_a_webcam_tells_all_but_the_roll_which_its_mount_hides(seed, capsys):
    offsets = np.random.default_rng(seed).uniform(-5.0, 5.0, 5)
    Path("setup.yaml").write_text(yaml.safe_dump(WEBCAM))
    seen(offsets, seed)
    output = calibrated(capsys)
    found = told(output)
    assert [*found] == ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex"]
    for (joint, shown), true in zip(found.items(), offsets, strict=False):
        acceptable(shown, true, joint)
    # No number for what is not known.
    (line,) = (x for x in output.splitlines() if x.startswith("wrist_roll"))
    assert not any(letter.isdigit() for letter in line)
    *known, roll = table().items()
    for (_, (offset, sigma, _, status)), true in zip(known, offsets, strict=False):
        assert status == "identifiable" and abs(float(offset) - true) < CLOSE
        assert abs(float(offset) - true) < 4.0 * float(sigma)
    assert roll == ("wrist_roll", ("", "", "", "coupled"))
    assert "wrist_roll (coupled)" in Path("offsets.csv").read_text()


@pytest.mark.parametrize("stated", [{}, {"encoder_steps": {"elbow_flx": 4096}}])
def test_without_encoders_there_are_no_steps(stated, capsys):
    """Those of no joint are refused."""
    setup = {k: v for k, v in WEBCAM.items() if k != "encoder_steps"}
    Path("setup.yaml").write_text(yaml.safe_dump(setup))
    seen(np.zeros(5) + 2.0, 0)
    Path("setup.yaml").write_text(yaml.safe_dump(setup | stated))
    if not stated:
        assert "steps" not in calibrated(capsys)
        assert all(row[2] == "" for row in table().values())
        return
    words = f"calibrate {ROBOT} measured.csv --setup setup.yaml -o out"
    assert main(words.split()) == 1
    said = capsys.readouterr().err
    assert "'elbow_flx'" in said and "elbow_flex" in said


def test_what_slack_leaves_in_close_images_is_no_mystery(capsys):
    """A millimeter of slack is 4.5 px where the camera is 0.2 m from its board."""
    Path("setup.yaml").write_text(yaml.safe_dump(WEBCAM))
    seen(np.array([0.1, 0.3, -0.1, -0.4, 0.0]), 1)
    lines = Path("measured.csv").read_text().splitlines()
    header, *rows = csv.reader(line for line in lines if not line.startswith("#"))
    chain = calib_pin.load_chain(ROBOT, tip="gripper_link")
    joints = [header.index(joint) for joint in chain.joints]
    rng, slack = np.random.default_rng(1), dict[tuple[str, ...], np.ndarray]()
    for row in rows:
        stated = tuple(row[k] for k in joints)
        moved = slack.setdefault(stated, rng.uniform(-0.004, 0.004, 5))
        for k, shift in zip(joints, moved, strict=True):
            row[k] = str(float(row[k]) + shift)
    Path("measured.csv").write_text("\n".join(map(",".join, [header, *rows])))
    main(f"calibrate {ROBOT} measured.csv --setup setup.yaml".split())
    output = capsys.readouterr().out
    assert "px" in output and "nothing that was estimated" not in output
