"""The reports of a fleet and of a Monte Carlo study."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np

from calib_pin.errors import counted
from calib_pin.monte_carlo import Outlook, Study
from calib_pin.monte_carlo.summary import LEVELS
from calib_pin.report.blocks import Block, Cell, Facts, Line, Table, note, table
from calib_pin.report.tables import (
    UNIT,
    amount,
    measures,
    quantity,
    unit_of,
)
from calib_pin.setup import LimitSetup
from calib_pin.setup.population import PopulationPrior
from calib_pin.validation.fleet import FAILED, ORDER, FleetRow

FEW, MANY = 20, 2000
"""Rows that a terminal and a page show, the most urgent first."""


def fleet_report(
    rows: Sequence[FleetRow], types: Sequence[PopulationPrior] = (), most: int = FEW
) -> Iterator[Block]:
    """The report of a fleet.

    Args:
        rows: The rows, the most urgent first.
        types: Priors of the types that are known well enough.
        most: Most rows that are listed.
    """
    counts = Counter(row.verdict for row in rows)
    text = ", ".join(f"{count} {verdict}" for verdict, count in counts.most_common())
    good = all(row.trusted for row in rows)
    yield Line(
        f"{counted(len(rows), 'calibration')}: {text}.", "good" if good else "bad"
    )
    if drifted := sum(row.drift.beyond for row in rows):
        verb = "calibration differs" if drifted == 1 else "calibrations differ"
        yield Line(
            f"{drifted} {verb} from the one before by more than noise explains.", "bad"
        )
    shown = rows[:most]
    # A reason that is the same for several robots is said once.
    reasons: dict[tuple[str, bool], list[str]] = {}
    for row in shown:
        if not row.trusted:
            urgent = row.verdict in ORDER[:2]
            reasons.setdefault((row.reason, urgent), []).append(row.job)
    for (reason, urgent), jobs in reasons.items():
        yield Line(f"{', '.join(jobs)}: {reason}", "bad" if urgent else "strong")
    yield from _accuracy(rows)
    titles = ("job", "verdict|word", "nominal", "calibrated", "expected", "drift", UNIT)
    listed = [_listed(row) for row in shown]
    yield table("Robots, those that need attention first", titles, listed)
    if any(row.drift.beyond for row in shown):
        yield note(
            "!: the tool points differ from the calibration before by more than noise "
            "explains."
        )
    if len(rows) > most:
        yield note(f"{len(rows) - most} more are in fleet.csv.")
    for prior in types:
        yield Line(
            f"{prior.robots} robots '{prior.robot.name}' are the prior of the next one "
            "of their type."
        )


def _accuracy(rows: Sequence[FleetRow]) -> Iterator[Table]:
    """Errors before and after over the fleet, by quantity."""
    cells = []
    for name in dict.fromkeys(row.quantity for row in rows if row.quantity):
        group = [row for row in rows if row.quantity == name and row.trusted]
        for robot in ("nominal", "calibrated") if group else ():
            sizes = np.array([getattr(row, robot) for row in group])
            quantiles = np.quantile(sizes, LEVELS).tolist()
            cells.append((name, robot, *measures(group[0].unit, *quantiles)))
    if cells:
        yield table(
            "Errors of trusted calibrations (rms of a robot, held-out measurements)",
            ("", "robot|word", "5 %", "median", "95 %", UNIT),
            cells,
            grouped=1,
        )


def _listed(row: FleetRow) -> tuple[Cell | str, ...]:
    """The line of a robot; what is expected is a length."""
    unit = row.unit or "m"
    far, size = (
        quantity(x if unit == "m" else math.nan, "m")
        for x in (row.expected.calibrated, row.drift.size)
    )
    if row.drift.beyond:
        size = Cell(f"{size.text} !", row.drift.size)
    verdict = row.verdict.upper() if row.verdict == FAILED else row.verdict
    pair = measures(unit, row.nominal, row.calibrated)[:2]
    return row.job, verdict, *pair, far, size, unit_of(unit)[0]


def outlook_report(
    study: Study, outlooks: Sequence[Outlook], limit: LimitSetup
) -> Iterator[Block]:
    """How accurate robots of a type would be.

    Args:
        study: The study.
        outlooks: Its outlooks, by rising number of configurations.
        limit: What has to be reached.
    """
    yield _decision(outlooks, limit)
    setup, noise = study.truth.setup, "noise of 0.1 mm and 0.1 mrad"
    if setup.noise:
        units = {"orientation": "rad", "pixel": "px"}
        sigmas = setup.noise.items()
        parts = (f"{name} {amount(s, units.get(name, 'm'))}" for name, s in sigmas)
        noise = f"noise: {', '.join(parts)}"
    instruments = "+".join(dict.fromkeys(key.model for key in study.truth.terms))
    yield Facts(
        "Study",
        [
            ("robot", study.chains.robot.name),
            ("measured", f"{instruments}, {noise}"),
            ("configurations", "random" if study.plan is None else "of the plan"),
            ("true errors", ", ".join(setup.parameters)),
            ("fitted", ", ".join(study.setup.parameters)),
            ("robots", str(outlooks[0].robots)),
            ("random seed", str(study.seed)),
        ],
    )
    titles = ("nominal", "5 %", "median", "95 %", "within, 95 % of workspace", UNIT)
    errors, trust = list[tuple[object, ...]](), list[tuple[object, ...]]()
    for outlook in outlooks:
        count, known = str(outlook.configurations), math.isfinite(outlook.honesty)
        sizes = outlook.nominal[1], *outlook.position, outlook.position_share[2]
        honesty = Cell(f"{outlook.honesty:.2f}", outlook.honesty) if known else "-"
        errors.append((count, *measures("m", *sizes)))
        trust.append((count, *_share(outlook.coverage), honesty, *_share(outlook.met)))
    configurations = "configurations|word"
    title = "Position error over the workspace (rms of a robot)"
    yield table(title, (configurations, *titles), errors)
    shares = "covered", "95 %", "actual/expected", "limit met", "95 %"
    yield table("Trust", (configurations, *shares), trust)
    yield note(
        "Covered: robots within the bound that their own calibration states with 95 % "
        "confidence. Actual/expected: 1 where calibrations say how accurate they are."
    )
    if any(outlook.failed for outlook in outlooks):
        failed = [(str(o.configurations), str(o.failed)) for o in outlooks]
        yield table("Not calibrated", (configurations, "robots"), failed)


def _decision(outlooks: Sequence[Outlook], limit: LimitSetup) -> Line:
    """Whether and when the limit is met."""
    if not math.isfinite(outlooks[0].met[0]):
        last = outlooks[-1]
        return Line(
            f"With {last.configurations} configurations 95 % of the robots are within "
            f"{amount(last.position[2], 'm')} rms over the workspace.",
            "strong",
        )
    limits = [(limit.position, "m"), (limit.orientation, "rad")]
    words = " and ".join(amount(size, unit) for size, unit in limits if size)
    enough = next((o for o in outlooks if o.met[0] >= LEVELS[-1]), None)
    outlook = enough or max(outlooks, key=lambda outlook: outlook.met[0])
    share, low, high = (f"{100.0 * part:.0f} %" for part in outlook.met)
    return Line(
        f"With {outlook.configurations} configurations {share} of the robots ({low} to "
        f"{high}) are within {words} in 95 % of their workspace.",
        "good" if enough else "bad",
    )


def _share(interval: tuple[float, float, float]) -> tuple[Cell | str, str]:
    share, low, high = interval
    if not math.isfinite(share):
        return "-", "-"
    ends = f"{100.0 * low:.0f} ... {100.0 * high:.0f} %"
    return Cell(f"{100.0 * share:.1f} %", share), ends
