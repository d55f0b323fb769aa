"""A camera on the hand: robot, mount, lens and board from twenty images."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import calib_pin
from calib_pin.cli import main

CELL = """\
tip: tool
model: camera
frames:
  base: {xyz: [1.0, -0.1, 0.3], rpy: [3.14159, 0, 0]}
  tool: {xyz: [0.04, 0, 0.06]}
board: {type: charuco, columns: 7, rows: 5, square: 0.03}
camera: {mount: hand, focal: [905, 903], center: [641, 478], size: [1280, 960]}
"""
Path("cell.yaml").write_text(CELL)
words = "simulate pa10 --setup cell.yaml --count 20 --noise 0.2 --seed 5 -o pixels.csv"
main(words.split())

# With images: calib-pin detect shots/*.png --board charuco:7x5:0.03:0.022
#     --joints joints.csv -o pixels.csv --setup-output camera.yaml
Path("camera.yaml").write_text("""\
tip: tool
model: camera
board: {type: charuco, columns: 7, rows: 5, square: 0.03}
camera: {mount: hand, focal: [800, 800], center: [639.5, 479.5], size: [1280, 960],
         estimate: true}
""")
chain = calib_pin.load_chain("pa10")
setup = calib_pin.read_setup("camera.yaml")
pixels = calib_pin.read_measurements("pixels.csv", chain, model="camera")
result = calib_pin.calibrate(chain, pixels, setup)
print(f"{result.verdict}: {result.reason}")

(camera,) = result.model.cameras.values()
print(
    f"focal lengths {camera.focal[0]:.1f}, {camera.focal[1]:.1f} px; 905, 903 are true"
)
mount = result.model.of().tool.translation
print(f"camera in the hand at {np.round(1e3 * mount, 1)} mm; [40 0 60] is true")

before, after = result.fitted.before, result.fitted.after
figure, panels = plt.subplots(1, 2, figsize=(6.4, 3.2), layout="constrained")
for axes, title, errors in zip(
    panels, ("nominal robot", "calibrated"), (before, after), strict=True
):
    axes.scatter(errors[:, 0], errors[:, 1], s=5, color="#0072b2", alpha=0.6)
    size = 1.1 * np.abs(errors).max()
    axes.set(title=title, xlim=(-size, size), ylim=(-size, size), aspect="equal")
    axes.set(xlabel="error along u [px]", ylabel="error along v [px]")
figure.savefig("hand_eye_camera.png", dpi=110)
