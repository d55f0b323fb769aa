"""A small robot with measurements of every kind, as files in a folder of its own."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

from calib_pin.cli import main

ARM = """<?xml version="1.0"?>
<robot name="arm">
  <link name="base_link"/><link name="link1"/><link name="link2"/>
  <link name="link3"/><link name="link4"/><link name="tool"/>
  <joint name="joint1" type="revolute">
    <origin xyz="0 0 0.4"/>
    <parent link="base_link"/><child link="link1"/><axis xyz="0 0 1"/>
    <limit lower="-2.5" upper="2.5" effort="1" velocity="1"/>
  </joint>
  <joint name="joint2" type="revolute">
    <origin xyz="0.1 0 0" rpy="0.1 0 0"/>
    <parent link="link1"/><child link="link2"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/>
  </joint>
  <joint name="joint3" type="revolute">
    <origin xyz="0.5 0 0.05"/>
    <parent link="link2"/><child link="link3"/><axis xyz="0 1 0"/>
    <limit lower="-2.5" upper="2.5" effort="1" velocity="1"/>
  </joint>
  <joint name="joint4" type="revolute">
    <origin xyz="0.4 0 0"/>
    <parent link="link3"/><child link="link4"/><axis xyz="0 0 1"/>
    <limit lower="-2.5" upper="2.5" effort="1" velocity="1"/>
  </joint>
  <joint name="tool_joint" type="fixed">
    <origin xyz="0.1 0.02 0.05" rpy="0 1.4 0"/>
    <parent link="link4"/><child link="tool"/>
  </joint>
</robot>
"""

ERRORS = "joint2.joint-offset.q: 2.0e-3\njoint3.joint-offset.q: -3.0e-3\n"
OPPOSITE = "joint2.joint-offset.q: -2.0e-3\njoint3.joint-offset.q: 3.0e-3\n"

PLANE = """\
model: plane-distance
parameters: [joint-offset]
planes:
  wall: {normal: [1, 0.2, 0.3], offset: -1.8}
"""

DRAW = "calib_pin.cli.calibrate.draw_calibration"
"""What a command draws the figures of a calibration with."""

SETUP = "tip: tool\nparameters: [joint-offset]\nnoise: {position: 1.0e-4}\n"


@dataclass(frozen=True)
class Run:
    """What a command left behind."""

    status: int
    out: str
    err: str


@pytest.fixture(scope="session")
def workshop(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files; made once, and never to be changed."""
    folder = tmp_path_factory.mktemp("workshop")
    for name, text in {
        "arm.urdf": ARM,
        "errors.yaml": ERRORS,
        "opposite.yaml": OPPOSITE,
        "none.yaml": "joint1.placement.x: 0\n",
        "plane.yaml": PLANE,
        "setup.yaml": SETUP,
    }.items():
        (folder / name).write_text(text)
    position = "--model position --noise 1e-4"
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(DRAW, lambda *about: [])
        for words in (
            f"simulate arm.urdf {position} --count 40 --errors errors.yaml "
            "--parameters joint-offset -o rows.csv --truth truth.urdf",
            f"simulate truth.urdf {position} --count 25 --seed 2 --errors none.yaml "
            "-o new.csv",
            f"simulate arm.urdf {position} --count 25 --seed 3 --errors opposite.yaml "
            "--parameters joint-offset -o foreign.csv",
            "simulate arm.urdf --model pose --count 20 --seed 4 -o poses.csv",
            "simulate arm.urdf --setup plane.yaml --count 40 --seed 5 -o distances.csv",
            "calibrate arm.urdf rows.csv --setup setup.yaml -o done --quiet",
        ):
            assert main(words.split()) == 0, words
    return folder


@pytest.fixture
def here(workshop: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the files, as the working folder."""
    folder = tmp_path / "work"
    shutil.copytree(workshop, folder)
    monkeypatch.chdir(folder)
    return folder


@pytest.fixture(autouse=True)
def undrawn(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages without figures, unless a test asks for `drawn`: they take the longest."""
    if "drawn" not in request.fixturenames:
        monkeypatch.setattr(DRAW, lambda *about: [])


@pytest.fixture
def drawn() -> None:
    """Pages and folders with their figures."""


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Callable[..., Run]:
    """Run a command in this process."""

    def run(words: str | Sequence[str]) -> Run:
        capsys.readouterr()
        status = main(words.split() if isinstance(words, str) else words)
        return Run(status, *capsys.readouterr())

    return run


@pytest.fixture
def listing() -> Callable[[Path], dict[str, str]]:
    """Every file and folder below a folder, with a hash of its content."""

    def listing(folder: Path) -> dict[str, str]:
        return {
            str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
            if path.is_file()
            else "folder"
            for path in sorted(folder.rglob("*"))
        }

    return listing
