"""Identifiability: ranks, combinations, unobservable parameters, suggestions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

from calib_pin.planning.suggestions import LARGEST, Suggestion
from calib_pin.report.blocks import Block, Facts, Line, note, table
from calib_pin.report.robot_errors import error_table, held
from calib_pin.report.tables import ESTIMATE, STATUS, estimate, listed, number
from calib_pin.validation.result import CoupledGroup, Identification

REMARKS = {"weak": " (held wholly or partly at nominal)"}
"""Remarks on a status that explain it."""


def identified(
    found: Identification,
    *,
    fitted: bool,
    suggestions: Sequence[Suggestion] = (),
    details: bool = False,
) -> Iterator[Block]:
    """Ranks, the errors of the robot, what is not known, suggested measurements.

    Args:
        found: The identifiability of a robot.
        fitted: Whether there are estimates.
        suggestions: Suggested measurements.
        details: Also the parameters, and all combinations of them in full.
    """
    yield ranks(found, fitted=fitted)
    known = [e for e in found.robot_errors if e.status == "identifiable"]
    if known:
        title = "Identifiable errors of the robot"
        if fitted:
            yield error_table(known, title, ESTIMATE)
        else:
            yield error_table(known, f"{title} (SI units)", ("formula|name",))
    yield from held(found.robot_errors)
    if details or not found.robot_errors:
        yield from in_full(found, fitted=fitted)
    for status in ("weak", "unidentifiable", "fixed"):
        names = [p.name for p in found.parameters if p.status == status]
        yield from listed(STATUS[status] + REMARKS.get(status, ""), names)
    yield from _remedied(found, suggestions)


def summary(result: Identification, suggestions: Sequence[Suggestion]) -> Line:
    """How much of the robot is known, and how more would be."""
    found = result.identifiability
    said = f"Identifiability: {found.robot_rank - found.weak} of {found.robot_rank}"
    said += " independent errors of the robot are known"
    if not found.scale_observable:
        said += "; its absolute scale is unobservable, add a known length"
    better = [s for s in suggestions if s.count > found.robot_rank]
    if better:
        best = max(better, key=lambda s: s.count)
        said += f"; {best.count} would be if you {best.change}"
    return Line(f"{said}.")


def in_full(found: Identification, *, fitted: bool) -> Iterator[Block]:
    """Parameters that are known alone, and combinations as formulae."""
    identifiable = [p for p in found.parameters if p.status == "identifiable"]
    if identifiable and fitted:
        yield table(
            "Identifiable parameters",
            ("", *ESTIMATE),
            [(p.name, *estimate(p.value, p.sigma, p.unit)) for p in identifiable],
        )
    else:
        yield from listed("identifiable", [p.name for p in identifiable])
    groups = [group for group in found.groups if not of_place(group)]
    if groups:
        shown = 5 if fitted else 2
        yield table(
            "Identifiable linear combinations (coefficients in SI units)",
            ("|number", f"{'combination' * fitted}|name", *ESTIMATE)[:shown],
            [
                (str(g.number), g.expression, *estimate(g.value, g.sigma, g.unit))[
                    :shown
                ]
                for g in groups
            ],
        )
    if hidden := len(found.groups) - len(groups):
        yield note(
            f"{hidden} more combinations start with the position of a socket, sphere "
            "or fixed reference point; see calibration.json or `identify --json`."
        )


def of_place(group: CoupledGroup) -> bool:
    """Whether a combination starts with the position of a socket or the like.

    Such a position is of no interest by itself.
    """
    _, kind, _ = group.terms[0][0].rsplit(".", 2)
    return kind in ("socket", "sphere", "anchor")


def _remedied(
    found: Identification, suggestions: Sequence[Suggestion]
) -> Iterator[Block]:
    """Suggested measurements, and how many robot parameters each would identify."""
    known, weak = found.identifiability.robot_rank, found.identifiability.weak
    rows = [("no change", known - weak)]
    if weak:
        rows.append(("more or other configurations: calib-pin plan --add N", known))
    rows += [(remedy.change, remedy.count) for remedy in suggestions]
    if len(rows) > 1:
        titles = ("|remark", "identifiable robot parameters")
        yield table("Suggested measurements", titles, rows)
    if found.identifiability.parameters > LARGEST:
        many = f"more than {LARGEST} parameters"
        yield note(f"No measurements are suggested for {many}.")
    if any(remedy.complete for remedy in suggestions):
        yield note(
            "The combinations that remain move the tool point only together: no "
            "measurement of it can separate them, and no task requires it."
        )


def ranks(known: Identification, *, fitted: bool) -> Facts:
    """Numbers of free parameters, structural and practical rank, singular values."""
    found = known.identifiability
    status = Counter(p.status for p in known.parameters if p.status != "fixed")
    counts = ", ".join(f"{count} {STATUS[name]}" for name, count in status.items())
    entries = [
        ("free parameters", f"{found.parameters}   ({counts})"),
        (
            "structural rank",
            f"{found.structural_rank}   (gap {number(found.gap)}; Everett's count "
            f"4R + 2P + 6 = {found.everett}, for geometry and full poses)",
        ),
    ]
    if fitted:
        remarks = [f"{found.weak} directions held at nominal"][: bool(found.weak)]
        if found.revealed:
            only = "observable only at the calibrated geometry"
            remarks.append(f"{found.revealed} {only}")
        remark = f"   ({'; '.join(remarks)})" if remarks else ""
        entries.append(("practical rank", f"{found.rank}{remark}"))
    if not found.scale_observable:
        entries.append(("absolute scale", "unobservable; add a known length"))
    if found.singular_values:
        first, last = found.singular_values[0], found.singular_values[-1]
        spread = f"{number(first)} ... {number(last)}"
        entries.append(("singular values", f"{spread}   (scaled, whitened)"))
        entries.append(("condition number", number(found.condition)))
    if found.singular_values and found.observability:
        indices = "  ".join(f"{k} {number(v)}" for k, v in found.observability.items())
        entries.append(("observability indices", indices))
    return Facts("Identifiability", entries)
