"""`scripts/reproduce` from outside: its files, and what it refuses."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from studies.liu2012_study import MUTATIONS, Settings, study

SCRIPTS = Path(__file__).parents[2] / "scripts"


def reproduce(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "studies", *words],
        env={**os.environ, "PYTHONPATH": str(SCRIPTS)},
        capture_output=True,
        text=True,
        check=False,
    )


def test_liu2012_writes_numbers_and_figures(tmp_path: Path) -> None:
    words = ("--seeds", "1", "--generations", "20", "-o", str(tmp_path / "new"))
    ended = reproduce("liu2012", *words)
    assert ended.returncode == 0 and ended.stderr == ""
    assert all(len(line) <= 80 for line in ended.stdout.splitlines()[:-4])
    names = {"convergence.png", "distances.png", "validation.png", "liu2012.json"}
    assert {file.name for file in (tmp_path / "new").iterdir()} == names
    for name in names - {"liu2012.json"}:
        start = (tmp_path / "new" / name).read_bytes()[:8]
        assert start == b"\x89PNG\r\n\x1a\n"

    document = json.loads((tmp_path / "new" / "liu2012.json").read_text())
    assert document["settings"]["seeds"] == 1
    assert document["settings"]["generations"] == 20
    histories = document["convergence"]["median_squares_m2"]["35"]
    assert set(histories) == set(MUTATIONS)
    assert {len(history) for history in histories.values()} == {21}
    # 20 generations do not suffice, and the conditions say so.
    met = [condition["met"] for condition in document["conditions"]]
    assert met[:2] == [False, False] and met[-1]
    # The same seed gives the same numbers in this process.
    settings = Settings(counts=(35, 100), generations=20, mutations=("best/1",))
    case = study(settings, 0).cases[35]
    written = document["seeds"][0]["cases"]["35"]
    assert written["best/1"]["squares_m2"] == case["best/1"].squares
    np.testing.assert_array_equal(
        written["distance_errors_m"]["nominal"], case.before.errors
    )


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["lieu"], "reproduce: unknown study 'lieu'; there is liu2012"),
        ([], "reproduce: name a study; there is liu2012"),
        (
            ["liu2012", "--seeds", "0"],
            "reproduce liu2012: argument --seeds: '0' is not a number from 1 on",
        ),
        (
            ["liu2012", "-o", __file__],
            f"reproduce liu2012: argument -o/--output: '{__file__}' is not a folder",
        ),
    ],
)
def test_what_it_refuses(words: list[str], message: str) -> None:
    ended = reproduce(*words)
    assert ended.returncode == 1 and ended.stdout == ""
    assert ended.stderr == f"{message}\n"
