"""The report of a plan: what a reader must be able to see in it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import calib_pin
from calib_pin.planning.plan import Plan, Step
from calib_pin.report.plan_text import plan_report
from calib_pin.report.tables import significant
from calib_pin.report.terminal import plain_text
from calib_pin.setup import FrameSetup, Setup
from calib_pin.solvers import Status

SETUP = Setup(tool_frame=FrameSetup((0.05, 0.08, 0.12)))


@pytest.fixture(scope="module")
def plan() -> Plan:
    return calib_pin.plan(
        calib_pin.load_chain("space6"),
        "position",
        14,
        SETUP,
        method="greedy",
        candidates=120,
    )


def text(plan: Plan, **changes: Any) -> str:
    return plain_text(plan_report(replace(plan, **changes)))


def rows(report: str, head: str) -> list[list[str]]:
    """Cells of the lines below a heading, up to the next empty line."""
    lines = report.split(head)[1].splitlines()[1:]
    block = lines[: lines.index("")]
    return [line.split() for line in block]


def test_what_was_planned(plan: Plan) -> None:
    report = text(plan)
    first, second, third, *_ = report.splitlines()
    assert first == (
        "space6: 6 joints from base_link to tool; position, 14 configurations"
    )
    assert second == (
        "Selected by greedy from 120 candidates that meet the constraints, of "
        f"{plan.tried} drawn."
    )
    assert third == "Collisions are not checked."
    assert max(map(len, report.splitlines())) <= 80


def test_rows_that_were_there_before(plan: Plan) -> None:
    assert "14 configurations in addition to 40 measurements" in " ".join(
        text(plan, measured=40).split()
    )
    assert "measure" not in text(plan).splitlines()[0]


@pytest.mark.parametrize(
    ("status", "remark"),
    [
        (Status.CONVERGED, "Selected by greedy from"),
        (Status.STOPPED, "Selected by greedy (stopped: the best so far) from"),
        (Status.ITERATIONS, f"Selected by greedy ({Status.ITERATIONS.value}) from"),
    ],
)
def test_how_the_search_ended(status: Status, remark: str, plan: Plan) -> None:
    assert remark in text(plan, status=status)


@pytest.mark.parametrize(
    ("blocked", "remark"),
    [
        (None, "Collisions are not checked."),
        ((), "No configuration and no straight move between them collides."),
        ((2, 4), "from the one before does for number 3, 5: take a detour"),
    ],
)
def test_collisions(blocked: tuple[int, ...] | None, remark: str, plan: Plan) -> None:
    report = " ".join(text(plan, blocked=blocked).split())
    assert remark in report
    # A plan that was not checked must not look as if it had been.
    assert ("No configuration" in report) == (blocked is not None)


def test_the_criterion_against_the_number(plan: Plan) -> None:
    report = text(plan)
    cells = rows(report, "Accuracy against number of configurations")
    assert cells[0][-1] == "[mm]"
    found = {int(row[0]): float(row[-1]) for row in cells[1:-1]}
    of = {step.count: 1e3 * step.value for step in plan.steps}
    assert all(value == pytest.approx(of[n], abs=6e-5) for n, value in found.items())
    # The fewest, the plan itself and the most are always there.
    assert {plan.steps[0].count, 14, plan.steps[-1].count} <= set(found)
    assert list(found) == sorted(found)
    assert len(found) <= 16
    (own,) = [row for row in cells if row[1:2] == ["planned"]]
    assert int(own[0]) == 14
    assert cells[-1][:3] == ["14", "random", "baseline"]
    assert float(cells[-1][-1]) == pytest.approx(1e3 * plan.random, abs=6e-5)


def test_other_criteria_show_the_tip_as_well(plan: Plan) -> None:
    steps = tuple(Step(n, float(n), 1e-3 / n) for n in range(10, 29))
    report = text(plan, criterion="O1", value=14.0, random=7.5, steps=steps)
    assert "O1" in report and "tool-point uncertainty [mm]" in report
    (own,) = [line for line in report.splitlines() if "planned" in line]
    numbers = [float(cell) for cell in own.split()[2:]]
    assert numbers == [14.0, pytest.approx(1.0 / 14, abs=1e-4)]
    (random,) = [line for line in report.splitlines() if "random baseline" in line]
    assert float(random.split()[3]) == 7.5


def test_a_table_of_very_many_steps_stays_short(plan: Plan) -> None:
    steps = tuple(Step(n, 1.0 / n, 1.0 / n) for n in range(0, 1001) if n)
    report = text(plan, steps=steps)
    shown = [
        line for line in report.splitlines() if line.split()[:1] and line[0].isdigit()
    ]
    assert len(shown) < 30
    assert any(line.startswith("14  planned") for line in shown)


def test_steps_that_begin_with_none(plan: Plan) -> None:
    steps = (Step(0, 2e-4, 2e-4), *plan.steps)
    lines = text(plan, steps=steps).splitlines()
    (line,) = [line for line in lines if line.startswith("0 ")]
    assert line.split() == ["0", "0.2000"]


def test_random_sets_that_determine_nothing(plan: Plan) -> None:
    """Where chance would not do at all there is no number, but no failure either."""
    report = text(plan, random=float("inf"))
    (line,) = [line for line in report.splitlines() if "random baseline" in line]
    assert "nan" not in line


def test_what_a_fit_will_know(plan: Plan) -> None:
    report = text(plan)
    position = f"{1e3 * plan.predicted.position:.4f} mm"
    assert position in report
    assert f"{plan.predicted.rank} of {plan.predicted.rank}" in report
    errors = plan.predicted.robot_errors
    identifiable = [e for e in errors if e.status == "identifiable"]
    assert len(identifiable) == plan.predicted.directions.robot.shape[1]
    lines = report.splitlines()
    for error in identifiable:
        shown = significant(
            {"m": 1e3, "rad": np.degrees(1.0)}[error.unit] * error.sigma
        )
        assert any(error.of[0] in line and shown in line.split() for line in lines)
    assert "std. dev." in report
    # Nothing has been estimated yet.
    assert "value" not in report.split("Expected calibration result")[1]


def test_weak_directions_are_named(plan: Plan) -> None:
    directions = plan.predicted.directions
    weak = replace(
        directions, robot=directions.robot[:, 2:], weak=directions.robot[:, :2]
    )
    parameters = tuple(
        replace(p, status="weak", sigma=None) if k < 9 and k > 6 else p
        for k, p in enumerate(plan.parameters)
    )
    report = text(
        plan, predicted=replace(plan.predicted, directions=weak), parameters=parameters
    )
    said = "(2 weakly observable directions held at nominal:"
    assert said in " ".join(report.split())
    assert f"{plan.predicted.rank - 2} of {plan.predicted.rank}" in report
    assert "weakly observable (held at nominal)" in report
    owner, kind, first = parameters[7].name.split(".")
    second = parameters[8].name.split(".")[2]
    assert report.split("at nominal):")[1].split() == [
        f"{owner}.{kind}.{first}|{second}"
    ]
