"""Liu Qian et al. 2022 from one command: numbers, conditions, figures and our plan.

Search and calibration are in `liu2022_study`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from calib_pin.io.files import write_atomically
from calib_pin.io.measurements import encode_configurations
from calib_pin.kinematics.spatial import Floats
from studies import shared
from studies.liu2022_arm import PUBLISHED, Arm
from studies.liu2022_figures import FIGURES
from studies.liu2022_study import OURS, Search, Settings, Study, study
from studies.records import Condition, Report, Table, Values
from studies.tip_errors import TipErrors

SOURCE = "Liu Qian et al. 2022, Manned Spaceflight 28(6), 711-719"

SETS = (*PUBLISHED, OURS)

CONDITIONS = {"hand-picked": 354.8, "swarm": 25.2}
"""Published condition numbers."""

LINEAR = {"hand-picked": (0.1195, 0.7083), "swarm": (0.0111, 0.0667)}
"""Published relative errors of the linear combinations, mean and largest."""

NOMINAL = (25e-3, float(np.radians(0.45)))
"""Published errors along the trajectory before calibration [m, rad]."""

CORRECTED = (1e-3, float(np.radians(0.1)))
"""Published bounds of the errors there after the swarm's linear step [m, rad]."""

WANTED = 5.0
"""Condition number that ours is to have at most."""

LIMIT = 10.0
"""Time that the search may take [s]."""

EXACT = 1e-9
"""Relative error of a linear combination that is numerically zero; the same for errors
of the tool, in m and rad."""


def main(words: Sequence[str]) -> bool:
    """Run the study, print it, write its files; whether all conditions are met."""
    chosen = shared.options(
        "liu2022",
        SOURCE,
        words,
        seeds=shared.Number(20, 20, "number of seeds of the noise"),
        starts=shared.Number(Settings.starts, Settings.starts, "starts of our search"),
        iterations=shared.Number(
            Settings.iterations, Settings.iterations, "iterations of a swarm"
        ),
    )
    settings = Settings(starts=chosen.starts, iterations=chosen.iterations)
    result = study(settings, chosen.seeds)
    write_plan(chosen.output / "plan.csv", result.apart)
    about = settings, result
    return report(settings, result).publish(chosen.output, FIGURES, about, "plan.csv")


def write_plan(path: Path, ours: Search) -> None:
    """Write our configurations, for `calib-pin simulate --configurations`."""
    comments = [
        f"Six configurations of space7 with condition number {ours.condition:.2f}, in",
        f"place of those of {SOURCE};",
        "the arm keeps its distance from itself.",
    ]
    chain = Arm.load().problem.chains
    data = encode_configurations(chain, ours.q, comments=comments)
    write_atomically(path, data, force=True)


def report(settings: Settings, study: Study) -> Report:
    """The report on the results."""
    return Report(
        name="liu2022",
        source=SOURCE,
        description=tuple(_description(settings, study)),
        settings={"seeds": len(study.noisy)} | vars(settings),
        tables=(
            _conditions(study),
            _searches(study),
            _combinations(study),
            _along(study),
            _verdicts(study),
        ),
        results={
            "random": {
                "median": float(np.median(study.random)),
                "least": float(study.random.min()),
            },
            "ours": study.ours,
            "ours_without_self_collision": study.apart,
            "swarms": study.swarms,
            "nominal_tip": tip_of(study.nominal),
            "sets": {name: _set(study, name) for name in SETS},
        },
    )


def _description(settings: Settings, study: Study) -> Iterator[str]:
    noise, s = dict(settings.noise), settings
    yield (
        "The arm space7 with the published errors, calibrated by its tool's poses "
        "at six configurations within +-120 deg: by one linear step as published, "
        "then by ours, from exact poses and from poses with noise of "
        f"{1e3 * noise['position']:g} mm and {np.degrees(noise['orientation']):g} deg "
        f"({len(study.noisy)} seeds)."
    )
    yield (
        f"ours: exchange among {s.candidates} candidates, {s.starts + 1} descents, "
        f"{study.ours.evaluations[-1]:.0f} matrices with gradients."
    )
    if study.swarms:
        yield (
            f"swarm: {s.particles} particles, {s.iterations} iterations, "
            f"{study.swarms[0].evaluations[-1]:.0f} matrices."
        )


