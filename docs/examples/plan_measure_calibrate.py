"""Plan, measure, calibrate: twelve good configurations against twelve random ones."""

from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

import calib_pin
from calib_pin.cli import main

Path("cell.yaml").write_text("""\
tip: tool
model: position
frames:
  base: {xyz: [2.0, 0.5, 0.1], estimate: true}
  tool: {xyz: [0.05, 0.03, 0.12], estimate: true}
noise: {position: 1.0e-4}
""")
chain = calib_pin.load_chain("space6")
setup = calib_pin.read_setup("cell.yaml")

# Where the target sits on the tool, and where the tracker stands, matters for a plan.
plan = calib_pin.plan(chain, "position", 12, setup, seed=1)
print(f"the plan promises {1e3 * plan.predicted.position:.3f} mm (1 sigma of the tool)")


def csv(name: str, q: NDArray[np.float64]) -> str:
    """A file of configurations, as the operator gets it."""
    header = ",".join(chain.joints)
    np.savetxt(name, q, delimiter=",", header=header, comments="")
    return name


def campaign(configurations: str, seed: int) -> float:
    """The tool error over the workspace [mm] after measuring these configurations."""
    words = f"simulate space6 --setup cell.yaml --seed {seed} --truth true.urdf --force"
    with redirect_stdout(StringIO()):  # It says what it writes, sixteen times.
        main([*words.split(), "--configurations", configurations, "-o", "m.csv"])
    rows = calib_pin.read_measurements("m.csv", chain)
    model = calib_pin.calibrate(chain, rows, setup, validate=False).model.of()
    q = chain.random_configurations(300, np.random.default_rng(0))
    target = np.array([0.05, 0.03, 0.12, 1.0])
    there = calib_pin.load_chain("true.urdf", tip="tool").poses(q) @ target
    truth = there[:, :3] + [2.0, 0.5, 0.1]
    off = np.linalg.norm(model.poses(q)[:, :3, 3] - truth, axis=1)
    return 1e3 * float(off.mean())


# `calib-pin plan ... -o plan.csv` writes the same file in an order of short travel.
csv("plan.csv", plan.q)
planned, random = [], []
for seed in range(8):
    planned.append(campaign("plan.csv", seed))
    drawn = chain.random_configurations(12, np.random.default_rng(seed))
    random.append(campaign(csv("random.csv", drawn), seed))
print(f"planned {np.mean(planned):.3f} mm, random {np.mean(random):.3f} mm on average")

figure, axes = plt.subplots(figsize=(6, 3.2), layout="constrained")
for x, (values, color) in enumerate(((planned, "#0072b2"), (random, "#d55e00"))):
    axes.scatter(np.full(len(values), x), values, color=color, alpha=0.7)
    axes.hlines(np.mean(values), x - 0.2, x + 0.2, color=color)
axes.set_xticks([0, 1], ["12 planned", "12 random"])
axes.set(xlim=(-0.5, 1.5), ylim=(0, None), ylabel="tool error after calibration [mm]")
figure.savefig("plan_measure_calibrate.png", dpi=110)
