"""Many jobs on a cluster in which workers, scheduler and command are killed."""

from __future__ import annotations

import csv
import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.formulation import nominal_problem

MANY = 20

pytestmark = [
    pytest.mark.slow,
    pytest.mark.needs("cluster"),
    pytest.mark.filterwarnings("default"),
]


@pytest.fixture
def jobs(here: Path) -> Path:
    """Tables of robots with errors of their own, two of which cannot be calibrated."""
    chain = calib_pin.load_chain("arm.urdf", tip="tool")
    setup = calib_pin.read_setup("setup.yaml")
    problem = nominal_problem(chain, "position", setup)
    lines = ["name,robot,measurements,setup"]
    for k in range(MANY):
        rng = np.random.default_rng([21, k])
        theta = calib_pin.draw_errors(problem.parameters, rng)
        rows = calib_pin.simulate(problem, theta, rng, count=25)
        calib_pin.write_measurements(f"m{k}.csv", rows)
        lines.append(f"robot {k:03d},arm.urdf,m{k}.csv,setup.yaml")
    Path("m7.csv").write_text("joint1,x,y,z\n1,2,3,4\n")
    Path("m8.csv").unlink()
    Path("many.csv").write_text("\n".join(lines) + "\n")
    return here


def start(folder: str, words: str = "") -> subprocess.Popen[str]:
    """Begin a fleet."""
    options = f"fleet many.csv -o {folder} --no-pages --quiet {words}"
    return subprocess.Popen(
        [sys.executable, "-m", "calib_pin.cli", *options.split()],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def ended(process: subprocess.Popen[str]) -> tuple[int, str]:
    """Status and complaint of a command."""
    _, complaint = process.communicate(timeout=1200)
    return process.returncode, complaint


def calibrations(folder: str) -> dict[Path, int]:
    """Calibrations that are there, with the time of their last change."""
    files = Path(folder).glob("robot*/calibration.json")
    return {file: file.stat().st_mtime_ns for file in files}


def wait_for(folder: str, count: int) -> None:
    """Wait until some calibrations are there."""
    deadline = time.monotonic() + 300
    while len(calibrations(folder)) < count:
        assert time.monotonic() < deadline
        time.sleep(0.02)


def finished(folder: str) -> dict[str, object]:
    """All files but for times; every job once in the table."""
    with Path(folder, "fleet.csv").open() as stream:
        names = [row["job"] for row in csv.DictReader(stream)]
    assert sorted(names) == [f"robot {k:03d}" for k in range(MANY)]
    assert names[:2] == ["robot 007", "robot 008"]
    found: dict[str, object] = {}
    for path in sorted(Path(folder).rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.name == "calibration.json":
            document = json.loads(path.read_text())
            document["provenance"].pop("created")
            document["provenance"].pop("command")
            document["solver"].pop("seconds")
            found[name] = document
        elif path.is_file():
            found[name] = path.read_bytes()
    return found


def test_kills_cost_time_only(jobs: Path, start_dask: Callable[[], Any]):
    """Of a worker, of the scheduler, and of the command itself."""
    assert ended(start("local")) == (2, "")
    expected = finished("local")
    assert len([name for name in expected if name.endswith("/arm.urdf")]) > 0.8 * MANY
    dask = start_dask()
    running = start("out", f"--cluster {dask.file}")
    wait_for("out", 4)
    dask.workers[0].send_signal(signal.SIGKILL)
    wait_for("out", 8)
    dask.scheduler.send_signal(signal.SIGKILL)
    status, complaint = ended(running)
    assert status == 1 and complaint.count("\n") == 1
    assert not Path("out", "fleet.csv").exists()
    before = calibrations("out")
    dask = start_dask()
    running = start("out", f"--cluster {dask.file} --resume")
    wait_for("out", len(before) + 3)
    running.send_signal(signal.SIGKILL)
    running.communicate()
    assert ended(start("out", "--resume"))[0] == 2
    assert finished("out") == expected
    # Finished calibrations are not done twice.
    assert before.items() <= calibrations("out").items()
