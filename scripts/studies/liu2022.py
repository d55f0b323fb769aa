"""Liu Qian et al. 2022 from one command: numbers, conditions, figures and our plan.

What is searched and how it is calibrated stands in `liu2022_study`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from calib_pin.control.trajectory import TipErrors
from calib_pin.io.measurements import write_configurations
from calib_pin.kinematics.spatial import Floats
from studies import liu2022_figures as figures
from studies import shared
from studies.liu2022_arm import PUBLISHED, Arm
from studies.liu2022_study import OURS, Record, Settings, Study, study

SOURCE = "Liu Qian et al. 2022, Manned Spaceflight 28(6), 711-719"

SETS = (*PUBLISHED, OURS)

CONDITIONS = {"hand-picked": 354.8, "swarm": 25.2}
"""Published condition numbers."""

LINEAR = {"hand-picked": (11.95, 70.83), "swarm": (1.11, 6.67)}
"""Published errors of the sums, mean and largest [%]."""

NOMINAL = (25.0, 0.45)
"""Published errors along the trajectory before calibration [mm, deg]."""

WANTED = 5.0
"""Condition number that ours is to have at most."""

LIMIT = 10.0
"""Time that the search may take [s]."""

EXACT = 1e-9
"""Relative error of a sum that counts as rounding; the same for errors of the tip, in
m and rad."""

UNITS = (1e3, float(np.degrees(1.0)))
"""Factors to mm and degrees."""


def main(words: Sequence[str]) -> None:
    """Run the study, print it, and write its files."""
    parser = shared.options("liu2022", SOURCE, 20)
    parser.add_argument(
        *("--starts",),
        type="count",
        default=Settings.starts,
        metavar="K",
        help="starts of our search, less for a short run (default: %(default)s)",
    )
    parser.add_argument(
        *("--iterations",),
        type="count",
        default=Settings.iterations,
        metavar="U",
        help="iterations of a swarm, less for a short run (default: %(default)s)",
    )
    chosen = parser.parse_args(words)
    settings = Settings(starts=chosen.starts, iterations=chosen.iterations)
    report = Report(settings, study(settings, chosen.seeds))
    print(report.text())
    for condition in report.conditions():
        print(condition)
    shared.write_json(chosen.output / "liu2022.json", report.document())
    write_plan(chosen.output / "plan.csv", report.study.apart)
    written = figures.draw(chosen.output, settings, report.study)
    print()
    for name in ("liu2022.json", "plan.csv", *written):
        print(f"wrote {chosen.output / name}")


def write_plan(path: Path, ours: Record) -> None:
    """Write our configurations, for `calib-pin simulate --configurations`."""
    comments = [
        f"Six configurations of space7 with condition number {ours.condition:.2f}, in",
        f"place of those of {SOURCE};",
        "the arm keeps its distance from itself.",
    ]
    chain = Arm.load().problem.error.chain
    write_configurations(path, chain, ours.q, comments=comments, force=True)


class Report:
    """The numbers of a study.

    Args:
        settings: What was searched and simulated.
        study: What came out.
    """

    def __init__(self, settings: Settings, study: Study) -> None:
        """Keep both."""
        self.settings, self.study = settings, study

    def noisy(self, name: str, value: Callable[[Floats], float]) -> float:
        """Median over the seeds of a number of the sums' errors with noise."""
        seeds = self.study.noisy
        return float(np.median([value(seed[name].errors) for seed in seeds]))

    def noisy_tip(self, name: str) -> tuple[float, float]:
        """Median over the seeds of the largest errors of the tip with noise."""
        largest = [seed[name].tip.largest for seed in self.study.noisy]
        position, orientation = np.median(largest, axis=0).tolist()
        return position, orientation

    @property
    def swarm(self) -> float:
        """Median of the condition numbers of the swarms that ran here."""
        return float(np.median([swarm.condition for swarm in self.study.swarms]))

    def text(self) -> str:
        """Tables for the terminal."""
        parts = self._head(), self._searched(), self._sums(), self._tip()
        return "\n\n".join("\n".join(part) for part in parts) + "\n"

    def _head(self) -> Iterator[str]:
        noise = dict(self.settings.noise)
        yield SOURCE
        yield shared.wrapped(
            "The arm space7 with the published errors, calibrated by its tool's poses "
            "at six configurations within +-120 deg: by one linear step as published, "
            "then by ours, from exact poses and from poses with noise of "
            f"{1e3 * noise['position']:g} mm and "
            f"{np.degrees(noise['orientation']):g} deg ({len(self.study.noisy)} seeds)."
        )

    def _searched(self) -> Iterator[str]:
        s, ours = self.settings, self.study.ours
        title = "Condition number of the 36 x 34 matrix"
        yield f"{title:<48}{'published':>16}{'here':>16}"
        for name, published in CONDITIONS.items():
            found = self.study.judged[name].condition
            yield self._condition(name, found, f"{published:g}")
        yield self._condition(
            f"random, median of {len(self.study.random)}",
            float(np.median(self.study.random)),
        )
        count = len(self.study.swarms)
        runs = f"median of {count} runs" if count > 1 else "one run"
        yield self._condition(f"improved swarm run here, {runs}", self.swarm)
        yield self._condition(f"{OURS}, within the limits", ours.condition)
        apart = self.study.apart
        yield self._condition(f"{OURS}, without self-collision too", apart.condition)
        yield (
            f"ours: exchange among {s.candidates} candidates, {s.starts + 1} descents, "
            f"{ours.evaluations[-1]:.0f}"
        )
        yield (
            f"matrices with gradients, {ours.seconds:.1f} s ({apart.seconds:.1f} s "
            "without self-collision)"
        )
        if count:
            swarm = self.study.swarms[0]
            yield (
                f"swarm: {s.particles} particles, {s.iterations} iterations, "
                f"{swarm.evaluations[-1]:.0f} matrices, {swarm.seconds:.1f} s each"
            )

    @staticmethod
    def _condition(name: str, value: float, published: str = "") -> str:
        return f"  {name:<46}{published:>16}{value:>16.4g}"

    def _sums(self) -> Iterator[str]:
        """Errors of the parameters."""
        judged = self.study.judged
        yield self._row("Relative errors of 34 sums [%]", SETS, 16)
        yield self._row("", ("mean", "largest") * 3)
        yield self._row(
            "  one linear step, published",
            [f"{x:g}" for name in LINEAR for x in LINEAR[name]],
        )
        for label, rows in (
            ("one linear step", [judged[name].linear for name in SETS]),
            ("our calibration", [judged[name].solved for name in SETS]),
        ):
            numbers = [100.0 * float(f(row)) for row in rows for f in (np.mean, np.max)]
            yield self._row(f"  {label}", map(number, numbers))
        medians = [
            100.0 * self.noisy(name, f) for name in SETS for f in (np.mean, np.max)
        ]
        yield self._row("  our calibration, with noise", map(number, medians))

    def _tip(self) -> Iterator[str]:
        """Errors along the trajectory."""
        judged = self.study.judged
        yield self._row("Tool along the trajectory,", SETS, 16)
        yield self._row("largest components", ("mm", "deg") * 3)
        yield self._row("  one linear step, published", ("", "", "< 1", "< 0.1"))
        for label, tips in (
            ("one linear step", [judged[name].tip_linear for name in SETS]),
            ("our calibration", [judged[name].tip_solved for name in SETS]),
        ):
            yield self._row(f"  {label}", self._largest(tips))
        medians = [
            x * factor
            for name in SETS
            for x, factor in zip(self.noisy_tip(name), UNITS, strict=True)
        ]
        yield self._row("  our calibration, with noise", map(number, medians))
        position, orientation = self._largest([self.study.nominal])
        yield (
            f"nominal: {position} mm, {orientation} deg "
            f"(published {NOMINAL[0]:g} mm, {NOMINAL[1]:g} deg)"
        )

    @staticmethod
    def _largest(tips: Sequence[TipErrors]) -> Iterator[str]:
        for tip in tips:
            for value, factor in zip(tip.largest, UNITS, strict=True):
                yield number(value * factor)

    @staticmethod
    def _row(label: str, cells: Iterable[str], width: int = 8) -> str:
        columns = "".join(f"{cell:>{width}}" for cell in cells)
        return f"{label:<32}{columns}".rstrip()

    def conditions(self) -> Iterator[shared.Condition]:
        """What must be shown, whether it is, and by what numbers."""
        yield self._matrix()
        yield self._planned()
        yield self._step()
        yield self._solved()
        yield self._corrected()
        yield self._with_noise()

    def _matrix(self) -> shared.Condition:
        found = {name: self.study.judged[name].condition for name in PUBLISHED}
        words = [f"{found[name]:.1f} {name}" for name in PUBLISHED]
        return shared.Condition(
            f"the matrix is the published one: condition numbers {', '.join(words)}",
            all(abs(found[name] - CONDITIONS[name]) < 0.1 for name in PUBLISHED),
            dict(found),
        )

    def _planned(self) -> shared.Condition:
        ours = self.study.ours
        found, apart = (search.condition for search in (ours, self.study.apart))
        return shared.Condition(
            f"our six configurations reach {found:.2f}, {apart:.2f} without "
            f"self-collision (at most {WANTED:g}), in {ours.seconds:.1f} s (at most "
            f"{LIMIT:g})",
            max(found, apart) <= WANTED and ours.seconds <= LIMIT,
            {
                "condition": found,
                "condition_without_self_collision": apart,
                "seconds": ours.seconds,
            },
        )

    def _step(self) -> shared.Condition:
        means = {name: float(self.study.judged[name].linear.mean()) for name in SETS}
        words = [f"{100 * means[name]:.3g} % {name}" for name in SETS]
        return shared.Condition(
            f"one linear step, mean error of the sums: {', '.join(words)}",
            falling(means),
            means,
        )

    def _solved(self) -> shared.Condition:
        worst = max(float(judged.solved.max()) for judged in self.study.judged.values())
        verdicts = {judged.verdict for judged in self.study.judged.values()}
        return shared.Condition(
            f"our calibration finds the sums of exact poses but for rounding: relative "
            f"errors up to {worst:.1e} (limit {EXACT:g})",
            worst < EXACT and verdicts == {"good"},
            {"largest_relative_error": worst},
        )

    def _corrected(self) -> shared.Condition:
        before = self.study.nominal.largest
        largest = [judged.tip_solved.largest for judged in self.study.judged.values()]
        position, orientation = np.max(largest, axis=0).tolist()
        return shared.Condition(
            f"the largest error along the trajectory falls from {1e3 * before[0]:.1f} "
            f"mm, {np.degrees(before[1]):.2f} deg to {1e3 * position:.1e} mm, "
            f"{np.degrees(orientation):.1e} deg, whatever the set",
            max(position, orientation) < EXACT,
            {
                "before_m": before[0],
                "before_rad": before[1],
                "after_m": position,
                "after_rad": orientation,
            },
        )

    def _with_noise(self) -> shared.Condition:
        sums = {name: self.noisy(name, lambda e: float(e.mean())) for name in SETS}
        tips = {name: self.noisy_tip(name)[0] for name in SETS}
        words = [
            f"{100 * sums[name]:.3g} % and {1e3 * tips[name]:.2g} mm {name}"
            for name in SETS
        ]
        return shared.Condition(
            f"with noise, mean error of the sums and largest of the tip: "
            f"{', '.join(words)}",
            falling(sums) and falling(tips),
            {f"{name}_mean_relative_error": sums[name] for name in SETS}
            | {f"{name}_tip_m": tips[name] for name in SETS},
        )

    def document(self) -> dict[str, object]:
        """All numbers; names end in their unit."""
        s, study = self.settings, self.study
        return {
            "study": "liu2022",
            "source": SOURCE,
            "versions": shared.versions(),
            "settings": {"seeds": len(study.noisy)} | settings_of(s),
            "published": {
                "condition": CONDITIONS,
                "relative_errors_mean_largest_percent": LINEAR,
                "nominal_tip_mm_deg": NOMINAL,
                "corrected_tip_mm_deg": "< 1, < 0.1 (swarm)",
            },
            "conditions": [asdict(condition) for condition in self.conditions()],
            "random": {
                "median": float(np.median(study.random)),
                "least": float(study.random.min()),
            },
            "ours": search_of(study.ours),
            "ours_without_self_collision": search_of(study.apart),
            "swarms": [search_of(swarm) for swarm in study.swarms],
            "nominal_tip": tip_of(study.nominal),
            "sets": {name: self._set(name) for name in SETS},
        }

    def _set(self, name: str) -> dict[str, object]:
        """Numbers of a set of configurations."""
        judged = self.study.judged[name]
        return {
            "q_rad": judged.q.tolist(),
            "condition": judged.condition,
            "singular_values": judged.singular_values.tolist(),
            "linear_step": errors_of(judged.linear) | tip_of(judged.tip_linear),
            "calibration": errors_of(judged.solved) | tip_of(judged.tip_solved),
            "calibration_with_noise": [
                errors_of(seed[name].errors) | tip_of(seed[name].tip)
                for seed in self.study.noisy
            ],
        }


