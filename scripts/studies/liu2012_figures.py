"""The figures of the study of Liu et al. (2012)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from calib_pin.kinematics.spatial import Floats
from calib_pin.solvers.differential_evolution import TRADEOFF
from studies import shared
from studies.liu2012_study import LEAST_SQUARES, Seed, Settings

C = shared.COLORS

LINES = {
    "rand/1": (C["orange"], "-"),
    "best/1": (C["red"], "-"),
    "rand-to-best/1": (C["blue"], "-"),
    "midpoint": (C["green"], "--"),
}
"""Color and dashes of every mutation."""

BEFORE = {"color": C["orange"], "marker": "s", "label": "nominal"}
AFTER = (
    {"color": C["sky"], "marker": "^"},
    {"color": C["blue"], "marker": "o"},
)
"""Color and marker by case."""


def median_history(seeds: Sequence[Seed], count: int, mutation: str) -> Floats:
    """Median of the least sums of squares so far, by generation [m^2]."""
    histories = [seed.cases[count][mutation].history for seed in seeds]
    return np.asarray(np.median(histories, axis=0))


def _convergence(path: Path, settings: Settings, seeds: Sequence[Seed]) -> None:
    with shared.figure(path, 7.2, 3.8) as figure:
        panels = figure.subplots(1, len(settings.counts), sharey=True)
        for axes, count in zip(panels, settings.counts, strict=True):
            for mutation in settings.mutations:
                color, dashes = LINES[mutation]
                history = 1e6 * median_history(seeds, count, mutation)
                name = " = tradeoff" if mutation == TRADEOFF else ""
                axes.plot(history, dashes, color=color, label=f"{mutation}{name}")
            optima = [seed.cases[count][LEAST_SQUARES].squares for seed in seeds]
            axes.axhline(
                1e6 * np.median(optima), color="black", ls=":", label=LEAST_SQUARES
            )
            shared.log_axis(axes)
            axes.set_xlim(0, settings.generations)
            axes.set_title(f"{count} configurations, median of {len(seeds)} seeds")
            axes.set_xlabel(f"generations of {settings.population} evaluations")
        panels[0].set_ylabel("sum of squared distance errors [mm²]")
        shared.legend(figure, panels[0])


def _distances(path: Path, settings: Settings, seeds: Sequence[Seed]) -> None:
    """Distance errors of every measurement of the first seed."""
    with shared.figure(path, 7.2, 3.6) as figure:
        panels = figure.subplots(
            1, len(settings.counts), sharey=True, width_ratios=[2, 3]
        )
        for axes, count in zip(panels, settings.counts, strict=True):
            case = seeds[0].cases[count]
            _points(axes, 1e3 * np.abs(case.before.errors), BEFORE)
            calibrated = {**AFTER[1], "label": "calibrated (tradeoff)"}
            _points(axes, 1e3 * np.abs(case[TRADEOFF].errors), calibrated)
            axes.axhline(0.2, color="black", ls=":", label="0.2 mm, as published")
            shared.log_axis(axes)
            axes.set_title(f"{count} configurations, seed 0")
            axes.set_xlabel("measurement")
        panels[0].set_ylabel("distance error, absolute [mm]")
        shared.legend(figure, panels[0])


def _validation(path: Path, settings: Settings, seeds: Sequence[Seed]) -> None:
    """Errors of the tool on the validation configurations of the first seed."""
    with shared.figure(path, 7.2, 5.0) as figure:
        panels = figure.subplots(2, 1, sharex=True)
        cases = [seeds[0].cases[count] for count in settings.counts]
        for axes, name, factor, unit in (
            (panels[0], "position", 1e3, "mm"),
            (panels[1], "orientation", np.degrees(1.0), "deg"),
        ):
            before = getattr(cases[0].before.validation, name)
            _points(axes, factor * before, BEFORE)
            for case, count, style in zip(cases, settings.counts, AFTER, strict=True):
                after = getattr(case[TRADEOFF].validation, name)
                label = f"calibrated with {count} configurations"
                _points(axes, factor * after, {**style, "label": label})
            shared.log_axis(axes)
            axes.set_ylabel(f"{name} error [{unit}]")
        panels[0].set_title(
            "Tool at validation configurations, seed 0, "
            "aligned by the unobservable motions"
        )
        panels[1].set_xlabel("validation configuration")
        panels[1].set_xticks(np.arange(1, settings.validation + 1))
        shared.legend(figure, panels[0])


def _points(axes: Axes, values: Floats, style: dict[str, Any]) -> None:
    axes.plot(np.arange(1, len(values) + 1), values, ls="", markersize=4, **style)


FIGURES: shared.Figures = {
    "convergence.png": _convergence,
    "distances.png": _distances,
    "validation.png": _validation,
}
"""The figures by the names of their files."""
