"""The report as tables for a terminal, at most 80 columns wide."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pinocchio as pin
from rich.console import Group, RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from calib_pin.assessment import chi2_interval
from calib_pin.report.tables import (
    ESTIMATE,
    group_table,
    listed,
    number,
    parameter_table,
    plain_text,
    table,
)
from calib_pin.result import (
    Accuracy,
    CalibrationResult,
    CoupledGroup,
    Evaluation,
    Identifiability,
    Identification,
    QuantityErrors,
)
from calib_pin.solvers import Status
from calib_pin.training import BEYOND
from calib_pin.units import DISPLAY

__all__ = [
    "evaluation_report",
    "format_report",
    "identification_report",
    "report",
    "untrusted",
]

TITLES = {"network": "network", "gaussian-process": "Gaussian process"}
"""What residual models are called in sentences."""

UNSEEN_ROWS = ("set", "file", "holdout", "none")
"""Ways to check a calibration that are no cross-validation."""

LISTED_OWNERS = 3
"""Members of one kind, such as sockets, that are named before they are counted."""

LISTED_ROWS = 5
"""Outliers and correlated pairs that are listed before the rest is only counted."""


def format_report(result: CalibrationResult) -> str:
    """The report of a calibration as plain text of at most 80 columns.

    Example:
        >>> import calib_pin
        >>> chain = calib_pin.load_chain("space7")
        >>> setup = calib_pin.read_setup(calib_pin.robot_file("space7", "setup.yaml"))
        >>> rows = calib_pin.read_measurements(
        ...     calib_pin.robot_file("space7", "measurements.csv"), chain
        ... )
        >>> result = calib_pin.calibrate(chain, rows, setup)
        >>> print(calib_pin.format_report(result).splitlines()[0])
        GOOD: the fit converged and is better on rows it has not seen.
    """
    return plain_text(report(result))


def report(result: CalibrationResult) -> RenderableType:
    """Verdict, accuracy, identifiability and what does not fit."""
    return Group(
        _verdict(result),
        _subject(result),
        "",
        *_ladder(result),
        *_accuracy(result),
        *_distances(result),
        *_moves(result),
        *_beyond(result),
        "",
        identification_report(result, fitted=True),
        *listed("at a bound", result.at_bounds),
        *_statistics(result),
        *_outliers(result),
    )


def identification_report(found: Identification, *, fitted: bool) -> RenderableType:
    """Ranks, parameters by status, and coupled groups as formulae.

    Args:
        found: What can be known.
        fitted: Whether there are estimates to show.
    """
    parts: list[RenderableType] = [*_ranks(found.identifiability, fitted)]
    identifiable = [p for p in found.parameters if p.status == "identifiable"]
    if identifiable and fitted:
        parts += ["", parameter_table(identifiable)]
    else:
        parts += listed("identifiable", [p.name for p in identifiable])
    groups = [group for group in found.groups if not _of_place(group)]
    if groups:
        parts += ["", group_table(groups, ESTIMATE if fitted else ())]
    if hidden := len(found.groups) - len(groups):
        parts.append(
            Text(
                f"{hidden} more sums begin with the place of a socket, sphere or "
                "anchor; they are in calibration.json or with `identify --json`.",
                style="dim",
            )
        )
    remarks = {
        "weak": "weak (these rows tell too little; partly or wholly left at nominal)",
        "unidentifiable": "unidentifiable (no effect on what is measured)",
        "fixed": "fixed",
    }
    for status, meaning in remarks.items():
        names = [p.name for p in found.parameters if p.status == status]
        parts += listed(meaning, names)
    return Group(*parts)


def _of_place(group: CoupledGroup) -> bool:
    """Whether a sum is that of the place of a socket or the like.

    Where a thing stands that one has put somewhere is of no interest by itself.
    """
    _, kind, _ = group.terms[0][0].rsplit(".", 2)
    return kind in ("socket", "sphere", "anchor")


def evaluation_report(evaluation: Evaluation) -> RenderableType:
    """Accuracy on rows that were not fitted."""
    accuracies = table("Accuracy", ("rows", "mean", "rms", "max", "unit"))
    counts = evaluation.counts or (evaluation.rows,) * len(evaluation.errors)
    for (name, unit, accuracy), count in zip(evaluation.errors, counts, strict=True):
        cells = (*_sizes(accuracy, unit), DISPLAY[unit][0])
        accuracies.add_row(name, str(count), *cells)
    how = (
        "What is unknown of base, tool and instrument was registered on these rows."
        if evaluation.registered
        else "Nothing was fitted to these rows."
    )
    if evaluation.placed:
        how = (
            f"New to the calibration, and placed by these rows: "
            f"{', '.join(evaluation.placed)}. Nothing else was fitted to them."
        )
    if evaluation.outside:
        how += (
            f" {evaluation.outside} rows lie outside the region in which the "
            "correction was learned; there it fades to zero."
        )
    parts: list[RenderableType] = [accuracies, Text(how, style="dim")]
    if evaluation.verdict != "good":
        parts = [untrusted(evaluation.reason), "", *parts]
    return Group(*parts)


def untrusted(reason: str) -> Text:
    """The line that comes first where a result must not be trusted."""
    return Text(f"UNTRUSTED: {reason.rstrip('.')}.", style="bold red")


def _verdict(result: CalibrationResult) -> Text:
    if result.verdict != "good":
        return untrusted(result.reason)
    ended = "reached its target" if result.status is Status.TARGET else "converged"
    if result.validation == "none":
        checked = "; too few rows to check it on unseen ones."
    elif all(_better(error) for error in result.errors):
        checked = " and is better on rows it has not seen."
    else:
        checked = " and is no worse on rows it has not seen."
    return Text(f"GOOD: the fit {ended}{checked}", style="bold green")


def _better(error: QuantityErrors) -> bool:
    before, after = error.validation_before, error.validation_after
    return before is None or after is None or after.rms < 0.99 * before.rms


def _subject(result: CalibrationResult) -> Text:
    """Which robot was measured in which way."""
    model = result.model
    chain, rows = model.chain, f"{result.training} rows"
    search = ""
    if result.history:
        search = (
            f"; {result.solver}, {result.evaluations} evaluations ({result.evaluator})"
        )
    return Text(
        f"{chain.robot.name}: {len(chain.joints)} joints from {chain.base} to "
        f"{chain.tip}; {model.measurement.name}, {rows} fitted{search}",
        style="dim",
    )


def _ladder(result: CalibrationResult) -> Iterator[RenderableType]:
    """The rungs of the model ladder with their errors on unseen rows."""
    if result.ladder is None:
        return
    rungs = result.ladder.rungs
    quantities = [
        (name, unit) for name, unit, _ in max((r.errors for r in rungs), key=len)
    ]
    units = [f"{name} [{DISPLAY[unit][0]}]" for name, unit in quantities]
    shown = table("Model ladder: mean errors on unseen rows", (*units, "error", ""))
    shown.columns[-1].justify = "left"
    shown.columns[-1].no_wrap = False
    best = min((r for r in rungs if not r.reason), key=lambda rung: rung.score)
    for k, rung in enumerate(rungs):
        if rung.reason:
            cells = ["-"] * len(quantities)
            relative, remark = "-", rung.reason
        else:
            cells = [number(DISPLAY[unit][1] * mean) for _, unit, mean in rung.errors]
            part, deviation = (x / rungs[0].score for x in (rung.score, rung.deviation))
            relative = f"{100.0 * part:.1f} +- {100.0 * deviation:.1f} %"
            remark = "kept" if k == result.ladder.chosen else ""
            if not rung.helps:
                remark = "does not help"
            elif rung is best and not remark:
                remark = "no better than what is kept"
        shown.add_row(rung.name, *cells, relative, remark)
    yield shown
    yield ""


def _accuracy(result: CalibrationResult) -> Iterator[RenderableType]:
    accuracies = table("Accuracy", ("rows", "robot", "mean", "rms", "max", "unit"))
    for error in result.errors:
        pairs = [("fitted", error.before, error.after)]
        if error.validation_before and error.validation_after:
            unseen = f"unseen ({result.validation})"
            pairs.append((unseen, error.validation_before, error.validation_after))
        name = error.name
        for rows, before, after in pairs:
            for robot, accuracy in (("nominal", before), ("calibrated", after)):
                cells = (*_sizes(accuracy, error.unit), DISPLAY[error.unit][0])
                accuracies.add_row(name, rows, robot, *cells)
                name = rows = ""
    yield accuracies
    if result.ladder is not None and result.validation not in UNSEEN_ROWS:
        yield Text(
            "The same parts have chosen the model; rows of their own (--validation) "
            "are the stricter check.",
            style="dim",
        )
    yield Text(_registered(result), style="dim")


def _moves(result: CalibrationResult) -> Iterator[RenderableType]:
    """How far the corrected robot is from the nominal one: it must look like it."""
    geometry = result.geometry or (result.model if result.urdf is None else None)
    corrections = {} if geometry is None else geometry.urdf_corrections()
    if not corrections:
        return
    shifts = {j: float(np.linalg.norm(M.translation)) for j, M in corrections.items()}
    turns = {
        j: float(np.linalg.norm(pin.log3(M.rotation))) for j, M in corrections.items()
    }
    parts = []
    for sizes, unit in ((shifts, "m"), (turns, "rad")):
        joint = max(sizes, key=sizes.__getitem__)
        shown, factor = DISPLAY[unit]
        parts.append(f"{number(factor * sizes[joint])} {shown} ({joint})")
    yield Text(f"Joint origins move by up to {' and '.join(parts)}.", style="dim")


def _beyond(result: CalibrationResult) -> Iterator[RenderableType]:
    """What a URDF cannot hold, and how good it is without."""
    if result.silent:
        yield Text(
            f"The {TITLES[result.silent]} found nothing that holds on rows it had not "
            "seen: nothing is corrected.",
            style="dim",
        )
    if result.urdf is None:
        return
    setup = result.model.setup
    kinds: list[str] = [name for name in setup.parameters if name in BEYOND]
    if setup.learned is not None:
        kinds.append(f"what the {TITLES[setup.learned]} has learned")
    said = f"A URDF cannot hold {' and '.join(kinds)}. "
    if result.urdf.reason:
        yield Text(
            f"{said}None is written: {result.urdf.reason.rstrip('.')}.",
            style="bold red",
        )
        return
    means = []
    for error in result.urdf.errors:
        accuracy = error.validation_after or error.after
        shown, factor = DISPLAY[error.unit]
        means.append(f"{error.name} {number(factor * accuracy.mean)} {shown}")
    rows = "fitted" if result.validation == "none" else "unseen"
    yield Text(
        f"{said}It gets the best geometry without: mean error on {rows} rows "
        f"{', '.join(means)}. `calib-pin compensate` uses all.",
        style="dim",
    )


def _distances(result: CalibrationResult) -> Iterator[RenderableType]:
    """Known distances beside those that the robot finds."""
    if not result.distances:
        return
    shown = table("Known distances", ("rows", "known", "nominal", "calibrated", "unit"))
    unit, factor = DISPLAY["m"]
    for distance in result.distances:
        cells = (distance.value, distance.nominal, distance.found)
        shown.add_row(
            " - ".join(distance.between),
            "fitted" if distance.fitted else "unseen",
            *(f"{factor * value:.3f}" for value in cells),
            unit,
        )
    yield ""
    yield shown


def _registered(result: CalibrationResult) -> str:
    """What is fitted even where the robot is nominal."""
    of_robot = {p.name for p in result.model.error.parameters if not p.nuisance}
    owners: dict[str, dict[str, None]] = {}
    for parameter in result.parameters:
        if parameter.status != "fixed" and parameter.name not in of_robot:
            owner, kind, _ = parameter.name.rsplit(".", 2)
            owners.setdefault(kind, {})[owner] = None
    if not owners:
        return "Frames and instrument are known, nothing is registered."
    told = [
        f"{len(names)} {kind}s"
        if len(names) > LISTED_OWNERS
        else ", ".join(f"{name} {kind}" for name in names)
        for kind, names in owners.items()
    ]
    said = f"Fitted in either case: {', '.join(told)}."
    if result.placed:
        names = ", ".join(result.placed)
        if len(result.placed) > 2 * LISTED_OWNERS:
            names = f"{len(result.placed)} of them"
        said += f" Placed by the unseen rows that name them: {names}."
    if result.spoiled:
        reasons = " and ".join(dict.fromkeys(result.spoiled))
        count = len(result.spoiled)
        parts = "part of the check is" if count == 1 else "parts of the check are"
        said += f" {count} {parts} left out, for in the fit without: {reasons}."
    return said


def _ranks(ranks: Identifiability, fitted: bool) -> Iterator[RenderableType]:
    yield Text("Identifiability", style="bold")
    lines = [
        ("free parameters", f"{ranks.parameters}"),
        (
            "structural rank",
            f"{ranks.structural_rank}   (gap {number(ranks.gap)}; Everett's count "
            f"4R + 2P + 6 = {ranks.everett}, geometry and full poses)",
        ),
    ]
    if fitted:
        remarks = []
        if ranks.weak:
            remarks.append(f"{ranks.weak} directions left at nominal")
        if ranks.revealed:
            remarks.append(f"{ranks.revealed} seen only because the errors are large")
        remark = f"   ({'; '.join(remarks)})" if remarks else ""
        lines.append(("practical rank", f"{ranks.rank}{remark}"))
    if not ranks.scale_observable:
        lines.append(("scale", "unobservable: a larger robot fits as well"))
    if ranks.singular_values:
        first, last = ranks.singular_values[0], ranks.singular_values[-1]
        spread = f"{number(first)} ... {number(last)}"
        lines.append(("singular values", f"{spread}   (scaled, whitened)"))
        lines.append(("condition number", number(ranks.condition)))
    if ranks.singular_values and ranks.observability:
        indices = "  ".join(f"{k} {number(v)}" for k, v in ranks.observability.items())
        lines.append(("observability", indices))
    grid = Table.grid(padding=(0, 2))
    for name, value in lines:
        grid.add_row(f"  {name}", value)
    yield grid


def _statistics(result: CalibrationResult) -> Iterator[RenderableType]:
    learned = result.model.setup.learned is not None
    yield ""
    title = "Statistics of the parameters, before what is learned"
    yield Text(title if learned else "Statistics", style="bold")
    grid = Table.grid(padding=(0, 2))
    sigmas = "stated" if result.stated_sigma else "assumed"
    grid.add_row("  chi-square", f"{number(result.chi2)} with {result.dof} dof")
    grid.add_row("  sigma0", f"{number(result.sigma0)} times the {sigmas} sigma")
    remark = ""
    if result.stated_sigma and result.dof > 0:
        low, high = chi2_interval(result.dof)
        where = "inside"
        if result.chi2 < low:
            where, remark = "below", "less than their sigma says: it may be too large."
        elif result.chi2 > high:
            where = "above"
            remark = (
                "more than their sigma says: the standard deviations are too small."
            )
        interval = f"{number(low)} ... {number(high)}"
        grid.add_row("", f"{where} the 95 % interval {interval}")
    yield grid
    if remark and not learned:
        yield Padding(f"The rows scatter {remark}", (0, 0, 0, 2))
    pairs = result.identifiability.correlated
    if pairs:
        yield ""
        yield Text("Correlated above 0.95", style="bold")
        for first, second, value in pairs[:LISTED_ROWS]:
            yield Padding(f"{value:+.3f}  {first}  |  {second}", (0, 0, 0, 2))
        yield from _rest(len(pairs), "pairs")


def _outliers(result: CalibrationResult) -> Iterator[RenderableType]:
    if not result.outliers:
        return
    yield ""
    count = f"{len(result.outliers)} of {result.training}"
    yield Text(f"Rows that do not fit ({count})", style="bold")
    for outlier in result.outliers[:LISTED_ROWS]:
        size = number(outlier.size)
        yield Padding(f"{outlier.place}  {size} sigma", (0, 0, 0, 2))
    yield from _rest(len(result.outliers), "rows")


def _rest(count: int, what: str) -> Iterator[RenderableType]:
    if count > LISTED_ROWS:
        more = f"and {count - LISTED_ROWS} more {what} in calibration.json"
        yield Padding(more, (0, 0, 0, 2))


def _sizes(accuracy: Accuracy, unit: str) -> tuple[str, str, str]:
    factor = DISPLAY[unit][1]
    mean, rms, largest = (
        number(factor * value) for value in (accuracy.mean, accuracy.rms, accuracy.max)
    )
    return mean, rms, largest
