"""The cost of a whole process, and Python against the command.

The times are those of the processor, of processes one after the other in turns: they
say the same on a busy machine. What everything is measured by is to import Pinocchio,
and to save one empty figure.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import calib_pin
from benchmarks.timing import DATA, processor_time, simulated
from calib_pin.setup import FrameSetup, Setup

TURNS = 3

FIGURE = """
import io
from matplotlib.figure import Figure
figure = Figure()
figure.add_subplot()
figure.savefig(io.BytesIO(), format="svg")
"""

SCRIPT = """
import sys, time
import numpy as np

import calib_pin
chain = calib_pin.load_chain(sys.argv[1], tip=sys.argv[3] or None)
rows = calib_pin.read_measurements(sys.argv[2], chain)
calib_pin.calibrate
start = time.perf_counter()
calib_pin.calibrate(chain, rows)
print(time.perf_counter() - start)
"""


def main() -> None:
    """Processes by importing Pinocchio and an empty figure; Python by the command."""
    with tempfile.TemporaryDirectory() as name:
        _measure(Path(name))


def _measure(folder: Path) -> None:
    robot, rows, tip = _rows(folder)
    run = ["-m", "calib_pin.cli"]
    calibrate = [*run, "calibrate", robot, str(rows), *(("--tip", tip) if tip else ())]
    out = folder / "out"
    commands = {
        "importing pinocchio": ["-c", "import pinocchio"],
        "an empty figure": ["-c", FIGURE],
        "calib-pin --help": [*run, "--help"],
        "calibrate, 500 poses": calibrate,
        "calibrate with its page": [*calibrate, "-o", str(out), "--force"],
    }
    seconds = dict.fromkeys(commands, float("inf"))
    python = command = float("inf")
    for _ in range(TURNS):
        for name, words in commands.items():
            seconds[name] = min(seconds[name], _cpu_seconds(words))
        found = json.loads((out / "calibration.json").read_text())
        command = min(command, found["solver"]["seconds"])
        script = [sys.executable, "-c", SCRIPT, robot, str(rows), tip]
        done = subprocess.run(
            script, check=True, capture_output=True, text=True, env=_plain()
        )
        python = min(python, float(done.stdout))
    pinocchio, figure = (seconds[name] for name in list(commands)[:2])
    for name, time in seconds.items():
        print(
            f"{name:<40}{1e3 * time:>11.0f} ms{time / pinocchio:>8.1f} x pinocchio"
            f"{time / (pinocchio + figure):>8.1f} x (pinocchio + figure)"
        )
    print(
        f"{'calib_pin.calibrate in a script':<40}{1e3 * python:>11.0f} ms"
        f"{python / command:>8.2f} x the command's own time"
    )


def _rows(folder: Path) -> tuple[str, Path, str]:
    """Robot, file and tip: 500 poses of a UR10, or as many of a bundled robot."""
    file = DATA / "ur10_tmac" / "train.csv"
    if file.is_file():
        return "example:ur10_robot", file, "tool0"
    print(f"(no real measurements in {DATA}: simulated ones)")
    chain = calib_pin.load_chain("space6")
    setup = Setup(tool_frame=FrameSetup())
    _, _, data = simulated(chain, "pose", setup, 500, 1e-4)
    calib_pin.write_measurements(folder / "rows.csv", data)
    return "space6", folder / "rows.csv", ""


def _plain() -> dict[str, str]:
    """The environment of a user who has set nothing about threads."""
    return {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")}


def _cpu_seconds(words: list[str]) -> float:
    """Time of the processor that a Python process takes [s]."""
    command = [sys.executable, *words]
    return processor_time(
        lambda: subprocess.run(command, check=True, capture_output=True, env=_plain())
    )
