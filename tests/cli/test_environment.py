"""What the environment holds changes no byte of a result."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import calib_pin

ENVIRONMENTS = (
    {
        **{"PYTHONHASHSEED": "0", "LC_ALL": "C", "TZ": "UTC", "COLUMNS": "200"},
        **{"OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"},
    },
    {
        **{"PYTHONHASHSEED": "1", "LC_ALL": "C.UTF-8", "TZ": "Asia/Tokyo"},
        **{"COLUMNS": "40", "OPENBLAS_NUM_THREADS": "3", "NUMBA_NUM_THREADS": "2"},
        **{"OMP_NUM_THREADS": "2"},
    },
)

TIMES = re.compile(
    r'"seconds": [^\n]*|"created": [^\n]*|<dt>(created|time)</dt><dd>[^<]*'
)


@pytest.mark.slow
def test_the_same_bytes_in_any_environment(tmp_path: Path) -> None:
    rows = calib_pin.robot_file("space7", "measurements.csv")
    setup = calib_pin.robot_file("space7", "setup.yaml")
    out, found = tmp_path / "out", []
    for k, environment in enumerate(ENVIRONMENTS):
        folder = tmp_path / f"folder{k}"
        folder.mkdir()
        words = ["calibrate", "space7", rows, "--setup", setup, "-o", out, "--force"]
        words += [
            "--solver",
            "two-step",
            "--learned",
            "gaussian-process",
            "--holdout",
            "0.2",
        ]
        subprocess.run(
            [sys.executable, "-m", "calib_pin.cli", *map(str, words)],
            env={**os.environ, **environment},
            cwd=folder,
            capture_output=True,
            check=True,
        )
        texts = {
            path.name: TIMES.sub("", path.read_text("utf-8")) for path in out.iterdir()
        }
        found.append(texts)
    assert {"calibration.json", "report.html"} <= found[0].keys()
    assert found[0] == found[1]
