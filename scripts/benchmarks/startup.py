"""The cost of whole commands, and Python against the command.

The times are those of the processor, of processes one after the other in turns and with
one thread: they say the same on a busy machine. What everything is measured by is to
import Pinocchio; `LIMITS` are the most that a command may take of that.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

import calib_pin
from benchmarks.timing import DATA, processor_time, simulated
from calib_pin.kinematics.spatial import Floats
from calib_pin.setup import FrameSetup, Setup

TURNS = 5

POSES = 500

LIMITS = {
    "calibrate": 4.0,
    "calibrate with its page": 9.0,
    **dict.fromkeys(("export", "join", "init", "compare"), 4.0),
}
"""The most that commands should take, by the time of importing Pinocchio."""

TIMED = 2.0
"""Time from one standstill of the joint log to the next, which lasts half of it [s]."""

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
    """Commands by importing Pinocchio; Python by the command."""
    with tempfile.TemporaryDirectory() as name:
        _measure(Path(name))


def _measure(folder: Path) -> None:
    robot, rows, tip = _rows(folder)
    run, given = (
        ["-m", "calib_pin"],
        [robot, str(rows), *["--tip", tip][: 2 * bool(tip)]],
    )
    calibrate = [*run, "calibrate", *given]
    first, second, made = folder / "first", folder / "second", str(folder / "made")
    logs = _logs(rows, robot, tip, folder)
    forced = ["-o", made, "--force"]
    gears = ["--parameters", "placement,transmission", "-o", str(second)]
    _cpu_seconds([*calibrate, *gears])
    commands = {
        "importing pinocchio": ["-c", "import pinocchio"],
        "calib-pin --help": [*run, "--help"],
        "calibrate": calibrate,
        "calibrate with its page": [*calibrate, "-o", str(first), "--force"],
        "export": [*run, "export", str(first), "--format", "joint-offsets", *forced],
        "join": [*run, "join", *map(str, logs), *forced],
        "init": [*run, "init", *given, *forced],
        "compare": [
            *run,
            "compare",
            *(f"{d}/calibration.json" for d in (first, second)),
        ],
        "report --pdf": [*run, "report", str(first), "--pdf", made, "--force"],
    }
    seconds = dict.fromkeys(commands, float("inf"))
    python = command = float("inf")
    for _ in range(TURNS):
        for name, words in commands.items():
            seconds[name] = min(seconds[name], _cpu_seconds(words))
        found = json.loads((first / "calibration.json").read_text())
        command = min(command, found["solver"]["seconds"])
        script = [sys.executable, "-c", SCRIPT, robot, str(rows), tip]
        done = subprocess.run(
            script, check=True, capture_output=True, text=True, env=_plain()
        )
        python = min(python, float(done.stdout))
    for name, time in seconds.items():
        ratio = time / seconds["importing pinocchio"]
        most = f" (<= {LIMITS[name]:g})" if name in LIMITS else ""
        print(f"{name:<32}{1e3 * time:>9.0f} ms{ratio:>8.1f} x pinocchio{most}")
    print(
        f"{'calib_pin.calibrate in a script':<32}{1e3 * python:>9.0f} ms"
        f"{python / command:>8.2f} x the command's own time"
    )


def _logs(rows: Path, robot: str, tip: str, folder: Path) -> tuple[Path, Path]:
    """Two logs of the measurements, as a robot that stops for each would write them."""
    chain = calib_pin.load_chain(robot, tip=tip or None)
    data = calib_pin.read_measurements(rows, chain)
    begins = TIMED * np.arange(len(data))
    samples = np.arange(0.0, begins[-1] + 1.0, 0.1)
    # It stands for half of the time, and then moves evenly.
    known = np.sort(np.concatenate([begins, begins + 0.5 * TIMED]))
    q = [np.interp(samples, known, np.repeat(each, 2)) for each in data.q.T]
    joints, readings = folder / "joints.csv", folder / "readings.csv"
    _write(joints, ["time", *data.joints], np.column_stack([samples, *q]))
    values = data.only.values[:, :3]
    _write(readings, ["time", *"xyz"], np.column_stack([begins + 0.7, values]))
    return joints, readings


def _write(file: Path, header: list[str], rows: Floats) -> None:
    np.savetxt(file, rows, "%.9g", ",", header=",".join(header), comments="")


def _rows(folder: Path) -> tuple[str, Path, str]:
    """Robot, file and tip: 500 poses of a UR10, or as many of a bundled robot."""
    file = DATA / "ur10_tmac" / "train.csv"
    if file.is_file():
        return "example:ur10_robot", file, "tool0"
    print(f"(no real measurements in {DATA}: simulated ones)")
    chain = calib_pin.load_chain("space6")
    setup = Setup(tool_frame=FrameSetup())
    _, _, data = simulated(chain, "pose", setup, POSES, 1e-4)
    calib_pin.write_measurements(folder / "rows.csv", data)
    return "space6", folder / "rows.csv", ""


def _plain() -> dict[str, str]:
    """The environment of a user whose processor has one core, and keeps bytecode."""
    kept = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    return kept | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def _cpu_seconds(words: list[str]) -> float:
    """Time of the processor that a Python process takes [s]."""
    command = [sys.executable, *words]
    return processor_time(
        lambda: subprocess.run(command, check=True, capture_output=True, env=_plain())
    )
