"""Aoyagi et al. 2010 from one command: numbers, conditions, figures.

What is simulated, and what the noise floor is, stands in `aoyagi2010_study`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import partial

import numpy as np

from calib_pin.setup import Setup
from studies import aoyagi2010_figures as figures
from studies import shared
from studies.aoyagi2010_study import (
    COMPLIANCE,
    GENETIC,
    MODELS,
    RANDOM,
    REFLECTOR,
    TRACKER,
    Case,
    Cases,
    Selection,
    Settings,
    genetic_set,
    study,
)

SOURCE = "Aoyagi et al. 2010, IROS, Mitsubishi PA10"

STALLED = 1e-4
"""Mean error above which geometry alone has stalled [m]."""

FALLEN = 5.0
"""Factor by which the network is to lower the mean error."""

NEAR = 3.0
"""Multiple of the noise floor that the network is to come within."""

REACHED = 1.25
"""The same for the right structure, whose mean error differs from fit to fit."""


def main(words: Sequence[str]) -> None:
    """Run the study, print it, and write its files."""
    parser = shared.options("aoyagi2010", SOURCE, 5)
    parser.add_argument(
        *("--points",),
        type="count",
        default=max(Settings.counts),
        metavar="N",
        help="largest number of points, less for a short run (default: %(default)s)",
    )
    chosen = parser.parse_args(words)
    counts = tuple(n for n in Settings.counts if n <= chosen.points)
    settings = Settings(counts=counts or (chosen.points,))
    genetic = [n for n in settings.counts if n <= settings.genetic]
    sets = shared.each(partial(genetic_set, settings), genetic, "selection")
    selected = dict(zip(genetic, sets, strict=True))
    work = partial(study, settings, selected)
    seeds = shared.each(work, range(chosen.seeds), "seed")
    report = Report(settings, selected, seeds)
    print(report.text())
    for condition in report.conditions():
        print(condition)
    shared.write_json(chosen.output / "aoyagi2010.json", report.document())
    written = figures.draw(chosen.output, settings, seeds)
    print()
    for name in ("aoyagi2010.json", *written):
        print(f"wrote {chosen.output / name}")


class Report:
    """The numbers of some seeds.

    Args:
        settings: What was simulated.
        selected: What the genetic algorithm has chosen, by number of points.
        seeds: What came out, seed by seed.
    """

    def __init__(
        self,
        settings: Settings,
        selected: Mapping[int, Selection],
        seeds: Sequence[Cases],
    ) -> None:
        """Keep them."""
        self.settings, self.selected, self.seeds = settings, selected, seeds

    @property
    def _cases(self) -> list[tuple[int, str]]:
        """Number of points and way to choose them, of every case."""
        return [(n, name) for n in self.settings.counts for name in self.seeds[0][n]]

    def _all(self, count: int, name: str) -> list[Case]:
        """One case, seed by seed."""
        return [seed[count][name] for seed in self.seeds]

    def median(self, count: int, name: str, value: Callable[[Case], float]) -> float:
        """Median of a number over the seeds of one case."""
        return float(np.median([value(case) for case in self._all(count, name)]))

    def _mean(self, count: int, name: str, model: str) -> float:
        return self.median(count, name, lambda case: case.mean(model))

    def text(self) -> str:
        """Tables for the terminal."""
        return "\n".join([*self._head(), "", *self._errors(), "", *self._ratios(), ""])

    def _head(self) -> Iterator[str]:
        s = self.settings
        first, second = s.harmonics
        yield SOURCE
        yield shared.wrapped(
            f"A tracker with {1e6 * s.noise:g} um of noise on the arm pa10. Hidden are "
            f"geometric errors up to {1e3 * s.length:g} mm and {1e3 * s.angle:g} mrad, "
            f"compliance of {1e6 * min(COMPLIANCE):g} to "
            f"{1e6 * max(COMPLIANCE):g} urad/Nm, "
            f"harmonics of {1e3 * first:g} and {1e3 * second:g} mrad, and the places "
            "of tracker and reflector. Models are judged by the true positions on "
            f"{s.verification} configurations that were not measured."
        )
        yield shared.wrapped(
            "geometric: six errors of every joint's placement; + network: a learned "
            "correction of the joint positions on top; structure: placement, "
            "transmission and compliance, as the truth has them. Noise floor: what the "
            "covariance of the structure's fit at these points (the Cramer-Rao bound) "
            "leaves in the mean."
        )

    def _errors(self) -> Iterator[str]:
        """Mean errors."""
        yield f"Mean errors on unseen configurations [um], {self._medians}"
        columns = ("O1", "nominal", "geometric", "+ network", "structure", "floor")
        yield self._row("points", "", columns)
        for count, name in self._cases:
            means = [self._mean(count, name, model) for model in MODELS]
            o1 = self.median(count, name, lambda case: case.observability)
            floor = self.median(count, name, lambda case: case.floor)
            cells = [f"{o1:.1f}", *(number(1e6 * x) for x in (*means, floor))]
            yield self._row(str(count), name, cells)
        if len(self.selected) < len(self.settings.counts):
            yield shared.wrapped(
                f"More than {self.settings.genetic} points are random only: of "
                f"{self.settings.candidates} candidates too few would be left out."
            )

    def _ratios(self) -> Iterator[str]:
        """The same as multiples."""
        yield f"Ratios of mean errors, {self._medians}"
        yield self._row("points", "", ("network", "structure", "geometric"), 16)
        yield self._row("", "", ("over floor", "over floor", "over network"), 16)
        for count, name in self._cases:
            ratios = [self.median(count, name, f) for f in (near, reached, improvement)]
            yield self._row(str(count), name, map(number, ratios), 16)

    @property
    def _medians(self) -> str:
        count = len(self.seeds)
        return f"medians of {count} seeds" if count > 1 else "one seed"

    @staticmethod
    def _row(points: str, name: str, cells: Iterable[str], width: int = 10) -> str:
        columns = "".join(f"{cell:>{width}}" for cell in cells)
        return f"{points:>6}  {name:<9}{columns}".rstrip()

    def conditions(self) -> Iterator[shared.Condition]:
        """What must be shown, whether it is, and by what numbers."""
        yield self._stalls()
        yield self._learned()
        yield self._structure()
        if self.selected:
            yield self._selected()

    def _stalls(self) -> shared.Condition:
        means = {
            n: [case.mean("geometric") for case in self._all(n, RANDOM)]
            for n in self.settings.counts
        }
        least = min(
            case.mean("geometric") for key in self._cases for case in self._all(*key)
        )
        medians = {n: float(np.median(values)) for n, values in means.items()}
        words = [f"{number(1e3 * x)} mm with {n}" for n, x in medians.items()]
        return shared.Condition(
            f"geometry alone stalls above {1e3 * STALLED:g} mm however many points "
            f"there are: {', '.join(words)} (at least {number(1e3 * least)})",
            least > STALLED,
            {"least_m": least} | {f"median_{n}_m": x for n, x in medians.items()},
        )

    def _learned(self) -> shared.Condition:
        """At the largest number of points, which are random: the network needs many."""
        *fewer, count = sorted(self.settings.counts)
        values = {
            "geometric_m": lambda case: case.mean("geometric"),
            "network_m": lambda case: case.mean("network"),
            "floor_m": lambda case: case.floor,
            "improvement": improvement,
            "over_floor": near,
        }
        medians = {key: self.median(count, RANDOM, f) for key, f in values.items()}
        geometric, network, floor, fall, ratio = medians.values()
        cases = self._all(count, RANDOM)
        least, most = min(map(improvement, cases)), max(map(near, cases))
        within = sum(near(case) <= NEAR for case in cases)
        others = {n: self.median(n, RANDOM, near) for n in fewer}
        words = "".join(f"; {number(x)} with {n} points" for n, x in others.items())
        return shared.Condition(
            f"{count} random points: the network lowers the mean error from "
            f"{number(1e6 * geometric)} to {number(1e6 * network)} um, {number(fall)} "
            f"times (at least {number(least)}; wanted {FALLEN:g}), and comes to "
            f"{number(ratio)} times the noise floor of {number(1e6 * floor)} um (at "
            f"most {number(most)}; wanted {NEAR:g}, reached in {within} of "
            f"{len(cases)} seeds{words})",
            fall >= FALLEN and ratio <= NEAR,
            {f"median_{key}": value for key, value in medians.items()}
            | {"least_improvement": least, "largest_over_floor": most}
            | {"seeds_within_limit": within}
            | {f"median_over_floor_{n}": x for n, x in others.items()},
        )

    def _structure(self) -> shared.Condition:
        medians = {key: self.median(*key, reached) for key in self._cases}
        largest = max(reached(case) for key in self._cases for case in self._all(*key))
        words = [f"{number(x)} with {n} {name}" for (n, name), x in medians.items()]
        return shared.Condition(
            f"the right structure reaches the noise floor: {', '.join(words)} times it "
            f"(limit {REACHED:g}; single fits up to {number(largest)})",
            max(medians.values()) <= REACHED,
            {f"median_{n}_{name}": x for (n, name), x in medians.items()}
            | {"largest": largest},
        )

    def _selected(self) -> shared.Condition:
        found = {
            n: (
                self.median(n, GENETIC, lambda case: case.observability),
                max(case.observability for case in self._all(n, RANDOM)),
            )
            for n in self.selected
        }
        words = [f"{ours:.1f} against {best:.1f}" for ours, best in found.values()]
        return shared.Condition(
            f"O1 of the genetic selection and of the best random set, "
            f"{', '.join(map(str, found))} points: {', '.join(words)}",
            all(ours > best for ours, best in found.values()),
            {
                f"{name}_{n}": x
                for n, pair in found.items()
                for name, x in zip((GENETIC, "best_random"), pair, strict=True)
            },
        )

    def document(self) -> dict[str, object]:
        """All numbers; names end in their unit."""
        return {
            "study": "aoyagi2010",
            "source": SOURCE,
            "versions": shared.versions(),
            "settings": {"seeds": len(self.seeds)} | settings_of(self.settings),
            "models": {name: setup_of(setup) for name, setup in MODELS.items()},
            "conditions": [asdict(condition) for condition in self.conditions()],
            "selections": {
                count: {
                    "O1": self.median(count, GENETIC, lambda case: case.observability),
                    "random_median_O1": found.median,
                    "seconds": found.seconds,
                    "q_rad": found.q.tolist(),
                }
                for count, found in self.selected.items()
            },
            "medians": {
                count: {
                    name: medians_of(
                        [numbers_of(case) for case in self._all(count, name)]
                    )
                    for name in self.seeds[0][count]
                }
                for count in self.settings.counts
            },
            "seeds": [
                {
                    "seed": k,
                    "cases": {
                        count: {name: numbers_of(case) for name, case in sets.items()}
                        for count, sets in seed.items()
                    },
                }
                for k, seed in enumerate(self.seeds)
            ],
        }


def settings_of(settings: Settings) -> dict[str, object]:
    """Settings under names with their units."""
    names = {
        "genetic": "largest_genetic_count",
        "noise": "noise_m",
        "length": "geometric_errors_m",
        "angle": "geometric_errors_rad",
        "harmonics": "harmonics_rad",
    }
    return shared.renamed(settings, names) | {
        "compliance_rad_per_Nm": COMPLIANCE,
        "base_in_tracker_m_rad": [TRACKER.xyz, TRACKER.rpy],
        "reflector_on_tool_m": REFLECTOR.xyz,
    }


def setup_of(setup: Setup) -> dict[str, object]:
    """What a model estimates and learns."""
    return {"parameters": setup.parameters, "learned": setup.learned}


def numbers_of(case: Case) -> dict[str, float]:
    """The numbers of a case."""
    result = {"O1": case.observability}
    for name, errors in case.errors.items():
        result[f"{name}_mean_m"] = case.mean(name)
        result[f"{name}_rms_m"] = float(np.sqrt(np.mean(errors**2)))
        result[f"{name}_max_m"] = float(errors.max())
    return result | {
        "noise_floor_m": case.floor,
        "noise_floor_spread_m": case.spread,
        "network_over_floor": near(case),
        "structure_over_floor": reached(case),
        "geometric_over_network": improvement(case),
        "structure_rank": case.rank,
        "outside_trained_region": case.outside,
    }


def medians_of(rows: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Medians of all numbers."""
    return {key: float(np.median([row[key] for row in rows])) for key in rows[0]}


def near(case: Case) -> float:
    """Mean error of the network over the noise floor."""
    return case.mean("network") / case.floor


def reached(case: Case) -> float:
    """Mean error of the right structure over the noise floor."""
    return case.mean("structure") / case.floor


def improvement(case: Case) -> float:
    """How many times the network lowers the mean error of geometry alone."""
    return case.mean("geometric") / case.mean("network")


def number(value: float) -> str:
    """Three significant digits, of large numbers all before the point."""
    return f"{value:.3g}" if value < 1000.0 else f"{value:.0f}"
