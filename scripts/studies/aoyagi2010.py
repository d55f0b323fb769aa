"""Aoyagi et al. 2010 from one command: numbers, conditions, figures.

The simulation and the noise floor are in `aoyagi2010_study`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np

from studies import shared
from studies.aoyagi2010_figures import FIGURES
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
from studies.records import Condition, Report, Table

SOURCE = "Aoyagi et al. 2010, IROS, Mitsubishi PA10"

STALLED = 1e-4
"""Mean error above which geometry alone has stalled [m]."""

FALLEN = 5.0
"""Factor by which the network is to lower the mean error."""

NEAR = 3.0
"""Multiple of the noise floor that the network is to come within."""

REACHED = 3.0
"""Standard errors of the mean over the seeds by which the right structure, whose mean
error differs from fit to fit, may be above it."""

STALLS = "geometry alone stalls at any number of points"
LOWERS = "the network lowers the mean error"
COMES_NEAR = "the network comes near the noise floor"
"""Claims."""

RATIOS: Mapping[str, Callable[[Case], float]] = {
    "O1": lambda case: case.observability,
    "network / floor": lambda case: case.ratio("network"),
    "structure / floor": lambda case: case.ratio("structure"),
    "geometric / network": lambda case: case.improvement,
}
"""Columns of the table of ratios."""


def main(words: Sequence[str]) -> bool:
    """Run the study, print it, write its files; whether all conditions are met."""
    most = max(Settings.counts)
    chosen = shared.options(
        "aoyagi2010",
        SOURCE,
        words,
        seeds=shared.Number(2, 5, "number of robots"),
        points=shared.Number(most, most, "largest number of points"),
    )
    counts = tuple(n for n in Settings.counts if n <= chosen.points)
    settings = Settings(counts=counts or (chosen.points,))
    genetic = [n for n in settings.counts if n <= settings.genetic]
    sets = shared.each(partial(genetic_set, settings), genetic, "selection")
    selected = dict(zip(genetic, sets, strict=True))
    work = partial(study, settings, selected)
    seeds = shared.each(work, range(chosen.seeds), "seed")
    result = report(settings, selected, seeds)
    return result.publish(chosen.output, FIGURES, (settings, seeds))


def report(
    settings: Settings, selected: Mapping[int, Selection], seeds: Sequence[Cases]
) -> Report:
    """The report on the results of some seeds.

    Args:
        settings: The settings of the simulation.
        selected: The genetic selections, by number of points.
        seeds: The results, seed by seed.
    """
    cases = [(count, name) for count in settings.counts for name in seeds[0][count]]
    of = {key: [seed[key[0]][key[1]] for seed in seeds] for key in cases}
    parts = [_errors, _ratios, _single, *([_observability] if selected else [])]
    return Report(
        name="aoyagi2010",
        source=SOURCE,
        description=_description(settings),
        settings={
            "seeds": len(seeds),
            **vars(settings),
            "compliance_rad_per_Nm": COMPLIANCE,
            "base_in_tracker_m_rad": [TRACKER.xyz, TRACKER.rpy],
            "reflector_on_tool_m": REFLECTOR.xyz,
        },
        tables=[part(settings, of) for part in parts],
        results={
            "models": {
                name: {"parameters": setup.parameters, "learned": setup.learned}
                for name, setup in MODELS.items()
            },
            "selections": {
                count: {
                    "O1": median(of[count, GENETIC], RATIOS["O1"]),
                    "random_median_O1": found.median,
                    "seconds": found.seconds,
                    "q_rad": found.q,
                }
                for count, found in selected.items()
            },
            "medians": {
                count: {
                    name: shared.medians(of[count, name]) for name in seeds[0][count]
                }
                for count in settings.counts
            },
            "seeds": [
                {"seed": seed, "cases": found} for seed, found in enumerate(seeds)
            ],
        },
    )


Found = Mapping[tuple[int, str], Sequence[Case]]
"""Cases of all seeds, by number of points and by how they were chosen."""


def median(cases: Sequence[Case], value: Callable[[Case], float]) -> float:
    """The median of a number over the seeds of one case."""
    return float(np.median([value(case) for case in cases]))


def _description(s: Settings) -> tuple[str, ...]:
    first, second = s.harmonics
    return (
        f"A tracker with {1e6 * s.noise:g} um of noise and the arm pa10. Hidden are "
        f"geometric errors up to {1e3 * s.length:g} mm and {1e3 * s.angle:g} mrad, "
        f"compliance of {1e6 * min(COMPLIANCE):g} to {1e6 * max(COMPLIANCE):g} "
        f"urad/Nm, harmonics of {1e3 * first:g} and {1e3 * second:g} mrad, and the "
        "positions of tracker and reflector. Models are judged by the true positions "
        f"at {s.verification} validation configurations.",
        "geometric: six errors of every joint's placement; network: a learned "
        "correction of the joint positions in addition; structure: placement, "
        "transmission and compliance, as in the truth. Noise floor: the mean error "
        "that the covariance of the fit of the right structure at these points (the "
        "Cramer-Rao bound) predicts.",
    )


def _errors(settings: Settings, of: Found) -> Table:
    title = (
        "Mean errors at the validation configurations by points, medians of the seeds"
    )
    few = (
        f"More than {settings.genetic} points are random only: of "
        f"{settings.candidates} candidates too few would be left out."
    )
    table = Table(title, few if max(settings.counts) > settings.genetic else "")
    for (count, name), cases in of.items():
        means = {
            model: median(cases, partial(Case.mean, model=model)) for model in MODELS
        }
        floor = median(cases, lambda case: case.floor)
        table.add(f"{count} {name}", means | {"floor": floor}, "um")
    return table


def _ratios(settings: Settings, of: Found) -> Table:
    """O1 and ratios of mean errors."""
    table = Table("Observability index and ratios of mean errors, medians of the seeds")
    reaches = "the right structure reaches the noise floor"
    # At the largest number of points, which are random: the network needs many.
    most = (
        Condition(LOWERS, "at least", {"geometric / network": FALLEN}),
        Condition(COMES_NEAR, "at most", {"network / floor": NEAR}),
    )
    largest = max(settings.counts), RANDOM
    for key, cases in of.items():
        ratios = {column: median(cases, value) for column, value in RATIOS.items()}
        spread = median(cases, lambda case: case.spread / case.floor)
        limit = 1.0 + REACHED * spread / np.sqrt(len(cases))
        reached = Condition(reaches, "at most", {"structure / floor": float(limit)})
        more = most if key == largest else ()
        table.add(f"{key[0]} {key[1]}", ratios, "", reached, *more)
    return table


def _single(settings: Settings, of: Found) -> Table:
    """Least and largest numbers of single seeds."""
    table, count = Table("Single fits"), max(settings.counts)
    most, every = of[count, RANDOM], [case for cases in of.values() for case in cases]
    stalls = Condition(STALLS, "above", STALLED)
    least = min(case.mean("geometric") for case in every)
    table.add("geometric, least mean error", least, "mm", stalls)
    table.add("structure / floor, largest", max(c.ratio("structure") for c in every))
    name = f"with {count} random"
    table.add(f"geometric / network, least {name}", min(c.improvement for c in most))
    near = [case.ratio("network") for case in most]
    table.add(f"network / floor, largest {name}", max(near))
    within = sum(x <= NEAR for x in near)
    table.add(f"  seeds with at most {NEAR:g}, of {len(most)}", within)
    return table


def _observability(settings: Settings, of: Found) -> Table:
    table = Table("Observability index O1")
    counts = [count for count, name in of if name == GENETIC]
    best = {
        f"{n} points": max(case.observability for case in of[n, RANDOM]) for n in counts
    }
    ours = {f"{n} points": median(of[n, GENETIC], RATIOS["O1"]) for n in counts}
    better = Condition("the genetic selection has the largest O1", "above", best)
    table.add("genetic selection", ours, "", better)
    table.add("best random set", best)
    return table
