"""The reports of a fleet and of a Monte Carlo study."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from calib_pin.estimation.statistics.population_prior import Population, common_errors
from calib_pin.monte_carlo import Outlook, Study
from calib_pin.monte_carlo.summary import LEVELS
from calib_pin.report.blocks import (
    Block,
    Cell,
    Column,
    Facts,
    Line,
    Table,
    Tone,
    columns,
)
from calib_pin.report.tables import amount, known, quantity, uncertain
from calib_pin.setup import LimitSetup
from calib_pin.units import DISPLAY
from calib_pin.validation.fleet import FAILED, ORDER, FleetRow

FEW, MANY = 20, 2000
"""Rows that a terminal and a page show, the most urgent first."""


def fleet_report(
    rows: Sequence[FleetRow], types: Sequence[Population] = (), most: int = FEW
) -> Iterator[Block]:
    """The report of a fleet.

    Args:
        rows: The rows, the most urgent first.
        types: Types of robots that are known well enough to compare with.
        most: Most rows that are listed.
    """
    counts = Counter(row.verdict for row in rows)
    parts = [f"{count} {verdict}" for verdict, count in counts.most_common()]
    urgent = sum(not row.trusted for row in rows)
    yield Line(
        f"{len(rows)} calibrations: {', '.join(parts)}.", "bad" if urgent else "good"
    )
    if drifted := sum(row.drift.beyond for row in rows):
        said = "calibration differs" if drifted == 1 else "calibrations differ"
        yield Line(
            f"{drifted} {said} from the one before by more than noise explains.", "bad"
        )
    shown = rows[:most]
    for row in shown:
        if not row.trusted:
            tone: Tone = "bad" if row.verdict in ORDER[:2] else "strong"
            yield Line(f"{row.job}: {row.reason}", tone)
    yield from _accuracy(rows)
    yield Table("Robots, those that need attention first", LISTED, [*_listed(shown)])
    if any(row.drift.beyond for row in shown):
        yield Line(
            "!: the tool points differ from the calibration before by more than noise "
            "explains.",
            "note",
        )
    if len(rows) > most:
        yield Line(f"{len(rows) - most} more are in fleet.csv.", "note")
    yield from _joints(rows, most)
    for population in types:
        yield from _common(population, most)


def _common(population: Population, most: int) -> Iterator[Block]:
    """Errors that the robots of a type have in common."""
    name, robots = population.evidences[0].robot.name, len(population.evidences)
    errors = [error for error in common_errors(population) if error.significant]
    errors.sort(key=lambda error: error.chance)
    said = f"{robots} robots '{name}' are the prior of the next one of their type"
    if not errors:
        yield Line(f"{said}; they have no error in common that shows.")
        return
    yield Line(f"{said}.")
    cells = []
    for error in errors[:most]:
        unit, factor = DISPLAY.get(error.unit, (error.unit, 1.0))
        pair = uncertain(error.mean, error.sigma, factor)
        cells.append((Cell(error.name), *pair, Cell(unit)))
    yield Table(
        f"Errors that robots '{name}' have in common",
        columns("error", ("mean", "std. dev.", "unit")),
        cells,
    )
    if len(errors) > most:
        yield Line(f"{len(errors) - most} more are in fleet.json.", "note")


def _accuracy(rows: Sequence[FleetRow]) -> Iterator[Table]:
    """Errors before and after over the fleet, by quantity."""
    cells = []
    for name in dict.fromkeys(row.quantity for row in rows if row.quantity):
        own = [row for row in rows if row.quantity == name and row.trusted]
        if not own:
            continue
        unit = own[0].unit
        for robot in ("nominal", "calibrated"):
            sizes = np.array([getattr(row, robot) for row in own])
            found = np.quantile(sizes, LEVELS).tolist()
            label = Cell(name if robot == "nominal" else "")
            numbers = (quantity(size, unit) for size in found)
            cells.append((label, Cell(robot), *numbers, Cell(DISPLAY[unit][0])))
    if cells:
        yield Table(
            "Errors of trusted calibrations (rms of a robot, held-out measurements)",
            columns("", ("robot", "5 %", "median", "95 %", "unit")),
            cells,
        )


LISTED = (
    Column("job", "name"),
    Column("verdict", "word"),
    *map(Column, ("nominal", "calibrated", "expected", "drift")),
    Column("unit", "word"),
)


def _listed(rows: Sequence[FleetRow]) -> Iterator[tuple[Cell, ...]]:
    """A line for each of some rows."""
    for row in rows:
        unit = row.unit or "m"
        lengths = unit == "m"
        drift = known(row.drift.size, "m") if lengths else Cell("-")
        if row.drift.beyond:
            drift = Cell(f"{drift.text} !", row.drift.size)
        yield (
            Cell(row.job),
            Cell(row.verdict.upper() if row.verdict == FAILED else row.verdict),
            known(row.nominal, unit),
            known(row.calibrated, unit),
            known(row.expected.calibrated, "m") if lengths else Cell("-"),
            drift,
            Cell(DISPLAY[unit][0]),
        )


def _joints(rows: Sequence[FleetRow], most: int) -> Iterator[Block]:
    """Joints that stand out among those of other robots."""
    apart = [row for row in rows if row.joint.significant]
    if apart:
        yield Table(
            "Joints that differ from those of other robots by more than chance",
            columns("job", ("joint", "spreads"), {"joint": "word"}),
            [
                (
                    Cell(row.job),
                    Cell(row.joint.name),
                    Cell(f"{row.joint.spreads:+.1f}", row.joint.spreads),
                )
                for row in apart[:most]
            ],
        )


def outlook_report(
    study: Study, found: Sequence[Outlook], limit: LimitSetup
) -> Iterator[Block]:
    """How accurate robots of a type would be.

    Args:
        study: The study.
        found: Its outlooks, by rising number of configurations.
        limit: What has to be reached.
    """
    yield from _decision(found, limit)
    instruments = "+".join(dict.fromkeys(key.model for key in study.truth.terms))
    setup = study.truth.setup
    yield Facts(
        "Study",
        [
            ("robot", study.chains.robot.name),
            ("measured", f"{instruments}, {_noise(setup.noise)}"),
            ("configurations", "random" if study.plan is None else "of the plan"),
            ("true errors", ", ".join(setup.parameters)),
            ("fitted", ", ".join(study.setup.parameters)),
            ("robots", str(found[0].robots)),
            ("random seed", str(study.seed)),
        ],
    )
    yield Table(
        "Position error over the workspace (rms of a robot)",
        SIZES,
        [_sizes(one) for one in found],
    )
    yield Table("Trust", TRUST, [_trust(one) for one in found])
    yield Line(
        "Covered: robots within the bound that their own calibration states with 95 % "
        "confidence. Actual/expected: 1 where calibrations say how accurate they "
        "are.",
        "note",
    )
    if any(one.failed for one in found):
        yield Table(
            "Not calibrated",
            (CONFIGURATIONS, Column("robots")),
            [(Cell(str(one.configurations)), Cell(str(one.failed))) for one in found],
        )


def _decision(found: Sequence[Outlook], limit: LimitSetup) -> Iterator[Line]:
    """Whether and when the limit is met."""
    if not math.isfinite(found[0].met[0]):
        last = found[-1]
        yield Line(
            f"With {last.configurations} configurations 95 % of the robots are within "
            f"{amount(last.position[2], 'm')} rms over the workspace.",
            "strong",
        )
        return
    limits = [(limit.position, "m"), (limit.orientation, "rad")]
    words = " and ".join(amount(size, unit) for size, unit in limits if size)
    enough = next((one for one in found if one.met[0] >= LEVELS[-1]), None)
    one = enough or max(found, key=lambda one: one.met[0])
    share, low, high = (f"{100.0 * part:.0f} %" for part in one.met)
    yield Line(
        f"With {one.configurations} configurations {share} of the robots ({low} to "
        f"{high}) are within {words} in 95 % of their workspace.",
        "good" if enough else "bad",
    )


def _noise(noise: Mapping[str, float]) -> str:
    if not noise:
        return "noise of 0.1 mm and 0.1 mrad"
    units = {"orientation": "rad", "pixel": "px"}
    parts = (f"{name} {amount(s, units.get(name, 'm'))}" for name, s in noise.items())
    return f"noise: {', '.join(parts)}"


CONFIGURATIONS = Column("configurations", "word")
SIZES = (
    CONFIGURATIONS,
    *columns(
        "", ("nominal", "5 %", "median", "95 %", "within, 95 % of workspace", "unit")
    )[1:],
)
TRUST = (
    CONFIGURATIONS,
    *map(Column, ("covered", "95 %", "actual/expected", "limit met", "95 %")),
)


def _sizes(one: Outlook) -> tuple[Cell, ...]:
    return (
        Cell(str(one.configurations)),
        known(one.nominal[1], "m"),
        *(known(size, "m") for size in one.position),
        known(one.position_share[2], "m"),
        Cell(DISPLAY["m"][0]),
    )


def _trust(one: Outlook) -> tuple[Cell, ...]:
    return (
        Cell(str(one.configurations)),
        *_share(one.coverage),
        Cell(f"{one.honesty:.2f}" if math.isfinite(one.honesty) else "-", one.honesty),
        *_share(one.met),
    )


def _share(found: tuple[float, float, float]) -> tuple[Cell, Cell]:
    share, low, high = found
    if not math.isfinite(share):
        return Cell("-"), Cell("-")
    ends = f"{100.0 * low:.0f} ... {100.0 * high:.0f} %"
    return Cell(f"{100.0 * share:.1f} %", share), Cell(ends)
