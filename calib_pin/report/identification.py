"""Identifiability, and the errors of the robot as people name them.

Ranks, combinations, unobservable parameters, suggestions; offsets of the joints.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

from calib_pin.errors import counted, enumerated
from calib_pin.estimation.evidence import ADDING
from calib_pin.planning.suggestions import LARGEST
from calib_pin.report.blocks import Block, Cell, Facts, Line, Table, note, table
from calib_pin.report.tables import ESTIMATE, STATUS, estimate, listed, number
from calib_pin.validation.joint_errors import OffsetEstimate, joint_offsets
from calib_pin.validation.result import (
    CalibrationResult,
    CoupledGroup,
    Identification,
    RobotError,
    Suggestion,
)


def identified(
    result: Identification, *, fitted: bool, details: bool = False
) -> Iterator[Block]:
    """Ranks, the errors of the robot, what is not known, suggested measurements.

    Args:
        result: The identifiability of a robot.
        fitted: Whether there are estimates.
        details: Also the parameters, and all combinations of them in full.
    """
    yield ranks(result, fitted=fitted)
    known = [e for e in result.robot_errors if e.status == "identifiable"]
    if known:
        title = "Identifiable errors of the robot"
        keys = ESTIMATE if fitted else ("formula|name",)
        yield error_table(known, title if fitted else f"{title} (SI units)", keys)
    yield from held(result.robot_errors)
    if details or not result.robot_errors:
        yield from in_full(result, fitted=fitted)
    for status in ("weak", "unidentifiable", "fixed"):
        names = [p.name for p in result.parameters if p.status == status]
        remark = " (held wholly or partly at nominal)" * (status == "weak")
        yield from listed(STATUS[status] + remark, names)
    yield from _suggestion_blocks(result)


def summary(result: Identification, *, advised: bool) -> Line:
    """How much of the robot is known and, if advised, how more would be."""
    analysis = result.identifiability
    rank = analysis.robot_rank
    text = f"Identifiability: {rank - analysis.weak} of {rank} independent errors of "
    text += "the robot are known"
    if not analysis.scale_observable:
        text += "; its absolute scale is unobservable, add a known length"
    best = max(result.suggestions, key=lambda s: s.count, default=None)
    if advised and best and best.count > rank:
        text += f"; {best.count} would be if you {best.change}"
    return Line(f"{text}.")


def in_full(result: Identification, *, fitted: bool) -> Iterator[Block]:
    """Parameters that are known alone, and combinations as formulae."""
    identifiable = [p for p in result.parameters if p.status == "identifiable"]
    if identifiable and fitted:
        known = [(p.name, *estimate(p.value, p.sigma, p.unit)) for p in identifiable]
        yield table("Identifiable parameters", ("", *ESTIMATE), known)
    else:
        yield from listed("identifiable", [p.name for p in identifiable])
    groups = [group for group in result.groups if not of_place(group)]
    if groups:
        titles = ("|number", f"{'combination' * fitted}|name", *ESTIMATE)
        rows = [
            (str(g.number), g.expression, *estimate(g.value, g.sigma, g.unit))
            for g in groups
        ]
        shown = slice(5 if fitted else 2)
        title = "Identifiable linear combinations (coefficients in SI units)"
        yield table(title, titles[shown], [row[shown] for row in rows])
    if hidden := len(result.groups) - len(groups):
        which = f"{counted(hidden, 'combination')} with the position of a reference"
        yield note(f"Not listed: {which} object; see calibration.json.")


def of_place(group: CoupledGroup) -> bool:
    """Whether a combination starts with the position of a socket or the like.

    Such a position is of no interest by itself.
    """
    _, kind, _ = group.terms[0][0].rsplit(".", 2)
    return kind in ("socket", "sphere", "anchor")


def _suggestion_blocks(result: Identification) -> Iterator[Block]:
    """Suggested measurements, and how many robot parameters each would identify."""
    known, weak = result.identifiability.robot_rank, result.identifiability.weak
    rows = [("no change", known - weak)]
    if weak:
        rows.append((f"more or other configurations: {ADDING}", known))
    rows += [(remedy.change, remedy.count) for remedy in result.suggestions]
    if len(rows) > 1:
        titles = ("|remark", "identifiable robot parameters")
        yield table("Suggested measurements", titles, rows)
    if result.identifiability.parameters > LARGEST:
        yield note(
            f"With more than {LARGEST} parameters no measurements are suggested."
        )
    if any(remedy.complete for remedy in result.suggestions):
        yield note(
            "The combinations that remain move the tool point only together: no "
            "measurement of it can separate them, and no task requires it."
        )


def ranks(known: Identification, *, fitted: bool) -> Facts:
    """Numbers of free parameters, structural and practical rank, singular values."""
    of = known.identifiability
    status = Counter(p.status for p in known.parameters if p.status != "fixed")
    counts = ", ".join(f"{count} {STATUS[name]}" for name, count in status.items())
    everett = f"Everett's count 4R + 2P + 6 = {of.everett}, for geometry and full poses"
    entries = [
        ("free parameters", f"{of.parameters}   ({counts})"),
        ("structural rank", f"{of.structural_rank}   (gap {number(of.gap)})"),
        ("", everett),
    ]
    if fitted:
        only = f"{of.revealed} observable only at the calibrated geometry"
        entries.append(("practical rank", f"{of.rank}   ({of.weak} weak, {only})"))
    if not of.scale_observable:
        entries.append(("absolute scale", "unobservable; add a known length"))
    if values := of.singular_values:
        spread = f"{number(values[0])} ... {number(values[-1])}   (scaled, whitened)"
        indices = [f"{k} {number(v)}" for k, v in of.observability.items()]
        entries.append(("singular values", spread))
        entries.append(("condition number", number(of.condition)))
        entries.append(("observability indices", "  ".join(indices)))
    return Facts("Identifiability", entries)


# --- errors of the robot -------------------------------------------------------------

CLEAR = 2.0
"""Standard deviations from which a correction is told as one."""

MANY = 4
"""Joints and links from which on their errors are only counted, without details."""

USE = (
    "A joint stands where it says plus the offset: add the offset to the position "
    "that you read, subtract it from the position that you command."
)
"""How offsets are used."""

CAUSES = {
    "coupled": "it shows only together with other errors",
    "weak": "these measurements hardly show it",
    "unidentifiable": "nothing that was measured depends on it",
}
"""Why an offset is not known, by the status of its parameter."""


def offsets(result: CalibrationResult) -> Iterator[Block]:
    """Offsets of the joints, in degrees and in steps of their encoders."""
    every = joint_offsets(result)
    known = [offset for offset in every if offset.sigma is not None]
    stepped = any(offset.steps is not None for offset in known)
    if known and result.geometry is not None:
        titles = ("offset", *ESTIMATE[1:], *["steps"][:stepped])
        rows = [_offset(offset, stepped) for offset in known]
        yield table("Joint offsets", ("", *titles, "the joint stands|remark"), rows)
        yield note(USE)
    for offset in every:
        if offset.sigma is None:
            yield Line(_unknown(offset, result.suggestions), "strong")
        if offset.reverses:
            yield Line(f"{offset.reverses}.", "strong")


def _offset(offset: OffsetEstimate, stepped: bool) -> list[Cell | str]:
    position = "further than it says"
    # Whole steps are what a motor can store.
    steps = "-" if offset.steps is None else f"{round(offset.steps * offset.value):+d}"
    if abs(offset.value) < CLEAR * (offset.sigma or 0.0):
        position = "where it says"
    elif offset.value < 0.0:
        position = "less far than it says"
    name = offset.joint
    name += f" (column {offset.column})" * (offset.column != name)
    cells = estimate(offset.value, offset.sigma, offset.unit)
    position += ", reversed" * bool(offset.reverses)
    return [name, *cells, *[steps][:stepped], position]


def _unknown(offset: OffsetEstimate, suggestions: Sequence[Suggestion]) -> str:
    """A joint whose offset is not known, why, and what would tell it."""
    why = CAUSES.get(offset.status, "nothing tells it")
    if offset.within:
        frames = enumerated([_frame(name) for name in offset.within])
        why = f"it shows only together with {frames}, which is estimated as well"
    name = f"{offset.joint}.joint-offset.q"
    ways = [s.change for s in suggestions if name in s.parameters]
    advice = f"; to know it, {ways[0]}" if ways else ""
    return f"{offset.joint}: not known, because {why}{advice}."


def _frame(name: str) -> str:
    """A frame or an instrument in a sentence, by owner and kind."""
    owner, _, kind = name.rpartition(".")
    return f"the {owner} frame" if kind == "frame" else f"the {kind} '{owner}'"


def error_table(errors: Sequence[RobotError], title: str, keys: Sequence[str]) -> Table:
    """Errors of the robot, grouped by their kind.

    Args:
        errors: The errors.
        title: Title of the table.
        keys: Some of `ESTIMATE`, or `formula|name`.
    """
    rows, sizes = [], Counter((error.kind, error.of) for error in errors)
    for error in errors:
        owner = _owner(error)
        if sizes[error.kind, error.of] > 1 and error.terms:  # A link with two branches.
            owner += f" to {error.terms[0].parameter.rsplit('.', 2)[0]}"
        cells = dict(
            zip(ESTIMATE, estimate(error.value, error.sigma, error.unit), strict=True)
        )
        cells["formula|name"] = Cell(error.expression)
        rows.append((error.kind, owner, *(cells[key] for key in keys)))
    return table(title, ("|word", "|name", *keys), rows, grouped=1)


def _owner(error: RobotError) -> str:
    """The joint or link of an error, or those of which only the sum is known."""
    if len(error.of) == 1:
        return error.of[0]
    return f"sum of {', '.join(error.of)}"


def offsets_alone(result: CalibrationResult) -> bool:
    """Whether the offsets of the joints are all that is told of the robot."""
    kinds = {error.kind for error in result.robot_errors}
    return kinds == {"joint offset"} and bool(joint_offsets(result))


def corrections(result: CalibrationResult) -> Iterator[Block]:
    """The errors that were found, those beyond their uncertainty, and the others."""
    if result.verdict == "no-gain" or offsets_alone(result):
        return
    known = [e for e in result.robot_errors if e.sigma is not None]
    clear = [e for e in known if abs(e.value) >= CLEAR * (e.sigma or 0.0)]
    if clear:
        yield error_table(clear, "Errors of the robot that were found", ESTIMATE)
        count = len(known) - len(clear)
        yield note(f"Below {CLEAR:.0f} standard deviations: {count} more.")


def held(errors: Sequence[RobotError], *, details: bool = True) -> Iterator[Line]:
    """Errors that stay at nominal, and those that frames take along."""
    together: dict[str, dict[str, dict[str, None]]] = {}
    for error in errors:
        meaning = "Held at nominal, hardly observable"
        if error.status == "absorbed":
            meaning = f"Part of {enumerated(map(_frame, error.within))}"
        if error.status in ("absorbed", "weak"):
            # Errors by joint, such as `joint offset and link offset of wrist_3_joint`.
            owners = together.setdefault(meaning, {})
            owners.setdefault(_owner(error), {})[error.kind] = None
    for meaning, owners in sorted(together.items()):
        parts = [
            f"{enumerated(kinds) if len(kinds) < 4 else 'the placement'} of {owner}"
            for owner, kinds in owners.items()
        ]
        text = "; ".join(parts)
        if len(parts) > MANY and not details:
            text = f"{counted(sum(map(len, owners.values())), 'error')}, see --details"
        yield note(f"{meaning}: {text}.")