def _conditions(study: Study) -> Table:
    table, here = Table("Condition number of the 36 x 34 matrix", digits=4), "here"
    for name in PUBLISHED:
        same = Condition(
            "the matrix is the published one", "within", CONDITIONS[name], 0.1
        )
        found = {here: study.judged[name].condition}
        table.add(name, found, "", same, published={here: CONDITIONS[name]})
    random = float(np.median(study.random))
    table.add(f"random, median of {len(study.random)}", {here: random})
    count = len(study.swarms)
    runs = f"median of {count} runs" if count > 1 else "one run"
    swarm = float(np.median([swarm.condition for swarm in study.swarms]))
    table.add(f"improved swarm run here, {runs}", {here: swarm})
    small = Condition("our six configurations are well conditioned", "at most", WANTED)
    table.add(f"{OURS}, within the limits", {here: study.ours.condition}, "", small)
    apart = {here: study.apart.condition}
    table.add(f"{OURS}, without self-collision too", apart, "", small)
    return table


def _searches(study: Study) -> Table:
    table = Table("Processor time of a search")
    fast = Condition("our search is fast", "at most", LIMIT)
    table.add(OURS, study.ours.seconds, "s", fast)
    table.add(f"{OURS}, without self-collision", study.apart.seconds, "s")
    if study.swarms:
        table.add("swarm", study.swarms[0].seconds, "s")
    return table


def _by_set(value: Callable[[str], float]) -> Values:
    return {name: float(value(name)) for name in SETS}


def _better(what: str, values: Values) -> Condition:
    """Every set is better than the one before."""
    before = dict(zip(SETS[1:], (values[name] for name in SETS), strict=False))
    return Condition(f"better configurations give better {what}", "below", before)


def _combinations(study: Study) -> Table:
    """Errors of the parameters."""
    table = Table("Relative errors of 34 identifiable linear combinations")
    judged, exact = (
        study.judged,
        "our calibration finds the combinations of exact poses",
    )
    statistics: dict[str, Callable[[Floats], float]] = {
        "mean": np.mean,
        "largest": np.max,
    }
    for k, (label, statistic) in enumerate(statistics.items()):
        step = _by_set(lambda name: statistic(judged[name].linear))  # noqa: B023
        solved = _by_set(lambda name: statistic(judged[name].solved))  # noqa: B023
        noisy = _by_set(
            lambda name: np.median(
                [statistic(seed[name].errors) for seed in study.noisy]  # noqa: B023
            )
        )
        means = k == 0
        by_step = [_better("combinations by one linear step", step)] if means else []
        by_noisy = [_better("combinations with noise", noisy)] if means else []
        known = {name: x[k] for name, x in LINEAR.items()}
        table.add(f"one linear step, {label}", step, "%", *by_step, published=known)
        small = Condition(exact, "below", EXACT)
        table.add(f"calibration, {label}", solved, "%", small)
        table.add(f"calibration, noise, {label}", noisy, "%", *by_noisy)
    return table


def _along(study: Study) -> Table:
    """Errors along the trajectory."""
    table, judged = Table("Tool along the trajectory, largest components"), study.judged
    exact = Condition("our calibration corrects exact poses", "below", EXACT)
    for k, (quantity, unit) in enumerate((("position", "mm"), ("orientation", "deg"))):
        nominal, known = (
            dict.fromkeys(SETS, x[k]) for x in (study.nominal.largest, NOMINAL)
        )
        step = _by_set(lambda name: judged[name].tip_linear.largest[k])  # noqa: B023
        solved = _by_set(lambda name: judged[name].tip_solved.largest[k])  # noqa: B023
        noisy = _by_set(
            lambda name: np.median(
                [seed[name].tip.largest[k] for seed in study.noisy]  # noqa: B023
            )
        )
        better = [] if k else [_better("tool positions with noise", noisy)]
        table.add(f"nominal, {quantity}", nominal, unit, published=known)
        after = {"swarm": CORRECTED[k]}
        name = f"one linear step, {quantity}"
        table.add(name, step, unit, published=after, bound="<")
        table.add(f"calibration, {quantity}", solved, unit, exact)
        table.add(f"calibration, noise, {quantity}", noisy, unit, *better)
    return table


def _verdicts(study: Study) -> Table:
    table = Table("Calibrations from exact poses")
    verdicts = [judged.verdict for judged in study.judged.values()]
    good = Condition("our calibrations are good", "equal to", float(len(SETS)))
    table.add("with verdict good", verdicts.count("good"), "", good)
    return table


def _set(study: Study, name: str) -> dict[str, object]:
    """The numbers of a set of configurations that are written."""
    judged = study.judged[name]
    return {
        "q_rad": judged.q,
        "condition": judged.condition,
        "singular_values": judged.singular_values,
        "linear_step": errors_of(judged.linear) | tip_of(judged.tip_linear),
        "calibration": errors_of(judged.solved) | tip_of(judged.tip_solved),
        "calibration_with_noise": [
            errors_of(seed[name].errors) | tip_of(seed[name].tip)
            for seed in study.noisy
        ],
    }


def errors_of(relative: Floats) -> dict[str, float]:
    """Relative errors of the linear combinations."""
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
