"""The figures of the study of Aoyagi et al. (2010)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import NullLocator

from studies import shared
from studies.aoyagi2010_study import GENETIC, RANDOM, Case, Cases, Settings

C = shared.COLORS

MODELS = {
    "geometric": (C["orange"], "s", "geometric only"),
    "network": (C["blue"], "o", "with the network"),
    "structure": (C["green"], "^", "right structure"),
}
"""Color, marker and label of every model."""

DASHES = {RANDOM: ("-", "random points"), GENETIC: ("--", "genetic selection by O1")}
"""Dashes and label by how the points were chosen."""

LEAST = 2e-4
"""Errors below this are so few that they are not shown [mm]."""

FLOOR: dict[str, Any] = {"color": C["black"], "lw": 1.0}
"""How the noise floor is drawn."""


def _points(path: Path, settings: Settings, seeds: Sequence[Cases]) -> None:
    """Mean errors and multiples of the noise floor against the number of points."""
    with shared.figure(path, 7.2, 4.0) as figure:
        left, right = figure.subplots(1, 2, width_ratios=[3, 2])
        for model, (color, marker, _) in MODELS.items():
            style = {"color": color, "marker": marker, "ms": 4.0}
            _lines(left, seeds, lambda c: 1e3 * c.mean(model), style)  # noqa: B023
            if model != "geometric":
                _lines(right, seeds, lambda c: c.mean(model) / c.floor, style)  # noqa: B023
        _lines(left, seeds, lambda c: 1e3 * c.floor, FLOOR)
        right.axhline(1.0, **FLOOR)
        right.axhline(3.0, color=C["black"], lw=1.0, ls=":")
        at_right = right.get_yaxis_transform()
        right.text(1.01, 3.0, "3", transform=at_right, va="center")
        for axes in (left, right):
            axes.set_xscale("log")
            axes.xaxis.set_minor_locator(NullLocator())
            axes.set_xticks(settings.counts, [str(n) for n in settings.counts])
            axes.set_xlabel("measured points")
            shared.log_axis(axes)
        count = len(seeds)
        of = f"median of {count} seeds" if count > 1 else "seed 0"
        left.set_title(f"validation configurations, {of}")
        left.set_ylabel("mean error [mm]")
        right.set_title("the same over the noise floor")
        _legend(figure, Line2D([], [], label="noise floor", **FLOOR))


def _lines(
    axes: Axes,
    seeds: Sequence[Cases],
    value: Callable[[Case], float],
    style: Mapping[str, Any],
) -> None:
    """A number against the number of points: medians of the seeds, by the sets."""
    for name, (dashes, _) in DASHES.items():
        counts = [n for n in seeds[0] if name in seeds[0][n]]
        medians = [np.median([value(seed[n][name]) for seed in seeds]) for n in counts]
        axes.plot(counts, medians, ls=dashes, **style)


def _verification(path: Path, settings: Settings, seeds: Sequence[Cases]) -> None:
    """Distribution of the errors on the verification configurations, first seed."""
    counts = sorted(settings.counts)[-3:]
    with shared.figure(path, 7.2, 3.6) as figure:
        panels = figure.subplots(
            1, len(counts), sharex=True, sharey=True, squeeze=False
        )[0]
        for axes, count in zip(panels, counts, strict=True):
            for name, case in seeds[0][count].items():
                for model, (color, _, _) in MODELS.items():
                    errors = 1e3 * np.sort(case.errors[model])
                    part = 100.0 * np.arange(1, len(errors) + 1) / len(errors)
                    axes.plot(errors, part, DASHES[name][0], color=color)
            axes.axvline(0.1, color=C["black"], lw=1.0, ls=":")
            axes.set_xscale("log")
            axes.set_xlim(LEAST)
            axes.xaxis.set_major_formatter("{x:g}")
            axes.set_title(f"{count} points, seed 0")
            axes.set_xlabel("error [mm]")
        panels[0].set_ylabel("validation configurations below [%]")
        _legend(figure, Line2D([], [], color=C["black"], ls=":", label="0.1 mm"))


def _legend(figure: Figure, last: Line2D) -> None:
    """Colors of the models, dashes of the sets, and one thing more."""
    models = [
        Line2D([], [], color=color, label=label) for color, _, label in MODELS.values()
    ]
    sets = [
        Line2D([], [], color="#777777", ls=dashes, label=label)
        for dashes, label in DASHES.values()
    ]
    # Column by column: the models, then the rest.
    figure.legend(handles=[*models, *sets, last], loc="outside lower center", ncols=2)


FIGURES: shared.Figures = {"points.png": _points, "verification.png": _verification}
"""The figures by the names of their files."""
