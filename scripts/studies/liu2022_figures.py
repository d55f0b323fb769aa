"""The figures of the study of Liu Qian et al. (2022)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from calib_pin.kinematics.spatial import Floats
from studies import shared
from studies.liu2022_study import OURS, Settings, Study, motion
from studies.tip_errors import TipErrors

C = shared.COLORS

SETS = {
    "hand-picked": (C["orange"], "s"),
    "swarm": (C["blue"], "^"),
    OURS: (C["green"], "o"),
}
"""Color and marker of every set."""

COMPONENTS = {"x": C["orange"], "y": C["blue"], "z": C["green"]}
"""Color of every component."""

QUANTITIES = {"position": ("mm", 1e3), "orientation": ("deg", np.degrees(1.0))}
"""Unit and factor of every quantity."""


def _search(path: Path, settings: Settings, study: Study) -> None:
    """Condition numbers by effort, and the singular values behind them."""
    with shared.figure(path, 7.2, 4.0) as figure:
        left, right = figure.subplots(1, 2, width_ratios=[3, 2])
        for k, swarm in enumerate(study.swarms):
            label = "their swarm, run here" if k == 0 else None
            left.plot(swarm.evaluations, swarm.best, color=C["blue"], lw=1, label=label)
        for ours, dashes, label in (
            (study.ours, "-", "ours, after exchange"),
            (study.apart, "--", "the same, without self-collision"),
        ):
            x = ours.evaluations
            left.plot(x, ours.best, dashes, color=C["green"], label=label)
        for name, value, dashes in (
            ("random, median", float(np.median(study.random)), ":"),
            ("published swarm", study.judged["swarm"].condition, "--"),
        ):
            left.axhline(value, color="black", lw=1, ls=dashes, label=name)
        left.set_xscale("log")
        shared.log_axis(left)
        left.set_title("search for six configurations")
        left.set_xlabel("evaluations of the matrix")
        left.set_ylabel("condition number")
        shared.legend(figure, left)
        for name, (color, marker) in SETS.items():
            s = study.judged[name].singular_values
            label = f"{name}: {s[0] / s[-1]:.3g}"
            order = np.arange(1, len(s) + 1)
            right.plot(order, s, marker, color=color, ms=3, label=label)
        shared.log_axis(right)
        right.set_title("singular values")
        right.set_xlabel("number")
        right.legend(loc="lower left", title="condition number")


def _trajectory(path: Path, settings: Settings, study: Study) -> None:
    """Errors along the trajectory, before and after a calibration with our set."""
    time = motion(settings).time
    step, noisy = study.judged[OURS].tip_linear, study.noisy[0][OURS].tip
    sizes = {
        "nominal": (study.nominal, C["black"]),
        "one linear step": (step, C["purple"]),
        "calibrated, noise": (noisy, C["sky"]),
        "calibrated, exact": (study.judged[OURS].tip_solved, C["red"]),
    }
    with shared.figure(path, 9.0, 5.2) as figure:
        panels = figure.subplots(2, 3, sharex=True)
        for row, (name, (unit, factor)) in zip(panels, QUANTITIES.items(), strict=True):
            before, after, all_of_them = row
            _components(before, time, factor * _of(study.nominal, name), "-")
            _components(after, time, factor * _of(step, name), "-")
            _components(after, time, factor * _of(noisy, name), "--")
            for label, (tip, color) in sizes.items():
                size = factor * np.linalg.norm(_of(tip, name), axis=1)
                all_of_them.plot(time, size, color=color, lw=1.2, label=label)
            shared.log_axis(all_of_them)
            all_of_them.set_ylabel(f"norm [{unit}]")
            before.set_ylabel(f"{name} error [{unit}]")
        panels[0, 0].set_title("nominal, components")
        panels[0, 1].set_title("linear step (solid), noise (dashed)")
        panels[0, 2].set_title("before and after")
        for axes in panels[1]:
            axes.set_xlabel("time [s]")
        handles, labels = panels[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower left", ncols=3)
        handles, labels = panels[0, 2].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower right", ncols=4)


def _of(tip: TipErrors, name: str) -> Floats:
    return np.asarray(getattr(tip, name))


def _components(axes: Axes, time: Floats, values: Floats, dashes: str) -> None:
    for (name, color), column in zip(COMPONENTS.items(), values.T, strict=True):
        axes.plot(time, column, dashes, color=color, lw=1.2, label=name)


FIGURES: shared.Figures = {"search.png": _search, "trajectory.png": _trajectory}
"""The figures by the names of their files."""
