"""What can be known of a robot, what cannot, and what would tell more."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

from calib_pin.planning.suggestions import Suggestion
from calib_pin.report.blocks import Block, Cell, Column, Facts, Line, Names, Table
from calib_pin.report.tables import (
    ESTIMATE,
    group_table,
    listed,
    number,
    parameter_table,
)
from calib_pin.validation.result import CoupledGroup, Identification

__all__ = ["identified", "of_place", "ranks", "remedied", "unknown"]

REMARKS = {
    "weak": "weak (these rows tell too little; partly or wholly left at nominal)",
    "unidentifiable": "unidentifiable (no effect on what is measured)",
    "fixed": "fixed",
}
"""Parameters without an estimate of their own, by their status."""


def identified(
    found: Identification, *, fitted: bool, remedies: Sequence[Suggestion] = ()
) -> Iterator[Block]:
    """Ranks, parameters by status, coupled groups as formulae, and remedies.

    Args:
        found: What can be known.
        fitted: Whether there are estimates to show.
        remedies: What would tell more.
    """
    yield ranks(found, fitted=fitted)
    identifiable = [p for p in found.parameters if p.status == "identifiable"]
    if identifiable and fitted:
        yield parameter_table(identifiable)
    else:
        yield from listed("identifiable", [p.name for p in identifiable])
    groups = [group for group in found.groups if not of_place(group)]
    if groups:
        yield group_table(groups, ESTIMATE if fitted else ())
    if hidden := len(found.groups) - len(groups):
        yield Line(
            f"{hidden} more sums begin with the place of a socket, sphere or "
            "anchor; they are in calibration.json or with `identify --json`.",
            "note",
        )
    yield from unknown(found)
    yield from remedied(found, remedies)


def of_place(group: CoupledGroup) -> bool:
    """Whether a sum is that of the place of a socket or the like.

    Where a thing stands that one has put somewhere is of no interest by itself.
    """
    _, kind, _ = group.terms[0][0].rsplit(".", 2)
    return kind in ("socket", "sphere", "anchor")


def unknown(found: Identification) -> Iterator[Names]:
    """Parameters that have neither an estimate of their own nor stand in a sum."""
    for status, meaning in REMARKS.items():
        names = [p.name for p in found.parameters if p.status == status]
        yield from listed(meaning, names)


def remedied(found: Identification, remedies: Sequence[Suggestion]) -> Iterator[Block]:
    """What else could be measured or known, and how much of the robot it would tell."""
    known, weak = found.identifiability.robot_rank, found.identifiability.weak
    rows = [("as it is", known - weak)]
    if weak:
        rows.append(("more configurations, or others: calib-pin plan --add N", known))
    rows += [(remedy.change, remedy.count) for remedy in remedies]
    if len(rows) > 1:
        yield Table(
            "What would tell more",
            (Column("", "remark"), Column("robot errors known")),
            [(Cell(words), Cell(str(count), count)) for words, count in rows],
        )
    if any(remedy.complete for remedy in remedies):
        yield Line(
            "Sums that are left then move the tool only together: no measurement of "
            "the tool can take them apart, and no use of the robot needs to.",
            "note",
        )


def ranks(known: Identification, *, fitted: bool) -> Facts:
    """Counts of what is free, what can be known, and what these rows tell."""
    found = known.identifiability
    status = Counter(p.status for p in known.parameters if p.status != "fixed")
    counts = ", ".join(f"{count} {name}" for name, count in status.items())
    entries = [
        ("free parameters", f"{found.parameters}   ({counts})"),
        (
            "structural rank",
            f"{found.structural_rank}   (gap {number(found.gap)}; Everett's count "
            f"4R + 2P + 6 = {found.everett}, geometry and full poses)",
        ),
    ]
    if fitted:
        remarks = []
        if found.weak:
            remarks.append(f"{found.weak} directions left at nominal")
        if found.revealed:
            remarks.append(f"{found.revealed} seen only because the errors are large")
        remark = f"   ({'; '.join(remarks)})" if remarks else ""
        entries.append(("practical rank", f"{found.rank}{remark}"))
    if not found.scale_observable:
        entries.append(("scale", "unobservable: a larger robot fits as well"))
    if found.singular_values:
        first, last = found.singular_values[0], found.singular_values[-1]
        spread = f"{number(first)} ... {number(last)}"
        entries.append(("singular values", f"{spread}   (scaled, whitened)"))
        entries.append(("condition number", number(found.condition)))
    if found.singular_values and found.observability:
        indices = "  ".join(f"{k} {number(v)}" for k, v in found.observability.items())
        entries.append(("observability", indices))
    return Facts("Identifiability", entries)
