"""A measurement model of one's own: a height gauge on a surface plate."""

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import calib_pin
from calib_pin.cli import main
from calib_pin.measurement_models import Declaration, Inference, Quantity
from calib_pin.measurement_models.named_points import located_tool, tip_points
from calib_pin.measurement_models.tool_point import PointMeasurement, PointModel


@dataclass(frozen=True)
class HeightGauge(PointModel):
    """`residual = z(p) - height` of a point on the tool above the base's plane [m]."""

    declaration = Declaration(
        name="height",
        help="height of a point on the tool above a surface plate: height gauge",
        components=("height",),
        quantities=(Quantity("height", "m", slice(0, 1), 1e-5),),
        inference=Inference("a height"),
        yardstick="the height gauge",
    )

    def compare(self, p, site, values):
        """The height of points `p`, shape (N, 3), and its derivative by them."""
        up = np.broadcast_to([[0.0, 0.0, 1.0]], (len(p), 1, 3))
        return PointMeasurement(p[:, 2:], up, np.zeros((len(p), 1, 0)))

    def register(self, F, data, base, tool):
        """The unknown point on the tool, for which heights are linear equations."""
        tip = tip_points(self.points, tool)
        up = (base.rotation @ F[:, :3, :3])[:, 2]
        below = (F[:, :3, 3] @ base.rotation.T + base.translation)[:, 2]
        if np.isnan(tip[0, 0]):
            tip[0] = np.linalg.lstsq(up, data.values[:, 0] - below, rcond=None)[0]
        points, tool = located_tool(tip, self.points, tool)
        return replace(self, points=points), base, tool


if __name__ == "__main__":
    # A package declares its models in its metadata; pip would write these two files.
    info = Path("site", "height_gauge-1.0.dist-info")
    info.mkdir(parents=True, exist_ok=True)
    (info / "METADATA").write_text("Name: height-gauge\nVersion: 1.0\n")
    entry = (
        "[calib_pin.measurement_models]\nheight = own_measurement_model:HeightGauge\n"
    )
    (info / "entry_points.txt").write_text(entry)
    sys.path[:0] = [str(info.parent), str(Path(__file__).parent)]

    # From here on it is a model like any other, for commands and from Python.
    words = (
        "simulate space6 --model height --count 120 --noise 1e-5 --seed 9 -o plate.csv"
    )
    main(words.split())
    chain = calib_pin.load_chain("space6")
    heights = calib_pin.read_measurements("plate.csv", chain)
    result = calib_pin.calibrate(chain, heights)
    print(f"{heights.models[0]}, {result.verdict}: {result.reason}")

    figure, axes = plt.subplots(figsize=(6, 3.2), layout="constrained")
    for name, errors, color in (
        ("before", result.fitted.before, "#d55e00"),
        ("after", result.fitted.after, "#0072b2"),
    ):
        axes.plot(np.abs(1e3 * errors[:, 0]), ".", color=color, label=name)
    axes.set(yscale="log", xlabel="measurement", ylabel="error of the height [mm]")
    axes.legend(frameon=False)
    figure.savefig("own_measurement_model.png", dpi=110)
