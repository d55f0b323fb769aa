"""The report of a plan as tables for a terminal, at most 80 columns wide."""

from __future__ import annotations

from collections.abc import Iterator

from rich.console import Group, RenderableType
from rich.text import Text

from calib_pin.planning.plan import Plan, Step
from calib_pin.report.tables import group_table, listed, number, parameter_table, table
from calib_pin.solvers import Status
from calib_pin.units import DISPLAY

__all__ = ["plan_report"]

SHOWN = 12
"""Lines of the table of the criterion against the number of configurations."""


def plan_report(plan: Plan) -> RenderableType:
    """What was planned, when to stop measuring, and what the plan will tell."""
    columns = ("std. dev.", "unit")
    identifiable = [p for p in plan.parameters if p.status == "identifiable"]
    weak = [p.name for p in plan.parameters if p.status == "weak"]
    parts: list[RenderableType] = [*_subject(plan), "", _steps(plan), "", *_tip(plan)]
    if identifiable:
        parts += ["", parameter_table(identifiable, columns)]
    if plan.groups:
        parts += ["", group_table(plan.groups, columns)]
    parts += listed("weak (the plan tells too little; they stay at nominal)", weak)
    return Group(*parts)


def _subject(plan: Plan) -> Iterator[RenderableType]:
    chain = plan.problem.error.chain
    more = f" beside {plan.measured} measured rows" if plan.measured else ""
    yield Text(
        f"{chain.robot.name}: {len(chain.joints)} joints from {chain.base} to "
        f"{chain.tip}; {plan.problem.measurement.name}, {len(plan.q)} configurations"
        f"{more}",
        style="bold",
    )
    ended = {Status.CONVERGED: "", Status.STOPPED: " (stopped: the best so far)"}
    remark = ended.get(plan.status, f" ({plan.status.value})")
    yield Text(
        f"Found by {plan.method}{remark} from {plan.candidates} candidates of "
        f"{plan.tried} tried.",
        style="dim",
    )
    if plan.assumed_tool:
        yield Text(
            "Where the target sits on the tool is not stated (frames.tool.xyz in a "
            "setup file); it is assumed to be 6 cm beside the tip.",
            style="dim",
        )
    if plan.unseen:
        yield Text(
            f"No configuration can measure {', '.join(plan.unseen)}.", style="bold red"
        )
    if not plan.checked:
        moves = "Collisions are not checked."
    elif plan.blocked:
        rows = ", ".join(str(place + 1) for place in plan.blocked)
        moves = (
            "No configuration collides, but the straight move from the one before does "
            f"for row {rows}: go another way there."
        )
    else:
        moves = "No configuration and no straight move between them collides."
    yield Text(moves, style="dim")


def _steps(plan: Plan) -> RenderableType:
    """The criterion against the number of configurations."""
    name, unit, factor = plan.criterion, "", 1.0
    if name == "prediction":
        unit, factor = DISPLAY["m"]
    columns = [f"{name} [{unit}]" if unit else name]
    columns += [] if name == "prediction" else ["tip error [mm]"]
    result = table("When to stop", columns)
    for step in _chosen_steps(plan):
        label = f"{step.count}"
        if step.count == len(plan.q):
            label += "  this plan"
        cells = [number(factor * step.value)]
        if name != "prediction":
            cells.append(number(1e3 * step.position))
        result.add_row(label, *cells)
    result.add_row(f"{len(plan.q)}  at random", number(factor * plan.random))
    return result


def _chosen_steps(plan: Plan) -> list[Step]:
    """Some of the steps, more closely where there are few configurations."""
    steps = plan.steps
    own = next(k for k, step in enumerate(steps) if step.count == len(plan.q))
    kept = {0, own, len(steps) - 1}
    ratio = (steps[-1].count / max(steps[0].count, 1)) ** (1.0 / (SHOWN - 2))
    wanted = float(steps[0].count)
    for k, step in enumerate(steps):
        if step.count >= wanted:
            kept.add(k)
            wanted = max(step.count + 1.0, step.count * ratio)
    return [steps[k] for k in sorted(kept)]


def _tip(plan: Plan) -> Iterator[RenderableType]:
    predicted, directions = plan.predicted, plan.predicted.directions
    yield Text("What a fit will know", style="bold")
    unit, factor = DISPLAY["rad"]
    quantities = [q.name for q in plan.problem.measurement.quantities]
    tip = f"{number(1e3 * predicted.position)} mm"
    # Without measured orientations the tool's own turn is not known anyway.
    if "orientation" in quantities:
        tip += f", {number(factor * predicted.orientation)} {unit}"
    yield Text(f"  tip error that noise leaves  {tip}   (rms over test poses)")
    remark = ""
    if weak := directions.weak.shape[1]:
        remark = f"   ({weak} directions too weak, left at nominal: their part of the "
        remark += "tip error comes on top)"
    yield Text(
        f"  rank                         {directions.count} of {plan.rank}{remark}"
    )
