"""The figures of the study of partial pose measurements."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from calib_pin.kinematics.spatial import Floats
from studies import shared
from studies.klimchik_arm import COMPLIANCE, Settings
from studies.klimchik_design import PLANNED, RANDOM
from studies.klimchik_model import LOADS
from studies.klimchik_study import BOTH, GEOMETRY, Seed

C = shared.COLORS

MODELS = {
    "nominal": C["orange"],
    GEOMETRY: C["sky"],
    BOTH: C["blue"],
}
"""Color of every model."""


def _alternation(path: Path, settings: Settings, seeds: Sequence[Seed]) -> None:
    """The way of the alternation to the joint solution."""
    with shared.figure(path, 6.0, 3.6) as figure:
        axes = figure.subplots()
        for name, color in (("plain", C["orange"]), ("mixed", C["blue"])):
            for k, seed in enumerate(seeds):
                way = getattr(seed.alternation, name)
                label = {
                    "plain": "alternating, plain",
                    "mixed": "two-step (accelerated)",
                }
                axes.plot(way, color=color, lw=1.0, label=label[name] if not k else "")
        axes.axhline(settings.near, color=C["black"], lw=1.0, ls=":")
        axes.set_yscale("log")
        axes.set_xlim(0)
        axes.set_xlabel("rounds: base and points, then the robot")
        axes.set_ylabel("largest difference to the joint solution\n[expected sizes]")
        axes.set_title(_of(seeds))
        axes.legend()


def _elastostatics(path: Path, settings: Settings, seeds: Sequence[Seed]) -> None:
    """Errors by model and load, and the compliances beside the true ones."""
    with shared.figure(path, 7.2, 3.8) as figure:
        left, right = figure.subplots(1, 2, width_ratios=[1, 1])
        _bars(left, seeds)
        true = np.array(COMPLIANCE)
        known = [seed.elastostatics.compliances for seed in seeds]
        joints = np.arange(1, len(true) + 1)
        for k, found in enumerate(known):
            offset = 0.6 * ((k + 0.5) / len(known) - 0.5)
            sizes = (found.value - true) / found.sigma
            right.plot(joints + offset, sizes, "o", ms=3, color=C["blue"])
        right.axhline(0.0, color=C["black"], lw=1.0)
        sigma = 100.0 * np.median([found.sigma for found in known], axis=0) / true
        names = [f"{x:.1g} %" if np.isfinite(x) else "hidden" for x in sigma]
        right.set_xticks(joints, [f"{k}\n{name}" for k, name in enumerate(names, 1)])
        right.set_xlim(0.5, len(true) + 0.5)
        right.set_ylim(-4.0, 4.0)
        right.set_xlabel("joint, and standard deviation of its compliance")
        right.set_ylabel("found minus true [standard deviations]")
        right.set_title(f"compliances, {_of(seeds)}")
        shared.legend(figure, left)


def _bars(axes: Axes, seeds: Sequence[Seed]) -> None:
    """Medians of the seeds by model and load."""
    width = 0.8 / len(MODELS)
    for m, (model, color) in enumerate(MODELS.items()):
        heights = [
            1e3 * np.median([s.elastostatics.mean(model, load) for s in seeds])
            for load in LOADS
        ]
        places = np.arange(len(LOADS)) + (m - 1) * width
        bars = axes.bar(places, heights, width, color=color, label=model)
        axes.bar_label(bars, [f"{height:#.2g}" for height in heights], fontsize=8)
    shared.log_axis(axes)
    axes.set_ylim(2e-3, 12.0)
    axes.set_xticks(range(len(LOADS)), list(LOADS.values()))
    axes.grid(axis="x", visible=False)
    axes.set_ylabel("mean error at validation configurations [mm]")
    axes.set_title("median of seeds" if len(seeds) > 1 else "seed 0")


def _accuracy(path: Path, settings: Settings, seeds: Sequence[Seed]) -> None:
    """Predicted and found errors by the number of points, and at the test poses."""
    with shared.figure(path, 7.2, 3.6) as figure:
        panels = figure.subplots(1, 3)
        counts = list(seeds[0].accuracies)
        for axes, part, what in (
            (panels[0], 0, "robot: position [µm]"),
            (panels[1], 1, "robot: orientation [µrad]"),
        ):
            own = [
                [(s.accuracies[n].robot[part], s.accuracies[n].predicted_robot[part])]
                for s in seeds
                for n in counts
            ]
            _beside(axes, np.reshape(own, (len(seeds), len(counts), 2)))
            axes.set_xticks(range(len(counts)), [str(n) for n in counts])
            axes.set_xlabel("reference points")
            axes.set_title(what)
        tests = [
            [(shared.rms(s.planned[name].errors), s.planned[name].predicted)]
            for s in seeds
            for name in (RANDOM, PLANNED)
        ]
        _beside(panels[2], np.reshape(tests, (len(seeds), 2, 2)))
        panels[2].set_xticks(range(2), [RANDOM, PLANNED])
        panels[2].set_xlabel(f"{settings.count} configurations")
        panels[2].set_title("test poses: position [µm]")
        panels[0].set_ylabel("error of the tool frame")
        shared.legend(figure, panels[0])


def _beside(axes: Axes, values: Floats) -> None:
    """Found and predicted errors beside each other, shape (seeds, K, 2) [m, rad]."""
    places = np.arange(values.shape[1])
    every, root = 1e6 * values, 1e6 * np.sqrt(np.mean(values**2, axis=0))
    for k, found in enumerate(every[:, :, 0]):
        label = "every seed" if k == 0 else ""
        axes.plot(places, found, "o", ms=2.5, color=C["sky"], label=label)
    axes.plot(places, root[:, 0], "o", ms=6, color=C["blue"], label="found, rms")
    style: dict[str, Any] = {
        "marker": "_",
        "ms": 22,
        "mew": 1.5,
        "color": C["black"],
        "ls": "",
    }
    axes.plot(places, root[:, 1], label="predicted", **style)
    axes.set_xlim(-0.5, len(places) - 0.5)
    axes.set_ylim(0.0, 1.1 * every.max())
    axes.grid(axis="x", visible=False)


def _of(seeds: Sequence[Seed]) -> str:
    return f"{len(seeds)} seeds" if len(seeds) > 1 else "seed 0"


FIGURES: shared.Figures = {
    "turns.png": _alternation,
    "elastostatics.png": _elastostatics,
    "accuracy.png": _accuracy,
}
"""The figures by the names of their files."""
