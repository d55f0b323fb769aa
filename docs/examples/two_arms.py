"""Two arms on one torso: one fit, one covariance, one URDF."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

import calib_pin
from calib_pin.cli import main

Floats = NDArray[np.float64]

# The robot comes with the package example-robot-data.
ROBOT = "example:talos_reduced"
ARMS = """\
chains:
  left: {tip: arm_left_7_link}
  right: {tip: arm_right_7_link}
frames: {base: {xyz: [0.5, 1.2, -0.1], rpy: [0, 0, 1.1], estimate: true}}
"""
Path("arms.yaml").write_text(ARMS)
words = (
    f"simulate {ROBOT} --setup arms.yaml --model pose --count 60 --noise 2e-4 --seed 6"
)
main([*words.split(), "--truth", "true.urdf", "--force", "-o", "hands.csv"])

setup = calib_pin.read_setup("arms.yaml")
names = ("left", "right")
chains = calib_pin.load_chains(ROBOT, stated=setup.chains, names=names)
hands = calib_pin.read_measurements("hands.csv", chains)
result = calib_pin.calibrate(chains, hands, setup)
print(f"{result.verdict}: {result.reason}")
calib_pin.write_urdf(result.geometry, "corrected.urdf", force=True)

# A test that needs no tracker: how do the hands stand to each other?
true = calib_pin.load_chains("true.urdf", stated=setup.chains, names=names)
rng = np.random.default_rng(3)
q = {name: chains[name].random_configurations(300, rng) for name in names}
shared = [j for j in chains["left"].joints if j in chains["right"].joints]
for joint in shared:  # Both hands hang on the same torso.
    column = chains["right"].joints.index(joint)
    q["right"][:, column] = q["left"][:, chains["left"].joints.index(joint)]


def between(left: Floats, right: Floats) -> Floats:
    """The right hand as the left one sees it, positions of N configurations [m]."""
    return np.asarray((np.linalg.inv(left) @ right)[:, :3, 3])


nominal, truth, calibrated = (
    between(*(of(name).poses(q[name]) for name in names))
    for of in (chains.__getitem__, true.__getitem__, result.model.of)
)
before, after = (
    1e3 * np.linalg.norm(found - truth, axis=1) for found in (nominal, calibrated)
)
print(f"hand to hand {before.mean():.2f} mm off before, {after.mean():.2f} mm after")

figure, axes = plt.subplots(figsize=(6, 3.2), layout="constrained")
bins = np.linspace(0, before.max(), 30).tolist()
axes.hist(before, bins, color="#d55e00", alpha=0.7, label="before")
axes.hist(after, bins, color="#0072b2", alpha=0.7, label="after")
axes.set(xlabel="error of one hand in the other [mm]", ylabel="configurations")
axes.legend(frameon=False)
figure.savefig("two_arms.png", dpi=110)
