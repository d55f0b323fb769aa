"""The report of a calibration from very many measurements: time and size.

The reference is a single scatter plot of the same measurements as SVG.
"""

from __future__ import annotations

import io
from dataclasses import replace

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

import calib_pin
from benchmarks.timing import best, show, simulated
from calib_pin.io.results import calibration_document
from calib_pin.planning.suggestions import with_suggestions
from calib_pin.report.figures import drawn
from calib_pin.report.html import html_report
from calib_pin.setup import FrameSetup, Setup
from calib_pin.validation.result import CalibrationResult, Provenance

ROWS = (10_000, 100_000)
"""Numbers of fitted measurements; as many others validate the fit."""

TOOL = FrameSetup((0.05, 0.03, 0.1))
PROVENANCE = Provenance(seconds=0.0)


def main() -> None:
    """Print time and size of the page."""
    for count in ROWS:
        result = _result(count)
        size = len(page_of(result))
        seconds = best(lambda result=result: page_of(result), 3)
        other = best(lambda result=result: scatter_of(result), 2)
        name = f"page of {size / 1e6:.2f} MB, {count} + {count} poses"
        show(name, seconds, "one scatter as SVG", other)


def _result(count: int) -> CalibrationResult:
    chain = calib_pin.load_chain("pa10")
    setup = Setup(tool_frame=TOOL)
    _, _, rows = simulated(chain, "pose", setup, 2 * count, seed=1)
    marked = replace(rows, validate=np.arange(2 * count) % 2 == 1)
    return calib_pin.calibrate(chain, marked)


def page_of(result: CalibrationResult) -> bytes:
    """The page as a command makes it."""
    result = with_suggestions(result)
    return html_report(
        result,
        calibration_document(result, PROVENANCE),
        figures=list(drawn("calibration", result)),
    )


def scatter_of(result: CalibrationResult) -> bytes:
    """The fitted measurements as one scatter plot."""
    sizes = result.fitted.sizes(result.fitted.quantities[0])
    stream = io.BytesIO()
    with mpl.rc_context({"svg.fonttype": "none"}):
        figure = Figure(figsize=(7.2, 3.0), layout="constrained")
        axes = figure.add_subplot()
        axes.set_yscale("log")
        for errors in sizes:
            axes.plot(errors, ".")
        figure.savefig(stream, format="svg")
    return stream.getvalue()
