"""The accuracies as a figure: one line for every kind of held-out measurements."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from benchmarks.accuracy.measuring import CHOSEN, NOMINAL, Errors, Measured
from benchmarks.accuracy.published import Published, published
from benchmarks.accuracy.showing import HEADERS, MM
from calib_pin.report.figures.canvas import (
    AFTER,
    BEFORE,
    GROUPS,
    INK,
    MUTED,
    Drawn,
    key,
    log_axis,
    marks,
    panels,
)

LINE = 0.24
"""Height of a line [inch]."""

LEFT = 2.8
"""Width of the names [inch]."""

SIGNS = {
    NOMINAL: marks(BEFORE, "o", hollow=True),
    "placement": marks(MUTED, "v"),
    "compliance": marks(GROUPS[2], "^"),
    CHOSEN: marks(AFTER, "s", 8.0, hollow=True),
}
PREDICTED = marks(AFTER, "|", 11.0, hollow=True)
OTHERS = marks(INK, "x", 5.0, hollow=True)


def figure_of(found: Sequence[Measured]) -> Drawn:
    """Errors near and away by data set, with what others reach."""
    lines = [(measured, line) for measured in found for line in measured.lines]
    height = LINE * (len(lines) + 1)
    figure, ((axes,),) = panels(1, 1, height, left=LEFT, top=0.35)
    axes.set_ylim(len(lines) - 0.2, -0.8)
    names = []
    drawn = []
    for place, (measured, line) in enumerate(lines):
        which = measured.data_set.statistic
        names.append(f"{measured.data_set.name}, {line.what} ({which})")
        for method, sign in SIGNS.items():
            size = MM * getattr(line.errors[method], which)
            axes.plot([size], [place], **sign)
            drawn.append(size)
        if (predicted := measured.predicted_beside(line)) is not None:
            size = MM * getattr(predicted, which)
            axes.plot([size], [place], **PREDICTED)
            drawn.append(size)
        for other in _others(measured, line):
            axes.plot([other.error], [place], **OTHERS)
            drawn.append(other.error)
    axes.set_yticks(range(len(lines)), names)
    log_axis(axes, "x", np.array(drawn))
    axes.set_xlabel("position error [mm]")
    signs = {HEADERS[method]: sign for method, sign in SIGNS.items()}
    key(figure, signs | {"predicted away": PREDICTED, "others": OTHERS})
    return Drawn(
        "Accuracy on public measurements",
        "Position errors on measurements that were not fitted, mean or rms as others "
        "tell it. A model that chose itself should be left of the others near the "
        "fitted configurations, and right of none away from them.",
        figure,
        "accuracy",
    )


def _others(measured: Measured, line: Errors) -> list[Published]:
    """What others reach, in the statistic that is drawn."""
    data_set = measured.data_set
    known = published(data_set.key, line.where)
    return [each for each in known if each.statistic == data_set.statistic]
