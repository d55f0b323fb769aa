"""Liu, Ni, Liu, Xu 2012 from one command: numbers, conditions, figures.

Simulation and solution are in `liu2012_study`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from calib_pin.estimation.solve import INVISIBLE
from calib_pin.kinematics.spatial import Floats
from calib_pin.solvers.differential_evolution import TRADEOFF
from studies import shared
from studies.liu2012_figures import FIGURES, median_history
from studies.liu2012_study import LEAST_SQUARES, Case, Seed, Settings, study
from studies.records import Condition, Report, Table, Values

SOURCE = "Liu, Ni, Liu, Xu 2012, doi 10.1007/s11771-012-1095-1"

REACHES = "tradeoff reaches the published accuracy"
SAME_COST = "hybrid has the cost of gauss-newton"
"""Claims."""

BEFORE, AFTER = 30e-3, 0.2e-3
"""Published bounds of the largest distance error, in both cases [m]."""

REACHED = 0.01
"""Part of the least sum of squares that an evolution may exceed and have reached it."""


def main(words: Sequence[str]) -> bool:
    """Run the study, print it, write its files; whether all conditions are met."""
    generations = Settings.generations
    chosen = shared.options(
        "liu2012",
        SOURCE,
        words,
        seeds=shared.Number(20, 20, "number of robots"),
        generations=shared.Number(generations, generations, "limit of an evolution"),
    )
    settings = Settings(generations=chosen.generations)
    seeds = shared.each(partial(study, settings), range(chosen.seeds), "seed")
    return report(settings, seeds).publish(chosen.output, FIGURES, (settings, seeds))


def report(settings: Settings, seeds: Sequence[Seed]) -> Report:
    """The report on the results of some seeds."""
    histories = {
        count: {name: median_history(seeds, count, name) for name in settings.mutations}
        for count in settings.counts
    }
    names = ("nominal", "truth", LEAST_SQUARES, *settings.mutations)
    medians = {
        count: {
            name: shared.medians([seed.cases[count][name] for seed in seeds])
            for name in names
        }
        for count in settings.counts
    }
    return Report(
        name="liu2012",
        source=SOURCE,
        description=_description(settings, seeds),
        settings={"seeds": len(seeds), "tradeoff": TRADEOFF} | vars(settings),
        tables=[f(settings, seeds) for f in (_largest, _squares, _validation)],
        results={
            "medians": medians,
            "convergence": {
                "evaluations_per_entry": settings.population,
                "median_squares_m2": histories,
            },
            "seeds": seeds,
        },
    )


def _description(s: Settings, seeds: Sequence[Seed]) -> tuple[str, ...]:
    redrawn = sum(seed.redrawn for seed in seeds)
    return (
        "A laser distance sensor and a plane. The robot is space6 in place of the lost "
        f"DH table, with 24 dh errors up to {1e3 * s.size:g} mm and "
        f"{1e3 * s.size:g} mrad and the published errors of the plane: n_x "
        f"{s.plane[0]}, n_z {s.plane[1]}. All 27 are searched at once, within "
        f"{1e3 * s.box:g} mm and {1e3 * s.box:g} mrad (plane: "
        f"{1e3 * s.plane_box[0]:g} mrad, {1e3 * s.plane_box[2]:g} mm).",
        f"Np {s.population}, F {s.mutation}, CR {s.recombination}, "
        f"G {s.generations}, V {1e6 * s.target:g} mm^2 (below the noise). "
        f"{len(seeds)} seeds; errors are drawn again until the nominal robot is more "
        f"than {1e3 * s.start:g} mm off ({redrawn} time{'' if redrawn == 1 else 's'}).",
        f"tradeoff, its formula lost, is {TRADEOFF} here; least squares is "
        "Gauss-Newton in the same 27 parameters, from the nominal robot.",
    )


def _by_count(
    settings: Settings,
    seeds: Sequence[Seed],
    value: Callable[[Case], float],
    statistic: Callable[[list[float]], float] = np.median,
) -> dict[str, float]:
    """A statistic over the seeds, by the number of configurations."""
    return {
        str(count): float(statistic([value(seed.cases[count]) for seed in seeds]))
        for count in settings.counts
    }


def _label(name: str) -> str:
    return f"{name} = tradeoff" if name == TRADEOFF else name


def _largest(settings: Settings, seeds: Sequence[Seed]) -> Table:
    by_count = partial(_by_count, settings, seeds)
    table = Table("Largest distance error by calibration configurations, medians")
    far = Condition("every seed starts far from its robot", "above", settings.start)
    falls = Condition(REACHES, "below", AFTER)
    known = {"nominal": (">", BEFORE), TRADEOFF: ("<", AFTER)}
    for name in ("nominal", LEAST_SQUARES, *settings.mutations):
        ours = by_count(lambda c: c[name].largest)  # noqa: B023
        sign, bound = known.get(name, ("", 0.0))
        published = dict.fromkeys(ours, bound) if sign else None
        conditions = (falls,) if name == TRADEOFF else ()
        table.add(
            _label(name), ours, "mm", *conditions, published=published, bound=sign
        )
    least = by_count(lambda c: c.before.largest, min)
    table.add("nominal, least of the seeds", least, "mm", far)
    most = by_count(lambda c: c[TRADEOFF].largest, max)
    table.add("tradeoff, largest of the seeds", most, "mm")
    below = by_count(lambda c: c[TRADEOFF].largest < AFTER, sum)
    table.add(f"tradeoff, seeds below {1e3 * AFTER:g} mm", below)
    return table


def _squares(settings: Settings, seeds: Sequence[Seed]) -> Table:
    by_count = partial(_by_count, settings, seeds)
    table = Table(
        "Sum of squared distance errors, medians",
        "Published: tradeoff ends far lower than rand/1 and best/1. The difference of "
        "chi-square is the largest of all seeds; a solver has converged where steps "
        f"gain less than {INVISIBLE:g} of it.",
    )
    lowest = by_count(lambda c: c[TRADEOFF].squares)
    conditions = {
        "best/1": Condition("best/1 ends no lower than tradeoff", "at least", lowest),
        "rand/1": Condition("rand/1 ends above tradeoff", "above", lowest),
    }
    for name in (LEAST_SQUARES, *settings.mutations):
        squares = by_count(lambda c: c[name].squares)  # noqa: B023
        own = (conditions[name],) if name in conditions else ()
        table.add(_label(name), squares, "mm^2", *own)

    def reached(case: Case, name: str) -> bool:
        limit = (1.0 + REACHED) * case[LEAST_SQUARES].squares
        return case[name].squares <= limit

    for name in settings.mutations:
        count = by_count(partial(reached, name=name), sum)
        table.add(f"{name}, seeds within {100 * REACHED:g} % of least squares", count)
    same = Condition(SAME_COST, "at most", INVISIBLE)
    difference = by_count(lambda c: c.difference, max)
    table.add("hybrid and gauss-newton, chi-square", difference, "", same)
    return table


def _validation(settings: Settings, seeds: Sequence[Seed]) -> Table:
    table = Table(
        f"{settings.validation} validation configurations, tradeoff, medians",
        "A rotation of robot and plane about z of the base, a shift along it, and a "
        "rotation about the beam are unobservable: poses are aligned by these three, "
        "one of each for all.",
    )
    fewest, most = min(settings.counts), max(settings.counts)

    def add(
        label: str,
        quantity: str,
        statistic: Callable[[Floats], float],
        claim: str = "",
    ) -> None:
        def errors(name: str) -> Values:
            return _by_count(
                settings,
                seeds,
                lambda c: statistic(getattr(c[name].validation, quantity)),
            )

        after = {f"after {n}": x for n, x in errors(TRADEOFF).items()}
        limit = {f"after {most}": after[f"after {fewest}"]}
        conditions = (Condition(claim, "below", limit),) if claim else ()
        ours = {"nominal": errors("nominal")[str(most)], **after}
        unit = "deg" if quantity.startswith("orientation") else "mm"
        table.add(label, ours, unit, *conditions)

    better = f"{most} configurations validate better than {fewest}, as published"
    for name in ("distance", "position", "orientation"):
        add(f"{name}, rms", name, shared.rms, better)
        add(f"{name}, max", name, np.max)
    for name in ("position", "orientation"):
        add(f"{name}, not aligned, rms", f"{name}_found", shared.rms)
    return table
