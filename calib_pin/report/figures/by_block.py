"""Errors of every block of measurements, before and after."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from calib_pin.report.breakdown import block_names, keys_of
from calib_pin.report.figures.canvas import MUTED, WIDTH, Drawn, key, panel
from calib_pin.report.figures.estimates import FOOT, HEAD, LEFT, LINE, RULE, beside
from calib_pin.report.figures.labels import log_axis, log_limits, shortened, unit_of
from calib_pin.report.figures.measurement_errors import SIGNS
from calib_pin.report.tables import number
from calib_pin.validation.breakdown import Breakdown

MOST = 60
"""Lines of a panel; of more blocks the worst are drawn."""


def errors_by_block(found: Breakdown) -> Drawn | None:
    """Root-mean-square errors of each block, one panel for each quantity."""
    if len(found.blocks) < 2:
        return None
    lines: dict[tuple[str, str], list[tuple[str, float, float]]] = {}
    for name, block in zip(block_names(keys_of(found)), found.blocks, strict=True):
        for error in block.errors:
            pair = error.before.rms, error.after.rms
            of = error.name.partition(" (")[0], error.unit
            lines.setdefault(of, []).append((shortened(name), *pair))
    lines = {of: _worst(own) for of, own in lines.items()}
    count = sum(map(len, lines.values()))
    height = HEAD + LINE * (count + len(lines)) + FOOT * len(lines)
    figure, top = Figure(figsize=(WIDTH, height)), HEAD
    for (name, unit), own in lines.items():
        axes = panel(figure, LEFT, top, WIDTH - LEFT - 0.2, LINE * (len(own) + 1))
        axes.set_ylim(len(own) - 0.2, -0.8)
        axes.set_yticks([])
        for k, (label, _, _) in enumerate(own):
            beside(axes, k, label)
        axes.hlines(
            range(len(own)), 0.0, 1.0, **RULE, transform=axes.get_yaxis_transform()
        )
        display, factor = unit_of(unit)
        sizes = factor * np.array([pair for _, *pair in own])
        places = np.arange(len(own))
        axes.hlines(places, *sizes.T, color=MUTED, linewidth=0.9)
        for stage, sign in enumerate(SIGNS.values()):
            axes.plot(sizes[:, stage], places, **sign)
        if (limits := log_limits(sizes)) is not None:
            log_axis(axes, "x", limits)
        axes.set_xlabel(f"{name} error, rms [{display}]")
        top += LINE * (len(own) + 1) + FOOT
    before, after = SIGNS.values()
    key(figure, {"before (nominal robot)": before, "after (calibrated)": after}, LEFT)
    (name, unit), own = next(iter(lines.items()))
    worst = max(own, key=lambda line: line[2])
    display, factor = unit_of(unit)
    left_out = len(found.blocks) - max(map(len, lines.values()))
    remark = f" {left_out} with smaller errors are left out." if left_out > 0 else ""
    return Drawn(
        "errors-by-block",
        "Errors by block of measurements",
        f"Fitted measurements of each block. After the calibration the largest {name} "
        f"error is that of {worst[0]}: {number(factor * worst[2])} {display}. A block "
        f"that stands out was measured or mounted differently.{remark}",
        figure,
    )


def _worst(lines: list[tuple[str, float, float]]) -> list[tuple[str, float, float]]:
    """Those with the largest errors after, in their own order."""
    order = sorted(range(len(lines)), key=lambda k: -lines[k][2])[:MOST]
    return [lines[k] for k in sorted(order)]
