"""Predicted accuracy over the workspace."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from calib_pin.estimation.statistics.distributions import chi2_interval
from calib_pin.kinematics.spatial import Floats
from calib_pin.report.figures.canvas import (
    SCALE,
    VECTORS,
    Drawn,
    panels,
    top_of,
)
from calib_pin.report.tables import number, unit_of
from calib_pin.validation.result import CalibrationResult

SIDES = ((0, 1), (0, 2), (1, 2))
"""Axes of the base link to the right and upwards, of every view."""


def views(points: Floats, values: Floats, label: str) -> tuple[Figure, Any]:
    """Points (N, 3) [m] of the base link from three sides, colored by values (N,)."""
    figure, (axes,) = panels(1, 3, 1.9, top=0.15, foot=1.2, gap=0.7)
    high = top_of(values)
    order = np.argsort(values)  # The largest come last and hide the others.
    size = float(np.clip(60.0 / np.sqrt(len(points)), 2.5, 5.0)) ** 2
    for view, (right, up) in zip(axes, SIDES, strict=True):
        drawn = view.scatter(
            *(points[order, right], points[order, up], size, values[order]),
            cmap=SCALE,
            vmin=float(values.min()),
            vmax=high,
            linewidths=0.0,
            rasterized=len(points) > VECTORS,
        )
        view.set_aspect("equal", "datalim")
        view.set_xlabel(f"{'xyz'[right]} [m]")
        view.set_ylabel(f"{'xyz'[up]} [m]", labelpad=1.0)
        view.locator_params(nbins=5)
    place = (0.35, 0.5 / figure.get_figheight(), 0.5, 0.04)
    scale = figure.colorbar(drawn, figure.add_axes(place), orientation="horizontal")
    scale.ax.locator_params(nbins=5)
    scale.outline.set_visible(False)
    scale.set_label(f"{label}{', more at the end' if values.max() > high else ''}")
    return figure, axes


def tip_in_workspace(result: CalibrationResult) -> Drawn | None:
    """The predicted tool-point uncertainty over the workspace, from three sides."""
    tip = result.accuracy.tip
    if tip is None or len(tip.points) == 0 or not np.isfinite(tip.position).all():
        return None
    text = "Of unmodeled errors it has what they do to the fit, not what they add"
    if weak := result.identifiability.weak:
        text += f"; it excludes the {weak} directions held at nominal"
    fit = result.statistics
    if fit.stated_sigma and fit.chi2 > chi2_interval(fit.dof)[1]:
        text += (
            "; it holds for the stated sigma, while the measurements scatter "
            f"{number(fit.sigma0)} times as much"
        )
    unit, factor = unit_of("m")
    label = f"uncertainty [{unit}], rms"
    figure, _ = views(tip.points, factor * tip.position, label)
    return Drawn(
        "Tool-point accuracy over the workspace",
        f"Predicted tool-point uncertainty (1 sigma) "
        f"{_spread(tip.points, tip.position)}, in the frame of the instrument. {text}.",
        figure,
    )


def _spread(points: Floats, sizes: Floats) -> str:
    """Lengths (N,) [m] at tool points (N, 3) [m] in words."""
    unit, factor = unit_of("m")
    values = factor * sizes
    place = ", ".join(f"{value:.2f}" for value in points[int(values.argmax())])
    rms = float(np.sqrt(np.mean(values**2)))
    return (
        f"at {len(values)} random configurations: rms {number(rms)} {unit}, from "
        f"{number(values.min())} to {number(values.max())} {unit}, the largest at "
        f"({place}) m"
    )
