"""Command the real robot: a circle, by nominal and by compensated joint commands."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

import calib_pin
from calib_pin.cli import main

# Base and tool are known here, so that the true robot can be asked without a tracker.
Path("cell.yaml").write_text("""\
tip: tool
model: pose
frames: {base: {estimate: false}, tool: {estimate: false}}
""")
words = "simulate pa10 --setup cell.yaml --count 40 --noise 5e-5 --seed 8"
main([*words.split(), "--truth", "true.urdf", "--force", "-o", "poses.csv"])
chain = calib_pin.load_chain("pa10")
setup = calib_pin.read_setup("cell.yaml")
rows = calib_pin.read_measurements("poses.csv", chain)
result = calib_pin.calibrate(chain, rows, setup)
print(f"{result.verdict}: {result.reason}")

# A circle of 20 cm around where the tool is at a comfortable configuration.
start = np.array([0.2, 0.6, 0.0, 1.2, 0.1, 0.9, 0.0])
center = chain.poses(start[None])[0]
angles = np.linspace(0.0, 2.0 * np.pi, 121)
targets = np.repeat(center[None], len(angles), axis=0)
targets[:, 0, 3] += 0.1 * np.cos(angles) - 0.1
targets[:, 1, 3] += 0.1 * np.sin(angles)

found = calib_pin.compensate(
    result.model.of(), targets, np.repeat(start[None], len(angles), axis=0)
)
assert found.reached.all()
true = calib_pin.load_chain("true.urdf", tip="tool")


def errors(q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where the real tool is off the circle [mm]."""
    return np.asarray(1e3 * (true.poses(q)[:, :3, 3] - targets[:, :3, 3]))


nominal, compensated = errors(found.nominal), errors(found.q)
sizes = [np.linalg.norm(e, axis=1).max() for e in (nominal, compensated)]
print(
    f"largest deviation {sizes[0]:.2f} mm by nominal commands, {sizes[1]:.3f} mm ours"
)

figure, axes = plt.subplots(figsize=(4.8, 4.2), layout="constrained")
path = 1e3 * (targets[:, :2, 3] - targets[:, :2, 3].mean(0))
for name, error, color in (
    ("nominal commands", nominal, "#d55e00"),
    ("compensated", compensated, "#0072b2"),
):
    axes.plot(*(path + 10.0 * error[:, :2]).T, color=color, label=name)
axes.plot(*path.T, "--", color="black", linewidth=1, label="wanted")
axes.set(xlabel="x [mm], deviations x 10", ylabel="y [mm]", aspect="equal")
axes.legend(frameon=False, loc="center")
figure.savefig("compensate_trajectory.png", dpi=110)
