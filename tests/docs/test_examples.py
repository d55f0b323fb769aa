"""The examples do what they claim, as somebody would run them who copied them."""

from __future__ import annotations

import ast
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest

from documentation.blocks import ROOT

EXAMPLES = ROOT / "docs" / "examples"
SCRIPTS = sorted(EXAMPLES.glob("*.py"))
NOTEBOOKS = sorted(EXAMPLES.glob("*.ipynb"))
LARGEST = 80_000
"""Bytes of a picture in the repository."""


CLAIMS: dict[str, tuple[str, float]] = {
    "tracker": (r"was (?P<before>[\d.]+) mm off and is (?P<after>[\d.]+)", 0.1),
    "plan_measure_calibrate": (
        r"planned (?P<after>[\d.]+) mm, random (?P<before>[\d.]+) mm",
        0.8,
    ),
    "sockets": (r"were (?P<before>[\d.]+) mm off and are (?P<after>[\d.]+)", 0.05),
    "two_arms": (r"hand (?P<before>[\d.]+) mm off before, (?P<after>[\d.]+) mm", 0.1),
    "payload_and_compliance": (
        r"alone: (?P<before>[\d.]+) mm.*compliance: (?P<after>[\d.]+) mm",
        0.05,
    ),
    "compensate_trajectory": (
        r"deviation (?P<before>[\d.]+) mm by nominal commands, (?P<after>[\d.]+)",
        0.05,
    ),
    "own_measurement_model": (
        r"error (?P<after>[\d.]+) mm rms instead of (?P<before>[\d.]+) mm",
        0.01,
    ),
    "hand_eye_camera": (r"focal lengths (?P<focal>[\d.]+)", 1.5),
}
"""What a script prints against the truth, which it knows: errors after and before, and
the part that may be left; of a focal length the pixels that it may be off."""


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
    pattern, part = CLAIMS[path.stem]
    claimed = re.search(pattern, done.stdout, re.DOTALL)
    assert claimed is not None, done.stdout
    sizes = {name: float(value) for name, value in claimed.groupdict().items()}
    if "focal" in sizes:
        assert abs(sizes["focal"] - 905.0) < part
    else:
        assert sizes["after"] < part * sizes["before"]
    told = re.findall(r"([\d.]+) \+- ([\d.]+) urad/Nm, ([\d.]+) is", done.stdout)
    assert len(told) == (5 if path.stem == "payload_and_compliance" else 0)
    for found, sigma, true in np.array(told, float).reshape(-1, 3):
        # Four standard deviations, and what four digits round.
        assert abs(found - true) < 4.0 * sigma + 1e-4
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
