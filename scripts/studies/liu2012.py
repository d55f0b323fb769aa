"""Liu, Ni, Liu, Xu 2012 from one command: numbers, conditions, figures.

What is simulated and how it is solved stands in `liu2012_study`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import partial

import numpy as np

from calib_pin.kinematics.spatial import Floats
from calib_pin.solvers.differential_evolution import TRADEOFF
from studies import liu2012_figures as figures
from studies import shared
from studies.liu2012_study import (
    LEAST_SQUARES,
    Case,
    Outcome,
    Seed,
    Settings,
    study,
)

SOURCE = "Liu, Ni, Liu, Xu 2012, doi 10.1007/s11771-012-1095-1"

QUANTITIES = {
    "distance": ("mm", 1e3),
    "position": ("mm", 1e3),
    "orientation": ("deg", np.degrees(1.0)),
}
"""What validation compares, with unit and factor for the terminal."""

MET = 0.2e-3
"""Largest distance error after calibration in the publication [m]."""

REACHED = 0.01
"""Part of the least sum of squares that an evolution may exceed and have reached it."""

SAME = 1e-10
"""Relative difference of two costs that count as equal."""


def main(words: Sequence[str]) -> None:
    """Run the study, print it, and write its files."""
    parser = shared.options("liu2012", SOURCE, 20)
    parser.add_argument(
        *("--generations",),
        type="count",
        default=Settings.generations,
        metavar="G",
        help="limit of the evolutions, less for a short run (default: %(default)s)",
    )
    chosen = parser.parse_args(words)
    settings = Settings(generations=chosen.generations)
    seeds = shared.each(partial(study, settings), range(chosen.seeds), "seed")
    report = Report(settings, seeds)
    print(report.text())
    for condition in report.conditions():
        print(condition)
    shared.write_json(chosen.output / "liu2012.json", report.document())
    written = figures.draw(chosen.output, settings, seeds)
    print()
    for name in ("liu2012.json", *written):
        print(f"wrote {chosen.output / name}")


class Report:
    """The numbers of some seeds.

    Args:
        settings: What was simulated.
        seeds: What came out, seed by seed.
    """

    def __init__(self, settings: Settings, seeds: Sequence[Seed]) -> None:
        """Keep both."""
        self.settings, self.seeds = settings, seeds
        self._first, self._last = min(settings.counts), max(settings.counts)

    def median(self, count: int, value: Callable[[Case], float]) -> float:
        """Median of a number over the seeds of one case."""
        return float(np.median([value(seed.cases[count]) for seed in self.seeds]))

    def text(self) -> str:
        """Tables for the terminal."""
        return "\n".join([*self._head(), "", *self._fitted(), "", *self._unseen()])

    def _head(self) -> Iterator[str]:
        s, redrawn = self.settings, sum(seed.redrawn for seed in self.seeds)
        times = f"{redrawn} time{'' if redrawn == 1 else 's'}"
        yield SOURCE
        yield shared.wrapped(
            "A laser ranger on a plane. The robot is space6 in place of the lost DH "
            f"table, with 24 dh errors up to {1e3 * s.size:g} mm and "
            f"{1e3 * s.size:g} mrad and the published errors of the plane: n_x "
            f"{s.plane[0]}, n_z {s.plane[1]}. All 27 are searched at once, within "
            f"{1e3 * s.box:g} mm and {1e3 * s.box:g} mrad (plane: "
            f"{1e3 * s.plane_box[0]:g} mrad, {1e3 * s.plane_box[2]:g} mm)."
        )
        yield shared.wrapped(
            f"Np {s.population}, F {s.mutation}, CR {s.recombination}, "
            f"G {s.generations}, V {1e6 * s.target:g} mm^2 (below the noise). "
            f"{len(self.seeds)} seeds; errors are drawn again until the nominal "
            f"robot is more than {1e3 * s.start:g} mm off ({times})."
        )

    def _fitted(self) -> Iterator[str]:
        """What the evolutions make of the calibration configurations."""
        cases = "".join(f"{count:>14}" for count in self.settings.counts)
        yield f"{'Calibration configurations, medians':<36}{cases}{'published':>16}"
        yield "largest distance error [mm]"
        published = {"nominal": "> 30 (both)", TRADEOFF: "< 0.2 (both)"}
        for name in ("nominal", LEAST_SQUARES, *self.settings.mutations):
            yield self._line(
                name,
                [
                    1e3 * self.median(count, lambda c: largest(c[name]))  # noqa: B023
                    for count in self.settings.counts
                ],
                published.get(name, ""),
            )
        yield "sum of squared distance errors [mm^2]"
        for name in (LEAST_SQUARES, *self.settings.mutations):
            yield self._line(
                name,
                [
                    1e6 * self.median(count, lambda c: c[name].squares)  # noqa: B023
                    for count in self.settings.counts
                ],
                "the lowest" if name == TRADEOFF else "",
            )
        yield f"seeds that come within {100 * REACHED:g} % of least squares"
        for name in self.settings.mutations:
            counts = [self._reached(count, name) for count in self.settings.counts]
            yield self._line(name, [f"{k} of {len(self.seeds)}" for k in counts])
        yield (
            f"tradeoff, its formula lost, is {TRADEOFF} here; least squares is\n"
            "Gauss-Newton in the same 27 parameters, from the nominal robot."
        )

    def _reached(self, count: int, name: str) -> int:
        limit = 1.0 + REACHED
        cases = [seed.cases[count] for seed in self.seeds]
        return sum(c[name].squares <= limit * c[LEAST_SQUARES].squares for c in cases)

    @staticmethod
    def _line(name: str, values: Sequence[float | str], published: str = "") -> str:
        label = f"{name} = tradeoff" if name == TRADEOFF else name
        columns = [v if isinstance(v, str) else number(v) for v in values]
        line = f"  {label:<34}{''.join(f'{c:>14}' for c in columns)}{published:>16}"
        return line.rstrip()

    def _unseen(self) -> Iterator[str]:
        """Validation, before and after."""
        count = self.settings.validation
        cases = "".join(f"{f'after {n}':>14}" for n in self.settings.counts)
        title = f"{count} validation configurations, tradeoff"
        yield f"{title:<42}{'nominal':>10}{cases}"
        for name, (unit, factor) in QUANTITIES.items():
            for label, statistic in (("rms", rms), ("max", np.max)):
                yield self._compared(
                    f"{name}, {label} [{unit}]", name, factor, statistic
                )
        yield "with the motions that no ranger sees:"
        for name in ("position", "orientation"):
            unit, factor = QUANTITIES[name]
            yield self._compared(f"{name}, rms [{unit}]", f"{name}_found", factor, rms)
        yield shared.wrapped(
            "No ranger sees a turn of robot and plane about z of the base, a shift "
            "along it, or a turn about the beam: poses are compared apart from these "
            "three, one of each for all."
        )

    def _compared(
        self, label: str, name: str, factor: float, statistic: Callable[[Floats], float]
    ) -> str:
        def of(case: Case, solution: str) -> float:
            return factor * float(statistic(getattr(case[solution].validation, name)))

        nominal = self.median(self._last, lambda c: of(c, "nominal"))
        after = [
            self.median(count, lambda c: of(c, TRADEOFF))
            for count in self.settings.counts
        ]
        columns = "".join(f"{number(value):>14}" for value in after)
        return f"  {label:<40}{number(nominal):>10}{columns}"

    def conditions(self) -> Iterator[shared.Condition]:
        """What must be shown, whether it is, and by what numbers."""
        for count in self.settings.counts:
            yield self._falls(count)
        for count in self.settings.counts:
            yield self._lowest(count)
        yield self._more_is_better()
        worst = max(c.difference for seed in self.seeds for c in seed.cases.values())
        yield shared.Condition(
            f"hybrid has the cost of gauss-newton: relative difference up to "
            f"{worst:.1e} (limit {SAME:g})",
            worst <= SAME,
            {"largest_relative_difference": worst},
        )

    def _falls(self, count: int) -> shared.Condition:
        nominal, after = (
            self.median(count, lambda c: largest(c[name]))  # noqa: B023
            for name in ("nominal", TRADEOFF)
        )
        starts = [largest(seed.cases[count].before) for seed in self.seeds]
        ends = [largest(seed.cases[count][TRADEOFF]) for seed in self.seeds]
        below = sum(end < MET for end in ends)
        return shared.Condition(
            f"{count} configurations: the largest distance error falls from "
            f"{1e3 * nominal:.1f} mm (at least {1e3 * min(starts):.1f}) to "
            f"{1e3 * after:.3f} mm (at most {1e3 * max(ends):.3f}; below "
            f"{1e3 * MET:g} in {below} of {len(ends)} seeds)",
            min(starts) > self.settings.start and after < MET,
            {
                "median_before_m": nominal,
                "least_before_m": min(starts),
                "median_after_m": after,
                "largest_after_m": max(ends),
                "seeds_below_limit": below,
            },
        )

    def _lowest(self, count: int) -> shared.Condition:
        ends = {
            name: self.median(count, lambda c: c[name].squares)  # noqa: B023
            for name in (TRADEOFF, "best/1", "rand/1")
        }
        tradeoff, best, rand = ends.values()
        return shared.Condition(
            f"{count} configurations: tradeoff ends at {number(1e6 * tradeoff)} mm^2, "
            f"best/1 at {number(1e6 * best)}, rand/1 at {number(1e6 * rand)}",
            tradeoff < rand and tradeoff <= best,
            {f"{name}_m2": value for name, value in ends.items()},
        )

    def _more_is_better(self) -> shared.Condition:
        numbers = {
            f"{name}_{count}": self.median(
                count,
                lambda c: rms(getattr(c[TRADEOFF].validation, name)),  # noqa: B023
            )
            for name in QUANTITIES
            for count in (self._first, self._last)
        }
        words = [
            f"{name} {number(factor * numbers[f'{name}_{self._last}'])} against "
            f"{number(factor * numbers[f'{name}_{self._first}'])} {unit}"
            for name, (unit, factor) in QUANTITIES.items()
        ]
        return shared.Condition(
            f"{self._last} configurations validate better than {self._first}: "
            f"{', '.join(words)} (rms)",
            all(
                numbers[f"{name}_{self._last}"] < numbers[f"{name}_{self._first}"]
                for name in QUANTITIES
            ),
            numbers,
        )

    def document(self) -> dict[str, object]:
        """All numbers; names end in their unit."""
        names = ("nominal", "truth", LEAST_SQUARES, *self.settings.mutations)
        found = {
            count: {
                name: [numbers_of(seed.cases[count][name]) for seed in self.seeds]
                for name in names
            }
            for count in self.settings.counts
        }
        return {
            "study": "liu2012",
            "source": SOURCE,
            "versions": shared.versions(),
            "settings": {"seeds": len(self.seeds), "tradeoff": TRADEOFF}
            | settings_of(self.settings),
            "published": {
                "largest_distance_error_before_m": "> 0.030, both cases",
                "largest_distance_error_after_m": "< 0.0002, both cases",
                "validation": "100 configurations are better than 35",
                "convergence": "tradeoff is far better than rand/1 and best/1",
            },
            "conditions": [asdict(condition) for condition in self.conditions()],
            "medians": {
                count: {
                    name: {key: median_of(rows, key) for key in rows[0]}
                    for name, rows in case.items()
                }
                for count, case in found.items()
            },
            "convergence": {
                "evaluations_per_entry": self.settings.population,
                "median_squares_m2": {
                    count: {
                        name: figures.median_history(self.seeds, count, name).tolist()
                        for name in self.settings.mutations
                    }
                    for count in self.settings.counts
                },
            },
            "seeds": [
                {
                    "seed": k,
                    "redrawn": seed.redrawn,
                    "cases": {
                        count: {name: found[count][name][k] for name in names}
                        | {"distance_errors_m": distances(case), "fit_cost": case.fits}
                        for count, case in seed.cases.items()
                    },
                }
                for k, seed in enumerate(self.seeds)
            ],
        }


def settings_of(settings: Settings) -> dict[str, object]:
    """Settings under names with their units."""
    names = {
        "noise": "noise_m",
        "size": "dh_errors_m_rad",
        "plane": "errors_of_n_x_n_z",
        "start": "least_start_m",
        "box": "box_dh_m_rad",
        "plane_box": "box_plane_u_rad_v_rad_f_m",
        "target": "target_m2",
    }
    return shared.renamed(settings, names)


def numbers_of(outcome: Outcome) -> dict[str, float]:
    """The numbers of a solution."""
    result = {
        "squares_m2": outcome.squares,
        "largest_distance_error_m": largest(outcome),
    }
    for name, values in vars(outcome.validation).items():
        unit = "rad" if name.startswith("orientation") else "m"
        result[f"validation_{name}_rms_{unit}"] = rms(values)
        result[f"validation_{name}_max_{unit}"] = float(values.max())
    return result


def median_of(rows: Sequence[Mapping[str, float]], key: str) -> float:
    """Median of one number."""
    return float(np.median([row[key] for row in rows]))


def distances(case: Case) -> dict[str, list[float]]:
    """Distance errors of every measurement, before and after [m]."""
    return {name: case[name].errors.tolist() for name in ("nominal", TRADEOFF)}


def largest(outcome: Outcome) -> float:
    """Largest distance error on the calibration configurations [m]."""
    return float(np.abs(outcome.errors).max())


def rms(values: Floats) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def number(value: float) -> str:
    """Three significant digits without an exponent."""
    digits = 2 - int(np.floor(np.log10(value))) if value > 0.0 else 0
    return f"{value:.{max(0, digits)}f}"
