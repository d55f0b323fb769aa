"""Ball and sockets: a calibration without an instrument."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

import calib_pin
from calib_pin.cli import main
from calib_pin.setup import PointSetup

Floats = NDArray[np.float64]

CELL = """\
tip: tool
model: fixed-point
targets: {ball: {xyz: [0.02, 0.03, 0.1], estimate: true}}
sockets:
  front/0: {xyz: [0.9, 0.2, 0.4]}
  front/1: {xyz: [0.9, 0.28, 0.4]}
  side/0: {xyz: [0.1, 0.95, 0.5]}
  side/1: {xyz: [0.1, 0.95, 0.58]}
"""
Path("cell.yaml").write_text(CELL)
words = "simulate space6 --setup cell.yaml --count 100 --noise 5e-5 --seed 4"
main([*words.split(), "--truth", "true.urdf", "--force", "-o", "contacts.csv"])

# All that a user knows: which socket, and how far two sockets of a plate are apart.
Path("sockets.yaml").write_text("""\
tip: tool
model: fixed-point
distances:
  - {between: [front/0, front/1], value: 0.08, sigma: 1.0e-5}
  - {between: [side/0, side/1], value: 0.08, sigma: 1.0e-5}
""")
chain = calib_pin.load_chain("space6")
setup = calib_pin.read_setup("sockets.yaml")
contacts = calib_pin.read_measurements("contacts.csv", chain, model="fixed-point")
result = calib_pin.calibrate(chain, contacts, setup)
print(f"{result.verdict}: {result.reason}")

# Where the ball was in its socket by the nominal and by the calibrated robot.
q, names = contacts.q, np.array(list(contacts.target))
ball = np.array([0.02, 0.03, 0.1, 1.0])
nominal = (chain.poses(q) @ ball)[:, :3]
model = result.model.of()
found = result.model.references["targets", "ball"].stated()
assert isinstance(found, PointSetup) and found.xyz
point = np.append(found.xyz, 1.0)
calibrated = (model.error.tip_poses(q, model.theta) @ point)[:, :3]

# The truth: how far apart the ball is at two configurations that nobody measured. The
# robot's place in the world is not known, so lengths are what can be compared.
pairs = chain.random_configurations(600, np.random.default_rng(5))


def lengths(places: Floats) -> Floats:
    """Distances between the places of a pair [mm]."""
    return np.asarray(1e3 * np.linalg.norm(places[::2, :3] - places[1::2, :3], axis=1))


truth = lengths(calib_pin.load_chain("true.urdf", tip="tool").poses(pairs) @ ball)
before = lengths(chain.poses(pairs) @ ball) - truth
after = lengths(model.error.tip_poses(pairs, model.theta) @ point) - truth
print(f"lengths were {before.std():.2f} mm off and are {after.std():.3f}")

figure, panels = plt.subplots(1, 2, figsize=(6.4, 3.2), layout="constrained")
for axes, title, points in zip(
    panels, ("before", "after"), (nominal, calibrated), strict=True
):
    for name in np.unique(names):
        own = points[names == name]
        away = 1e3 * (own - own.mean(0))
        axes.scatter(away[:, 0], away[:, 1], s=9, label=name.partition("@")[2])
    axes.set(title=title, xlim=(-6, 6), ylim=(-6, 6), aspect="equal")
    axes.set(xlabel="x of the ball in its socket [mm]", ylabel="y [mm]")
panels[1].legend(frameon=False, fontsize=8)
figure.savefig("sockets.png", dpi=110)
