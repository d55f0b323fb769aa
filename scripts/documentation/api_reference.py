"""The reference of the Python API: the public names, each where it is defined."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from calib_pin import _HOMES

INTRODUCTION = """\
# Python

The public names of `calib_pin`, which loads what a name needs at its first use.
Lengths are in meters, angles in radians, twists in the order (linear, angular). A
wrong input raises `calib_pin.CalibPinError`, one line that says where: the argument,
or the file and its line.

Arguments are taken where their meaning is clear: lists for arrays and tuples, one
word for a tuple of one, joint positions of shape `(n,)` for a single configuration,
one `sigma` for all values, joints in any order, a robot by its name or file, and the
keys of a setup file as a mapping.

```python
import calib_pin

chain = calib_pin.load_chain("space7")
file = calib_pin.robot_file("space7", "measurements.csv")
rows = calib_pin.read_measurements(file, chain)
result = calib_pin.calibrate("space7", rows, {"parameters": ["placement"]})
print(result)  # The first lines of the report.
poses, covariance = result.predict(rows.q)
calib_pin.write_result(result, "out")  # Whole, as the command does; and back:
result = calib_pin.read_result("out")
```

Measurements need no file. Rows are in the order in which they were measured:

```python
import numpy as np

q = chain.random_configurations(40, np.random.default_rng(1))  # rad, m
measured = chain.poses(q + 1e-3)[:, :3, 3]  # m
rows = calib_pin.Measurements(chain.joints, q, "position", measured)
print(calib_pin.calibrate(chain, rows).verdict)
```

## Threads and processes

Threads may share robots, measurements, setups and results: each has data of Pinocchio
of its own, and nothing else is written. A calibration in a thread has the numbers
that it has alone. All of these can be pickled, for `multiprocessing`, joblib or a
cluster. A progress callback is called in the thread that calibrates. Figures are
matplotlib's, which is not made for threads: draw them in one.
"""

TOPICS: Mapping[str, tuple[str, ...]] = {
    "Robots": ("load_chain", "load_chains", "robot_file", "load_collisions", "Chain"),
    "Measurements": (
        "read_measurements",
        "write_measurements",
        "Measurements",
        "Observations",
        "Conditions",
    ),
    "Setup": ("read_setup", "Setup"),
    "Calibration": ("calibrate", "CalibrationResult", "identify", "evaluate"),
    "Results": (
        "format_report",
        "report",
        "write_result",
        "write_urdf",
        "read_result",
        "read_calibration",
        "compare",
    ),
    "Planning and simulation": ("plan", "simulate", "draw_errors"),
    "Control": ("compensate",),
    "Extensions": ("register",),
    "Errors": ("CalibPinError",),
}
"""Names by topic; a test holds them to `calib_pin.__all__`."""


def text() -> str:
    """The text of docs/reference/api.md."""
    return "\n".join([INTRODUCTION, *_topics()])


def _topics() -> Iterator[str]:
    for topic, names in TOPICS.items():
        yield f"## {topic}\n"
        for name in names:
            yield f"::: calib_pin.{_HOMES[name]}.{name}\n"
