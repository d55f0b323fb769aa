"""The examples do what they claim, as somebody would run them who copied them."""

from __future__ import annotations

import ast
import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

from documentation.blocks import ROOT

EXAMPLES = ROOT / "docs" / "examples"
SCRIPTS = sorted(EXAMPLES.glob("*.py"))
NOTEBOOKS = sorted(EXAMPLES.glob("*.ipynb"))
LARGEST = 80_000
"""Bytes of a picture in the repository."""


def numbers(pattern: str) -> Callable[[str], list[float]]:
    """The numbers that a program prints at the groups of a pattern."""

    def found(printed: str) -> list[float]:
        match = re.search(pattern, printed)
        assert match is not None, printed
        return [float(group) for group in match.groups()]

    return found


CLAIMS: dict[str, Callable[[str], bool]] = {
    # Against the truth, which each of them knows.
    "tracker": lambda said: (
        (sizes := numbers(r"was ([\d.]+) mm off and is ([\d.]+)")(said))[1]
        < 0.1
        < 1.0
        < sizes[0]
    ),
    "plan_measure_calibrate": lambda said: (
        (sizes := numbers(r"planned ([\d.]+) mm, random ([\d.]+) mm")(said))[0]
        < 0.8 * sizes[1]
    ),
    "sockets": lambda said: (
        (sizes := numbers(r"were ([\d.]+) mm off and are ([\d.]+)")(said))[1]
        < 0.05 * sizes[0]
    ),
    "hand_eye_camera": lambda said: (
        abs(numbers(r"focal lengths ([\d.]+)")(said)[0] - 905.0) < 1.5
    ),
    "two_arms": lambda said: (
        (sizes := numbers(r"hand ([\d.]+) mm off before, ([\d.]+)")(said))[1]
        < 0.1 * sizes[0]
    ),
    "payload_and_compliance": lambda said: (
        numbers(r"compliance: ([\d.]+) mm")(said)[0]
        < 0.05 * numbers(r"alone: ([\d.]+) mm")(said)[0]
        and all(
            # Four standard deviations, and what four digits round.
            abs(found - true) < 4.0 * sigma + 1e-4
            for joint in range(2, 7)
            for found, sigma, true in [
                numbers(rf"joint_{joint}: ([\d.]+) \+- ([\d.]+) urad/Nm, ([\d.]+) is")(
                    said
                )
            ]
        )
    ),
    "compensate_trajectory": lambda said: (
        (
            sizes := numbers(r"deviation ([\d.]+) mm by nominal commands, ([\d.]+)")(
                said
            )
        )[1]
        < 0.05 * sizes[0]
    ),
    "own_measurement_model": lambda said: (
        (sizes := numbers(r"error ([\d.]+) mm rms instead of ([\d.]+) mm")(said))[0]
        < 0.01 * sizes[1]
    ),
}


def test_there_are_eight_and_two():
    assert {path.stem for path in SCRIPTS} == CLAIMS.keys()
    assert len(NOTEBOOKS) == 2
    index = (EXAMPLES / "index.md").read_text()
    for path in (*SCRIPTS, *NOTEBOOKS):
        assert f"`{path.name}`" in index


def test_scripts_are_short_and_have_their_pictures():
    for path in SCRIPTS:
        assert len(path.read_text().splitlines()) < 80
        picture = EXAMPLES / "pictures" / f"{path.stem}.png"
        assert picture.stat().st_size < LARGEST
        assert f"pictures/{picture.name}" in (EXAMPLES / "index.md").read_text()
        assert f'savefig("{picture.name}"' in path.read_text()


def test_what_scripts_import_is_there():
    for path in SCRIPTS:
        body = ast.parse(path.read_text()).body
        imports = [one for one in body if isinstance(one, ast.Import | ast.ImportFrom)]
        exec(compile(ast.Module(imports, []), str(path), "exec"), {})


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One folder for all, as a reader has: none takes files of another for its own."""
    return tmp_path_factory.mktemp("examples")


@pytest.mark.slow
@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.stem)
def test_a_script_does_what_it_claims(path: Path, folder: Path):
    environment = os.environ | {"MPLBACKEND": "Agg"}
    done = subprocess.run(
        [sys.executable, str(path)],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert CLAIMS[path.stem](done.stdout), done.stdout
    made = (folder / f"{path.stem}.png").read_bytes()
    kept = (EXAMPLES / "pictures" / f"{path.stem}.png").read_bytes()
    assert made[16:24] == kept[16:24]  # Width and height; ink differs by fonts.


@pytest.mark.slow
def test_scripts_are_typed():
    checker = [sys.executable, "-m", "mypy", "--strict", *map(str, SCRIPTS)]
    done = subprocess.run(
        checker, cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Cell by cell, as Jupyter would, in a fresh folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(plt, "show", lambda: None)
    names: dict[str, object] = {"__name__": "__main__"}
    document = json.loads(path.read_text())
    cells = [cell for cell in document["cells"] if cell["cell_type"] == "code"]
    assert len(cells) > 4 and not any(cell["outputs"] for cell in cells)
    try:
        for number, cell in enumerate(cells, 1):
            code = compile(
                "".join(cell["source"]), f"{path.name}, cell {number}", "exec"
            )
            exec(code, names)
    finally:
        plt.close("all")