def falling(values: dict[str, float]) -> bool:
    """Whether ours has the least, and the hand-picked set the largest value."""
    hand_picked, swarm, ours = (values[name] for name in SETS)
    return hand_picked > swarm > ours


def settings_of(settings: Settings) -> dict[str, object]:
    """Settings under names with their units."""
    names = {
        "noise": "noise_m_rad",
        "start": "start_rad",
        "goal": "goal_rad",
        "velocity": "velocity_rad_per_s",
        "acceleration": "acceleration_rad_per_s2",
        "period": "period_s",
    }
    return shared.renamed(settings, names)


def search_of(search: Record) -> dict[str, object]:
    """The numbers of a search."""
    return {
        "condition": search.condition,
        "seconds": search.seconds,
        "q_rad": search.q.tolist(),
        "evaluations": search.evaluations.tolist(),
        "best": search.best.tolist(),
    }


def errors_of(relative: Floats) -> dict[str, float]:
    """Relative errors of the sums."""
    return {
        "mean_relative_error": float(relative.mean()),
        "largest_relative_error": float(relative.max()),
    }


def tip_of(tip: TipErrors) -> dict[str, float]:
    """Largest errors along the trajectory."""
    position, orientation = tip.largest
    return {
        "largest_component_m": position,
        "largest_component_rad": orientation,
        "largest_distance_m": float(tip.distances.max()),
        "largest_angle_rad": float(tip.angles.max()),
    }


def number(value: float) -> str:
    """Three significant digits, of rounding one."""
    if 0.0 < value < 1e-4:
        return f"{value:.0e}"
    return f"{value:.3g}" if value < 100.0 else f"{value:.0f}"
