"""A measurement model of one's own: a height gauge on a surface plate."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

import calib_pin
from calib_pin.cli import main
from calib_pin.measurement_models import Declaration, Quantity
from calib_pin.measurement_models.named_points import located_tool, tip_points
from calib_pin.measurement_models.tool_point import PointMeasurement, PointModel

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class HeightGauge(PointModel):
    """`residual = z(p) - height` of a point on the tool above the base's plane [m]."""

    declaration = Declaration(
        name="height",
        help="height of a point on the tool above a surface plate: height gauge",
        components=("height",),
        quantities=(Quantity("height", "m", slice(0, 1), 1e-5),),
        inferred="part",
        yardstick="the height gauge",
    )

    def compare(
        self, p: Floats, site: NDArray[np.int64], values: Floats
    ) -> PointMeasurement:
        """The height of points `p`, shape (N, 3), and its derivative by them."""
        up = np.broadcast_to([[0.0, 0.0, 1.0]], (len(p), 1, 3))
        return PointMeasurement(p[:, 2:], up, np.zeros((len(p), 1, 0)))

    def register(self, F: Floats, data: Any, base: Any, tool: Any) -> Any:
        """The unknown point on the tool, for which heights are linear equations."""
        tip = tip_points(self.points, tool)
        up = (base.rotation @ F[:, :3, :3])[:, 2]
        below = (F[:, :3, 3] @ base.rotation.T + base.translation)[:, 2]
        if np.isnan(tip[0, 0]):
            tip[0] = np.linalg.lstsq(up, data.values[:, 0] - below, rcond=None)[0]
        points, tool = located_tool(tip, self.points, tool)
        return replace(self, points=points), base, tool


if __name__ == "__main__":
    # A package would declare its models in its metadata; a script registers them.
    calib_pin.register("measurement_models", "height", HeightGauge)

    # From here on it is a model like any other, for commands and from Python.
    words = (
        "simulate space6 --model height --count 120 --noise 1e-5 --seed 9 -o plate.csv"
    )
    main([*words.split(), "--force"])
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
