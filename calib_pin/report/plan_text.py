"""The report of a plan."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

import numpy as np

from calib_pin.errors import counted
from calib_pin.planning.plan import Plan, Step, sides_of
from calib_pin.report.accuracy import chain_words, model_words
from calib_pin.report.blocks import Block, Cell, Facts, Line, Table, note, table
from calib_pin.report.identification import error_table
from calib_pin.report.tables import ESTIMATE, STATUS, amount, listed, number, quantity
from calib_pin.solvers import Status

SHOWN = 12
"""Lines of the table of accuracy against the number of configurations."""


def plan_report(plan: Plan) -> Iterator[Block]:
    """The plan, its accuracy against the number of configurations, its estimates."""
    more = f" in addition to {counted(plan.measured, 'measurement')}"
    more *= plan.measured > 0
    yield Line(
        f"{chain_words(plan.problem)}; {model_words(plan.problem)}, "
        f"{counted(len(plan.q), 'configuration')}{more}",
        "strong",
    )
    if plan.unmeasurable:
        yield Line(
            f"No configuration can measure {', '.join(plan.unmeasurable)}.", "bad"
        )
    yield from (note(sentence) for sentence in _assumptions(plan))
    yield _steps(plan)
    yield _tip(plan)
    known = [e for e in plan.predicted.robot_errors if e.status == "identifiable"]
    if known:
        yield error_table(known, "Expected errors of the robot", ESTIMATE[1:])
    weak = [p.name for p in plan.parameters if p.status == "weak"]
    yield from listed(f"{STATUS['weak']} (held at nominal)", weak)


def _assumptions(plan: Plan) -> Iterator[str]:
    """How the configurations were chosen, and what they assume."""
    if plan.places:
        shares = Counter(zip(*plan.places.values(), strict=True))
        parts = (f"{n} of {', '.join(filter(None, k))}" for k, n in shares.items())
        yield f"Configurations: {'; '.join(parts)}."
    ended = {Status.CONVERGED: "", Status.STOPPED: " (stopped: the best so far)"}
    remark = ended.get(plan.status, f" ({plan.status.value})")
    yield (
        f"Selected by {plan.method}{remark} from {plan.candidates} candidates that "
        f"meet the constraints, of {plan.tried} drawn."
    )
    if plan.assumed_tool:
        yield (
            "The setup does not say where the target sits on the tool "
            "(frames.tool.xyz); 6 cm beside the tip link is assumed."
        )
    if sides_of(plan):
        yield (
            "Each joint shall come to a configuration from the side that its column "
            "'<joint>.direction' states, by more than its lost motion."
        )
    if plan.blocked is None:
        yield "Collisions are not checked."
    elif plan.blocked:
        numbers = ", ".join(str(place + 1) for place in plan.blocked)
        yield (
            "No configuration collides, but the straight move to it from the one "
            f"before does for number {numbers}: take a detour there."
        )
    else:
        yield "No configuration and no straight move between them collides."


def _steps(plan: Plan) -> Table:
    """The criterion and the tool-point uncertainty by number of configurations."""
    predicted = plan.criterion == "prediction"
    titles = [*[plan.criterion][: not predicted], "tool-point uncertainty [mm]"]

    def criterion(value: float) -> Cell:
        return quantity(value, "m") if predicted else Cell(number(value), value)

    rows = []
    for step in _chosen_steps(plan):
        label = f"{step.count}{'  planned' * (step.count == len(plan.q))}"
        cells = [criterion(step.value), quantity(step.position, "m")]
        rows.append([label, *cells[: len(titles)]])
    random = [f"{len(plan.q)}  random baseline", criterion(plan.random), ""]
    rows.append(random[: 1 + len(titles)])
    return table("Accuracy against number of configurations", ("", *titles), rows)


def _chosen_steps(plan: Plan) -> list[Step]:
    """Some of the steps, more closely where there are few configurations."""
    counts = [step.count for step in plan.steps]
    wanted = np.geomspace(max(counts[0], 1), counts[-1], SHOWN - 2).round()
    indices = {0, counts.index(len(plan.q)), *np.searchsorted(counts, wanted).tolist()}
    return [plan.steps[k] for k in sorted(indices)]


def _tip(plan: Plan) -> Facts:
    predicted, directions = plan.predicted, plan.predicted.directions
    terms = plan.problem.terms.values()
    quantities = {q.name for term in terms for q in term.measurement.quantities}
    tip = amount(predicted.position, "m")
    # Without measured orientations the tool's orientation is not known anyway.
    if "orientation" in quantities:
        tip += f", {amount(predicted.orientation, 'rad')}"
    remark = ""
    if weak := directions.weak.shape[1]:
        remark = f"   ({weak} weakly observable directions held at nominal: their "
        remark += "error comes on top)"
    facts = {
        "predicted tool-point uncertainty": f"{tip}   (1 sigma, rms over test poses)",
        "rank": f"{directions.count} of {plan.predicted.rank}{remark}",
    }
    return Facts("Expected calibration result", [*facts.items()])
