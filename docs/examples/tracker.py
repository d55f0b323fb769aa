"""A laser tracker: from a CSV file to a corrected URDF, judged by the truth."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import calib_pin
from calib_pin.cli import main

Floats = NDArray[np.float64]

# Without a tracker at hand, let a robot with known errors be measured. Yours would be
# file = "tracker.csv", with columns as in docs/reference/measurements.md.
file = "measured.csv"
base = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, 2.6), np.array([2.7, -1.5, -0.4]))
target = np.array([0.06, 0.02, 0.10])
Path("cell.yaml").write_text("""\
model: position
frames:
  base: {xyz: [2.7, -1.5, -0.4], rpy: [0, 0, 2.6]}
  tool: {xyz: [0.06, 0.02, 0.10]}
""")
words = "simulate space6 --setup cell.yaml --count 40 --noise 5e-5 --seed 1"
main([*words.split(), "--truth", "true.urdf", "--force", "-o", file])

chain = calib_pin.load_chain("space6", tip="tool")
measurements = calib_pin.read_measurements(file, chain)
result = calib_pin.calibrate(chain, measurements)
calib_pin.write_urdf(result.geometry, "corrected.urdf", force=True)
error = result.errors[0].validation_after or result.errors[0].after
print(f"{result.verdict}: {error.rms * 1e3:.3f} mm rms left")

# What nobody knows of a real robot: where the reflector is at other configurations.
q = chain.random_configurations(500, np.random.default_rng(2))
place = base.homogeneous @ calib_pin.load_chain("true.urdf", tip="tool").poses(q)
truth = place[:, :3, 3] + place[:, :3, :3] @ target


def errors(points: Floats) -> Floats:
    """How far points are from the truth [mm]."""
    return np.asarray(1e3 * np.linalg.norm(points - truth, axis=1))


after = errors(result.model.of().poses(q)[:, :3, 3])
nominal = base.homogeneous @ chain.poses(q)
before = errors(nominal[:, :3, 3] + nominal[:, :3, :3] @ target)
# Before: the nominal robot with tracker and reflector where they truly are.
print(f"elsewhere the robot was {before.mean():.2f} mm off and is {after.mean():.3f}")

figure, axes = plt.subplots(figsize=(6, 3.2), layout="constrained")
for name, sizes, color in (("before", before, "#d55e00"), ("after", after, "#0072b2")):
    share = np.arange(1, len(sizes) + 1) / len(sizes) * 100
    axes.plot(np.sort(sizes), share, color=color, label=name)
axes.set(
    xlabel="tool error anywhere in the workspace [mm]", ylabel="configurations [%]"
)
axes.set(xlim=(-0.2, None), ylim=(0, 101))  # Beside the axis, not on it.
axes.legend(frameon=False, loc="lower right")
figure.savefig("tracker.png", dpi=110)
